"""What load and weight do to an arm beyond bending its springs: K_C, and which way a sensor on the tool points."""

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
    """What the exact equilibrium adds to the linear law (K_C).

    Args:
        tests: in base axes.
        robot, T_flange_tcp: the arm.
        masses: of links and tool; None: unknown, the load alone bends it.
        compliance: (6,) rad/(N·m).

    Returns:
        (N, D) m, rad; None where such springs hold no such load.
    """
    try:
        d, _ = LoadedEquilibriumModel(tests, robot, T_flange_tcp, masses).predict(compliance)
    except InputError:
        return None
    return np.asarray(d - tests.response() @ compliance)


def convert_wrench_at_loaded_pose(
    tests: LoadTestExperiment, recording: Recording, robot: Robot, T_flange_tcp: Array, masses: RobotMasses | None
) -> LoadTestExperiment:
    """A wrench read in tool axes, in base axes by where load and weight put the tool, or by where encoders say it is.

    R(q + c τ) instead of R(q): springs that sag by 5 mrad turn a sensor by as much, and its axes would seem askew. A
    load that is known in base axes, a weight, is turned into tool axes by the encoders alone. No recording says which;
    the springs do, which have to fit either.

    Args:
        tests: of the recording.
        recording: as mended.
        robot, T_flange_tcp: the arm.
        masses: of links and tool; None: unknown, the load alone turns the tool.
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
    """m, mean of what refitted joints leave of the translations, so that many small differences count.

    K_C is counted and a zero of the force is fitted too: either is as large as what a sag of the tool turns, and hid
    which of the two readings is right.
    """
    load = np.linalg.norm(tests.wrench[:, :3], axis=1) + np.linalg.norm(tests.wrench[:, 3:], axis=1)
    A, y = tests.response()[:, :3], tests.measured
    c = np.clip(fit_least_absolute_deviations(tests.response(), y, load), 0.0, 1.0 / LEAST_STIFFNESS)
    curved = compute_nonlinear_displacement(tests, robot, T_flange_tcp, masses, c)
    d = y[:, :3] if curved is None else y[:, :3] - curved[:, :3]
    J = tests.state.J
    zero = (
        (J[:, :3] * c) @ np.swapaxes(J[:, :3], 1, 2) @ tests.T_base_tcp[:, :3, :3]
    )  # m per N along an axis of the tool
    X = np.concatenate([A, zero], axis=2)
    return float(np.mean(np.abs(d - X @ fit_least_absolute_deviations(X, d, load))))
