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
from machopt.data_types.toolpath import Toolpath
from machopt.numerics.array_types import Array
from machopt.verification.checks import CheckName, VerificationCheck, build_file_check
from machopt.verification.motion.path_geometry.axis_interpolation import interpolate_axis
from machopt.verification.motion.path_geometry.motion_polyline import MotionPolyline
from machopt.verification.motion.path_geometry.sample_location import AXIS_DEG, PATH_MM
from machopt.verification.programs.ordered_matching import match_lines_in_order
from machopt.verification.programs.target_matching import AXIS_LEVER_M

FEED_TOLERANCE = 1e-4  # of the feed: what is left of a number printed to six digits
MAX_NAMED = 3
LINE_TIE_M = 5e-6  # m: of two lines that are equally near within this, the first one leads to the point
MAX_UNMATCHED = 100  # points that no line leads to: enough to say so
INSERTED_POINT_SPACING_M = 9e-5  # m: points that are put in keep a tenth of a millimetre from others
INDEX_TOLERANCE = 5e-5  # of a toolpath index: rounding of trajectory.csv's point column


@dataclass(frozen=True, kw_only=True)
class ExpectedCuts:
    """Cuts and events that the CAM file requires of the program."""

    toolpath: Toolpath
    position: Array  # (N, 3) m, its points; shifted where the path is commanded against a deflection
    corners: tuple[Array, Array]  # (P,) toolpath index and (P, 3) m of the commanded path's corners
    wanted: NDArray[np.bool_]  # (N,) cutting points that the program must reach
    corner: float  # m, beyond 0.02 mm, that the user allowed
    axis_corner: float  # rad, beyond 0.05°, the same of the tool axis
    approach_feed: float  # m/s where the CAM file has none
    offset: Array  # (M, 3) m from where a controller's nominal kinematics put the tool to where it truly is
    tilt: Array  # (M, 3) what is to be added to the tool axis (tip to shank) for the same reason
    reentries: tuple[int, ...] = ()  # points at which the tool is lifted inside of a cut
    line: MotionPolyline | None = None  # of a streamed program: its samples, with the path's corners between them


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
        *_check_events(program, cuts, reached, at_index),
        _check_operation_labels(program, cuts, reached, at_index),
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
    """As :func:`_find_cut_moves`, of a streamed program: the motion's own index tells between which samples each point
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
        way = place[a + 1] - place[a]
        length2 = np.einsum("ij,ij->i", way, way)
        along = np.einsum("ij,ij->i", cuts.position[wanted_points] - place[a], way)
        share = np.clip(np.where(length2 > 0.0, along / np.where(length2 > 0.0, length2, 1.0), 1.0), 0.0, 1.0)
        away = np.linalg.norm(place[a] + share[:, None] * way - cuts.position[wanted_points], axis=1)
        axis, wanted = interpolate_axis(shank[a], shank[a + 1], share), cuts.toolpath.axis[wanted_points]
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
        _build_list_check(program, "cuts are linear", joint, "cuts"),
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
            double += [moves.describe(n)] if twice > _count_repeats_before(path, int(k[n]) - 1) else []
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
        _build_list_check(program, "no move twice", double, "moves"),
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


def _build_list_check(program: ProgramInCell, what: str, wrong: list[str], unit: str) -> VerificationCheck:
    return build_file_check(
        program.file, what, not wrong, float(len(wrong)), 0.0, unit, "; ".join(wrong[:MAX_NAMED]) or "all"
    )


def _count_repeats_before(path: Toolpath, k: int) -> int:
    """How many points before k are the same place with the same axis: the file's own doubled moves."""
    count = 0
    while k > count and (
        np.abs(path.position[k - count - 1] - path.position[k]).max() < 1e-9
        and np.abs(path.axis[k - count - 1] - path.axis[k]).max() < 1e-9
    ):
        count += 1
    return count


def _count_repeats_after(path: Toolpath, k: int) -> int:
    """How many points from k on are the place of the point before with its axis."""
    count = 0
    while k > 0 and k + count < len(path) and _count_repeats_before(path, k + count) > count:
        count += 1
    return count


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


def _check_events(
    program: ProgramInCell, cuts: ExpectedCuts, reached: NDArray[np.int64], at_index: Array
) -> list[VerificationCheck]:
    """The file's events, all and in order, each between the moves it belongs between."""
    events = cuts.toolpath.events
    if len(program.events) != len(events):
        missing = _find_first_missing_event(program, cuts)
        have, need = float(len(program.events)), float(len(events))
        return [build_file_check(program.file, CheckName.EVENTS, False, have, need, "events", missing)]
    wrong: list[str] = []
    points = np.flatnonzero(cuts.wanted & (reached >= 0))
    finite = np.flatnonzero(np.isfinite(at_index))
    known = at_index.copy()
    if len(finite):  # on the way from home as to the first point; on the way home behind all
        known[: finite[0]], known[finite[-1] + 1 :] = at_index[finite[0]], np.inf
        known[0] = at_index[0] if np.isfinite(at_index[0]) else -np.inf  # home itself is ahead of all
    dwelt = {e.index: n for n, e in enumerate(events) if e.kind == "dwell"}
    for n, (read, event) in enumerate(zip(program.events, events, strict=True)):
        text, back = _shorten_label(event.text), _shorten_label(read.text)
        if not text.startswith(back) or bool(text) != bool(back):
            wrong.append(f"{read.text[:30]!r} instead of {event.text[:30]!r}")
            continue
        beyond = event.index + _count_repeats_after(
            cuts.toolpath, event.index
        )  # points that nothing moves to tell no order
        nth = int(np.searchsorted(points, event.index))  # points before the event
        # of a streamed program the sample nearest to the point may lie behind it; its index, below, tells
        early = nth > 0 and read.index <= reached[points[nth - 1]] - int(program.is_streamed)
        behind = int(np.searchsorted(points, beyond))
        late = behind < len(points) and read.index > reached[points[behind]]
        if len(finite) and 0 < read.index < len(known):
            slack = _compute_end_tolerance(
                cuts, event.index, 0.0 if program.is_streamed else INSERTED_POINT_SPACING_M + program.place_step
            )
            first = bool(known[read.index] <= event.index - 1 + slack)
            if n <= dwelt.get(event.index, -1):  # at the point itself, though the tool is then drawn out of it
                first = first and not _is_move_end_at_point(program, cuts, event.index, read.index, known)
            early |= first and not _is_at_point_before_move(program, cuts, event.index, read.index, known)
            settled = finite[0] < read.index and event.index < len(cuts.position)  # the ways from and to home have none
            slack = (
                slack
                if beyond == event.index
                else _compute_end_tolerance(cuts, beyond, 0.0 if program.is_streamed else INSERTED_POINT_SPACING_M)
            )
            at = known[read.index - 1]
            gone = bool(at > beyond - 1 + slack)
            # the index of a free way runs with time: where it sets out from rest, the tool may still be at the point
            gone = gone and not (at < beyond - 0.5 and _is_move_end_at_point(program, cuts, beyond, read.index, known))
            late |= settled and gone
        if early or late:
            wrong.append(f"{event.text[:30]!r} stands too {'early' if early else 'late'}: before move {read.index + 1}")
    text = "; ".join(wrong[:MAX_NAMED]) or "all in place"
    return [build_file_check(program.file, CheckName.EVENTS, not wrong, float(len(wrong)), 0.0, "events", text)]


def _compute_end_tolerance(cuts: ExpectedCuts, index: int, way: float) -> float:
    """How far behind ``index`` − 1 a move may end and still end there; nothing else ends within ``way`` m."""
    if not 0 < index < len(cuts.position):
        return 0.5
    length = float(np.linalg.norm(cuts.position[index] - cuts.position[index - 1]))
    return max(INDEX_TOLERANCE, min(0.5, way / length if length > 0.0 else 0.5))


def _is_at_point_before_move(program: ProgramInCell, cuts: ExpectedCuts, index: int, move: int, known: Array) -> bool:
    """Whether the program is at point ``index`` − 1 before its move ``move``, and point ``index`` lies there too.

    A move to where the tool stands already ends nowhere else, so its place does not tell which point it is for.
    """
    first = index - _count_repeats_before(cuts.toolpath, index) if 0 < index < len(cuts.position) else index
    if first >= index:
        return False
    away = float(
        np.linalg.norm(program.T_workpiece_tcp[move - 1, :3, 3] + cuts.offset[move - 1] - cuts.position[first])
    )
    return away <= INSERTED_POINT_SPACING_M + program.place_step and bool(known[move - 1] > first - 0.5)


def _is_move_end_at_point(program: ProgramInCell, cuts: ExpectedCuts, index: int, move: int, known: Array) -> bool:
    """Whether the move before ``move`` ends at point ``index`` − 1, and is not on its way to an earlier one."""
    if not 0 < index <= len(cuts.position) or not known[move - 1] > index - 1.5:
        return False
    away = float(
        np.linalg.norm(program.T_workpiece_tcp[move - 1, :3, 3] + cuts.offset[move - 1] - cuts.position[index - 1])
    )
    return away <= INSERTED_POINT_SPACING_M + program.place_step


def _find_first_missing_event(program: ProgramInCell, cuts: ExpectedCuts) -> str:
    for read, event in zip(program.events, cuts.toolpath.events, strict=False):
        if not _shorten_label(event.text).startswith(_shorten_label(read.text)):
            return f"{len(program.events)} for {len(cuts.toolpath.events)}; first other: {read.text[:40]!r}"
    return f"{len(program.events)} for {len(cuts.toolpath.events)} of the CAM file"


def _check_operation_labels(
    program: ProgramInCell, cuts: ExpectedCuts, reached: NDArray[np.int64], at_index: Array
) -> VerificationCheck:
    """The moves of a cut carry its operation's label, as far as a comment can hold it.

    A sample of a streamed program behind a point is already on the way to a later one, and carries that one's label.
    """
    path = cuts.toolpath
    k = np.flatnonzero(cuts.wanted & (reached >= 0))
    end_of_move = k
    if program.is_streamed:
        sample_index = np.ceil(at_index[reached[k]] - INDEX_TOLERANCE)
        end_of_move = np.clip(np.where(np.isfinite(sample_index), sample_index, k), k, len(path.operation) - 1)
    labels = [_shorten_label(o.label) for o in path.operations]
    kept = {word: _shorten_label(word) for word in set(program.operation)}
    wrong = [
        f"point {n} is cut in {word[:30]!r}"
        for n, own, word in zip(
            k.tolist(),
            path.operation[end_of_move.astype(int)].tolist(),
            map(program.operation.__getitem__, reached[k].tolist()),
            strict=True,
        )
        if word and not labels[own].startswith(kept[word])
    ]
    return _build_list_check(program, "operations", wrong, "points")


def _shorten_label(text: str) -> str:
    return "".join(c for c in text if c.isascii() and c.isalnum())
