"""A stretch of rows whose readings stand one row too high or too low: a cell that was deleted, or one too many.

A whole session is looked at by :mod:`.sessions`; a clerk's slip begins anywhere. Each reading is held against its own
row and the two beside it; the stretch is that with the largest sum of what a neighbour's row fits better.
"""

from __future__ import annotations

from collections.abc import Collection, Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from machopt.arrays import Array
from machopt.diagnose import calibrated
from machopt.diagnose.nouns.reflectors import registered
from machopt.diagnose.nouns.repaired import exact, repaired
from machopt.diagnose.nouns.result import Finding
from machopt.diagnose.record.rewritten import HEADS, put, slipped, taken
from machopt.diagnose.record.sessions import chance, equations
from machopt.domain.location import column_at
from machopt.domain.recording import Recording
from machopt.effects.record import COLUMNS
from machopt.model.robot import Robot

Flags = NDArray[np.bool_]
MOST = 3  # stretches of one record
LOST = "lost row"  # in the parameters of a finding


def mended(
    recording: Recording, robot: Robot, T_flange_tcp: Array, accept: Collection[str] = ()
) -> tuple[Recording, list[Finding]]:
    """Put stretches of readings back to their rows where that is sure.

    Args:
        recording: kind deflection or absolute, as read; stretches that are whole sessions stay.
        robot, T_flange_tcp: the arm.
        accept: effects that the user says are none.

    Returns:
        the recording as it should have been (itself where nothing is wrong), a finding for each stretch.
    """
    kind = "displacement" if recording.kind == "deflection" else "position"
    out: list[Finding] = []
    if COLUMNS.name in accept or getattr(recording, kind) is None:
        return recording, out
    if recording.kind == "deflection" and not (np.any(recording.wrench) and np.any(recording.displacement)):
        return recording, out  # says nothing, which is refused where it is looked at
    if len(recording) < 2 * calibrated.RECORD.part_readings:
        return recording, out
    for _ in range(MOST):
        found = _stretch(recording, robot, T_flange_tcp, kind)
        if found is None:
            break
        recording, finding = found
        out.append(finding)
    return recording, out


def lost(findings: Sequence[Finding], n: int) -> Flags:
    """(n,) rows whose own reading is nowhere in the file: where a cell was deleted, or the slip went over the end."""
    out = np.zeros(n, bool)
    for f in findings:
        row = f.parameters.get(LOST)
        if f.effect == COLUMNS.name and row is not None:
            out[round(row.value) - 1] = True
    return out


def _stretch(recording: Recording, robot: Robot, T: Array, kind: str) -> tuple[Recording, Finding] | None:
    """The recording with its worst stretch put back; None where none is sure."""
    limits = calibrated.RECORD
    best = max((_held(registered(recording, robot, T), robot, T, kind, by) for by in (-1, 1)), key=lambda h: h.score)
    rows, e, beside = best.rows, best.stated, best.moved
    least = limits.part_readings
    if rows.sum() < least or (~rows).sum() < least or (best.own and rows.mean() > calibrated.NOISE.mostly):
        return None
    if _whole_sessions(recording.session, rows):
        return None
    # the others say what fits, without what stands in the stretch
    others = float(np.median(e[~rows]))
    before, after = float(np.median(e[rows])), float(np.median(beside[rows]))
    if before < limits.part_stands_out * others or after > min(
        limits.session_falls * before, limits.part_level * others
    ):
        return None
    head = HEADS[kind]
    first, last = int(np.flatnonzero(rows)[0]) + 1, int(np.flatnonzero(rows)[-1]) + 1
    words = (
        f"rows {first} to {last}: the rows of {head} … stand one too {'low' if best.by < 0 else 'high'}; "
        "so read they fit the others, and they were read that way"
    )
    fixed = put(recording, taken(slipped(recording, kind, best.by), rows), rows)
    days = np.unique(recording.session[rows])
    session = {"session": exact(float(days[0]))} if len(days) == 1 else {}
    finding = repaired(
        COLUMNS.name,
        column_at(head),
        words,
        1e3 * before,
        1e3 * after,
        chance(recording.pose[rows], e[rows], beside[rows]),
        {
            "first row": exact(float(first)),
            "last row": exact(float(last)),
            LOST: exact(float(_lost(best) + 1)),
            **session,
        },
        stated={"message": words, "rows": [first, last]},
    )
    return fixed, finding


@dataclass(frozen=True, kw_only=True)
class _Held:
    """A record held against itself moved by one row."""

    by: int
    own: bool  # the model is that of the record as stated, not of the moved one
    stated: Array  # (N,) m, errors of rows as they stand
    moved: Array  # (N,) m, of rows with the reading of the row ``by`` before
    rows: Flags  # (N,) the stretch
    score: float


def _held(recording: Recording, robot: Robot, T: Array, kind: str, by: int) -> _Held:
    """The stretch that a move by ``by`` rows fits better, by the model that leaves the least of each row's better one.

    Where a cell was deleted near the beginning most rows are moved, and only the moved record tells the model.
    """
    stated, other = equations(recording, robot, T), equations(slipped(recording, kind, by), robot, T)
    fits = [stated.fit(), other.fit()]
    errors = [[np.linalg.norm(q.error(x), axis=1) for q in (stated, other)] for x in fits]
    n = int(np.argmin([np.minimum(*e).sum() for e in errors]))
    e, beside = errors[n]
    gain = (e - beside) / max(float(np.median(np.minimum(e, beside))), 1e-300)
    score, at = _largest(np.clip(gain, -calibrated.NOISE.gross, calibrated.NOISE.gross))
    rows = np.zeros(len(e), bool)
    rows[at] = True
    return _Held(by=by, own=n == 0, stated=e, moved=beside, rows=rows, score=score)


def _whole_sessions(session: NDArray[np.int64], rows: Flags) -> bool:
    """Whether the stretch is whole sessions, but for a row or two at its ends: these are looked at as such."""
    inside = np.unique(session[rows])
    every = np.isin(session, inside)
    return bool((every & ~rows).sum() <= 2 * len(inside))


def _lost(held: _Held) -> int:
    """The row whose own reading is nowhere: of the two at the end that then hold the same, the one it fits worse."""
    at = np.flatnonzero(held.rows)
    inside = int(at[0] if held.by > 0 else at[-1])
    outside = inside - held.by
    if not 0 <= outside < len(held.rows) or held.moved[inside] >= held.stated[outside]:
        return inside
    return outside


def _largest(gain: NDArray[np.float64]) -> tuple[float, slice]:
    """The stretch with the largest sum (Kadane), and the sum."""
    total = np.r_[0.0, np.cumsum(gain)]
    lowest = np.minimum.accumulate(total)
    stop = int(np.argmax(total - lowest))
    start = int(np.argmin(total[: stop + 1]))
    return float(total[stop] - total[start]), slice(start, stop)
