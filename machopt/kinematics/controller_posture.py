"""Posture bits of an arm as robot controllers define them."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from machopt.data_types.robot_program import RobotController
from machopt.kinematics.inverse.spherical_wrist import SphericalWristSolver, find_wrist_centre
from machopt.kinematics.robot import Robot
from machopt.numerics.array_types import Array
from machopt.numerics.rigid_transforms import compute_axis_rotation

BLOCK_ROWS = 20_000  # rows per block; poses of all links at a million points would need a gigabyte


def compute_posture_sides(
    robot: Robot, q: Array, front: Array, q1_zero: float = 0.0
) -> tuple[NDArray[np.bool_], NDArray[np.bool_]] | None:
    """Return the side of the wrist root relative to axis 1, and relative to the upper arm.

    f = Rot(h₁, q₁ − q₁₀) front is the direction the arm faces; n = h₁ × f is the normal of the arm's plane. The wrist
    root
    w is behind where (w − p₁)·f < 0; the elbow is up where ((e − s) × (w − e))·n > 0, with s and e the points of
    axes 2 and 3: the forearm is bent forward out of the line of the upper arm.

    Args:
        robot: kinematic model.
        q: (..., 6) rad.
        front: (3,) direction in base_link the arm faces where the controller's axis 1 is at zero.
        q1_zero: rad, joint 1 of the URDF there.

    Returns:
        ``behind`` (...,) and ``elbow_up`` (...,), or None: the arm has no wrist root or no parallel axes 2 and 3.

    Source: KUKA and ABB describe S bits 0 and 1 and cfx by these two planes; the sign of the elbow is taken
    from points recorded on robots.
    """
    centre = find_wrist_centre(robot)
    if centre is None or not SphericalWristSolver.is_applicable(robot):
        return None
    bodies = robot.compute_link_poses(q)

    def at(link: int, p: Array) -> Array:
        T = bodies[..., link, :, :]
        return np.asarray(T[..., :3, :3] @ p + T[..., :3, 3])

    h = robot.axis[0]
    level = front - (front @ h) * h
    f = compute_axis_rotation(h, np.asarray(q, float)[..., 0] - q1_zero) @ (level / np.linalg.norm(level))
    n = np.cross(h * np.sign(h[2] if abs(h[2]) > 1e-6 else 1.0), f)  # h upwards, so that bent forward is positive
    s, e, w = at(1, robot.point[1]), at(2, robot.point[2]), at(3, centre)  # the component along n is dropped by n · (…)
    behind = np.sum((w - robot.point[0]) * f, axis=-1) < 0.0
    up = np.sum(np.cross(e - s, w - e) * n, axis=-1) > 0.0
    return np.asarray(behind), np.asarray(up)


def compute_controller_posture(
    robot: Robot, q: Array, controller: RobotController
) -> tuple[NDArray[np.bool_], NDArray[np.bool_]] | None:
    """Return :func:`compute_posture_sides` in the convention of a controller.

    Front is the x axis of the controller's own robot system, at its axis 1 at zero.

    Args:
        robot: kinematic model.
        q: (N, 6) rad.
        controller: robot controller with its base system and joint map.
    """
    front = np.array([1.0, 0.0, 0.0]) if controller.T_base_root is None else controller.T_base_root[:3, 0]
    joints = controller.joint_map
    zero = 0.0 if joints is None else float(np.radians(-joints.offset_deg[0] * joints.sign[0]))
    found = [  # with the nominal arm, which the controller uses
        compute_posture_sides(robot.nominal_robot, q[first : first + BLOCK_ROWS], front, zero)
        for first in range(0, max(len(q), 1), BLOCK_ROWS)
    ]
    sides = [both for both in found if both is not None]  # all or none, depending on the arm
    return (np.concatenate([b for b, _ in sides]), np.concatenate([up for _, up in sides])) if sides else None
