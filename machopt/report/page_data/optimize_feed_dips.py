"""Rows of the page of a plan about the places where the programmed feed is not reached."""

from __future__ import annotations

from collections import Counter

import numpy as np

from machopt.data_types.toolpath import MoveKind
from machopt.numerics.array_types import Array
from machopt.planning.motion.trajectory_builder import MotionTimeline
from machopt.planning.pipeline.plan_data_types import Plan
from machopt.planning.retiming.slowdowns import FeedSlowdown
from machopt.report.page_data.optimize_series import interpolate_path_length
from machopt.report.page_types import optimize_page_data as page
from machopt.verification.motion.checks.time_and_joint_limits import format_axis_name


def list_feed_dips(plan: Plan, timeline: MotionTimeline | None, s: Array) -> tuple[page.FeedDipRow, ...]:
    """Return one row for each stretch below the programmed feed.

    Args:
        plan: The plan.
        timeline: The motion over time; None where there is no motion.
        s: (N,) m, path length at the toolpath's points.
    """
    if timeline is None or timeline.trajectory is None:
        return ()
    t = timeline.trajectory
    cut = np.flatnonzero((t.move != MoveKind.RAPID) & np.isfinite(t.point))
    index = t.point[cut]  # once: a job of many holes has a dip and more in each
    out = []
    for dip in (d for d in timeline.dips if d.lost):
        known = len(cut) > 0 and dip.first <= index[-1]  # where the machine was at rest before: the last row of that
        at = cut[max(int(np.searchsorted(index, dip.first + 1e-9, side="right")) - 1, 0)] if known else None
        end = cut[min(int(np.searchsorted(index, dip.last)), len(cut) - 1)] if len(cut) else 0
        programmed = float(
            plan.path.feed[min(int(np.searchsorted(plan.path.index, dip.last)), len(plan.path.feed) - 1)]
        )
        out.append(
            page.FeedDipRow(
                point=dip.first,
                s=float(interpolate_path_length(s, np.array(dip.first))),
                time=float(t.time[at]) if at is not None else float("nan"),
                duration=max(float(t.time[end] - t.time[at]), 0.0) if at is not None else float("nan"),
                feed_programmed=programmed,
                feed_lowest=dip.ratio * programmed,
                cause=describe_dip_cause(dip),
            )
        )
    return tuple(out)


def count_feed_stops(timeline: MotionTimeline | None) -> tuple[tuple[str, int], ...]:
    """Return how many ramps there are from and to each kind of stop that the path demands.

    Args:
        timeline: The motion over time; None where there is no motion.
    """
    words = {
        "reversal": "at reversals",
        "start": "at the start of cuts",
        "stop": "at the end of cuts",
        "rest": "at dwells",
    }
    dips = timeline.dips if timeline is not None and timeline.trajectory is not None else ()
    ramps = Counter(str(d.where) for d in dips if not d.lost)
    return tuple((text, ramps[where]) for where, text in words.items() if ramps[where])


def describe_dip_cause(dip: FeedSlowdown) -> str:
    """Return what limits the feed at a dip.

    Args:
        dip: The feed dip.
    """
    where = " while the tool turns on the spot" if dip.where == "reorientation" else ""
    return f"{format_axis_name(dip.joint - 1)} {dip.limit}{where}"
