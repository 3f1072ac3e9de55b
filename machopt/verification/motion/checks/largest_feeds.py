"""Check of feed_max_mm_min of points.csv: at that feed, the probability reaches the quantile."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from machopt.data_types.toolpath import Toolpath
from machopt.numerics.array_types import Array
from machopt.verification.checks import VerificationCheck, build_worst_value_check
from machopt.verification.motion.process.point_loads import RecomputedLoads
from machopt.verification.tables.exported_tables import ExportedPoints

COLUMN, PLACES = "feed_max_mm_min", 16  # points that are recomputed


def build_largest_feeds(
    toolpath: Toolpath, points: ExportedPoints, loads: RecomputedLoads
) -> tuple[Array, ExportedPoints]:
    """Return (N,) feeds in m/s, the stated largest ones at some points, and the points of which only these are ok.

    Args:
        toolpath: The toolpath.
        points: Rows of points.csv, one a toolpath point.
        loads: Recomputed loads, which name the strokes of each hole.
    """
    stated = points.numbers.get(COLUMN, np.full(len(toolpath), np.nan))
    rows = np.flatnonzero((stated > 0.0) & points.ok)
    picked = rows[np.unique(np.linspace(0, len(rows) - 1, min(len(rows), PLACES)).round().astype(int))]
    feed, ok = toolpath.feed.copy(), np.zeros(len(toolpath), bool)
    feed[picked], ok[picked] = stated[picked] / 6e4, True
    for hole in loads.holes:
        if ok[hole.deepest]:
            feed[[stroke.point for stroke in hole.strokes]] = feed[hole.deepest]
    return feed, replace(points, status=tuple("ok" if flag else "left out" for flag in ok))


def check_largest_feeds(quantile: float, points: ExportedPoints, p_in: Array, limit: float) -> list[VerificationCheck]:
    """Return the check of the largest feeds; none where no probability is recomputed.

    Args:
        quantile: What ``pass`` needs.
        points: Rows of points.csv, of which those to be checked are ok.
        p_in: (N,) recomputed probability at the largest feeds.
        limit: By which a recomputed probability may be below the quantile.
    """
    rows = np.flatnonzero(points.ok & np.isfinite(p_in))
    at = points.point[rows]
    short = np.maximum(quantile - p_in[rows], 0.0)
    if not len(rows):
        return []
    return [build_worst_value_check(f"points.csv {COLUMN}", "1 below", short, limit, lambda n: f"point {at[n]}")]
