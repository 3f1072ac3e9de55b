"""Tilt of a ball cutter: the columns lead_deg and side_deg of all tables, their ranges, and the cutter.

Each table is compared with the tool axis by forward kinematics, by the equations of
:mod:`machopt.verification.motion.path_geometry.tool_tilt`. That the ball stays on the path of the CAM file is seen
where the poses turned back are compared with it, and here by the tilt that each sample states.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from machopt.data_types.cell import Cell
from machopt.data_types.plan_options import PlanOptions
from machopt.data_types.toolpath import MoveKind, Toolpath
from machopt.numerics.array_types import Array
from machopt.verification.check_results import VerificationCheck, build_count_check, build_worst_value_check
from machopt.verification.motion.path_geometry.reference_direction import interpolate_directions
from machopt.verification.motion.path_geometry.sample_location import SampleLocations
from machopt.verification.motion.path_geometry.tool_tilt import (
    ToolTilt,
    compute_leaving_directions,
    compute_tilted_axis,
    find_range_excess,
    is_cut_place,
)
from machopt.verification.tables.exported_tables import ExportedMotion, ExportedPoints, ExportedTilt

RANGE_TOLERANCE_DEG = 1e-3  # what six decimals, and the tangents at a corner, leave of a range
POINT_TOLERANCE_DEG = 1e-5  # nine decimals of tilt and joints
TABLE_TOLERANCE_DEG = 1e-8  # the same number in two tables
NO_TILT_DEG = 1e-9
BULGE = 0.125  # a chord's rise is an eighth of the product of both angles
SMOOTH_TURN_RAD = np.radians(15.0)  # of the direction of travel: a curve of short moves, not a corner


@dataclass(frozen=True, kw_only=True)
class TiltTables:
    """What the checks of the tilt compare."""

    cell: Cell
    toolpath: Toolpath
    motion: ExportedMotion
    points: ExportedPoints
    exported: ExportedTilt
    tilt: ToolTilt
    locations: SampleLocations
    tcp_of_points: Array  # (N, 4, 4) in the workpiece frame, as the joints of points.csv have it
    live: NDArray[np.bool_]  # (N,) rows of points.csv with a configuration
    options: PlanOptions


def check_tilt(of: TiltTables) -> list[VerificationCheck]:
    """Return the checks of the tilt.

    Args:
        of: tables, motion and options.
    """
    return [
        _check_cutter(of),
        *_check_samples(of),
        *(replace(c, file="points.csv") for c in _check_points(of)),
        *(replace(c, file="tilt.csv") for c in _check_table(of)),
    ]


def _get_limits(of: TiltTables, index: Array) -> Array:
    """(M, 2, 2) rad, permitted lead and side on the move at or behind each index."""
    last = len(of.toolpath) - 1
    point = np.clip(np.floor(index + 1e-9).astype(int) + 1, 0, last)
    return _get_operation_limits(of, of.toolpath.operation[point])


def _get_operation_limits(of: TiltTables, operation: NDArray[np.int32]) -> Array:
    """(M, 2, 2) rad, permitted lead and side in each of the operations."""
    ranges = [of.options.tilt_range_of(one.label) for one in of.toolpath.operations]
    return np.array([[r.lead, r.side] for r in ranges]).reshape(-1, 2, 2)[operation]


def _check_cutter(of: TiltTables) -> VerificationCheck:
    tilted = np.degrees(np.maximum(np.abs(of.exported.lead), np.abs(of.exported.side))).max(initial=0.0)
    wrong = [f"up to {tilted:.3f} deg"] if tilted > NO_TILT_DEG and of.tilt.radius <= 0.0 else []
    return build_count_check("tilted cutter is a ball", wrong)


def _check_samples(of: TiltTables) -> list[VerificationCheck]:
    """Axis and tip of every sample by the tilt that its own row states."""
    motion, on = of.motion, of.locations
    if motion.lead is None or motion.side is None:
        return [build_count_check("tilt of the samples stated", ["trajectory.csv has no lead_deg and side_deg"])]
    stated = np.isfinite(motion.lead) & np.isfinite(motion.side) & np.isfinite(motion.point)
    cut = motion.move == MoveKind.CUT
    blank = [motion.describe_row(n) for n in np.flatnonzero(cut & ~stated)]
    rows = np.flatnonzero(stated & (on.on_feed_move | cut))
    s = np.clip(motion.point[rows], 0.0, len(of.toolpath) - 1.0)
    shank = -on.tool[rows, :3, 2]
    off, aside = np.full(len(rows), np.inf), np.full(len(rows), np.inf)
    spare = _compute_turn_tolerance(of, s, np.hypot(np.tan(motion.lead[rows]), np.tan(motion.side[rows])))
    for leaving in (True, False):
        there = interpolate_directions(of.toolpath, of.tilt.known, s, leaving=leaving)
        tilted = compute_tilted_axis(there.axis, there.travel, motion.lead[rows], motion.side[rows])
        angle = np.arctan2(np.linalg.norm(np.cross(tilted, shank), axis=1), np.einsum("ij,ij->i", tilted, shank))
        tip = on.tool[rows, :3, 3] - of.tilt.radius * (there.axis - tilted)
        moved = np.linalg.norm(tip - on.tcp[rows, :3, 3], axis=1)
        angle = np.maximum(angle - spare, 0.0)
        moved = np.maximum(moved - of.tilt.radius * spare, 0.0)
        closer = angle < off
        off, aside = np.where(closer, angle, off), np.where(closer, moved, aside)
    limits = _get_operation_limits(of, of.toolpath.operation[on.next_point[rows]])
    beyond = np.where(cut[rows], find_range_excess(motion.lead[rows], motion.side[rows], limits), 0.0)

    def where(n: int) -> str:
        return motion.describe_row(rows[n])

    axis_limit = float(np.degrees(on.axis_limit))
    return [
        build_count_check("tilt of the samples stated", blank),
        build_worst_value_check(
            "tilt of the samples", "deg", np.append(np.degrees(off), 0.0), axis_limit, _named(where, len(rows))
        ),
        build_worst_value_check(
            "tilted tip", "mm", np.append(1e3 * aside, 0.0), 1e3 * on.path_limit, _named(where, len(rows))
        ),
        build_worst_value_check(
            "tilt range of the samples",
            "deg",
            np.append(np.degrees(beyond), 0.0),
            RANGE_TOLERANCE_DEG,
            _named(where, len(rows)),
        ),
    ]


def _compute_turn_tolerance(of: TiltTables, s: Array, tilt: Array) -> Array:
    """(M,) rad by which a tilt may be off because the direction of travel or the axis turns.

    On a curve of short moves the axis turns evenly while the direction of travel turns at the points. Between two rows
    of tilt.csv the tilted axis turns evenly, too; where the CAM axis turns by θ, the tilt bulges by θ/8 of itself.
    """
    travel, last = of.tilt.known.travel, len(of.toolpath) - 1
    turn = np.zeros(last + 1)  # at each point
    turn[1:] = np.arccos(np.clip(np.einsum("ij,ij->i", travel[1:], travel[:-1]), -1.0, 1.0))
    turn[turn > SMOOTH_TURN_RAD] = 0.0
    low = np.clip(np.floor(s + 1e-9).astype(int), 0, last)
    around = np.maximum(np.maximum(turn[np.maximum(low - 1, 0)], turn[low]), turn[np.minimum(low + 1, last)])
    return np.asarray(tilt * (around + BULGE * _compute_axis_steps(of, s)))


def _compute_axis_steps(of: TiltTables, s: Array) -> Array:
    """(M,) rad by which the CAM axis turns between the rows of tilt.csv around each place."""
    axis, _, _ = compute_leaving_directions(of.toolpath, of.tilt.known, of.tilt.index)
    step = np.append(0.0, np.linalg.norm(np.diff(axis, axis=0), axis=1))
    row = np.clip(np.searchsorted(of.tilt.index, s - 1e-9), 0, len(step) - 1)
    return np.asarray(np.maximum(step[row], step[np.minimum(row + 1, len(step) - 1)]))


def _check_points(of: TiltTables) -> list[VerificationCheck]:
    """points.csv: the tilt that the joints have, and that of tilt.csv."""
    points = of.points
    if points.lead is None or points.side is None:
        return [build_count_check("points.csv tilt stated", ["there is no lead_deg and side_deg"])]
    rows = np.flatnonzero(of.live)
    lead, side = points.lead[rows], points.side[rows]
    k = points.point[rows]
    known = of.tilt.known
    axis = compute_tilted_axis(known.axis[k], known.travel[k], np.nan_to_num(lead), np.nan_to_num(side))
    shank = -of.tcp_of_points[rows, :3, 2]
    off = np.arctan2(np.linalg.norm(np.cross(axis, shank), axis=1), np.einsum("ij,ij->i", axis, shank))
    is_stated = np.isfinite(lead) & np.isfinite(side)
    off = np.where(is_stated, off, 0.0)
    wrong = [f"point {k[n]} has none" for n in np.flatnonzero(~is_stated)]
    more = np.flatnonzero(~of.live & (np.isfinite(points.lead) | np.isfinite(points.side)))
    wrong += [f"point {points.point[n]} has no joints and a tilt" for n in more]
    return [
        build_worst_value_check(
            "points.csv tilt",
            "deg",
            np.append(np.degrees(off), 0.0),
            POINT_TOLERANCE_DEG,
            _named(lambda n: f"point {k[n]}", len(rows)),
        ),
        build_count_check("points.csv tilt stated", wrong),
    ]


def _check_table(of: TiltTables) -> list[VerificationCheck]:
    """tilt.csv: inside the ranges where it cuts, and the same as points.csv at the points."""
    index, lead, side = of.exported.index, of.exported.lead, of.exported.side
    cut = is_cut_place(of.toolpath, index)
    bulge = BULGE * _compute_axis_steps(of, index) * np.hypot(np.tan(lead), np.tan(side))
    beyond = np.maximum(np.where(cut, find_range_excess(lead, side, _get_limits(of, index)), 0.0) - bulge, 0.0)

    def where(n: int) -> str:
        return f"point {index[n]:g}"

    out = [
        build_worst_value_check(
            "tilt.csv range", "deg", np.append(np.degrees(beyond), 0.0), RANGE_TOLERANCE_DEG, _named(where, len(index))
        )
    ]
    whole = np.flatnonzero(np.abs(index - np.round(index)) < 1e-9)
    row_of = dict(zip(np.round(index[whole]).astype(int).tolist(), whole.tolist(), strict=True))
    lacking = sorted(set(range(len(of.toolpath))) - set(row_of))
    out.append(build_count_check("tilt.csv complete", [f"point {k} is missing" for k in lacking]))
    if of.points.lead is not None and of.points.side is not None:
        known = [n for n in np.flatnonzero(of.live) if int(of.points.point[n]) in row_of]
        at = [row_of[int(of.points.point[n])] for n in known]
        apart = np.maximum(np.abs(of.points.lead[known] - lead[at]), np.abs(of.points.side[known] - side[at]))
        out.append(
            build_worst_value_check(
                "points.csv and tilt.csv",
                "deg",
                np.append(np.degrees(apart), 0.0),
                TABLE_TOLERANCE_DEG,
                _named(lambda n: f"point {of.points.point[known[n]]}", len(known)),
            )
        )
    return out


def _named(where: Callable[[int], str], count: int) -> Callable[[int], str]:
    """A function that names the n-th of ``count`` places, and "nowhere" behind the last."""
    return lambda n: where(n) if n < count else "nowhere"
