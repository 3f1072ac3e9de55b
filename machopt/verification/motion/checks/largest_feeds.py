"""Largest feeds of points.csv (feed_max_mm_min), recomputed: the probability at that feed, and at a higher one.

At the stated feed the tolerances hold with the probability that process.yaml asks for. At ``HIGHER`` times that feed
they do not, unless the coefficients or ``WIDEST`` times the driven feed end the search before. A feed of zero says that
no feed suffices: they hold at none of ``SMALL``. The probabilities are those of
:mod:`machopt.verification.motion.process.predicted_errors` under loads recomputed at these feeds.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

from machopt.data_types.cell import Cell
from machopt.data_types.toolpath import Toolpath
from machopt.numerics.array_types import Array, Bools
from machopt.verification.check_results import VerificationCheck, build_count_check, build_worst_value_check
from machopt.verification.motion.process.hole_strokes import HoleVisit
from machopt.verification.motion.process.point_loads import RecomputedLoads
from machopt.verification.tables.exported_tables import ExportedPoints

COLUMN, PLACES = "feed_max_mm_min", 48  # points whose probabilities are recomputed
HIGHER = 1.35  # the search corrects a feed down to 0.8 of what it found, in steps of 1/256 of an interval
WIDEST = 3.0  # times the driven feed, the end of the search
SMALL = 0.125  # times the driven feed: the first step of the search of a hole
TOO_LARGE = 0.03  # by which the probability may fall short: 20,000 draws of the plan, and as many here
TOO_SMALL = 0.6  # of the permitted share out of tolerance, by which the higher feed may exceed the quantile
MM_MIN = 6e4


@dataclass(frozen=True, kw_only=True)
class LargestFeeds:
    """What the check of the column needs."""

    cell: Cell
    toolpath: Toolpath
    points: ExportedPoints
    loads: RecomputedLoads  # at the driven feed
    driven: Array  # (N,) m/s
    compute_probability: Callable[[Array, Bools], Array]  # (N,) m/s, (N,) points → (N,) p_in of these points

    def check(self) -> list[VerificationCheck]:
        """Return the checks: where a feed is stated, that it is not too large, and that it is not too small."""
        stated = self.points.numbers.get(COLUMN)
        name = f"points.csv {COLUMN}"
        if stated is None:
            return [build_count_check(name, ["the column is missing"], "columns")]
        feed = np.full(len(self.toolpath), np.nan)
        inside = (self.points.point >= 0) & (self.points.point < len(feed))
        feed[self.points.point[inside]] = stated[inside] / MM_MIN
        wrong = self._list_misplaced_feeds(feed)
        if wrong or not np.isfinite(feed).any():
            return [build_count_check(name, wrong, "points")]
        assert self.cell.process is not None
        quantile = self.cell.process.quantile
        feed = self._pick_points(feed)
        reached = self._compute_probabilities(np.where(feed > 0.0, feed, np.nan))
        higher = self._compute_higher_feeds(feed)
        beyond = self._compute_probabilities(higher)
        short = np.where(feed > 0.0, np.maximum(quantile - np.nan_to_num(reached, nan=-1.0), 0.0), 0.0)
        spare = np.where(np.isfinite(higher), np.maximum(np.nan_to_num(beyond, nan=-1.0) - quantile, 0.0), 0.0)
        return [
            build_count_check(name, wrong, "points"),
            build_worst_value_check(f"{name} is not too large", "1", short, TOO_LARGE, "point {}".format),
            build_worst_value_check(
                f"{name} is the largest", "1", spare, TOO_SMALL * (1.0 - quantile), "point {}".format
            ),
        ]

    def _pick_points(self, feed: Array) -> Array:
        """(N,) m/s at up to ``PLACES`` points, spread over the holes or along the path; NaN elsewhere."""
        rows = np.flatnonzero(np.isfinite(feed))
        picked = rows[np.unique(np.linspace(0, len(rows) - 1, min(len(rows), PLACES)).round().astype(int))]
        out = np.full(len(feed), np.nan)
        out[picked] = feed[picked]
        return out

    def _compute_probabilities(self, feed: Array) -> Array:
        """(N,) p_in at the points with a feed; NaN where nothing follows from one."""
        return self.compute_probability(self._spread_over_strokes(feed), np.isfinite(feed))

    def _list_misplaced_feeds(self, feed: Array) -> list[str]:
        """Points with a feed and no outcome, milled points and holes without one, and negative feeds."""
        assert self.cell.process is not None
        operations, wrong = self.cell.process.operations, []
        words = dict(zip(self.points.point.tolist(), self.points.words.get("outcome", ()), strict=False))
        drilled = {hole.deepest for hole in self.loads.holes if self._follows_from_feed(hole)}
        for point, value in enumerate(feed.tolist()):
            known = words.get(point, "") not in ("", "unknown")
            k = int(self.loads.operation[point])
            if np.isfinite(value) and (not known or k < 0 or operations[k].kind == "force"):
                wrong.append(f"point {point}: has a feed, and its force or outcome does not follow from one")
            elif not np.isfinite(value) and known and k >= 0 and (operations[k].kind == "milling" or point in drilled):
                wrong.append(f"point {point}: lacks a feed")
            elif value < 0.0:
                wrong.append(f"point {point}: {value * MM_MIN:g} mm/min")
        return wrong

    def _follows_from_feed(self, hole: HoleVisit) -> bool:
        """Whether the force of a hole comes from its material."""
        assert self.cell.process is not None
        thrust = [self.loads.force[stroke.point, 2] for stroke in hole.strokes]
        return self.cell.process.operations[hole.operation].kind != "force" and bool(max(thrust, default=0.0) > 0.0)

    def _compute_higher_feeds(self, feed: Array) -> Array:
        """(N,) m/s, a feed at which the tolerances no longer hold; NaN where the search ended before."""
        assert self.cell.process is not None
        out = np.where(feed > 0.0, HIGHER * feed, SMALL * self.driven)
        most = WIDEST * self.driven
        cutter = self.cell.tool.cutter
        for k, one in enumerate(self.cell.process.operations):
            if one.kind != "milling" or cutter is None:
                continue
            coefficients = self.cell.process.materials[one.material].milling
            assert coefficients is not None
            least, largest = coefficients.h_range_m
            rows = self.loads.operation == k
            per_bite = self.loads.speed[rows] * (cutter.teeth or 1)
            most[rows] = np.minimum(most[rows], largest * per_bite)
            out[rows] = np.where(feed[rows] > 0.0, out[rows], least * per_bite)
        return np.where(np.isfinite(feed) & (out <= most), out, np.nan)

    def _spread_over_strokes(self, feed: Array) -> Array:
        """(N,) m/s, the feed of each hole on all of its strokes, and the driven feed where none is given."""
        out = np.where(np.isfinite(feed), feed, self.driven)
        for hole in self.loads.holes:
            if np.isfinite(feed[hole.deepest]):
                out[[stroke.point for stroke in hole.strokes]] = feed[hole.deepest]
        return out
