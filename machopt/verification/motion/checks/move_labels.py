"""Check of the columns move, operation and gamma_deg of trajectory.csv against the CAM file at each row's index.

``move`` is the file's word for the move that the sample lies on. It is ``approach`` or ``retract`` where the tool
moves straight along its axis at a point; ``rapid`` from and to home and where points are given up. Where points lie
closer than samples, a sample next to a cut counts as ``cut`` although it lies past its end, because no other sample
shows that cut. ``operation`` is that of the point the move leads to; empty on the way home. ``gamma_deg`` is empty in
rapid moves, retracts, and where points coincide. Elsewhere docs/conventions.md defines it
(:mod:`machopt.verification.motion.path_geometry.reference_direction`).
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from machopt.data_types.toolpath import MoveKind, Toolpath
from machopt.numerics.array_types import Array, Bools
from machopt.verification.check_results import VerificationCheck, build_count_check, build_worst_value_check
from machopt.verification.motion.path_geometry import reference_direction
from machopt.verification.motion.path_geometry.reference_direction import INDEX_TOLERANCE
from machopt.verification.motion.path_geometry.sample_location import SampleLocations
from machopt.verification.tables.exported_tables import ExportedMotion, ExportedPoints

BLOCK_ROWS = 10_000  # samples compared at a time
SAME_ROTATION = 1e-6  # rad; a larger difference may be that of the other move at a point
ROTATION_TOLERANCE_DEG = (
    0.1  # the axis may be 0.05° off while the tool rounds a corner, which turns what is measured about it
)


def check_move_labels(
    motion: ExportedMotion, toolpath: Toolpath, points: ExportedPoints, locations: SampleLocations, allow_gaps: bool
) -> list[VerificationCheck]:
    """Check the columns move, operation and gamma_deg of trajectory.csv.

    Args:
        motion: The exported motion (trajectory.csv), SI.
        toolpath: The toolpath, points in the workpiece frame, SI.
        points: The exported points (points.csv), SI.
        locations: Position of each motion sample relative to the toolpath.
        allow_gaps: Points that points.csv gives up need not be visited.
    """
    return [
        build_count_check("moves of the samples", _check_moves(motion, toolpath, points, locations, allow_gaps)),
        build_count_check("operations of the samples", _check_operations(motion, toolpath)),
        *_check_rotation(motion, toolpath, locations),
    ]


def _check_moves(
    motion: ExportedMotion, toolpath: Toolpath, points: ExportedPoints, locations: SampleLocations, allow_gaps: bool
) -> list[str]:
    known = np.isfinite(motion.point)
    wanted = np.where(known, toolpath.move[locations.next_point], MoveKind.RAPID)
    wanted = np.where(known & (locations.next_point == 0), MoveKind.RAPID, wanted)
    wrong = (motion.move != wanted) & (
        motion.move != toolpath.move[_find_next_point(motion, toolpath, locations.next_point)]
    )
    drawn = np.isin(motion.move, (MoveKind.APPROACH, MoveKind.RETRACT)) & locations.is_on_retract(motion.point)
    wrong &= ~drawn
    if motion.lifted is not None:
        wrong &= ~motion.lifted  # re-entries have a check of their own
    wrong &= ~_is_next_to_cut(motion, toolpath, wanted)
    if allow_gaps:
        wrong &= ~((motion.move == MoveKind.RAPID) & _is_in_gap(motion, toolpath, points))
    return [
        f"{motion.describe_row(n)} is called {MoveKind(int(motion.move[n])).word}, the toolpath says "
        f"{MoveKind(int(wanted[n])).word}"
        for n in np.flatnonzero(wrong)
    ]


def _find_next_point(motion: ExportedMotion, toolpath: Toolpath, toward: NDArray[np.int64]) -> NDArray[np.int64]:
    """(S,) the point after ``toward`` where the printed index may as well lie on the feed move to that one."""
    after = np.minimum(toward + 1, len(toolpath) - 1)
    edge = (np.abs(np.nan_to_num(motion.point) - toward) <= 2 * INDEX_TOLERANCE) & (
        toolpath.move[after] != MoveKind.RAPID
    )
    return np.where(edge & np.isfinite(motion.point), after, toward)


def _is_next_to_cut(motion: ExportedMotion, toolpath: Toolpath, wanted: NDArray[np.int64]) -> Bools:
    """(S,) rows on either side of a cut's point that no row of that cut is near."""
    s = motion.point
    out = np.zeros(len(s), bool)
    doubt = np.flatnonzero((motion.move == MoveKind.CUT) & (wanted != MoveKind.CUT) & np.isfinite(s))
    for n in doubt:
        for a in (n - 1, n):
            if not (a >= 0 and a + 1 < len(s) and np.isfinite(s[[a, a + 1]]).all()):
                continue
            pair = np.array([a, a + 1])
            for k in range(int(np.ceil(s[a] - INDEX_TOLERANCE)), int(np.floor(s[a + 1] + INDEX_TOLERANCE)) + 1):
                if toolpath.move[min(k, len(toolpath) - 1)] == MoveKind.CUT:
                    out[n] |= not ((np.abs(s[pair] - k) <= 0.5) & (wanted[pair] == MoveKind.CUT)).any()
    return out


def _is_in_gap(motion: ExportedMotion, toolpath: Toolpath, points: ExportedPoints) -> Bools:
    """(S,) rows of rapid moves that pass or touch a point given up."""
    given_up = np.zeros(len(toolpath), bool)
    inside = (points.point >= 0) & (points.point < len(toolpath))
    given_up[points.point[inside & ~points.ok]] = True
    before = np.concatenate([[0], np.cumsum(given_up)])
    rapid = (motion.move == MoveKind.RAPID) & np.isfinite(motion.point)
    out = np.zeros(len(rapid), bool)
    edges = np.flatnonzero(np.diff(np.concatenate([[False], rapid, [False]]).astype(int)))
    for a, b in edges.reshape(-1, 2):
        low = int(np.floor(motion.point[max(a - 1, 0)] if np.isfinite(motion.point[max(a - 1, 0)]) else 0.0))
        high = min(int(np.ceil(motion.point[b - 1])), len(toolpath) - 1)
        out[a:b] = before[high + 1] > before[low]
    return out


def _check_operations(motion: ExportedMotion, toolpath: Toolpath) -> list[str]:
    labels = np.array([" ".join(o.label.split()) for o in toolpath.operations] or [""], dtype=object)
    s, last = motion.point, len(toolpath) - 1
    known = np.flatnonzero(np.isfinite(s))
    if not len(known):
        return ["no row has a point"]
    toward = np.clip(np.ceil(np.nan_to_num(s) - INDEX_TOLERANCE), 0, last).astype(int)
    toward[: known[0]] = toward[known[0]]
    wanted = labels[toolpath.operation[toward]]
    wanted[known[-1] + 1 :] = ""
    have = np.array(motion.operation, dtype=object)
    is_next = have == labels[toolpath.operation[_find_next_point(motion, toolpath, toward)]]
    wrong = (have != wanted) & ~(is_next & (np.arange(len(s)) <= known[-1]))
    rapid = motion.move == MoveKind.RAPID  # one that passes points by belongs to where it ends
    for n in np.flatnonzero(wrong & rapid & np.isfinite(s)):
        after = np.flatnonzero(~rapid[n:])
        end = n + int(after[0]) if len(after) else len(s) - 1
        places = s[n : end + 1][np.isfinite(s[n : end + 1])]
        wrong[n] = have[n] not in set(
            labels[toolpath.operation[np.clip(np.ceil(places - INDEX_TOLERANCE), 0, last).astype(int)]]
        )
    return [
        f"{motion.describe_row(n)} is of {have[n]!r}, the toolpath says {wanted[n]!r}" for n in np.flatnonzero(wrong)
    ]


def _check_rotation(motion: ExportedMotion, toolpath: Toolpath, locations: SampleLocations) -> list[VerificationCheck]:
    stated = np.isfinite(motion.gamma)
    step = np.linalg.norm(np.diff(toolpath.position, axis=0, prepend=toolpath.position[:1]), axis=1)
    step += np.linalg.norm(np.diff(toolpath.axis, axis=0, prepend=toolpath.axis[:1]), axis=1)
    moving = (
        np.isfinite(motion.point)
        & (step[locations.next_point] > 0)
        & (toolpath.move[locations.next_point] != MoveKind.RAPID)
    )
    lift = np.isin(motion.move, (MoveKind.APPROACH, MoveKind.RETRACT)) & locations.is_on_retract(motion.point)
    due = moving & (motion.move != MoveKind.RAPID) & ~locations.on_retract_move & locations.on_feed_move & ~lift
    blank = (motion.move == MoveKind.RAPID) | ~np.isfinite(motion.point)
    wrong = [f"{motion.describe_row(n)} has none" for n in np.flatnonzero(due & ~stated)]
    wrong += [f"{motion.describe_row(n)} has one in a rapid move" for n in np.flatnonzero(blank & stated)]
    rows = np.flatnonzero(stated & locations.on_feed_move)
    out = [build_count_check("rotation of the samples stated", wrong)]
    if not len(rows):
        return out
    known = reference_direction.compute_directions_at_points(toolpath)
    off = np.full(len(rows), np.inf)
    for start in range(0, len(rows), BLOCK_ROWS):
        some = rows[start : start + BLOCK_ROWS]
        off[start : start + BLOCK_ROWS] = _compute_rotation_error(motion, toolpath, known, locations.tool[some], some)
    out.append(
        build_worst_value_check(
            "rotation of the samples",
            "deg",
            np.degrees(off),
            ROTATION_TOLERANCE_DEG,
            lambda n: motion.describe_row(rows[n]),
        )
    )
    return out


def _compute_rotation_error(
    motion: ExportedMotion,
    toolpath: Toolpath,
    known: reference_direction.PathDirections,
    tcp: Array,
    rows: NDArray[np.intp],
) -> Array:
    """(M,) rad by which some rows (M,) with TCP poses (M, 3, 4) miss the nearest rotation that the path gives them."""
    s, gamma = np.clip(motion.point[rows], 0.0, len(toolpath) - 1), motion.gamma[rows]
    off, left = np.full(len(rows), np.inf), np.arange(len(rows))
    for leaving in (False, True):  # both are the same inside a move: the second one is needed at points only
        there = reference_direction.interpolate_directions(toolpath, known, s[left], leaving=leaving)
        tolerance = _compute_rotation_tolerance(toolpath, known, s[left], there)
        for angle in there.compute_rotation_angle(tcp[left]).T:
            apart = np.abs((angle - gamma[left] + np.pi) % (2.0 * np.pi) - np.pi)
            off[left] = np.fmin(off[left], np.maximum(apart - tolerance, 0.0))
        left = np.flatnonzero(off > SAME_ROTATION)
        if not len(left):
            break
    return off


def _compute_rotation_tolerance(
    toolpath: Toolpath, known: reference_direction.PathDirections, s: Array, there: reference_direction.PathDirections
) -> Array:
    """(M,) rad by which the reference of a place inside a move whose axis turns differs from that carried from its
    start.

    The planner counts rotation from a direction carried along by the smallest turn; where the travel is inclined to an
    axis that turns sideways, its projection turns away from that.
    """
    low = np.clip(np.ceil(s - INDEX_TOLERANCE).astype(int) - 1, 0, len(toolpath) - 1)
    out = np.zeros(len(s))
    rows = np.flatnonzero(np.abs(toolpath.axis[low] - there.axis).max(axis=1) > 1e-9)
    a, b, x, zero = toolpath.axis[low[rows]], there.axis[rows], known.zero[low[rows]], there.zero[rows]
    v = np.cross(a, b)
    c = np.einsum("ij,ij->i", a, b)[:, None]
    carried = x + np.cross(v, x) + np.cross(v, np.cross(v, x)) / np.maximum(1.0 + c, 0.1)
    out[rows] = np.arctan2(np.linalg.norm(np.cross(carried, zero), axis=1), np.einsum("ij,ij->i", carried, zero))
    return out
