"""Uncertainty of the stiffness written by a diagnosis: covariance of the springs, and model discrepancy."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from machopt.data_types.cell import Cell
from machopt.data_types.stiffness import ArmStiffness, PositionError
from machopt.effects import registry
from machopt.effects.protocol import is_time_dependent
from machopt.kinematics.robot import Robot, RobotMasses
from machopt.kinematics.urdf_loading import load_robot
from machopt.measurement import thresholds
from machopt.measurement.diagnosis.data_types.diagnosis_problem import Flags
from machopt.measurement.diagnosis.data_types.diagnosis_result import DiagnosisResult, compute_rms
from machopt.measurement.diagnosis.diagnosis_pipeline import DiagnosedRecording, read_stated_masses
from machopt.measurement.diagnosis.effect_columns import joint_torque
from machopt.measurement.diagnosis.static import load_test_channel
from machopt.measurement.estimation.error_clusters import VarianceComponents, build_error_clusters
from machopt.measurement.estimation.load_test_equations import LoadTestExperiment, build_load_test_experiment
from machopt.measurement.estimation.reading_covariance import compute_reading_covariance
from machopt.measurement.identification.assessment.hysteresis_half_width import (
    add_arrival_side,
    estimate_loop_half_widths,
)
from machopt.measurement.identification.assessment.model_discrepancy import (
    DiscrepancyEstimate,
    ResidualReadings,
    estimate_model_discrepancy,
    list_coefficient_suspects,
)
from machopt.measurement.identification.assessment.prior_spread_models import UNKNOWN_COMPLIANCE_SIGMA
from machopt.numerics.array_types import Array
from machopt.stiffness.arm_stiffness import ArmElasticity


def add_model_uncertainty(
    cell: Cell, diagnosed_recording: DiagnosedRecording, stiffness: ArmStiffness | None
) -> ArmStiffness | None:
    """Add covariance, position error and model discrepancy to a stiffness.

    Args:
        cell: Robot cell.
        diagnosed_recording: Diagnosis with its problem and recording.
        stiffness: Extended stiffness, or None.

    Returns:
        The stiffness with uncertainty, or None.
    """
    if stiffness is None:
        return None
    known = None if cell.stiffness is None else cell.stiffness.position
    position = (
        estimate_position_error(diagnosed_recording) if diagnosed_recording.recording.kind == "absolute" else known
    )
    if stiffness is cell.stiffness:
        return stiffness if position is known else replace(stiffness, position=position)
    stiffness = replace(stiffness, position=position)
    out = replace(stiffness, covariance=_compute_spring_covariance(cell, diagnosed_recording.diagnosis, stiffness))
    if diagnosed_recording.recording.kind != "deflection":
        return out
    estimate = _estimate_load_test_discrepancy(cell, diagnosed_recording, stiffness)
    return replace(out, covariance=estimate.spring_error, discrepancy=estimate.discrepancy)


def estimate_position_error(diagnosed_recording: DiagnosedRecording) -> PositionError | None:
    """Estimate the TCP position error of the extended model from held-out poses.

    Args:
        diagnosed_recording: Diagnosis with its problem and recording.

    Returns:
        The error; None if there are too few poses for cross-validation.
    """
    d, recording = diagnosed_recording.diagnosis, diagnosed_recording.recording
    before, after = (compute_rms(e[d.used][:, :3]) for e in (d.errors.residual, d.errors.final))
    poses = len(np.unique(recording.pose[d.used]))
    if poses < thresholds.COUNTS.min_groups or not np.isfinite([before, after]).all():
        return None
    q = recording.q[d.used]
    return PositionError(after, before, d.noise_floor / 1e3, poses, np.stack([q.min(axis=0), q.max(axis=0)], axis=1))


def _compute_spring_covariance(cell: Cell, d: DiagnosisResult, stiffness: ArmStiffness) -> Array | None:
    """Return the covariance (n, n) of the joint compliances; joints with the cell's value keep its uncertainty."""
    known = None if cell.stiffness is None else cell.stiffness.covariance
    variance = np.zeros(len(stiffness.joints))
    refitted = {c.unknown.spring_joint: c for c in d.coefficients if c.unknown.spring_joint is not None}
    for j, k in enumerate(stiffness.joints):
        c = refitted.get(j + 1)
        is_unchanged = cell.stiffness is not None and k == cell.stiffness.joints[j]
        if c is not None and not is_unchanged and np.isfinite(c.sigma):
            variance[j] = c.sigma**2
        else:
            variance[j] = (UNKNOWN_COMPLIANCE_SIGMA / k) ** 2 if known is None else known[j, j]
    return np.diag(variance)


def _estimate_load_test_discrepancy(
    cell: Cell, diagnosed_recording: DiagnosedRecording, stiffness: ArmStiffness
) -> DiscrepancyEstimate:
    """Return the model discrepancy of the load tests with the model as a plan evaluates it."""
    robot, T = load_robot(cell), cell.tool.T_flange_tcp
    masses = read_stated_masses(cell)
    tests = build_load_test_experiment(diagnosed_recording.recording, robot, T)
    residual = tests.measured - _predict_planned_deflection(
        diagnosed_recording, tests, robot, T, masses, stiffness, cell.arm_limits
    )
    used = diagnosed_recording.diagnosis.used
    groups = build_error_clusters(tests)
    typical = np.array([_compute_typical_residual(residual[used, c : c + 3]) for c in range(0, tests.dimensions, 3)])
    arm = ArmElasticity(robot, T, stiffness, cell.arm_limits, masses)
    V = compute_reading_covariance(tests, 1.0 / stiffness.joints, arm.terms, tests.uncertainty, typical)
    stated = (tests.uncertainty.displacement is not None, tests.uncertainty.rotation is not None)
    readings = ResidualReadings(
        residual=residual,
        wrench=tests.wrench,
        clusters=groups,
        precision=np.where(used[:, None, None], 1.0, 1e-9) * np.linalg.inv(V),
        robust=np.repeat(used[:, None].astype(float), tests.dimensions, axis=1),
        components=tuple(
            VarianceComponents(max(1.0, float(np.mean(_compute_whitened_squares(residual[used], V, c, used)))))
            for c in range(len(V))
        ),
        stated=stated[: len(V)],
    )
    suspects = list_coefficient_suspects(arm, tests, masses)
    estimate = estimate_model_discrepancy(suspects, tests.state, stiffness.joints, readings)
    loops = estimate_loop_half_widths(tests, readings.robust)
    return replace(estimate, discrepancy=add_arrival_side(estimate.discrepancy, loops))


def _predict_planned_deflection(
    diagnosed_recording: DiagnosedRecording,
    tests: LoadTestExperiment,
    robot: Robot,
    T: Array,
    masses: RobotMasses | None,
    stiffness: ArmStiffness,
    limits: tuple[Array, Array],
) -> Array:
    """Return the deflection (N, D) that a plan predicts for the same loads: without history, gears start from rest.

    A law with memory may fit the readings by their history and still be wrong. A job has another history, so the
    residual without history is the least error to expect there. Time-dependent laws are excepted.
    """
    r = load_test_channel.build_load_test_readings(
        diagnosed_recording.recording, tests, robot, T, masses, 1.0 / stiffness.joints
    )
    slow = {e.file_word for e in registry.select_joint_torque_effects() if is_time_dependent(e.joint_laws[0])}
    lived, rest = joint_torque.compute_memory_term_displacement(r, [t for t in stiffness.terms if t.effect in slow])
    rest = (*rest, *(t for t in stiffness.terms if t.effect not in slow))
    whole = ArmElasticity(robot, T, replace(stiffness, terms=rest), limits, masses).evaluate(tests.state.q)
    return np.asarray((lived + whole.compute_twist(tests.wrench))[:, : tests.dimensions])


def _compute_whitened_squares(residual: Array, V: Array, channel: int, used: Flags) -> Array:
    """Return the squared residuals of a coordinate relative to their covariance."""
    part = residual[:, 3 * channel : 3 * channel + 3]
    return np.asarray(np.einsum("ni,nij,nj->n", part, np.linalg.inv(V[channel][used]), part) / 3.0)


def _compute_typical_residual(residual: Array) -> float:
    return max(float(1.4826 * np.median(np.abs(residual))), thresholds.LIMITS.displacement)
