"""A stretch of rows whose readings stand one row too high or too low: a cell that was deleted, or one too many.

A whole session is looked at by :mod:`.sessions`; a clerk's slip begins anywhere. Each reading is held against its own
row and the two beside it; the stretch is that with the largest sum of what a neighbour's row fits better.
"""

from __future__ import annotations

from collections.abc import Collection

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

MOST = 3  # stretches of one record


def mended(
    recording: Recording, robot: Robot, T_flange_tcp: Array, accept: Collection[str] = ()
) -> tuple[Recording, list[Finding]]:
    """Put stretches of readings back to their rows where that is sure.

    Args:
        recording: kind deflection or absolute; single sessions mended.
        robot, T_flange_tcp: the arm.
        accept: effects that the user says are none.

    Returns:
        the recording as it should have been (itself where nothing is wrong), a finding for each stretch.
    """
    kind = "displacement" if recording.kind == "deflection" else "position"
    out: list[Finding] = []
    if COLUMNS.name in accept or getattr(recording, kind) is None:
        return recording, out
    if recording.kind == "deflection" and (recording.wrench is None or not recording.wrench.any()):
        return recording, out
    for _ in range(MOST):
        found = _stretch(recording, robot, T_flange_tcp, kind)
        if found is None:
            break
        recording, finding = found
        out.append(finding)
    return recording, out


def _stretch(recording: Recording, robot: Robot, T: Array, kind: str) -> tuple[Recording, Finding] | None:
    """The recording with its worst stretch put back; None where none is sure."""
    limits, n = calibrated.RECORD, len(recording)
    brought = registered(recording, robot, T)
    stated = equations(brought, robot, T)
    fit = stated.fit()
    e = np.linalg.norm(stated.error(fit), axis=1)
    level = float(np.median(e))
    best: tuple[float, int, slice, Array] | None = None
    for by in (-1, 1):
        other = equations(slipped(brought, kind, by), robot, T)
        beside = np.linalg.norm(other.error(fit), axis=1)
        gain = (e - beside) / max(level, 1e-300)
        gain = np.clip(gain, -calibrated.NOISE.gross, calibrated.NOISE.gross)
        score, at = _largest(gain)
        if best is None or score > best[0]:
            best = score, by, at, beside
    assert best is not None
    _, by, at, beside = best
    rows = np.zeros(n, bool)
    rows[at] = True
    if rows.sum() < limits.part_readings or rows.mean() > calibrated.NOISE.mostly:
        return None
    # the others say what fits, without what stands in the stretch
    others = float(np.median(e[~rows]))
    before, after = float(np.median(e[rows])), float(np.median(beside[rows]))
    if before < limits.part_stands_out * others or after > min(
        limits.session_falls * before, limits.part_level * others
    ):
        return None
    head = HEADS[kind]
    first, last = at.start + 1, at.stop
    words = (
        f"rows {first} to {last}: the rows of {head} … stand one too {'low' if by < 0 else 'high'}; "
        "so read they fit the others, and they were read that way"
    )
    fixed = put(recording, taken(slipped(recording, kind, by), rows), rows)
    days = np.unique(recording.session[rows])
    session = {"session": exact(float(days[0]))} if len(days) == 1 else {}
    finding = repaired(
        COLUMNS.name,
        column_at(head),
        words,
        1e3 * before,
        1e3 * after,
        chance(recording.pose[rows], e[rows], beside[rows]),
        {"first row": exact(float(first)), "last row": exact(float(last)), **session},
        stated={"message": words, "rows": [first, last]},
    )
    return fixed, finding


def _largest(gain: NDArray[np.float64]) -> tuple[float, slice]:
    """The stretch with the largest sum (Kadane), and the sum."""
    total = np.r_[0.0, np.cumsum(gain)]
    lowest = np.minimum.accumulate(total)
    stop = int(np.argmax(total - lowest))
    start = int(np.argmin(total[: stop + 1]))
    return float(total[stop] - total[start]), slice(start, stop)
