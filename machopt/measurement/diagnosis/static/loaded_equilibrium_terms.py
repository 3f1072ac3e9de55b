"""Nonlinear effects of load and weight: geometric stiffness K_C, and the orientation of a sensor on the tool."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from machopt.data_types.measurements.recording import Recording
from machopt.data_types.stiffness import LEAST_STIFFNESS
from machopt.dynamics.gravity_torque import compute_gravity_torque
from machopt.errors import InputError
from machopt.kinematics.robot import Robot, RobotMasses
from machopt.measurement.diagnosis import thresholds
from machopt.measurement.estimation.load_test_equations import LoadTestExperiment
from machopt.measurement.estimation.robust_weights import fit_least_absolute_deviations
from machopt.measurement.identification.fitting.loaded_equilibrium import LoadedEquilibriumModel
from machopt.numerics.array_types import Array


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


def convert_wrench_at_loaded_pose(
    tests: LoadTestExperiment, recording: Recording, robot: Robot, T_flange_tcp: Array, masses: RobotMasses | None
) -> LoadTestExperiment:
    """Convert a wrench from tool to base axes by the deflected tool orientation, or by that of the encoders.

    R(q + c τ) instead of R(q): springs that deflect by 5 mrad rotate a sensor by the same angle, and its axes would
    seem misaligned. A load known in base axes (a weight) is converted to tool axes by the encoders alone. The
    recording does not tell which case applies, so the better fit of the springs decides.

    Args:
        tests: Load-test experiment: the recording in base axes with arm states.
        recording: Corrected recording.
        robot: Kinematic model of the arm.
        T_flange_tcp: (4, 4) pose of the TCP in the flange frame, m.
        masses: Link and tool masses; None: the load alone rotates the tool.

    Returns:
        The experiment with the better conversion.
    """
    if recording.wrench_frame != "tool":
        return tests
    load = np.linalg.norm(tests.wrench[:, :3], axis=1) + np.linalg.norm(tests.wrench[:, 3:], axis=1)
    c = np.clip(fit_least_absolute_deviations(tests.response(), tests.measured, load), 0.0, 1.0 / LEAST_STIFFNESS)
    tau = np.einsum("nci,nc->ni", tests.state.J, tests.wrench)
    if masses is not None:
        tau = tau + compute_gravity_torque(robot, masses, tests.state)[0]
    bend = np.clip(c * tau, -thresholds.RECORD.most_twist, thresholds.RECORD.most_twist)
    turned = robot.compute_fk(recording.q + bend, T_flange_tcp)[:, :3, :3] @ np.swapaxes(
        tests.T_base_tcp[:, :3, :3], 1, 2
    )
    wrench = np.einsum("nij,nbj->nbi", turned, tests.wrench.reshape(len(tests), -1, 3)).reshape(tests.wrench.shape)
    stands = replace(tests, wrench=wrench)
    left = [_compute_misfit(one, robot, T_flange_tcp, masses) for one in (stands, tests)]
    return stands if left[0] <= left[1] else tests


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
