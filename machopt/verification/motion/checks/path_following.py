"""Path checks: position, tool axis and index of the motion, and every point and move of the CAM file in order."""

from __future__ import annotations

import numpy as np

from machopt.data_types.infeasibility_reasons import InfeasibilityReason
from machopt.data_types.toolpath import MoveKind, Toolpath
from machopt.numerics.array_types import Array, Bools
from machopt.verification.check_results import VerificationCheck, build_count_check, build_worst_value_check
from machopt.verification.motion.path_geometry.reference_direction import (
    INDEX_TOLERANCE as VERIFICATION_INDEX_TOLERANCE,
)
from machopt.verification.motion.path_geometry.sample_location import SampleLocations
from machopt.verification.tables.exported_tables import ExportedMotion, ExportedPoints

END_TOLERANCE, NEAR_M = 2.0, 1e-5  # ways of a sample that a cut may lack, one at either end; m, rounding of the index
RAPID_POINT_TOLERANCE_MM = 0.02  # a rapid point, which the motion rests at, or passes by as far as it may
GAP_STATUS = InfeasibilityReason.GAP.word
INDEX_TOLERANCE = 3e-6  # of an index with six decimals, of second differences


def check_path(
    motion: ExportedMotion,
    toolpath: Toolpath,
    points: ExportedPoints,
    locations: SampleLocations,
    allow_gaps: bool,
    beyond: Array,
) -> list[VerificationCheck]:
    """Check that the motion follows the toolpath through every point and move, in order and without gaps.

    Args:
        motion: The exported motion (trajectory.csv), SI.
        toolpath: The toolpath, points in the workpiece frame, SI.
        points: The exported points (points.csv), SI.
        locations: Position of each motion sample relative to the toolpath.
        allow_gaps: Points that points.csv gives up need not be visited.
        beyond: (N,) m by which the tool passes a point at a rounded corner farther than it may; inf where no corner is
            rounded.
    """
    wanted = toolpath.cutting.copy()
    given_up = np.zeros(len(toolpath), bool)
    inside = (points.point >= 0) & (points.point < len(toolpath))
    given_up[points.point[inside & ~points.ok]] = True
    if allow_gaps:
        wanted &= ~given_up
    return [
        *_check_path_distance(motion, toolpath, locations),
        _check_index(motion, locations),
        _check_points_visited(motion, wanted, toolpath),
        _check_moves_complete("cut throughout", motion, toolpath, motion.move == MoveKind.CUT, wanted),
        _check_moves_complete(
            "feed moves driven",
            motion,
            toolpath,
            locations.on_feed_move | locations.on_retract_move,
            (toolpath.move != MoveKind.RAPID) & ~(given_up & allow_gaps),
        ),
        _check_rapid_points(motion, toolpath, locations, given_up & allow_gaps, beyond),
        _check_order(motion),
        _check_skipped_points(motion, locations, points),
    ]


def _check_path_distance(
    motion: ExportedMotion, toolpath: Toolpath, locations: SampleLocations
) -> list[VerificationCheck]:
    """Distance from the polyline near the sample's index, and angle from the axis there, of all but rapid moves.

    A row counts where it says that it is no rapid move, or where the file makes none there.
    """
    rows = np.flatnonzero((motion.move != MoveKind.RAPID) | locations.on_feed_move)
    away, angle = 1e3 * locations.off_path[rows], np.degrees(locations.off_axis[rows])
    away = np.where(locations.on_retract_move[rows] & (motion.move[rows] != MoveKind.CUT), 0.0, away)

    def where(n: int) -> str:
        return f"{motion.describe_row(rows[n])}, {get_move_word(motion, rows[n])}"

    if not (motion.move == MoveKind.CUT).any():
        return [
            VerificationCheck(
                name="path",
                passed=False,
                value=np.nan,
                limit=1e3 * locations.path_limit,
                unit="mm",
                where="no row cuts",
            ),
            VerificationCheck(
                name="tool axis",
                passed=False,
                value=np.nan,
                limit=float(np.degrees(locations.axis_limit)),
                unit="deg",
                where="no row cuts",
            ),
        ]
    return [
        build_worst_value_check("path", "mm", away, 1e3 * locations.path_limit, where),
        build_worst_value_check("tool axis", "deg", angle, float(np.degrees(locations.axis_limit)), where),
    ]


def get_move_word(motion: ExportedMotion, n: int | np.int64) -> str:
    """Return the move label of a row.

    Args:
        motion: The exported motion (trajectory.csv), SI.
        n: Number of the row, from 0.
    """
    return MoveKind(int(motion.move[n])).word


def _check_index(motion: ExportedMotion, locations: SampleLocations) -> VerificationCheck:
    """The index names the place where the tool is; corners are rounded by as much as the path may be left."""
    rows = np.flatnonzero(locations.on_feed_move | ((motion.move == MoveKind.CUT) & np.isfinite(motion.point)))
    if not len(rows):
        return VerificationCheck(
            name="index of the samples",
            passed=False,
            value=np.nan,
            limit=1e3 * locations.path_limit,
            unit="mm",
            where="no sample is on the toolpath",
        )
    return build_worst_value_check(
        "index of the samples",
        "mm",
        1e3 * locations.off_index[rows],
        1e3 * locations.path_limit,
        lambda n: motion.describe_row(rows[n]),
    )


def _check_points_visited(motion: ExportedMotion, wanted: Bools, toolpath: Toolpath) -> VerificationCheck:
    """Every point is passed while cutting; of successive ones at one place, each by the move through any of them."""
    rows = np.flatnonzero(motion.move == MoveKind.CUT)
    s = motion.point[rows]
    pairs = np.flatnonzero((np.diff(rows) == 1) & (s[:-1] <= s[1:])) if len(s) > 1 else np.empty(0, int)
    rises = np.r_[np.sort(s[np.isfinite(s)]), np.inf]
    expected_points = np.flatnonzero(wanted)
    near = rises[np.searchsorted(rises, expected_points - 0.51)] <= expected_points + 0.51
    # points that two successive samples enclose: one more from the first of them on, one less behind the last
    n = len(wanted)
    low = np.clip(np.ceil(s[pairs]), 0, n).astype(int)
    high = np.maximum(np.clip(np.floor(s[pairs + 1]) + 1, 0, n).astype(int), low)
    steps = np.bincount(low, minlength=n + 1) - np.bincount(high, minlength=n + 1)
    passed = np.zeros(n, bool)
    passed[expected_points] = near | (np.cumsum(steps)[expected_points] > 0)
    place = np.r_[0, np.cumsum(~_is_standing(toolpath)[1:])]
    missed = expected_points[(np.bincount(place, passed) == 0)[place[expected_points]]]
    text = f"{len(missed)} of {int(wanted.sum())} missed, first point {missed[0]}" if len(missed) else "all visited"
    return VerificationCheck(
        name="cutting points visited",
        passed=not len(missed),
        value=float(len(missed)),
        limit=0.0,
        unit="points",
        where=text,
    )


def _is_standing(toolpath: Toolpath) -> Bools:
    """(n,) the cutting move into a point from another that cuts neither goes nor turns."""
    still = np.zeros(len(toolpath), bool)
    moved = np.diff(np.hstack([toolpath.position, toolpath.axis]), axis=0).any(axis=1)
    still[1:] = ~moved & toolpath.cutting[1:] & toolpath.cutting[:-1]
    return still


def _check_moves_complete(
    name: str, motion: ExportedMotion, toolpath: Toolpath, driven: Bools, wanted: Bools
) -> VerificationCheck:
    """Every such move between two points is driven in one go: what no two successive samples enclose is short.

    At either end of a cut the way of one sample may belong to the move before or after.
    """
    rows = np.flatnonzero(driven & np.isfinite(motion.point))
    s = motion.point[rows]
    both = np.flatnonzero((np.diff(rows) == 1) & (np.diff(s) >= 0))
    kind = toolpath.cutting if name == "cut throughout" else toolpath.move != MoveKind.RAPID
    segments = 1 + np.flatnonzero(wanted[1:] & (wanted[:-1] | ~kind[:-1]))
    length = np.linalg.norm(toolpath.position[segments] - toolpath.position[segments - 1], axis=1)
    unit = "of a sample's way"
    if not len(segments):
        return VerificationCheck(
            name=name, passed=True, value=0.0, limit=END_TOLERANCE, unit=unit, where="there are none"
        )
    if not len(both):
        return VerificationCheck(
            name=name,
            passed=not (length > 0).any(),
            value=np.nan,
            limit=END_TOLERANCE,
            unit=unit,
            where="nothing to measure",
        )
    knots = np.column_stack([s[both], s[both + 1]])
    covered = np.cumsum(np.column_stack([np.zeros(len(both)), knots[:, 1] - knots[:, 0]]).ravel())
    ends = np.maximum.accumulate(knots.ravel())
    share = np.interp(segments, ends, covered) - np.interp(segments - 1, ends, covered)
    way = np.nan_to_num(toolpath.feed[segments]) * motion.sample_time + NEAR_M
    left = np.clip(1.0 - share, 0.0, 1.0) * length / way
    return build_worst_value_check(name, unit, left, END_TOLERANCE, lambda n: f"the move to point {segments[n]}")


def _check_rapid_points(
    motion: ExportedMotion, toolpath: Toolpath, locations: SampleLocations, given_up: Bools, beyond: Array
) -> VerificationCheck:
    """The points that rapid moves lead to are where the file has them, or rounded corners pass them by no more than
    they may; one given up may be passed by.
    """
    rows = np.flatnonzero(
        np.isfinite(motion.point) & (np.abs(motion.point - np.round(motion.point)) <= VERIFICATION_INDEX_TOLERANCE)
    )
    nearest = np.full(len(toolpath), np.inf)
    k = np.round(motion.point[rows]).astype(int)
    inside = (k >= 0) & (k < len(toolpath))
    np.minimum.at(nearest, k[inside], locations.off_index[rows[inside]])
    nearest = np.where(np.isfinite(beyond), beyond, nearest)
    expected_points = np.flatnonzero((toolpath.move == MoveKind.RAPID) & ~given_up)
    if not len(expected_points):
        return VerificationCheck(
            name="rapid points reached",
            passed=True,
            value=0.0,
            limit=RAPID_POINT_TOLERANCE_MM,
            unit="mm",
            where="there are none",
        )
    return build_worst_value_check(
        "rapid points reached",
        "mm",
        1e3 * nearest[expected_points],
        RAPID_POINT_TOLERANCE_MM,
        lambda n: f"point {expected_points[n]}",
    )


def _check_order(motion: ExportedMotion) -> VerificationCheck:
    """The index never falls, is empty only on the way from and to home, and rises evenly along a rapid move."""
    s = motion.point
    known = np.flatnonzero(np.isfinite(s))
    if not len(known):
        return VerificationCheck(
            name="in order", passed=False, value=np.nan, limit=1e-6, unit="points back", where="no row has a point"
        )
    first, last = int(known[0]), int(known[-1])
    if last - first + 1 != len(known):
        n = first + int(np.flatnonzero(np.isnan(s[first:last]))[0])
        return VerificationCheck(
            name="in order",
            passed=False,
            value=np.nan,
            limit=1e-6,
            unit="points back",
            where=f"no point at {motion.describe_row(n)}",
        )
    n = first + int(np.argmin(np.diff(s[first : last + 1]))) if last > first else first
    least = float(max(0.0, s[n] - s[n + 1])) if last > first else 0.0
    if least > 1e-6:
        return VerificationCheck(
            name="in order", passed=False, value=least, limit=1e-6, unit="points back", where=motion.describe_row(n + 1)
        )
    rapid = motion.move == MoveKind.RAPID
    middle = np.arange(first + 1, last)
    inner = (
        rapid[middle - 1]
        & rapid[middle]
        & rapid[middle + 1]
        & (np.abs(s[middle] - np.round(s[middle])) > VERIFICATION_INDEX_TOLERANCE)
    )
    bend = np.abs(s[middle + 1] - 2.0 * s[middle] + s[middle - 1]) * inner
    if len(bend) and bend.max() > INDEX_TOLERANCE:
        at = int(middle[np.argmax(bend)])
        return VerificationCheck(
            name="in order",
            passed=False,
            value=float(bend.max()),
            limit=INDEX_TOLERANCE,
            unit="points uneven",
            where=f"rapid move at {motion.describe_row(at)}",
        )
    return VerificationCheck(
        name="in order", passed=True, value=least, limit=1e-6, unit="points back", where=motion.describe_row(n)
    )


def _check_skipped_points(
    motion: ExportedMotion, locations: SampleLocations, points: ExportedPoints
) -> VerificationCheck:
    """No point that points.csv gives up is passed by the tool on the toolpath.

    A point called ``gap`` is where the tool comes down again: the cut to it is given up, the one from it is driven.
    """
    s, on = motion.point, locations.on_feed_move
    both = np.flatnonzero(on[1:] & on[:-1])
    wrong = []
    for k, status in zip(points.point[~points.ok], np.array(points.status)[~points.ok], strict=True):
        way = np.minimum(s[both + 1], k) - np.maximum(s[both], k - 1)  # on the move to the point
        hit = (
            both[way > 2 * VERIFICATION_INDEX_TOLERANCE]
            if status == GAP_STATUS
            else both[(s[both] <= k) & (s[both + 1] >= k)]
        )
        if len(hit):
            wrong.append(f"point {k} is called {status} and driven at {motion.describe_row(hit[0])}")
    return build_count_check("points given up are not driven", wrong, "points")
