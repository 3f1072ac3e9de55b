"""Charts of the motion over time: feed in the cut, joint angles, and their shares of the limits."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from machopt.numerics.array_types import Array
from machopt.report.charts.chart_colours import CHOSEN, DEFAULT, FOURTH, JIAO, Spec
from machopt.report.charts.point_reduction import round_for_json, select_deepest_dips, select_plot_points
from machopt.report.page_types.display_units import ANGLE, FEED, LENGTH
from machopt.report.page_types.optimize_page_data import FeedDipRow, MotionSeries

_SMALL = 1200  # points in one of the small pictures
_PEAKS = 400  # stretches of time whose peak share of a limit is shown

MAX_MARKS = 200  # most dips marked in the picture


def build_motion_charts(m: MotionSeries, dips: tuple[FeedDipRow, ...]) -> list[Spec]:
    """Build the charts of the motion over time.

    Args:
        m: Motion over time, in SI units.
        dips: Places where the feed is below the programmed one.

    Returns:
        One specification per chart.
    """
    charts = [_build_feed_chart(m, dips)]
    ratios = [
        (word, values, color)  # drawn in this order: velocity on top
        for word, values, color in (
            ("jerk", m.jerk_ratio, FOURTH),
            ("acceleration", m.acceleration_ratio, JIAO),
            ("velocity", m.velocity_ratio, CHOSEN),
        )
        if values is not None
    ]
    starts = np.arange(0, len(m.time), -(-len(m.time) // _PEAKS))
    for j, name in enumerate(m.joint_names):
        unit = LENGTH if m.prismatic[j] else ANGLE
        k = select_plot_points([m.q[:, j]], _SMALL)
        limits = [
            {"y": float(f"{v * unit.factor:.6g}"), "label": unit.format_value(v), "fit": True}
            for v in (m.lower[j], m.upper[j])
            if np.isfinite(v)
        ]
        charts.append(
            _build_time_chart(
                f"c-q{j}",
                m.time[k],
                [(name, m.q[k, j] * unit.factor, CHOSEN)],
                title=f"{name} ({unit.name})",
                unit=unit.name,
                xlabel="Time (s)",
                hlines=limits,
            )
        )
        peaks = [(word, np.maximum.reduceat(values[:, j], starts) * 100, c) for word, values, c in ratios]
        charts.append(
            _build_time_chart(
                f"c-v{j}",
                m.time[starts],
                peaks,
                title=f"{name} (% of its limits)",
                unit="%",
                xlabel="Time (s)",
                ymin=0,
                legend=False,
                hlines=[{"y": 100, "fit": True}],
            )
        )
    return charts


def _build_feed_chart(m: MotionSeries, dips: tuple[FeedDipRow, ...]) -> Spec:
    actual = np.where(m.cutting, m.feed_actual, np.nan) * FEED.factor
    programmed = np.where(m.cutting, m.feed_programmed, np.nan) * FEED.factor
    k = select_plot_points([programmed, actual])
    where = {"name": "path length (mm)", "names": round_for_json(m.s[k] * LENGTH.factor, 6), "at": list(range(len(k)))}
    spec = _build_time_chart(
        "c-feed",
        m.time[k],
        [("programmed", programmed[k], DEFAULT), ("actual", actual[k], CHOSEN)],
        title="Feed in the cut",
        unit="mm/min",
        ymin=0,
        height=250,
    )
    marks = [{"x": d.time + d.duration / 2, "label": d.cause} for d in select_deepest_dips(dips, m.time, MAX_MARKS)]
    return {**spec, "ylabel": "Feed (mm/min)", "xlabel": "Time (s)", "extra": [where], "marks": marks}


def _build_time_chart(
    name: str, time: Array, series: Sequence[tuple[str, Array, str]], *, title: str, unit: str, **more: object
) -> Spec:
    return {
        "id": name,
        "title": title,
        "group": "time",
        "x": round_for_json(time, 7),
        "xname": "time (s)",
        "xdec": 3,
        "unit": unit,
        "height": 168,
        "series": [{"name": n, "y": round_for_json(y), "color": c} for n, y, c in series],
        **more,
    }
