"""Parameters of the closed-form inverse kinematics of Tesseract (OPW: ortho-parallel basis, spherical wrist) from the
joint lines of an arm. Source: M. Brandstötter, A. Angerer, M. Hofbaur, "An analytical solution of the inverse
kinematics problem of industrial serial manipulators with an ortho-parallel basis and a spherical wrist", Austrian
Robotics Workshop 2014. The names of the lengths are theirs.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from machopt.kinematics.robot import Robot
from machopt.numerics.array_types import Array

ALIGNED = 1e-6  # sine between two axes that count as parallel, and m between two points that count as one
HAND = 0.2  # m from the wrist to OPW's tip, which is a frame of its own
UP = np.array([0.0, 0.0, 1.0])


@dataclass(frozen=True, kw_only=True)
class OpwParameters:
    """OPW lengths in m, and the posture in which the arm is stretched upwards, which is OPW's zero."""

    lengths: dict[str, float]
    stretched: Array  # (6,) rad, joints of the arm at OPW's zero
    sign: Array  # (6,) sense of each joint against OPW's
    T_base_opw: Array  # (4, 4) OPW's base in base_link
    T_base_tip: Array  # (4, 4) OPW's tip in base_link where the arm is stretched


def find_opw_parameters(robot: Robot) -> OpwParameters:
    """Return the parameters of an arm with a spherical wrist whose first axis is vertical in base_link.

    Args:
        robot: kinematics of the arm.

    Raises:
        ValueError: the arm has no such form.
    """
    axis, point = robot.axis, robot.point
    if abs(abs(axis[0] @ UP) - 1) > ALIGNED or abs(axis[1] @ UP) > ALIGNED:
        raise ValueError("the first axis is not vertical, or the second not horizontal")
    foot = _find_foot(point[1], axis[1], point[0])
    side = axis[1] if np.cross(axis[1], UP) @ (foot - point[0]) >= 0 else -axis[1]
    wrist = _find_wrist_centre(robot)
    upper_arm = _find_foot(point[2], axis[2], foot) - foot
    forearm = axis[3] * _sense(axis[3] @ (wrist - point[2]))
    hand = axis[5] * _sense(axis[5] @ (robot.T_base_flange_zero[:3, 3] - wrist))
    q = np.zeros(6)
    for joint, vector, goal in (
        (1, upper_arm, UP),
        (2, forearm, UP),
        (3, axis[4] * _sense(axis[4] @ side), side),
        (4, hand, UP),
    ):
        q[joint] = _find_angle(robot, q, joint, vector, goal)
    links = [_carry(robot, q, k) for k in range(7)]
    turned = np.array([links[k][:3, :3] @ axis[k] for k in range(6)])
    along = np.einsum("ki,ki->k", turned, np.array([UP, side, side, UP, side, UP]))
    if np.abs(np.abs(along) - 1).max() > ALIGNED:
        raise ValueError("no ortho-parallel basis")
    T_base_opw = np.eye(4)
    T_base_opw[:3, :3] = np.column_stack([np.cross(side, UP), side, UP])
    T_base_opw[:2, 3] = point[0, :2]
    second, third, centre = (
        T_base_opw[:3, :3].T @ (_move(links[k], p) - T_base_opw[:3, 3])
        for k, p in ((1, foot), (2, _find_foot(point[2], axis[2], foot)), (4, wrist))
    )
    T_base_tip = T_base_opw.copy()
    T_base_tip[:3, 3] = _move(links[4], wrist) + HAND * UP
    lengths = {
        "a1": second[0],
        "a2": centre[0] - third[0],
        "b": centre[1],
        "c1": second[2],
        "c2": third[2] - second[2],
        "c3": centre[2] - third[2],
        "c4": HAND,
    }
    return OpwParameters(
        lengths={k: float(v) for k, v in lengths.items()},
        stretched=q,
        sign=np.sign(along),
        T_base_opw=T_base_opw,
        T_base_tip=T_base_tip,
    )


def _find_angle(robot: Robot, q: Array, joint: int, vector: Array, goal: Array) -> float:
    """Return the angle of a joint at which a vector fixed to its link points along the goal, seen along its axis."""
    R = _carry(robot, q, joint)[:3, :3]
    about = R @ robot.axis[joint]
    now, wanted = (v - about * (about @ v) for v in (R @ vector, goal))
    return float(np.arctan2(about @ np.cross(now, wanted), now @ wanted))


def _carry(robot: Robot, q: Array, joint: int) -> Array:
    """Return the motion from zero of what carries a joint (0-based; 6: the flange), (4, 4)."""
    T = np.eye(4)
    for k in range(joint):
        x, y, z = robot.axis[k]
        K = np.array([[0.0, -z, y], [z, 0.0, -x], [-y, x, 0.0]])
        R = np.eye(3) + np.sin(q[k]) * K + (1.0 - np.cos(q[k])) * (K @ K)
        step = np.eye(4)
        step[:3, :3], step[:3, 3] = R, robot.point[k] - R @ robot.point[k]
        T = T @ step
    return T


def _sense(value: float) -> float:
    return -1.0 if value < 0 else 1.0


def _move(T: Array, p: Array) -> Array:
    return np.asarray(T[:3, :3] @ p + T[:3, 3])


def _find_foot(point: Array, axis: Array, other: Array) -> Array:
    """Return the point of a line nearest to another point."""
    return np.asarray(point + axis * (axis @ (other - point)))


def _find_wrist_centre(robot: Robot) -> Array:
    """Return the point where the last three axes meet."""
    across = [np.eye(3) - np.outer(v, v) for v in robot.axis[3:]]
    A = np.concatenate(across)
    b = np.concatenate([P @ p for P, p in zip(across, robot.point[3:], strict=True)])
    centre, *_ = np.linalg.lstsq(A, b, rcond=None)
    if np.abs(A @ centre - b).max() > ALIGNED:
        raise ValueError("the wrist axes do not meet in a point")
    return np.asarray(centre)
