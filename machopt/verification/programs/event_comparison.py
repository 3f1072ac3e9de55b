"""Events and operation labels of a robot program against those of the CAM file."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from machopt.data_types.program_in_cell import ProgramInCell
from machopt.numerics.array_types import Array
from machopt.verification.check_results import CheckName, VerificationCheck, build_file_check
from machopt.verification.programs.difference_list import MAX_NAMED, build_list_check
from machopt.verification.programs.expected_cuts import INDEX_TOLERANCE, ExpectedCuts
from machopt.verification.programs.repeated_points import count_repeats_after, count_repeats_before

INSERTED_POINT_SPACING_M = 9e-5  # m: points that are put in keep a tenth of a millimetre from others


def check_events(
    program: ProgramInCell, cuts: ExpectedCuts, reached: NDArray[np.int64], at_index: Array
) -> list[VerificationCheck]:
    """Check that the file's events are there, all and in order, each between the moves it belongs between.

    Args:
        program: the program.
        cuts: what is wanted.
        reached: (N,) move that reaches each toolpath point, −1 where none does.
        at_index: (M,) toolpath index by the motion at each move's end, NaN where there is none.
    """
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
        beyond = event.index + count_repeats_after(
            cuts.toolpath, event.index
        )  # points that nothing moves to tell no order
        nth = int(np.searchsorted(points, event.index))  # points before the event
        # of a streamed program the sample nearest to the point may lie behind it; its index, below, decides
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
            wrong.append(f"{event.text[:30]!r} is too {'early' if early else 'late'}: before move {read.index + 1}")
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

    A move to the present place of the tool ends nowhere else, so its place does not show which point it is for.
    """
    first = index - count_repeats_before(cuts.toolpath, index) if 0 < index < len(cuts.position) else index
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


def check_operation_labels(
    program: ProgramInCell, cuts: ExpectedCuts, reached: NDArray[np.int64], at_index: Array
) -> VerificationCheck:
    """Check that the moves of a cut carry its operation's label, as far as a comment can hold it.

    A sample of a streamed program behind a point is already on the way to a later one, and carries that one's label.

    Args:
        program: the program.
        cuts: what is wanted.
        reached: (N,) move that reaches each toolpath point, −1 where none does.
        at_index: (M,) toolpath index by the motion at each move's end, NaN where there is none.
    """
    path = cuts.toolpath
    k = np.flatnonzero(cuts.wanted & (reached >= 0))
    end_of_move = k
    if program.is_streamed:
        sample_index = np.ceil(at_index[reached[k]] - INDEX_TOLERANCE)
        end_of_move = np.clip(np.where(np.isfinite(sample_index), sample_index, k), k, len(path.operation) - 1)
    labels = [_shorten_label(o.label) for o in path.operations]
    short_labels = {word: _shorten_label(word) for word in set(program.operation)}
    wrong = [
        f"point {n} is cut in {word[:30]!r}"
        for n, own, word in zip(
            k.tolist(),
            path.operation[end_of_move.astype(int)].tolist(),
            map(program.operation.__getitem__, reached[k].tolist()),
            strict=True,
        )
        if word and not labels[own].startswith(short_labels[word])
    ]
    return build_list_check(program, "operations", wrong, "points")


def _shorten_label(text: str) -> str:
    return "".join(c for c in text if c.isascii() and c.isalnum())
