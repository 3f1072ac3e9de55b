"""Chart specifications of the pose plan page, for assets/xy.js."""

from __future__ import annotations

import math
from typing import Any

import numpy as np

from machopt.numerics.array_types import Array
from machopt.report.charts.point_reduction import round_for_json
from machopt.report.page_types.pose_plan_page_data import PosePlanPageData

Spec = dict[str, Any]  # JSON for assets/xy.js

PLAN_COLOR = "#1552b8"
COLORS = {"random": "#7a8490", "dumas2011": "#d9730d", "zhang2025": "#2c8a57", "jiao2022": "#8a3fb0"}
BAR_WIDTH = 0.15  # of a category's width


def build_uncertainty_chart(data: PosePlanPageData) -> Spec:
    """Return the chart of the expected 1 σ of each unknown, with the published rules for comparison.

    Args:
        data: The data of the page.
    """
    shown = np.flatnonzero(data.relative)
    entries = [("this plan", data.sigma, PLAN_COLOR), *((h.name, h.sigma, COLORS[h.name]) for h in data.heuristics)]
    layers: list[Spec] = []
    for n, (name, sigma, color) in enumerate(entries):
        at = np.arange(len(shown), dtype=float) + BAR_WIDTH * (n - (len(entries) - 1) / 2)
        value = np.asarray(100 * sigma[shown], float)
        seen = np.isfinite(value)
        layers.append(
            {
                "type": "points",
                "name": name,
                "color": color,
                "size": 0.1,
                "bar": 16,
                "x": round_for_json(at[seen]),
                "y": round_for_json(value[seen]),
                "lo": [0.0] * int(seen.sum()),
                "hi": round_for_json(value[seen]),
                "labels": [[["unknown", data.unknowns[p]]] for p in shown[seen]],
            }
        )
    lines = [{"y": 100 * data.target, "fit": False}] if math.isfinite(data.target) else []
    return {
        "id": "p-bars",
        "title": "Expected standard uncertainty of each joint's stiffness",
        "ymin": 0,
        "height": 270,
        "ylabel": "1 σ (% of the stiffness)",
        "yname": "1 σ (%)",
        "xcats": [data.unknowns[p] for p in shown],
        "hlines": lines,
        "layers": layers,
    }


def build_pose_count_chart(data: PosePlanPageData) -> Spec:
    """Return the chart of the expected 1 σ over the number of poses.

    Args:
        data: The data of the page.
    """
    x = np.array(data.curve_poses, float) * data.per_pose
    layers: list[Spec] = [
        {
            "type": "line",
            "name": h.name,
            "color": COLORS[h.name],
            "dash": "5 4",
            "x": round_for_json(x),
            "y": round_for_json(100 * h.curve),
        }
        for h in data.heuristics
    ]
    layers.append(
        {
            "type": "line",
            "name": "this plan",
            "color": PLAN_COLOR,
            "width": 2.4,
            "x": round_for_json(x),
            "y": round_for_json(100 * data.curve),
        }
    )
    layers.append(
        {
            "type": "points",
            "color": PLAN_COLOR,
            "x": round_for_json(x),
            "y": round_for_json(100 * data.curve),
            "legend": False,
        }
    )
    return {
        "id": "p-curve",
        "title": "Root mean square uncertainty over the number of readings",
        "xlog": True,
        "ylog": True,
        "xlabel": "Readings",
        "ylabel": "rms 1 σ (%)",
        "height": 260,
        "layers": layers,
    }


def build_arm_views(data: PosePlanPageData) -> list[Spec]:
    """Return the arm from above (x, y), and from the side: height over the distance from axis z of base_link.

    Args:
        data: The data of the page.
    """
    mm = 1e3
    cloud, arms = data.cloud * mm, data.arms * mm
    heading = arms[:, -1, :2]
    far = np.linalg.norm(heading, axis=1, keepdims=True)
    heading = heading / np.where(far > 0.0, far, 1.0)
    along = np.einsum("bkc,bc->bk", arms[:, :, :2], heading)  # each arm turned into the plane of its own TCP
    views = [
        ("p-top", "From above", "x (mm)", "y (mm)", cloud[:, 0], cloud[:, 1], arms[:, :, 0], arms[:, :, 1]),
        (
            "p-side",
            "From the side, each arm in the plane of its TCP",
            "Distance from the base's z axis (mm)",
            "z (mm)",
            np.linalg.norm(cloud[:, :2], axis=1),
            cloud[:, 2],
            along,
            arms[:, :, 2],
        ),
    ]
    frame: Spec = {"equal": True, "height": 510}
    return [
        {"id": name, "title": title, "xlabel": xlabel, "ylabel": ylabel, **frame, "layers": _build_arm_layers(*data_xy)}
        for name, title, xlabel, ylabel, *data_xy in views
    ]


def _build_arm_layers(cloud_x: Array, cloud_y: Array, arm_x: Array, arm_y: Array) -> list[Spec]:
    """Candidates (C,), arms (B, K) as lines through their axes, and the chosen TCPs at their ends."""
    grey: Spec = {"type": "points", "name": "candidates", "color": "#c3c9d1", "size": 1.4}
    lines: Spec = {"type": "line", "name": "arms", "color": "#d9730d", "width": 1.1}
    chosen: Spec = {"type": "points", "name": "chosen", "color": PLAN_COLOR, "size": 4}
    labels = [[["pose", str(n + 1)]] for n in range(len(arm_x))]
    ends = {"x": round_for_json(arm_x[:, -1], 5), "y": round_for_json(arm_y[:, -1], 5)}
    return [
        {**grey, "x": round_for_json(cloud_x, 4), "y": round_for_json(cloud_y, 4)},
        {**lines, "x": _join_with_gaps(arm_x), "y": _join_with_gaps(arm_y)},
        {**chosen, **ends, "labels": labels},
    ]


def _join_with_gaps(rows: Array) -> list[float | None]:
    """Rows of points as one list, a gap after each."""
    return [v for row in rows for v in [*round_for_json(row, 5), None]]
