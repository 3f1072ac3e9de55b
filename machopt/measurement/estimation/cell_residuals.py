"""Readings against the cell's own model; nothing is fitted but the frame of a tracker."""

from __future__ import annotations

import numpy as np

from machopt.data_types.cell import Cell
from machopt.data_types.measurements.recording import Recording
from machopt.kinematics.robot import Robot
from machopt.measurement.estimation.load_test_equations import build_load_test_experiment
from machopt.numerics.array_types import Array


def compare_with_cell(cell: Cell, robot: Robot, recording: Recording) -> tuple[Array | None, Array | None]:
    """Return what was measured and what the cell's own model predicts.

    Args:
        cell: The cell, with or without stiffness.
        robot: Kinematics of its arm.
        recording: Load tests or measured poses.

    Returns:
        (N, 3) m displacements in base_link under load, or positions in the registered frame, measured and predicted;
        None where they are not known.
    """
    compare = _compare_load_tests if recording.kind == "deflection" else _compare_positions
    return compare(cell, robot, recording)


def _compare_load_tests(cell: Cell, robot: Robot, recording: Recording) -> tuple[Array | None, Array | None]:
    tests = build_load_test_experiment(recording, robot, cell.tool.T_flange_tcp)
    measured = tests.measured[:, :3]
    if cell.stiffness is None:
        return measured, None
    return measured, np.asarray(tests.response() @ (1.0 / cell.stiffness.joints))[:, :3]


def _compare_positions(cell: Cell, robot: Robot, recording: Recording) -> tuple[Array | None, Array | None]:
    if recording.position is None:
        return None, None
    predicted = robot.compute_fk(recording.q, cell.tool.T_flange_tcp)[:, :3, 3]
    if recording.targets:
        flange = robot.compute_fk(recording.q)
        place = np.array([target.place for target in recording.targets])
        at = place[np.zeros(len(recording), int) if recording.target is None else recording.target]
        predicted = flange[:, :3, 3] + np.einsum("nij,nj->ni", flange[:, :3, :3], at)
    measured = recording.position
    if recording.registration == "fit":
        frame = np.zeros(len(recording), int) if recording.frame is None else recording.frame
        measured = measured.copy()
        for label in np.unique(np.stack([frame, recording.session]), axis=1).T:
            rows = (frame == label[0]) & (recording.session == label[1])
            measured[rows] = align_points(measured[rows], predicted[rows])
    return measured, predicted


def align_points(points: Array, to: Array) -> Array:
    """Return points moved rigidly onto others by least squares (Kabsch, Acta Cryst. A32 (1976) 922).

    Args:
        points: (N, 3).
        to: (N, 3) their counterparts.
    """
    centre, goal = points.mean(axis=0), to.mean(axis=0)
    u, _, vt = np.linalg.svd((points - centre).T @ (to - goal))
    R = vt.T @ np.diag([1.0, 1.0, np.sign(np.linalg.det(vt.T @ u.T)) or 1.0]) @ u.T
    return np.asarray((points - centre) @ R.T + goal)
