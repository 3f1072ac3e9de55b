"""Comparison of a robot program with the CAM file itself, without the motion in between.

Every cut of the CAM file is found in the program in order, on linear moves only, at the feed of the file and within
0.02 mm of its line. Every event lies between the moves it belongs to.
"""

from __future__ import annotations

import itertools
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from machopt.data_types.program_in_cell import ProgramInCell
from machopt.data_types.robot_program import LIN
from machopt.numerics.array_types import Array
from machopt.verification.check_results import CheckName, VerificationCheck, build_file_check
from machopt.verification.motion.path_geometry.axis_interpolation import interpolate_axis
from machopt.verification.motion.path_geometry.motion_polyline import MotionPolyline
from machopt.verification.motion.path_geometry.sample_location import AXIS_DEG, AXIS_LEVER_M, PATH_MM
from machopt.verification.programs.difference_list import MAX_NAMED, build_list_check
from machopt.verification.programs.event_comparison import check_events, check_operation_labels
from machopt.verification.programs.expected_cuts import INDEX_TOLERANCE, ExpectedCuts
from machopt.verification.programs.ordered_matching import match_lines_in_order
from machopt.verification.programs.repeated_points import count_repeats_before

FEED_TOLERANCE = 1e-4  # of the feed: what is left of a number printed to six digits
LINE_TIE_M = 5e-6  # m: of two lines that are equally near within this, the first one leads to the point
MAX_UNMATCHED = 100  # points that no line leads to: enough to say so


def compare_with_cam(program: ProgramInCell, cuts: ExpectedCuts, at_index: Array) -> list[VerificationCheck]:
    """Compare a program with the CAM file.

    Args:
        program: the program.
        cuts: what is wanted.
        at_index: (M,) toolpath index by the motion at each move's end, NaN where there is none.
    """
    place = program.T_workpiece_tcp[:, :3, 3] + cuts.offset
    shank = -program.T_workpiece_tcp[:, :3, 2] + cuts.tilt
    limit = max(PATH_MM * 1e-3, cuts.corner) + program.place_step
    if cuts.line is None:
        reached, gap, tilt = _find_cut_moves(
            place, shank, cuts, limit, 0.0 if program.is_streamed else program.print_resolution
        )
    else:
        reached, gap, tilt = _find_streamed_cut_moves(cuts.line, cuts, at_index, limit)
    points = np.flatnonzero(cuts.wanted)
    missing = points[reached[points] < 0]
    worst = float(gap[points].max(initial=0.0))
    text = (
        f"{len(missing)} of {len(points)} are not reached in order, first point {missing[0]}"
        if len(missing)
        else ("all reached in order")
    )
    checks = [
        build_file_check(program.file, CheckName.CAM_POINTS, not len(missing), 1e3 * worst, 1e3 * limit, "mm", text)
    ]
    there = points[reached[points] >= 0]
    if len(there):
        tilted = int(there[np.argmax(tilt[there])])
        allowed = max(
            cuts.corner / 1e-1, cuts.axis_corner if program.is_streamed else 0.0
        )  # others say the point itself
        most = max(AXIS_DEG, float(np.degrees(allowed))) + float(np.degrees(program.joint_step))
        checks.append(
            build_file_check(
                program.file,
                "CAM tool axis",
                bool(np.degrees(tilt[tilted]) <= most),
                float(np.degrees(tilt[tilted])),
                most,
                "deg",
                f"point {tilted}",
            )
        )
        checks += _check_cut_moves(program, place, cuts, reached, limit)
    checks += [
        *check_events(program, cuts, reached, at_index),
        check_operation_labels(program, cuts, reached, at_index),
    ]
    return checks


def _find_cut_moves(
    place: Array, shank: Array, cuts: ExpectedCuts, limit: float, printed: float = 0.0
) -> tuple[NDArray[np.int64], Array, Array]:
    """(N,) the move on whose line each wanted point lies first, in order, −1 for none; m; rad between the axes."""
    reached, share, gap = match_lines_in_order(
        np.ascontiguousarray(place),
        np.ascontiguousarray(shank),
        np.ascontiguousarray(cuts.position),
        np.array(cuts.toolpath.axis, float, order="C"),  # a copy: the kernel is compiled for arrays that may be written
        cuts.wanted,
        limit,
        AXIS_LEVER_M,
        LINE_TIE_M + printed,
        MAX_UNMATCHED,
    )
    tilt, on = np.full(len(reached), np.nan), np.flatnonzero(reached >= 0)
    j, wanted = reached[on], cuts.toolpath.axis[on]
    axis = interpolate_axis(shank[j - 1], shank[j], share[on])
    tilt[on] = np.arctan2(np.linalg.norm(np.cross(axis, wanted), axis=1), np.sum(axis * wanted, axis=1))
    return reached, gap, tilt


def _find_streamed_cut_moves(
    line: MotionPolyline, cuts: ExpectedCuts, at_index: Array, limit: float
) -> tuple[NDArray[np.int64], Array, Array]:
    """As :func:`_find_cut_moves`, of a streamed program: the motion's own index shows between which samples each point
    lies.

    Args:
        line: the samples, and the corners between them.
        at_index: (S,) toolpath index at the samples, NaN where there is none.
        limit: m, nearer than this to the line counts.
    """
    count, rows = len(cuts.wanted), np.arange(len(cuts.offset))
    offset, tilt = (
        np.column_stack([np.interp(line.sample, rows, of[:, c]) for c in range(3)]) for of in (cuts.offset, cuts.tilt)
    )
    place, shank = line.position + offset, -line.rotation[:, :, 2] + tilt
    known = np.flatnonzero(np.isfinite(at_index))
    reached, gap, tilted = np.full(count, -1), np.full(count, np.nan), np.full(count, np.nan)
    wanted_points = np.flatnonzero(cuts.wanted)
    gap[wanted_points] = np.inf
    if not len(known) or not len(wanted_points):
        return reached, gap, tilted
    nth = np.searchsorted(np.maximum.accumulate(at_index[known]), wanted_points - INDEX_TOLERANCE)
    wanted_points, nth = wanted_points[nth < len(known)], nth[nth < len(known)]
    row = known[nth]
    first = np.searchsorted(line.sample, np.maximum(row - 1, 0))
    last = np.maximum(np.searchsorted(line.sample, row), first + 1)
    best = np.full(len(wanted_points), np.inf)
    for k in range(int((last - first).max(initial=0))):
        a = np.minimum(first + k, len(place) - 2)
        way, wanted = place[a + 1] - place[a], cuts.toolpath.axis[wanted_points]
        turn = AXIS_LEVER_M * (shank[a + 1] - shank[a])  # where the tool turns on the spot, the place shows no share
        length2 = np.einsum("ij,ij->i", way, way) + np.einsum("ij,ij->i", turn, turn)
        along = np.einsum("ij,ij->i", cuts.position[wanted_points] - place[a], way)
        along += np.einsum("ij,ij->i", AXIS_LEVER_M * (wanted - shank[a]), turn)
        share = np.clip(np.where(length2 > 0.0, along / np.where(length2 > 0.0, length2, 1.0), 1.0), 0.0, 1.0)
        away = np.linalg.norm(place[a] + share[:, None] * way - cuts.position[wanted_points], axis=1)
        axis = interpolate_axis(shank[a], shank[a + 1], share)
        angle = np.arctan2(np.linalg.norm(np.cross(axis, wanted), axis=1), np.sum(axis * wanted, axis=1))
        better = (np.hypot(away, AXIS_LEVER_M * angle) < best) & (first + k < last)
        best[better] = np.hypot(away, AXIS_LEVER_M * angle)[better]
        gap[wanted_points[better]], tilted[wanted_points[better]] = away[better], angle[better]
    on = gap[wanted_points] <= limit
    reached[wanted_points[on]] = row[on]
    tilted[wanted_points[~on]] = np.nan
    return reached.astype(np.int64), gap, tilted


@dataclass(frozen=True, kw_only=True)
class _CutMoves:
    """Moves of a program that make the cuts to n points of the CAM file, M moves in all."""

    program: ProgramInCell
    point: NDArray[np.int64]  # (n,) of the CAM file
    first: NDArray[np.int64]  # (n,) first move of each cut
    last: NDArray[np.int64]  # (n,) move that ends at the point
    cut: NDArray[np.int64]  # (M,) which cut each move belongs to
    move: NDArray[np.int64]  # (M,)
    still: NDArray[np.bool_]  # (n,) nothing moves to what is reached already
    same: NDArray[np.bool_]  # of each move of the program: it ends where it begins

    @classmethod
    def build(
        cls, program: ProgramInCell, place: Array, cuts: ExpectedCuts, reached: NDArray[np.int64], limit: float
    ) -> _CutMoves:
        path = cuts.toolpath
        behind = (
            np.arange(len(reached)) > 0
        )  # nothing is cut on the way to the first point of the file: the arm comes from home
        k = np.flatnonzero(cuts.wanted & (reached >= 0) & behind)
        j, first = reached[k], _find_first_moves(place, cuts, reached, k, limit)
        count = j - first + 1
        nth = np.repeat(np.arange(len(k)), count)  # of each move: which point's cut it belongs to
        step = np.abs(np.diff(np.hstack([path.position, path.axis]), axis=0)).max(axis=1)
        return cls(
            program=program,
            point=k,
            first=first,
            last=j,
            cut=nth,
            move=first[nth] + np.arange(len(nth)) - np.repeat(np.cumsum(count) - count, count),
            still=np.append(False, step < 1e-9)[k],
            same=np.append(False, np.abs(np.diff(program.T_workpiece_tcp, axis=0)).max(axis=(1, 2)) < 1e-9),
        )

    def describe(self, n: int) -> str:
        """Return the place of a cut in the program."""
        j = self.last[n]
        return f"move {j + 1}, line {int(self.program.line[j])}, to point {self.point[n]}"

    def find_bent(self) -> NDArray[np.bool_]:
        """Return (n,) cuts that are not linear."""
        bent = np.zeros(len(self.point), bool)
        if not self.program.is_streamed:
            bent[self.cut[self.program.kind[self.move] != LIN]] = True
            bent &= ~self.still
        return bent


def _check_cut_moves(
    program: ProgramInCell, place: Array, cuts: ExpectedCuts, reached: NDArray[np.int64], limit: float
) -> list[VerificationCheck]:
    """The moves of each cut: linear, at the file's feed, on the file's line, none of them twice."""
    moves = _CutMoves.build(program, place, cuts, reached, limit)
    bent = moves.find_bent()
    joint = [moves.describe(n) for n in np.flatnonzero(bent).tolist()]
    return [
        build_list_check(program, "cuts are linear", joint, "cuts"),
        _check_cut_feeds(moves, cuts, bent),
        *_check_cut_lines(moves, place, cuts, bent, limit),
    ]


def _check_cut_feeds(moves: _CutMoves, cuts: ExpectedCuts, bent: NDArray[np.bool_]) -> VerificationCheck:
    """Return the check that the cuts have the file's feed."""
    program, nth, move = moves.program, moves.cut, moves.move
    fast, worst_feed = [], 0.0
    if not program.is_streamed:
        want = cuts.toolpath.feed[moves.point]
        off = np.abs(program.feed[move] - want[nth])
        off[np.isnan(off)] = np.inf
        fed = (np.isfinite(want) & ~bent & ~moves.still)[nth] & ~moves.same[move]
        worst_feed = float(off[fed].max(initial=0.0))
        wrong = fed & ~(off <= program.feed_step + FEED_TOLERANCE * want[nth])
        for n in np.unique(nth[wrong])[:MAX_NAMED].tolist():
            m = move[nth == n][int(np.argmax(off[nth == n]))]
            fast.append(f"{moves.describe(n)}: {6e4 * program.feed[m]:g} instead of {6e4 * want[n]:g} mm/min")
    return build_file_check(
        program.file,
        CheckName.CAM_FEED,
        not fast,
        6e4 * worst_feed,
        6e4 * program.feed_step,
        "mm/min",
        "; ".join(fast[:MAX_NAMED]) or "all as in the file",
    )


def _check_cut_lines(
    moves: _CutMoves, place: Array, cuts: ExpectedCuts, bent: NDArray[np.bool_], limit: float
) -> list[VerificationCheck]:
    """Return the checks that the cuts lie on the file's lines, and that none of their moves occurs twice."""
    index, corner = cuts.corners
    program, path, k, first, j = moves.program, cuts.toolpath, moves.point, moves.first, moves.last
    off_line, double, worst_line = [], [], 0.0
    repeats = np.append(0, np.cumsum(moves.same))
    far = np.append(False, np.linalg.norm(np.diff(path.position, axis=0), axis=1) > 1e-6)
    for n in np.flatnonzero((k > 0) & (first < j) & ~bent).tolist():  # where moves lead on between two points
        inner = place[first[n] : j[n]]
        on = slice(*np.searchsorted(index, (k[n] - 1 - 1e-9, k[n] + 1e-9)))
        away = _compute_polyline_distance(inner, corner[on]) if on.stop - on.start > 1 else np.zeros(len(inner))
        worst_line = max(worst_line, float(away.max()))
        if (away > limit).any():
            off_line.append(f"{moves.describe(n)}: {1e3 * away.max():.3f} mm beside the cut")
        if not program.is_streamed and far[k[n]] and first[n] > 0:
            twice = int(repeats[j[n] + 1] - repeats[first[n]])
            double += [moves.describe(n)] if twice > count_repeats_before(path, int(k[n]) - 1) else []
    return [
        build_file_check(
            program.file,
            "on the CAM lines",
            not off_line,
            1e3 * worst_line,
            1e3 * limit,
            "mm",
            "; ".join(off_line[:MAX_NAMED]) or "all",
        ),
        build_list_check(program, "no move twice", double, "moves"),
    ]


def _find_first_moves(
    place: Array, cuts: ExpectedCuts, reached: NDArray[np.int64], k: NDArray[np.int64], limit: float
) -> NDArray[np.int64]:
    """(K,) the first move of the cut that leads to each of the points k: behind where the point before is reached."""
    before = np.where(k > 0, reached[k - 1], -1)
    for n in np.flatnonzero((k > 0) & (before < 0)).tolist():
        before[n] = _find_arriving_move(place, cuts.position[k[n] - 1], int(reached[k[n]]), limit)
    for n in np.flatnonzero(np.isin(k - 1, cuts.reentries)).tolist():  # lifted there: the cut goes on from its return
        left, stop = max(int(before[n]), 0), int(reached[k[n]])
        near = np.linalg.norm(place[left:stop] - cuts.position[k[n] - 1], axis=1) <= limit
        before[n] = left + int(np.flatnonzero(near)[-1]) if near.any() else before[n]
    return np.where(before >= 0, np.minimum(before + 1, reached[k]), reached[k])


def _find_arriving_move(place: Array, point: Array, before: int, limit: float) -> int:
    """The last move ahead of ``before`` that ends at ``point``, among the few before it; −1 for none."""
    rows = place[max(before - 64, 0) : before]
    near = np.flatnonzero(np.linalg.norm(rows - point, axis=1) <= limit)
    return int(near[-1]) + max(before - 64, 0) if len(near) else -1


def _compute_polyline_distance(points: Array, corners: Array) -> Array:
    """(K,) m of points (K, 3) to the nearest line between successive corners (C, 3)."""
    best = np.full(len(points), np.inf)
    for a, b in itertools.pairwise(corners):
        way = b - a
        share = np.clip((points - a) @ way / max(float(way @ way), 1e-18), 0.0, 1.0)
        best = np.minimum(best, np.linalg.norm(points - a - share[:, None] * way, axis=1))
    return best
