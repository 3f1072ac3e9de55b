"""Feeds of points.csv that the programs have in place of those of the file: method joint, ``advised_feed_share``."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from machopt.data_types.plan_options import PlanOptions
from machopt.data_types.toolpath import Toolpath
from machopt.numerics.array_types import Array
from machopt.verification.check_results import VerificationCheck, build_count_check
from machopt.verification.tables.exported_tables import ExportedPoints

ADVISED = "feed_advised_mm_min"
ROUNDING = 1e-3  # mm/min, of a printed feed


def apply_exported_feeds(toolpath: Toolpath, advised: Array | None, points: NDArray[np.intp]) -> Toolpath:
    """Return the toolpath with the lower of the file's feed and the exported one.

    Args:
        toolpath: The toolpath.
        advised: (R,) mm/min of the rows of points.csv, NaN where there is none; None: the column is missing.
        points: (R,) toolpath point of each row.
    """
    if advised is None:
        return toolpath
    feed = toolpath.feed.copy()
    rows = np.flatnonzero((points >= 0) & (points < len(toolpath)) & (advised > 0))
    at = points[rows]
    feed[at] = np.where(np.isnan(feed[at]), np.nan, np.fmin(feed[at], advised[rows] / 6e4))
    return replace(toolpath, feed=feed)


def check_advised_feeds(toolpath: Toolpath, points: ExportedPoints, options: PlanOptions) -> list[VerificationCheck]:
    """Return the check of the column: above zero and at most the file's feed; there where the options ask for it.

    Whether the feed keeps the tolerance is checked by ``p_in``, which is that of the driven feed.

    Args:
        toolpath: The toolpath.
        points: Content of points.csv.
        options: The planning options in force.
    """
    stated = points.numbers.get(ADVISED)
    name = f"points.csv {ADVISED}"
    is_expected = options.method == "joint" or options.advised_feed_share is not None
    if stated is None:
        return [build_count_check(name, ["there is no such column"])] if is_expected else []
    if not is_expected:
        return [build_count_check(name, [f"method {options.method} has no such column"])]
    inside = (points.point >= 0) & (points.point < len(toolpath))
    programmed = np.full(len(stated), np.nan)
    programmed[inside] = 6e4 * toolpath.feed[points.point[inside]]
    wrong = []
    for n in range(len(stated)):
        at, value, of_file = f"point {points.point[n]}", stated[n], programmed[n]
        if np.isnan(of_file) != np.isnan(value):
            wrong.append(f"{at}: {'has' if np.isnan(of_file) else 'lacks'} a feed")
        elif value <= 0 or value > of_file + ROUNDING:
            wrong.append(f"{at}: {value:g} mm/min, expected above 0 and at most {of_file:g}")
    return [build_count_check(name, wrong, "points")]
