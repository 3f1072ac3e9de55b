"""Nonlinear effects of load and weight: geometric stiffness K_C, and the orientation of a sensor on the tool."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from machopt.data_types.measurements.recording import Recording
from machopt.data_types.stiffness import LEAST_STIFFNESS
from machopt.dynamics.gravity_torque import compute_weight_torque
from machopt.errors import InputError
from machopt.kinematics.robot import Robot, RobotMasses
from machopt.measurement import thresholds
from machopt.measurement.estimation.load_test_equations import LoadTestExperiment
from machopt.measurement.estimation.robust_weights import fit_least_absolute_deviations
from machopt.measurement.identification.fitting.loaded_equilibrium import LoadedEquilibriumModel
from machopt.numerics.array_types import Array

AXES_STEPS = 2  # fits of springs and axes in turn


def compute_nonlinear_displacement(
    tests: LoadTestExperiment, robot: Robot, T_flange_tcp: Array, masses: RobotMasses | None, compliance: Array
) -> Array | None:
    """Compute the difference between exact equilibrium and linear law (K_C).

    Args:
        tests: Load-test experiment: the recording in base axes with arm states.
        robot: Kinematic model of the arm.
        T_flange_tcp: (4, 4) pose of the TCP in the flange frame, m.
        masses: Link and tool masses; None: the load alone deflects the arm.
        compliance: (6,) joint compliance, rad/(N·m).

    Returns:
        (N, D) m, rad; None if the springs are unstable under the loads.
    """
    try:
        d, _ = LoadedEquilibriumModel(tests, robot, T_flange_tcp, masses).predict(compliance)
    except InputError:
        return None
    return np.asarray(d - tests.response() @ compliance)


def convert_tool_axes_at_loaded_pose(
    tests: LoadTestExperiment, recording: Recording, robot: Robot, T_flange_tcp: Array, masses: RobotMasses | None
) -> LoadTestExperiment:
    """Convert loads and displacements from tool to base axes by the deflected tool orientation, or by the encoders'.

    R(q + c τ) instead of R(q): springs that deflect by 5 mrad rotate a sensor by the same angle, and its axes would
    seem misaligned. A load known in base axes (a weight) is converted to tool axes by the encoders alone. Displacements
    may be in the axes of the loaded arm, of the arm under its weight, or of the encoders. The recording does not tell
    which case applies, so the better fit of the springs decides.

    Args:
        tests: Load-test experiment: the recording in base axes with arm states.
        recording: Corrected recording.
        robot: Kinematic model of the arm.
        T_flange_tcp: (4, 4) pose of the TCP in the flange frame, m.
        masses: Link and tool masses; None: the load alone rotates the tool.

    Returns:
        The experiment with the best conversion.
    """
    if "tool" not in (recording.wrench_frame, recording.displacement_frame):
        return tests
    best = tests
    for _ in range(AXES_STEPS):  # the springs follow from the axes, and the axes from the springs
        loaded, weighed = _compute_tool_rotations(tests, best, robot, T_flange_tcp, masses)
        same = np.broadcast_to(np.eye(3), loaded.shape)
        loads = [same, loaded] if recording.wrench_frame == "tool" else [same]
        moves = [same, loaded, weighed] if recording.displacement_frame == "tool" else [same]
        tried = [
            tests
            if w is same and d is same
            else replace(tests, wrench=_turn(w, tests.wrench), measured=_turn(d, tests.measured))
            for w in loads
            for d in moves
        ]
        best = min(tried, key=lambda one: _compute_misfit(one, robot, T_flange_tcp, masses))
    return best


def _compute_tool_rotations(
    tests: LoadTestExperiment, best: LoadTestExperiment, robot: Robot, T: Array, masses: RobotMasses | None
) -> tuple[Array, Array]:
    """Return the rotations (N, 3, 3) of the tool, in base axes, by load and weight, and by weight alone."""
    load = np.linalg.norm(best.wrench[:, :3], axis=1) + np.linalg.norm(best.wrench[:, 3:], axis=1)
    c = np.clip(fit_least_absolute_deviations(best.response(), best.measured, load), 0.0, 1.0 / LEAST_STIFFNESS)
    weight = np.zeros((len(tests), 6))
    if masses is not None:
        weight = compute_weight_torque(robot, masses, tests.state)
    tau = np.einsum("nci,nc->ni", tests.state.J, best.wrench)
    back = np.swapaxes(tests.T_base_tcp[:, :3, :3], 1, 2)
    out = []
    for torque in (weight + tau, weight):
        bend = np.clip(c * torque, -thresholds.LIMITS.large_rotation, thresholds.LIMITS.large_rotation)
        out.append(robot.compute_fk(tests.state.q + bend, T)[:, :3, :3] @ back)
    return out[0], out[1]


def _turn(R: Array, v: Array) -> Array:
    """Return vectors (N, 3) or (N, 6), rotated by halves."""
    return np.asarray(np.einsum("nij,nbj->nbi", R, v.reshape(len(v), -1, 3)).reshape(v.shape))


def _compute_misfit(tests: LoadTestExperiment, robot: Robot, T_flange_tcp: Array, masses: RobotMasses | None) -> float:
    """Return the mean residual (m) of the translations after a fit of the joints, sensitive to many small
    differences.

    K_C is included and a force zero offset is fitted: both are as large as the effect of the tool rotation.
    """
    load = np.linalg.norm(tests.wrench[:, :3], axis=1) + np.linalg.norm(tests.wrench[:, 3:], axis=1)
    A, y = tests.response()[:, :3], tests.measured
    c = np.clip(fit_least_absolute_deviations(tests.response(), y, load), 0.0, 1.0 / LEAST_STIFFNESS)
    curved = compute_nonlinear_displacement(tests, robot, T_flange_tcp, masses, c)
    d = y[:, :3] if curved is None else y[:, :3] - curved[:, :3]
    J = tests.state.J
    zero = (J[:, :3] * c) @ np.swapaxes(J[:, :3], 1, 2) @ tests.T_base_tcp[:, :3, :3]  # m per N along each tool axis
    X = np.concatenate([A, zero], axis=2)
    return float(np.mean(np.abs(d - X @ fit_least_absolute_deviations(X, d, load))))
