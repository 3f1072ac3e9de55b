"""Rigid reference: forward kinematics, Jacobian and the columns of a refitted base model, to measure what is visible.

This is used for the size of an effect and for the tests, never to make a reading.
"""

from __future__ import annotations

import numpy as np

from bushing_simulator.robot_descriptions import RobotDescription
from bushing_simulator.rotations import build_skew, compute_axis_rotation, compute_rpy_rotation


def compute_frames(robot: RobotDescription, q: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray, np.ndarray]:
    """Return joint places (N, 7, 3), rotations (N, 7, 3, 3) (last: flange), TCP (N, 3) and axes (N, 6, 3)."""
    count = len(q)
    R, p = np.broadcast_to(np.eye(3), (count, 3, 3)), np.zeros((count, 3))
    places, rotations, axes = [], [], []
    for i in range(6):
        p = p + R @ robot.origins[i]
        axes.append(R @ robot.axes[i])
        R = R @ compute_axis_rotation(robot.axes[i], q[:, i])
        places.append(p)
        rotations.append(R)
    p = p + R @ robot.flange
    R = R @ robot.flange_rotation
    places.append(p)
    rotations.append(R)
    return np.stack(places, 1), np.stack(rotations, 1), p + R @ robot.tcp, np.stack(axes, 1)


def compute_jacobian(robot: RobotDescription, q: np.ndarray, point: np.ndarray | None = None) -> np.ndarray:
    """Return J (N, 6, 6) of the TCP or of a point (3,) in the flange; linear part first."""
    places, rotations, tcp, axes = compute_frames(robot, q)
    if point is not None:
        tcp = places[:, 6] + rotations[:, 6] @ point
    linear = np.cross(axes, tcp[:, None] - places[:, :6])
    return np.concatenate([linear, axes], axis=2).transpose(0, 2, 1)


def compute_tool_axes(robot: RobotDescription, q: np.ndarray) -> np.ndarray:
    """Return TCP axes in the base (N, 3, 3)."""
    return compute_frames(robot, q)[1][:, 6] @ compute_rpy_rotation(robot.tcp_rpy)


def compute_gravity_torque(robot: RobotDescription, q: np.ndarray, masses: np.ndarray, tool_mass: float) -> np.ndarray:
    """Return joint torques (N, 6) that the weights cause."""
    places, rotations, _, axes = compute_frames(robot, q)
    torque = np.zeros((len(q), 6))
    weights = [(i, masses[i], places[:, i] + rotations[:, i] @ robot.centers[i]) for i in range(6)]
    weights.append((5, tool_mass, places[:, 6] + rotations[:, 6] @ robot.tool_center))
    for last, mass, center in weights:
        force = np.array([0, 0, -9.80665 * mass])
        for i in range(last + 1):
            torque[:, i] += np.cross(axes[:, i], center - places[:, i]) @ force
    return torque


def list_spring_columns(J: np.ndarray, torque: np.ndarray, dimensions: int) -> np.ndarray:
    """Return displacement per joint compliance (N, dimensions, 6)."""
    return J[:, :dimensions] * torque[:, None, :]


def list_body_columns(
    robot: RobotDescription, q: np.ndarray, wrench: np.ndarray, body: int, dimensions: int
) -> np.ndarray:
    """Return displacement (N, d, 21) per element of a symmetric 6×6 at 0 base, 1…6 link end, or 7 tool."""
    places, rotations, tcp, _ = compute_frames(robot, q)
    if body == 0:
        place, R = np.zeros_like(tcp), np.broadcast_to(np.eye(3), (len(q), 3, 3))
    elif body == 7:
        place, R = places[:, 6], rotations[:, 6]
    else:
        place, R = places[:, body], rotations[:, body - 1]
    Rt = np.swapaxes(R, 1, 2)
    lever = tcp - place
    G = np.zeros((len(q), 6, 6))  # twist at the interface, its axes → twist at the TCP, base axes
    G[:, :3, :3], G[:, 3:, 3:] = R, R
    G[:, :3, 3:] = -build_skew(lever) @ R
    local = np.concatenate(
        [
            np.einsum("nij,nj->ni", Rt, wrench[:, :3]),
            np.einsum("nij,nj->ni", Rt, wrench[:, 3:] + np.cross(lever, wrench[:, :3])),
        ],
        axis=1,
    )
    columns = []
    for i in range(6):
        for j in range(i, 6):
            e = np.zeros((len(q), 6))
            e[:, i] += local[:, j]
            if i != j:
                e[:, j] += local[:, i]
            columns.append(np.einsum("nij,nj->ni", G, e)[:, :dimensions])
    return np.stack(columns, axis=2)


def project_out(columns: np.ndarray, values: np.ndarray) -> np.ndarray:
    """Return values (M,) minus their least-squares fit by columns (M, k)."""
    scale = np.linalg.norm(columns, axis=0)
    scale[scale == 0] = 1.0
    return values - columns / scale @ np.linalg.lstsq(columns / scale, values, rcond=1e-10)[0]
