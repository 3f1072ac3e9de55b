"""Signs, axes, joints and rows that are exchanged in the whole recording, detected by the model alone.

A correction is accepted if it reduces the error strongly and no other correction is nearly as good.
"""

from __future__ import annotations

from collections.abc import Collection, Iterator
from dataclasses import replace
from itertools import combinations

import numpy as np

from machopt.data_types.effect_locations import format_column_location
from machopt.data_types.measurements.recording import Recording
from machopt.effects.recording.record_faults import COLUMNS, UNITS
from machopt.kinematics.robot import Robot
from machopt.measurement import thresholds
from machopt.measurement.diagnosis.data_quality.correction_candidates import (
    CorrectionCandidate,
    generate_correction_candidates,
    generate_moment_units,
)
from machopt.measurement.diagnosis.data_quality.session_corrections import (
    RecordEquations,
    build_record_equations,
    compute_sign_test,
    compute_typical_error,
)
from machopt.measurement.diagnosis.data_types.diagnosis_result import Finding
from machopt.measurement.diagnosis.data_types.record_findings import build_exact_estimate, build_record_finding
from machopt.measurement.diagnosis.data_types.reflectors_and_tracker_frames import register_positions
from machopt.numerics.array_types import Array


def correct_swapped_columns(
    recording: Recording, robot: Robot, T_flange_tcp: Array, accept: Collection[str] = ()
) -> tuple[Recording, list[Finding]]:
    """Correct exchanged columns of a whole recording if the evidence is clear; at most one fault.

    Args:
        recording: Load tests or measured poses with corrected units, frames and sessions.
        robot: Kinematic model of the arm.
        T_flange_tcp: (4, 4) pose of the TCP in the flange frame, m.
        accept: Names of faults that the user declares to be intended; they are not corrected.

    Returns:
        The recording (unchanged if nothing was corrected) and a finding for each correction.
    """
    if "columns" in accept or (recording.kind == "absolute" and recording.position is None):
        return recording, []
    stated = build_record_equations(register_positions(recording, robot, T_flange_tcp), robot, T_flange_tcp)
    before = _compute_errors(stated)
    left = _compute_error_share(stated, before)
    gate = thresholds.SHARES.relevant if recording.kind == "deflection" else thresholds.SHARES.pose_misfit
    if left < gate:
        return recording, []
    found: list[tuple[float, int, CorrectionCandidate, Recording, Array]] = []
    for way in _list_column_readings(recording):
        changed = way.apply(recording)
        now = build_record_equations(register_positions(changed, robot, T_flange_tcp), robot, T_flange_tcp)
        after = _compute_errors(now)
        if _compute_error_share(now, after) < thresholds.SHARES.corrected_misfit * left:
            found.append((_compute_error_share(now, after), len(found), way, changed, after))
    if not found:
        return recording, []
    least, _, way, changed, after = min(found, key=lambda f: f[:2])
    if compute_typical_error(after) > thresholds.SHARES.corrected_misfit * compute_typical_error(before):
        return recording, []
    as_good = [f for f in found if f[0] < thresholds.RATIOS.equal_fit * least]
    if recording.registration == "fit" and {f[2].column for f in as_good} == {"x_mm"}:
        _, _, way, changed, after = as_good[0]  # with a free frame all mirrored readings are equivalent
    elif len(as_good) > 1:  # ambiguous: nothing is corrected
        return recording, []
    return changed, [_build_column_finding(way, least / left, stated, before, after)]


def correct_moment_units(
    recording: Recording, robot: Robot, T_flange_tcp: Array, accept: Collection[str] = ()
) -> tuple[Recording, list[Finding]]:
    """Correct moments that are in another unit in every row while forces are not.

    Too small moments lie within the uncertainty of the sensor and would count as noise, together with their lever
    effect. The comparison uses models with the moments as stated and without moments.

    Args:
        recording: Load tests with corrected sessions.
        robot: Kinematic model of the arm.
        T_flange_tcp: (4, 4) pose of the TCP in the flange frame, m.
        accept: Names of faults that the user declares to be intended; they are not corrected.

    Returns:
        The recording (unchanged if nothing was corrected) and a finding for each correction.
    """
    if UNITS.name in accept or recording.wrench is None or not recording.wrench[:, 3:].any():
        return recording, []
    stated = build_record_equations(recording, robot, T_flange_tcp)
    if not stated.wrench[:, :3].any() or not stated.y.any() or len(recording) < thresholds.COUNTS.min_comparisons:
        return recording, []
    before = _compute_errors(stated)
    left = _compute_error_share(stated, before)
    silent = recording.wrench.copy()
    silent[:, 3:] = 0.0
    without = build_record_equations(replace(recording, wrench=silent), robot, T_flange_tcp)
    least = min(left, _compute_error_share(without, _compute_errors(without)))
    found = []
    for way in generate_moment_units():
        changed = way.apply(recording)
        now = build_record_equations(changed, robot, T_flange_tcp)
        after = _compute_errors(now)
        found.append((_compute_error_share(now, after), way, changed, after))
    found.sort(key=lambda f: f[0])
    (best, way, changed, after), (second, *_) = found[:2]
    if best > thresholds.SHARES.corrected_misfit * least or second < thresholds.RATIOS.equal_fit * best:
        return recording, []
    return changed, [_build_column_finding(way, best / left, stated, before, after)]


def _build_column_finding(
    way: CorrectionCandidate, share: float, stated: RecordEquations, before: Array, after: Array
) -> Finding:
    """Build the finding of exchanged columns that leave a ``share`` of the previous errors (N, 3) m."""
    return build_record_finding(
        way.effect,
        format_column_location(way.column),
        f"{way.words}, in the whole record: so read the model leaves {100 * share:.2g} % of what it left",
        1e3 * compute_typical_error(before),
        1e3 * compute_typical_error(after),
        compute_sign_test(stated.pose, *(np.linalg.norm(e, axis=1) for e in (before, after))),
        {"factor": build_exact_estimate(1.0 / way.factor)} if way.factor != 1.0 else {},
    )


def _list_column_readings(recording: Recording) -> Iterator[CorrectionCandidate]:
    """Yield candidates without units (separate check) and without rotations of the whole load."""
    for way in generate_correction_candidates(recording):
        if way.effect == COLUMNS.name:
            yield way
    n = recording.q.shape[1]
    for a, b in combinations(range(n), 2):
        yield CorrectionCandidate(
            effect=COLUMNS.name,
            column=f"q{a + 1}_deg",
            words=f"q{a + 1}_deg and q{b + 1}_deg are exchanged",
            apply=lambda r, a=a, b=b: _exchange_joints(r, a, b),  # type: ignore[misc]
        )


def _exchange_joints(r: Recording, a: int, b: int) -> Recording:
    q = r.q.copy()
    q[:, [a, b]] = q[:, [b, a]]
    return replace(r, q=q)


def _compute_errors(e: RecordEquations) -> Array:
    return e.error(e.fit())


def _compute_error_share(e: RecordEquations, error: Array) -> float:
    return float(np.abs(error).sum() / max(e.size.sum(), 1e-300))
