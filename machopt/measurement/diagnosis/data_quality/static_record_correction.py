"""Checks and corrections of a static recording: units, frames, signs, impossible rows.

A faulty recording explains more mismatch than rare physical effects. Certain faults are corrected before any physics
is tried and are reported as findings. Suspected faults are reported as warnings.
"""

from __future__ import annotations

from collections.abc import Collection
from dataclasses import replace

import numpy as np
from numpy.typing import NDArray
from scipy.special import bdtrc

from machopt.data_types.effect_locations import format_column_location
from machopt.data_types.measurements.recording import FrameName, Recording
from machopt.effects.recording.record_faults import FORCES, UNITS
from machopt.effects.recording.sensor_errors import DISPLACEMENT, FRAME, LOAD
from machopt.kinematics.robot import Robot
from machopt.measurement.diagnosis.data_quality import session_corrections, shifted_rows, swapped_columns
from machopt.measurement.diagnosis.data_quality.inconsistent_loads import correct_inconsistent_loads
from machopt.measurement.diagnosis.data_quality.load_and_length_units import find_displacement_unit_fault
from machopt.measurement.diagnosis.data_types import load_resolution
from machopt.measurement.diagnosis.data_types.diagnosis_result import EstimatedValue, Finding
from machopt.measurement.diagnosis.data_types.record_findings import build_exact_estimate, build_record_finding
from machopt.measurement.estimation.load_test_equations import LoadTestExperiment, build_load_test_experiment
from machopt.measurement.estimation.robust_weights import fit_least_absolute_deviations
from machopt.measurement.identification.data_quality.load_test_checks import check_experiment
from machopt.measurement.identification.data_quality.record_fault_type import RecordFault as Problem
from machopt.measurement.identification.data_quality.sensor_axes import CODE as SENSOR_AXES
from machopt.measurement.identification.data_quality.sensor_axes import find_rotated_axes
from machopt.measurement.identification.data_quality.unit_checks import estimate_reach
from machopt.numerics.array_types import Array
from machopt.numerics.rigid_transforms import convert_to_rotation_vector

Flags = NDArray[np.bool_]
MOST_REPAIRS = 3
FRAMES = {
    "displacement_frame": (DISPLACEMENT, DISPLACEMENT.places[0]),
    "wrench_frame": (FRAME, FRAME.places[0]),
    "frames": (DISPLACEMENT, DISPLACEMENT.places[0]),
    "load_sign": (LOAD, LOAD.places[0]),
    "moment_at_base": (LOAD, LOAD.places[0]),
    "moment_at_flange": (LOAD, LOAD.places[0]),
}


def correct_static_record(
    recording: Recording,
    robot: Robot,
    T_flange_tcp: Array,
    prior: Array | None,
    accept: Collection[str] = (),
    *,
    estimated: bool = False,
) -> tuple[Recording, list[Finding], list[str]]:
    """Check and correct a recording of load tests or poses.

    Args:
        recording: Recording as read.
        robot: Kinematic model of the arm.
        T_flange_tcp: (4, 4) pose of the TCP in the flange frame, m.
        prior: (6,) joint stiffness of the cell, N·m/rad; None if unknown.
        accept: Codes of faults that the user declares to be intended.
        estimated: Whether that stiffness is only estimated from the arm's size.

    Returns:
        The corrected recording, a finding for each correction, and warnings.

    Raises:
        InputError: The recording has no load or no displacement.
    """
    recording, late = shifted_rows.correct_shifted_rows(recording, robot, T_flange_tcp, accept)
    recording, odd = session_corrections.correct_sessions_and_poses(recording, robot, T_flange_tcp, prior, accept)
    odd = [*late, *odd]
    if recording.kind == "absolute":
        recording, more = swapped_columns.correct_swapped_columns(recording, robot, T_flange_tcp, accept)
        return recording, [*odd, *more], []
    findings: list[Finding] = []
    warnings: list[str] = []
    recording, turned = swapped_columns.correct_moment_units(recording, robot, T_flange_tcp, accept)
    odd = [*odd, *turned]
    recording, silent = load_resolution.discard_noise_components(recording)
    for _ in range(MOST_REPAIRS):
        tests = build_load_test_experiment(recording, robot, T_flange_tcp)
        found = check_experiment(tests, robot, T_flange_tcp, prior)
        error = next((f for f in found if f.severity == "error" and f.code not in accept), None)
        size = (
            None
            if "units" in accept
            else find_displacement_unit_fault(tests, prior, estimate_reach(robot, T_flange_tcp), estimated)
        )
        if size is not None and (error is None or error.code == "rotation_units"):
            error = size
        elif error is not None and error.code == "force_units":
            error = _find_force_unit_fault(error, recording, robot, T_flange_tcp)
        warnings = [f.message for f in found if f is not error]
        if error is None:
            break
        before = _compute_misfit(tests)
        corrected = _apply_correction(recording, error, robot, T_flange_tcp)
        if corrected is None:
            warnings.insert(0, error.message)
            break
        recording = corrected
        right = build_load_test_experiment(recording, robot, T_flange_tcp)
        usual = _select_reference_stiffness(prior, estimate_reach(robot, T_flange_tcp), len(robot.joints))
        chance = _compute_sign_test(
            tests.pose, _compute_misfit_by_pose(tests, usual), _compute_misfit_by_pose(right, usual)
        )
        findings = _merge_findings(findings, _build_correction_finding(error, before, _compute_misfit(right), chance))
    recording, more = correct_inconsistent_loads(recording, robot, T_flange_tcp)
    recording, exchanged = swapped_columns.correct_swapped_columns(recording, robot, T_flange_tcp, accept)
    rotated: list[Finding] = []
    if not exchanged and not {SENSOR_AXES, "columns"} & set(accept):
        usual = _select_reference_stiffness(prior, estimate_reach(robot, T_flange_tcp), len(robot.joints))
        recording, rotated = _correct_sensor_axes(recording, robot, T_flange_tcp, usual)
    return recording, [*odd, *findings, *more, *exchanged, *rotated], [*silent, *warnings]


def _correct_sensor_axes(
    recording: Recording, robot: Robot, T_flange_tcp: Array, usual: Array
) -> tuple[Recording, list[Finding]]:
    """Turn back recorded axes that are rotated by any angle."""
    tests = build_load_test_experiment(recording, robot, T_flange_tcp)
    found = find_rotated_axes(tests, robot)
    if found is None:
        return recording, []
    corrected = found.apply(recording)
    right = build_load_test_experiment(corrected, robot, T_flange_tcp)
    chance = _compute_sign_test(
        tests.pose, _compute_misfit_by_pose(tests, usual), _compute_misfit_by_pose(right, usual)
    )
    effect = FRAME if found.quantity == "wrench" else DISPLACEMENT
    words = f"{found.describe()}; they were turned back, and every joint and body kept its own springs"
    about = np.degrees(convert_to_rotation_vector(found.rotation))
    turn = {f"about {a}": build_exact_estimate(float(v), "deg") for a, v in zip("xyz", about, strict=True)}
    finding = build_record_finding(
        effect.name,
        effect.places[0],
        words,
        1e3 * _compute_misfit(tests),
        1e3 * _compute_misfit(right),
        chance,
        {"angle": build_exact_estimate(found.angle_deg, "deg"), **turn},
    )
    return corrected, [finding]


def _apply_correction(recording: Recording, error: Problem, robot: Robot, T_flange_tcp: Array) -> Recording | None:
    """Return the recording with the correction that a check implies; None if it is unknown."""
    if error.code == "joint_units":
        return replace(recording, q=np.degrees(recording.q))
    if error.code == "displacement_frame":
        return replace(recording, displacement_frame=_select_other_frame(recording.displacement_frame))
    if error.code == "wrench_frame":
        return replace(recording, wrench_frame=_select_other_frame(recording.wrench_frame))
    if error.code == "frames":
        return replace(
            recording,
            wrench_frame=_select_other_frame(recording.wrench_frame),
            displacement_frame=_select_other_frame(recording.displacement_frame),
        )
    assert recording.wrench is not None  # guaranteed by the check
    assert recording.displacement is not None
    if error.code == "load_sign":
        return replace(recording, wrench=-recording.wrench)
    if error.code == "moment_at_flange":
        return replace(recording, wrench_point=np.zeros(3))
    if error.code == "moment_at_base" and recording.wrench_frame == "base":
        p = robot.compute_fk(recording.q, T_flange_tcp)[:, :3, 3]
        w = recording.wrench.copy()
        w[:, 3:] -= np.cross(p, w[:, :3])
        return replace(recording, wrench=w)
    if error.code in ("units", "rotation_units", "moment_units", "force_units") and error.column:
        w, d = recording.wrench.copy(), recording.displacement.copy()
        target, columns = {
            "fx_N": (w, slice(0, 3)),
            "mx_Nm": (w, slice(3, 6)),
            "dx_mm": (d, slice(0, 3)),
            "rx_mrad": (d, slice(3, 6)),
        }[error.column]
        target[:, columns] *= error.factor
        if error.code == "units" and error.column == "fx_N":  # forces and moments are consistent with each other
            w[:, 3:] *= error.factor
        return replace(recording, wrench=w, displacement=d)
    return None


def _build_correction_finding(error: Problem, before: float, after: float, p_value: float) -> Finding:
    if error.code in FRAMES:
        effect, where = FRAMES[error.code]
        return build_record_finding(effect.name, where, error.message, 1e3 * before, 1e3 * after, p_value)
    radians = error.code == "joint_units"
    where = format_column_location("q1_deg" if radians else error.column)
    factor = {"factor": build_exact_estimate(1.0 / (float(np.degrees(1.0)) if radians else error.factor))}
    return build_record_finding(UNITS.name, where, error.message, 1e3 * before, 1e3 * after, p_value, factor)


def _find_force_unit_fault(error: Problem, recording: Recording, robot: Robot, T_flange_tcp: Array) -> Problem:
    """Return the unit of forces that is most consistent with the moments."""
    assert recording.wrench is not None  # guaranteed by the check

    def misfit(factor: float) -> float:
        w = recording.wrench.copy()  # type: ignore[union-attr]
        w[:, :3] *= factor
        return _compute_misfit(build_load_test_experiment(replace(recording, wrench=w), robot, T_flange_tcp))

    return replace(error, column="fx_N", factor=min(FORCES.values(), key=misfit))


def _merge_findings(findings: list[Finding], new: Finding) -> list[Finding]:
    """Merge two corrections of the same columns into one finding with one factor."""
    old = next((f for f in findings if (f.effect, f.location) == (new.effect, new.location)), None)
    if old is None:
        return [*findings, new]
    parameters = dict(new.parameters)
    for name, p in old.parameters.items():
        value = p.value * parameters[name].value
        parameters[name] = EstimatedValue(value, p.unit, (value, value), (value, value))
    both = replace(new, parameters=parameters, before=old.before, note=f"{old.note}; then {new.note}")
    return [both if f is old else f for f in findings]


def _select_reference_stiffness(prior: Array | None, reach: float, joints: int) -> Array:
    """Return the joint stiffness (n,) N·m/rad of the cell, or of a typical arm of this reach (known arms: within a
    factor 3.3).
    """
    return np.full(joints, 1e6 * (reach / 2.5) ** 3) if prior is None else prior


def _compute_misfit_by_pose(tests: LoadTestExperiment, stiffness: Array) -> Array:
    """Return the relative misfit (G,) of each pose for a stiffness, 0 to 1, translations and rotations equally
    weighted.
    """
    predicted = tests.response()[:, :, : len(stiffness)] @ (1.0 / stiffness)
    poses = np.unique(tests.pose)
    out = np.zeros(len(poses))
    for c in range(0, tests.dimensions, 3):
        y, p = tests.measured[:, c : c + 3], predicted[:, c : c + 3]
        for g, pose in enumerate(poses):
            rows = tests.pose == pose
            whole = float(np.abs(y[rows]).sum() + np.abs(p[rows]).sum())
            out[g] += float(np.abs(y[rows] - p[rows]).sum()) / max(whole, 1e-300)
    return out


def _compute_sign_test(pose: NDArray[np.int64], before: Array, after: Array) -> float:
    """Return the p-value of a sign test on misfits (G,) before and after."""
    better, n = int(np.sum(after < before)), len(np.unique(pose))
    return float(bdtrc(better - 1, n, 0.5)) if better > 0 else 1.0


def _compute_misfit(tests: LoadTestExperiment) -> float:
    """Return the robust rms (m) of the translations after a fit of the joint springs."""
    load = np.linalg.norm(tests.wrench[:, :3], axis=1) + np.linalg.norm(tests.wrench[:, 3:], axis=1)
    A = tests.response()[:, :3]
    e = tests.measured[:, :3] - A @ fit_least_absolute_deviations(A, tests.measured[:, :3], load)
    return float(1.4826 * np.median(np.abs(e)))


def _select_other_frame(frame: FrameName) -> FrameName:
    return "tool" if frame == "base" else "base"
