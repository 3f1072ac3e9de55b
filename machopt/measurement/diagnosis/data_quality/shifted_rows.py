"""Blocks of rows whose readings are shifted by one row, caused by a deleted or an inserted cell.

:mod:`machopt.measurement.diagnosis.data_quality.session_corrections` checks whole sessions; here a block begins
anywhere. Each reading is compared with its own row and its two neighbours. The block is the interval with the largest
sum of improvements by the neighbouring row.
"""

from __future__ import annotations

from collections.abc import Collection, Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from machopt.data_types.effect_locations import format_column_location
from machopt.data_types.measurements.recording import Recording
from machopt.effects.recording.record_faults import COLUMNS
from machopt.kinematics.robot import Robot
from machopt.measurement import thresholds
from machopt.measurement.diagnosis.data_quality.correction_candidates import (
    HEADS,
    replace_rows,
    select_rows,
    shift_rows,
)
from machopt.measurement.diagnosis.data_quality.session_corrections import build_record_equations, compute_sign_test
from machopt.measurement.diagnosis.data_types.diagnosis_result import Finding
from machopt.measurement.diagnosis.data_types.record_findings import build_exact_estimate, build_record_finding
from machopt.measurement.diagnosis.data_types.reflectors_and_tracker_frames import register_positions
from machopt.numerics.array_types import Array

Flags = NDArray[np.bool_]
MOST = 3  # most shifted blocks of one recording
LOST_ROW_KEY = "lost row"  # in the parameters of a finding


def correct_shifted_rows(
    recording: Recording, robot: Robot, T_flange_tcp: Array, accept: Collection[str] = ()
) -> tuple[Recording, list[Finding]]:
    """Shift blocks of readings back to their rows if the evidence is clear.

    Args:
        recording: Load tests or measured poses. Blocks that are whole sessions are not changed.
        robot: Kinematic model of the arm.
        T_flange_tcp: (4, 4) pose of the TCP in the flange frame, m.
        accept: Names of faults that the user declares to be intended; they are not corrected.

    Returns:
        The recording (unchanged if nothing was corrected) and a finding for each block.
    """
    kind = "displacement" if recording.kind == "deflection" else "position"
    out: list[Finding] = []
    if COLUMNS.name in accept or getattr(recording, kind) is None:
        return recording, out
    if recording.kind == "deflection" and not (np.any(recording.wrench) and np.any(recording.displacement)):
        return recording, out  # no load or no measurement; reported by a later check
    if len(recording) < 2 * thresholds.COUNTS.min_comparisons:
        return recording, out
    for _ in range(MOST):
        found = _correct_worst_interval(recording, robot, T_flange_tcp, kind)
        if found is None:
            break
        recording, finding = found
        out.append(finding)
    return recording, out


def find_lost_rows(findings: Sequence[Finding], n: int) -> Flags:
    """Find rows whose own reading is missing in the file because of a shift.

    Args:
        findings: Findings of the record corrections.
        n: Number of rows.

    Returns:
        (n,) True for rows without a reading of their own.
    """
    out = np.zeros(n, bool)
    for f in findings:
        row = f.parameters.get(LOST_ROW_KEY)
        if f.effect == COLUMNS.name and row is not None:
            out[round(row.value) - 1] = True
    return out


def _correct_worst_interval(
    recording: Recording, robot: Robot, T: Array, kind: str
) -> tuple[Recording, Finding] | None:
    """Return the recording with its worst block shifted back; None if no block is certain."""
    best = max(
        (_compare_shift(register_positions(recording, robot, T), robot, T, kind, by) for by in (-1, 1)),
        key=lambda h: h.score,
    )
    rows, e, beside = best.rows, best.stated, best.shifted_error
    least = thresholds.COUNTS.min_comparisons
    if (
        rows.sum() < least
        or (~rows).sum() < least
        or (best.is_stated_model and rows.mean() > thresholds.SHARES.majority)
    ):
        return None
    if _is_whole_sessions(recording.session, rows):
        return None
    # the model is fitted to the rows outside of the block
    others = float(np.median(e[~rows]))
    before, after = float(np.median(e[rows])), float(np.median(beside[rows]))
    if before < thresholds.RATIOS.double * others or after > min(
        thresholds.SHARES.minority * before, thresholds.RATIOS.double * others
    ):
        return None
    head = HEADS[kind]
    first, last = int(np.flatnonzero(rows)[0]) + 1, int(np.flatnonzero(rows)[-1]) + 1
    words = (
        f"rows {first} to {last}: the rows of {head} … stand one too {'low' if best.shift < 0 else 'high'}; "
        "so read they fit the others, and they were read that way"
    )
    fixed = replace_rows(recording, select_rows(shift_rows(recording, kind, best.shift), rows), rows)
    days = np.unique(recording.session[rows])
    session = {"session": build_exact_estimate(float(days[0]))} if len(days) == 1 else {}
    finding = build_record_finding(
        COLUMNS.name,
        format_column_location(head),
        words,
        1e3 * before,
        1e3 * after,
        compute_sign_test(recording.pose[rows], e[rows], beside[rows]),
        {
            "first row": build_exact_estimate(float(first)),
            "last row": build_exact_estimate(float(last)),
            LOST_ROW_KEY: build_exact_estimate(float(_find_lost_row(best) + 1)),
            **session,
        },
        stated={"message": words, "rows": [first, last]},
    )
    return fixed, finding


@dataclass(frozen=True, kw_only=True)
class _ShiftComparison:
    """Comparison of a recording with itself shifted by one row."""

    shift: int
    is_stated_model: bool  # the model was fitted to the recording as stated, not to the shifted one
    stated: Array  # (N,) m, errors of the rows as recorded
    shifted_error: Array  # (N,) m, errors with the reading of the row ``shift`` before
    rows: Flags  # (N,) True inside the block
    score: float


def _compare_shift(recording: Recording, robot: Robot, T: Array, kind: str, by: int) -> _ShiftComparison:
    """Return the block that a shift by ``by`` rows fits better, with the better of two models.

    If a cell was deleted near the beginning, most rows are shifted, and only the shifted recording determines the
    model.
    """
    stated, other = (
        build_record_equations(recording, robot, T),
        build_record_equations(shift_rows(recording, kind, by), robot, T),
    )
    fits = [stated.fit(), other.fit()]
    errors = [[np.linalg.norm(q.error(x), axis=1) for q in (stated, other)] for x in fits]
    n = int(np.argmin([np.minimum(*e).sum() for e in errors]))
    e, beside = errors[n]
    gain = (e - beside) / max(float(np.median(np.minimum(e, beside))), 1e-300)
    score, at = _find_largest_interval(np.clip(gain, -thresholds.LEVELS.outlier_sigma, thresholds.LEVELS.outlier_sigma))
    rows = np.zeros(len(e), bool)
    rows[at] = True
    return _ShiftComparison(shift=by, is_stated_model=n == 0, stated=e, shifted_error=beside, rows=rows, score=score)


def _is_whole_sessions(session: NDArray[np.int64], rows: Flags) -> bool:
    """Return whether the block consists of whole sessions except for a row or two at its ends."""
    inside = np.unique(session[rows])
    every = np.isin(session, inside)
    return bool((every & ~rows).sum() <= 2 * len(inside))


def _find_lost_row(comparison: _ShiftComparison) -> int:
    """Return the row without its own reading: of the two equal rows at the block's end, the one with the larger
    error.
    """
    at = np.flatnonzero(comparison.rows)
    inside = int(at[0] if comparison.shift > 0 else at[-1])
    outside = inside - comparison.shift
    if not 0 <= outside < len(comparison.rows) or comparison.shifted_error[inside] >= comparison.stated[outside]:
        return inside
    return outside


def _find_largest_interval(gain: NDArray[np.float64]) -> tuple[float, slice]:
    """Return the largest interval sum and the interval (Kadane's algorithm)."""
    total = np.r_[0.0, np.cumsum(gain)]
    lowest = np.minimum.accumulate(total)
    stop = int(np.argmax(total - lowest))
    start = int(np.argmin(total[: stop + 1]))
    return float(total[stop] - total[start]), slice(start, stop)
