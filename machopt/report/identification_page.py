"""The page of ``machopt identify``: which joints the data see, how well, and what to distrust."""

from __future__ import annotations

import math
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from machopt.report.display import fixed
from machopt.report.identification import Coefficient, GridView, IdentificationPage, SubsetStudy
from machopt.report.series import numbers
from machopt.report.shell import page_html, section
from machopt.report.tables import Column, folded, table
from machopt.report.template import part

if TYPE_CHECKING:
    from markupsafe import Markup

    Body = Markup | str

Spec = dict[str, Any]  # JSON for assets/xy.js

ARCMIN = np.pi / 180 / 60
AXES = (("x", "#1552b8"), ("y", "#d9730d"), ("z", "#2c8a57"))
JOINTS = ("#1552b8", "#d9730d", "#2c8a57", "#8a3fb0", "#b3261e", "#5b6673")
CHI2_90 = 4.605  # 90 % of a two-dimensional normal
MOST_POINTS = 4000  # readings drawn; the files hold all
ELLIPSES = 6
MOST_HALF = 100.0  # %


def write_identification(path: Path, data: IdentificationPage) -> None:
    """Write the page.

    Args:
        path: the HTML file.
        data: what to show; parts that are missing leave no gap.
    """
    path.write_text(identification_html(data), encoding="utf-8", newline="\n")


def identification_html(data: IdentificationPage) -> str:
    """The page as text; the same data give the same bytes."""
    charts = _charts(data)
    have = {c["id"] for c in charts}
    sections = [
        ("verdict", "Verdict", _verdict(data)),
        ("joints", "Joints", _joints(data, have)),
        ("fit", "Measured and predicted", _fit(data, have)),
        ("uncertainty", "Uncertainty", _uncertainty(data, have)),
        ("grid", "Grid", _grid(data, have)),
        ("models", "Models", _models(data)),
        ("readings", "Readings", _readings(data)),
        ("run", "This run", _run(data)),
    ]
    return page_html(
        data.title,
        (("Cell", data.cell), ("Recording", data.recording)),
        sections,
        {"xy": charts},
        scripts=("chart.js", "xy.js", "start_xy.js"),
        footer=f"machopt {data.version}. Lengths mm, angles mrad, stiffness N·m/rad. Bars of "
        f"stiffness are {100 * data.level:g} % intervals, ellipses 90 % regions. Click a legend entry to hide it.",
    )


def stiffness_text(k: float, digits: int = 3) -> str:
    """N·m/rad with so many digits: 3.80e6."""
    if not math.isfinite(k):
        return "∞" if k > 0 else "–"
    if k < 1e4:
        return f"{k:.0f}" if k >= 1e3 else f"{k:.{digits}g}"
    return f"{k / 10 ** math.floor(math.log10(k)):.{digits - 1}f}e{math.floor(math.log10(k))}"


def _verdict(data: IdentificationPage) -> Body:
    explained = 1.0 - (data.heldout_rmse / data.displacement) ** 2 if data.displacement > 0 else math.nan
    cards = [
        ("Held-out error", f"{data.heldout_rmse * 1e3:.3f}", "mm", "rms per axis, poses the fit did not see"),
        ("Fit error", f"{data.rmse * 1e3:.3f}", "mm", "rms per axis"),
        ("Measured", f"{data.displacement * 1e3:.3f}", "mm", "rms displacement per axis"),
        ("Explained", f"{100 * explained:.1f}" if math.isfinite(explained) else "–", "%", "of the held-out power"),
        ("Condition number", f"{data.condition_number:.1f}", "", "of the scaled design"),
        ("Readings", str(len(data.measured)), "", f"{len(np.unique(data.pose))} poses"),
    ]
    return part("verdict", "verdict", data.tone, data.badge, data.sentence, data.cautions, cards)


def _coefficient_rows(rows: tuple[Coefficient, ...], *, arcmin: bool) -> list[list[Body]]:
    out = []
    for c in rows:
        spread = f"{stiffness_text(c.low, 4)} … {stiffness_text(c.high, 4)}"
        half = 50.0 * (c.high - c.low) / c.value if math.isfinite(c.high) and c.value else math.nan
        half = half if half <= MOST_HALF else math.nan  # so wide that the two sides are nothing alike
        name = c.name.replace(" ", "\u00a0", 1)  # "joint 1" on one line
        out.append(
            [
                name,
                stiffness_text(c.value),
                *([f"{c.value * ARCMIN:.0f}"] if arcmin else [c.unit]),
                spread,
                f"± {half:.1f} %" if math.isfinite(half) else "–",
                stiffness_text(c.prior),
                part("toned", "pass", "yes") if c.identified else part("toned", "fail", "no"),
                c.reason,
            ]
        )
    return out


def _joints(data: IdentificationPage, have: set[str]) -> Body:
    columns = [
        Column("Joint"),
        Column("k (N·m/rad)", "n"),
        Column("N·m/arcmin", "n"),
        Column(f"{100 * data.level:g} % interval", "n"),
        Column("Half of it", "n"),
        Column("Before (N·m/rad)", "n"),
        Column("Identified", "html"),
        Column("Why", "why"),
    ]
    body: Body = table(columns, _coefficient_rows(data.joints, arcmin=True))
    if data.terms:
        columns = [Column("Further physics"), Column("Value", "n"), Column("Unit"), *columns[3:]]
        body += table(columns, _coefficient_rows(data.terms, arcmin=False))
    body += _host("i-joints", have)
    lead = (
        "A joint that no reading loads, or whose effect cannot be told from another's, is not fitted to noise: it is "
        "marked, and keeps the value it had before or a stated bound."
    )
    return section("joints", "Joint stiffness", lead, body)


def _fit(data: IdentificationPage, have: set[str]) -> Body:
    both = [part("chart", name) for name in ("i-parity", "i-parity-rot") if name in have]
    body: Body = part("grid", 2, both) if "i-parity-rot" in have else both[0]
    body += _host("i-residual", have) + _host("i-residual-rot", have)
    body += part("grid", 2, [_host("i-load", have), _host("i-heldout", have)])
    lead = "Points on the diagonal are explained; the bars are the standard uncertainty of the reading."
    return section("fit", "Measured and predicted", lead, body)


def _uncertainty(data: IdentificationPage, have: set[str]) -> Body:
    body: Body = ""
    for name, count, title in (
        ("i-ellipse", ELLIPSES, "Pairs of joints with the strongest correlation, 90 % ellipses of the compliances"),
        ("i-subset", 6, "Random subsets of the tests: median and 5–95 % of the identified stiffness"),
    ):
        small = [part("chart", f"{name}{n}") for n in range(count) if f"{name}{n}" in have]
        body += part("heading", title) + part("grid", 3, small) if small else ""
    if data.monte_carlo is not None:
        rows = [
            [c.name, f"± {100 * s:.1f} %" if math.isfinite(s) else "–"]
            for c, s in zip(data.joints, data.monte_carlo, strict=True)
        ]
        body += part("heading", "Repeated with measurement errors drawn anew: one standard deviation of the stiffness")
        body += table([Column("Joint"), Column("Spread", "n")], rows)
    return section("uncertainty", "Uncertainty", "What other readings of the same quality would have given.", body)


def _grid(data: IdentificationPage, have: set[str]) -> Body:
    if data.grid is None:
        return ""
    small = [_host(f"i-grid{j}", have) for j in range(6)]
    g = data.grid
    rows = [
        [
            str(n),
            *(f"{v * 1e3:.0f}" for v in g.centre[n]),
            f"{g.readings[n]:.1f}",
            *(f"{stiffness_text(g.k[n, j])} ± {100 * g.std[n, j] / g.k[n, j]:.0f} %" for j in range(6)),
        ]
        for n in range(len(g.k))
    ]
    columns = [
        Column("Cell", "n"),
        *(Column(f"{a} (mm)", "n") for a in "xyz"),
        Column("Readings", "n"),
        *(Column(f"k{j + 1}", "n") for j in range(6)),
    ]
    body = part("grid", 3, small) + folded("Cells", len(rows), table(columns, rows))
    lead = (
        f"{g.shape[0]} × {g.shape[1]} × {g.shape[2]} cells. A cell with few readings stays near the constant value "
        "(dashed) and its bar grows to the spread found between cells."
    )
    return section("grid", "Stiffness per grid cell", lead, body)


def _models(data: IdentificationPage) -> Body:
    if not data.comparisons:
        return ""
    rows = [
        [c.name, str(c.coefficients), f"{c.rmse * 1e3:.4f}", f"{c.heldout * 1e3:.4f}", "taken" if c.chosen else ""]
        for c in data.comparisons
    ]
    columns = [
        Column("Model"),
        Column("Unknowns", "n"),
        Column("Fit error (mm)", "n"),
        Column("Held-out error (mm)", "n"),
        Column("Verdict"),
    ]
    return section("models", "Models tried", "Judged by poses they did not see.", table(columns, rows))


def _readings(data: IdentificationPage) -> Body:
    residual = data.measured - data.predicted
    shown = np.abs(residual[:, :3] / data.sigma[:, :3]).max(axis=1)
    order = np.argsort(-shown, kind="stable")[:60]
    rows = [
        [
            str(data.line[n]),
            str(data.pose[n]),
            f"{data.load[n]:.0f}",
            *(fixed(float(data.measured[n, a]) * 1e3, 3) for a in range(3)),
            *(fixed(float(residual[n, a]) * 1e3, 3, signed=True) for a in range(3)),
            f"{shown[n]:.1f}",
            fixed(float(data.leverage[n]), 2),
            "left out as an outlier" if data.outlier[n] else "",
        ]
        for n in order
    ]
    columns = [
        Column("Line", "n"),
        Column("Pose", "n"),
        Column("Force (N)", "n"),
        Column("dx (mm)", "n"),
        Column("dy", "n"),
        Column("dz", "n"),
        Column("residual x (mm)", "n"),
        Column("y", "n"),
        Column("z", "n"),
        Column("largest / σ", "n"),
        Column("Leverage", "n"),
        Column("Note"),
    ]
    lead = "The readings that fit worst, with the line of the data file each stands on."
    return section("readings", "Readings", lead, table(columns, rows))


def _run(data: IdentificationPage) -> Body:
    body = table([Column("What"), Column("Value")], data.facts) if data.facts else ""
    return section("run", "This run", "What it was made from, with what settings.", body)


def _host(name: str, have: set[str]) -> Body:
    return part("chart", name) if name in have else ""


def _charts(data: IdentificationPage) -> list[Spec]:
    charts = [_forest(data.joints, data.level), _parity(data, 0), _residual(data, 0), _over_load(data)]
    if data.measured.shape[1] == 6:
        charts += [_parity(data, 3), _residual(data, 3)]
    charts += _ellipses(data)
    if np.isfinite(data.heldout).any():
        charts.append(_heldout(data))
    if data.subset is not None:
        charts += [_subset(data.subset, j) for j in range(6) if np.isfinite(data.subset.median[:, j]).any()]
    if data.grid is not None:
        charts += [_grid_chart(data.grid, j) for j in range(6)]
    return charts


def _forest(joints: tuple[Coefficient, ...], level: float) -> Spec:
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
            "x": numbers(np.array([c.prior for c in joints])),
            "y": numbers(at + 0.22),
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
                    "x": numbers(k[pick]),
                    "y": numbers(at[pick]),
                    "xlo": numbers(np.array([max(joints[n].low, 1.0) for n in pick])),
                    "xhi": numbers(np.where(np.isfinite(high[pick]), high[pick], top)),
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
        "left": 70,
        "height": 40 + 34 * len(joints),
        "layers": layers,
    }


def _pick(n: int) -> NDArray[np.intp]:
    return np.unique(np.linspace(0, n - 1, min(n, MOST_POINTS)).round().astype(int))


def _labels(data: IdentificationPage, rows: NDArray[np.intp]) -> list[list[list[str]]]:
    return [
        [["pose", str(data.pose[n])], ["line", str(data.line[n])], ["force", f"{data.load[n]:.0f} N"]] for n in rows
    ]


def _parity(data: IdentificationPage, first: int) -> Spec:
    rows, unit = _pick(len(data.measured)), "mrad" if first else "mm"
    labels = _labels(data, rows)
    both = 1e3 * np.concatenate([data.measured[rows, first : first + 3], data.predicted[rows, first : first + 3]])
    ends = [float(both.min()), float(both.max())]
    layers: list[Spec] = [{"type": "line", "color": "#7a8490", "dash": "5 4", "x": ends, "y": ends}]
    for a, (name, color) in enumerate(AXES):
        m, p, s = (1e3 * v[rows, first + a] for v in (data.measured, data.predicted, data.sigma))
        layers.append(
            {
                "type": "points",
                "name": f"{'r' if first else 'd'}{name}",
                "color": color,
                "labels": labels,
                "x": numbers(p),
                "y": numbers(m),
                "lo": numbers(m - s),
                "hi": numbers(m + s),
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


def _residual(data: IdentificationPage, first: int) -> Spec:
    rows, unit = _pick(len(data.measured)), "mrad" if first else "mm"
    poses, at = np.unique(data.pose[rows], return_inverse=True)
    labels = _labels(data, rows)
    layers: list[Spec] = []
    for a, (name, color) in enumerate(AXES):
        r = 1e3 * (data.measured - data.predicted)[rows, first + a]
        s = 1e3 * data.sigma[rows, first + a]
        layers.append(
            {
                "type": "points",
                "name": f"{'r' if first else 'd'}{name}",
                "color": color,
                "size": 2.4,
                "x": numbers(np.asarray(at, float) + 0.22 * (a - 1)),
                "y": numbers(r),
                "lo": numbers(r - s),
                "hi": numbers(r + s),
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


def _over_load(data: IdentificationPage) -> Spec:
    rows = _pick(len(data.measured))
    labels = _labels(data, rows)
    r = 1e3 * (data.measured - data.predicted)[rows]
    layers: list[Spec] = [
        {
            "type": "points",
            "name": f"d{name}",
            "color": color,
            "size": 2.4,
            "x": numbers(data.load[rows]),
            "y": numbers(r[:, a]),
            "labels": labels,
        }
        for a, (name, color) in enumerate(AXES)
    ]
    return {
        "id": "i-load",
        "title": "Residual over load",
        "xlabel": "Force (N)",
        "ylabel": "Residual (mm)",
        "hlines": [{"y": 0, "class": "axis", "fit": True}],
        "layers": layers,
    }


def _heldout(data: IdentificationPage) -> Spec:
    rows = _pick(len(data.measured))
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
                "x": numbers(size),
                "y": numbers(error),
                "labels": _labels(data, rows),
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


def _ellipses(data: IdentificationPage) -> list[Spec]:
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
    for n, (_, i, j) in enumerate(sorted(pairs, key=lambda p: (-p[0], p[1], p[2]))[:ELLIPSES]):
        S = data.covariance[np.ix_([i, j], [i, j])]
        w, V = np.linalg.eigh(S)
        ring = V @ (np.sqrt(CHI2_90 * np.maximum(w, 0.0))[:, None] * np.stack([np.cos(t), np.sin(t)]))
        c = data.compliances[[i, j]]
        layers: list[Spec] = [
            {
                "type": "line",
                "name": "90 %",
                "color": "#1552b8",
                "x": numbers(1e6 * (c[0] + ring[0])),
                "y": numbers(1e6 * (c[1] + ring[1])),
            },
            {
                "type": "points",
                "name": "identified",
                "color": "#1552b8",
                "size": 3,
                "legend": False,
                "x": numbers(1e6 * c[:1]),
                "y": numbers(1e6 * c[1:]),
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


def _subset(study: SubsetStudy, j: int) -> Spec:
    x = numbers(study.tests.astype(float))
    layers: list[Spec] = [
        {
            "type": "band",
            "color": JOINTS[j],
            "x": x,
            "y": x,
            "lo": numbers(study.low[:, j]),
            "hi": numbers(study.high[:, j]),
        },
        {"type": "line", "color": JOINTS[j], "x": x, "y": numbers(study.median[:, j])},
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


def _grid_chart(g: GridView, j: int) -> Spec:
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
            "color": JOINTS[j],
            "size": 2.6,
            "x": numbers(at),
            "y": numbers(g.k[:, j]),
            "lo": numbers(g.k[:, j] - 1.645 * g.std[:, j]),
            "hi": numbers(g.k[:, j] + 1.645 * g.std[:, j]),
            "labels": labels,
        },
    ]
    return {"id": f"i-grid{j}", "title": f"Joint {j + 1} (N·m/rad)", "xlabel": "Cell", "height": 200, "layers": layers}
