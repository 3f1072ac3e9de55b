"""Chart specifications of the page of ``machopt identify``, for assets/xy.js."""

from __future__ import annotations

import math
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from machopt.report.charts.point_reduction import round_for_json
from machopt.report.page_types.identification_page_data import (
    IdentificationPageData,
    IdentifiedCoefficient,
    StiffnessGridView,
    SubsetSpread,
)

if TYPE_CHECKING:
    from markupsafe import Markup

    Body = Markup | str

Spec = dict[str, Any]  # JSON for assets/xy.js

ARCMIN = np.pi / 180 / 60
AXIS_COLORS = (("x", "#1552b8"), ("y", "#d9730d"), ("z", "#2c8a57"))
JOINT_COLORS = ("#1552b8", "#d9730d", "#2c8a57", "#8a3fb0", "#b3261e", "#5b6673")
CHI2_90 = 4.605  # 90 % of a two-dimensional normal
MAX_POINTS = 4000  # readings drawn; the files hold all
MAX_ELLIPSES = 6
MAX_HALF_WIDTH = 100.0  # %


def build_identification_charts(data: IdentificationPageData) -> list[Spec]:
    """Return all charts of the page.

    Args:
        data: The data of the page.
    """
    charts = [
        _build_forest_chart(data.joints, data.level),
        _build_parity_chart(data, 0),
        _build_residual_chart(data, 0),
        _build_load_chart(data),
    ]
    if data.measured.shape[1] == 6:
        charts += [_build_parity_chart(data, 3), _build_residual_chart(data, 3)]
    charts += _build_ellipse_charts(data)
    if np.isfinite(data.heldout).any():
        charts.append(_build_holdout_chart(data))
    if data.subset is not None:
        charts += [
            _build_subset_chart(data.subset, j)
            for j in range(data.subset.median.shape[1])
            if np.isfinite(data.subset.median[:, j]).any()
        ]
    if data.grid is not None:
        charts += [_build_grid_chart(data.grid, j) for j in range(data.grid.k.shape[1])]
    return charts


def _build_forest_chart(joints: tuple[IdentifiedCoefficient, ...], level: float) -> Spec:
    at = np.arange(len(joints), dtype=float)[::-1]  # joint 1 on top
    k = np.array([c.value for c in joints])
    high = np.array([c.high for c in joints])
    top = 3.0 * np.nanmax(k)
    layers: list[Spec] = [
        {
            "type": "points",
            "name": "before",
            "color": "#7a8490",
            "mark": "diamond",
            "size": 4,
            "hollow": True,
            "x": round_for_json(np.array([c.prior for c in joints])),
            "y": round_for_json(at + 0.22),
        }
    ]
    for seen, name, color in ((True, "identified", "#1552b8"), (False, "not seen by the data", "#b3261e")):
        pick = [n for n, c in enumerate(joints) if c.identified is seen]
        if pick:
            layers.append(
                {
                    "type": "points",
                    "name": name,
                    "color": color,
                    "size": 4,
                    "bar": 3,
                    "hollow": not seen,
                    "x": round_for_json(k[pick]),
                    "y": round_for_json(at[pick]),
                    "xlo": round_for_json(np.array([max(joints[n].low, 1.0) for n in pick])),
                    "xhi": round_for_json(np.where(np.isfinite(high[pick]), high[pick], top)),
                    "labels": [[["joint", joints[n].name]] for n in pick],
                }
            )
    return {
        "id": "i-joints",
        "title": f"{100 * level:g} % intervals",
        "xlog": True,
        "xlabel": "Stiffness (N·m/rad)",
        "ylabel": "Joint",
        "ycats": [c.name for c in reversed(joints)],
        "height": 40 + 34 * len(joints),
        "layers": layers,
    }


def _select_points(n: int) -> NDArray[np.intp]:
    return np.unique(np.linspace(0, n - 1, min(n, MAX_POINTS)).round().astype(int))


def _build_labels(data: IdentificationPageData, rows: NDArray[np.intp]) -> list[list[list[str]]]:
    return [
        [["pose", str(data.pose[n])], ["line", str(data.line[n])], ["force", f"{data.load[n]:.0f} N"]] for n in rows
    ]


def _build_parity_chart(data: IdentificationPageData, first: int) -> Spec:
    rows, unit = _select_points(len(data.measured)), "mrad" if first else "mm"
    labels = _build_labels(data, rows)
    both = 1e3 * np.concatenate([data.measured[rows, first : first + 3], data.predicted[rows, first : first + 3]])
    ends = [float(both.min()), float(both.max())]
    layers: list[Spec] = [{"type": "line", "color": "#7a8490", "dash": "5 4", "x": ends, "y": ends}]
    for a, (name, color) in enumerate(AXIS_COLORS):
        m, p, s = (1e3 * v[rows, first + a] for v in (data.measured, data.predicted, data.sigma))
        layers.append(
            {
                "type": "points",
                "name": f"{'r' if first else 'd'}{name}",
                "color": color,
                "labels": labels,
                "x": round_for_json(p),
                "y": round_for_json(m),
                "lo": round_for_json(m - s),
                "hi": round_for_json(m + s),
            }
        )
    what = "rotation" if first else "displacement"
    return {
        "id": "i-parity-rot" if first else "i-parity",
        "title": f"Measured against predicted {what}",
        "xlabel": f"Predicted ({unit})",
        "ylabel": f"Measured ({unit})",
        "equal": True,
        "height": 380,
        "layers": layers,
    }


def _build_residual_chart(data: IdentificationPageData, first: int) -> Spec:
    rows, unit = _select_points(len(data.measured)), "mrad" if first else "mm"
    poses, at = np.unique(data.pose[rows], return_inverse=True)
    labels = _build_labels(data, rows)
    layers: list[Spec] = []
    for a, (name, color) in enumerate(AXIS_COLORS):
        r = 1e3 * (data.measured - data.predicted)[rows, first + a]
        s = 1e3 * data.sigma[rows, first + a]
        layers.append(
            {
                "type": "points",
                "name": f"{'r' if first else 'd'}{name}",
                "color": color,
                "size": 2.4,
                "x": round_for_json(np.asarray(at, float) + 0.22 * (a - 1)),
                "y": round_for_json(r),
                "lo": round_for_json(r - s),
                "hi": round_for_json(r + s),
                "labels": labels,
            }
        )
    return {
        "id": "i-residual-rot" if first else "i-residual",
        "title": f"Residual per pose ({unit})",
        "height": 250,
        "xlabel": "Pose",
        "ylabel": f"Measured − predicted ({unit})",
        "xcats": [str(p) for p in poses],
        "hlines": [{"y": 0, "class": "axis", "fit": True}],
        "layers": layers,
    }


def _build_load_chart(data: IdentificationPageData) -> Spec:
    rows = _select_points(len(data.measured))
    labels = _build_labels(data, rows)
    r = 1e3 * (data.measured - data.predicted)[rows]
    layers: list[Spec] = [
        {
            "type": "points",
            "name": f"d{name}",
            "color": color,
            "size": 2.4,
            "x": round_for_json(data.load[rows]),
            "y": round_for_json(r[:, a]),
            "labels": labels,
        }
        for a, (name, color) in enumerate(AXIS_COLORS)
    ]
    return {
        "id": "i-load",
        "title": "Residual over load",
        "xlabel": "Force (N)",
        "ylabel": "Residual (mm)",
        "hlines": [{"y": 0, "class": "axis", "fit": True}],
        "layers": layers,
    }


def _build_holdout_chart(data: IdentificationPageData) -> Spec:
    rows = _select_points(len(data.measured))
    size = 1e3 * np.linalg.norm(data.measured[rows, :3], axis=1)
    layers: list[Spec] = []
    for name, values, color, hollow in (
        ("fit", data.predicted, "#1552b8", False),
        ("pose left out", data.heldout, "#d9730d", True),
    ):
        error = 1e3 * np.linalg.norm((data.measured - values)[rows, :3], axis=1)
        layers.append(
            {
                "type": "points",
                "name": name,
                "color": color,
                "hollow": hollow,
                "size": 2.6,
                "x": round_for_json(size),
                "y": round_for_json(error),
                "labels": _build_labels(data, rows),
            }
        )
    return {
        "id": "i-heldout",
        "title": "Size of the error, fitted and with the pose left out",
        "ymin": 0,
        "xlabel": "Measured displacement (mm)",
        "ylabel": "Error (mm)",
        "layers": layers,
    }


def _build_ellipse_charts(data: IdentificationPageData) -> list[Spec]:
    """Pairs of identified joints in the order of their correlation."""
    seen = [j for j, c in enumerate(data.joints) if c.identified]
    sigma = np.sqrt(np.diag(data.covariance))
    pairs = [
        (abs(data.covariance[i, j]) / (sigma[i] * sigma[j]), i, j)
        for i in seen
        for j in seen
        if i < j and sigma[i] > 0 and sigma[j] > 0
    ]
    out = []
    t = np.linspace(0.0, 2 * np.pi, 61)
    for n, (_, i, j) in enumerate(sorted(pairs, key=lambda p: (-p[0], p[1], p[2]))[:MAX_ELLIPSES]):
        S = data.covariance[np.ix_([i, j], [i, j])]
        w, V = np.linalg.eigh(S)
        ring = V @ (np.sqrt(CHI2_90 * np.maximum(w, 0.0))[:, None] * np.stack([np.cos(t), np.sin(t)]))
        c = data.compliances[[i, j]]
        layers: list[Spec] = [
            {
                "type": "line",
                "name": "90 %",
                "color": "#1552b8",
                "x": round_for_json(1e6 * (c[0] + ring[0])),
                "y": round_for_json(1e6 * (c[1] + ring[1])),
            },
            {
                "type": "points",
                "name": "identified",
                "color": "#1552b8",
                "size": 3,
                "legend": False,
                "x": round_for_json(1e6 * c[:1]),
                "y": round_for_json(1e6 * c[1:]),
            },
        ]
        r = S[0, 1] / math.sqrt(S[0, 0] * S[1, 1])
        out.append(
            {
                "id": f"i-ellipse{n}",
                "title": f"Joints {i + 1} and {j + 1}: correlation {r:+.2f}".replace("-", "−"),
                "xlabel": f"c{i + 1} (µrad/(N·m))",
                "ylabel": f"c{j + 1} (µrad/(N·m))",
                "height": 230,
                "layers": layers,
            }
        )
    return out


def _build_subset_chart(study: SubsetSpread, j: int) -> Spec:
    x = round_for_json(study.tests.astype(float))
    layers: list[Spec] = [
        {
            "type": "band",
            "color": JOINT_COLORS[j],
            "x": x,
            "y": x,
            "lo": round_for_json(study.low[:, j]),
            "hi": round_for_json(study.high[:, j]),
        },
        {"type": "line", "color": JOINT_COLORS[j], "x": x, "y": round_for_json(study.median[:, j])},
    ]
    layers[0]["y"] = layers[1]["y"]
    return {
        "id": f"i-subset{j}",
        "title": f"Joint {j + 1}",
        "xlabel": "Tests",
        "ylabel": "k (N·m/rad)",
        "ylog": True,
        "height": 190,
        "layers": layers,
    }


def _build_grid_chart(g: StiffnessGridView, j: int) -> Spec:
    at = np.arange(len(g.k), dtype=float)
    labels = [
        [
            ["cell", str(n)],
            ["centre (mm)", ", ".join(f"{v * 1e3:.0f}" for v in g.centre[n])],
            ["readings", f"{g.readings[n]:.1f}"],
        ]
        for n in range(len(g.k))
    ]
    layers: list[Spec] = [
        {
            "type": "line",
            "color": "#7a8490",
            "dash": "5 4",
            "x": [0.0, max(len(g.k) - 1.0, 1e-3)],
            "y": [float(g.constant[j])] * 2,
        },
        {
            "type": "points",
            "name": f"joint {j + 1}",
            "color": JOINT_COLORS[j],
            "size": 2.6,
            "x": round_for_json(at),
            "y": round_for_json(g.k[:, j]),
            "lo": round_for_json(g.k[:, j] - 1.645 * g.std[:, j]),
            "hi": round_for_json(g.k[:, j] + 1.645 * g.std[:, j]),
            "labels": labels,
        },
    ]
    return {"id": f"i-grid{j}", "title": f"Joint {j + 1} (N·m/rad)", "xlabel": "Cell", "height": 200, "layers": layers}
