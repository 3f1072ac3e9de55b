"""Which axes of an arm are parallel, meet in a point, or make a spherical wrist.

Two lines (h_i, p_i) and (h_j, p_j) are parallel when |h_i × h_j| is zero; otherwise their distance is
|(p_j − p_i) · (h_i × h_j)| / |h_i × h_j|. Consecutive axes keep both for every q, so the lines at q = 0 decide.
"""

from __future__ import annotations

import numpy as np

from machopt.kinematics.robot import Robot
from machopt.numerics.array_types import Array

PARALLEL_TOLERANCE_RAD = (
    1e-6  # URDFs print π/2 with six decimals or more; below this the closed form is within Newton's reach
)
INTERSECTION_TOLERANCE_M = 1e-6  # one micrometre: far below any machine's accuracy, far above rounding


def compute_axis_angle(robot: Robot, i: int, j: int) -> float:
    """Return the angle in [0, π/2] rad between the lines of two joints at q = 0.

    Args:
        robot: kinematic model.
        i: first joint, 0-based.
        j: second joint, 0-based.
    """
    a, b = robot.axis[i], robot.axis[j]
    return float(np.arctan2(np.linalg.norm(np.cross(a, b)), abs(a @ b)))


def compute_axis_distance(robot: Robot, i: int, j: int) -> float:
    """Return the shortest distance in m between the lines of two joints at q = 0.

    Args:
        robot: kinematic model.
        i: first joint, 0-based.
        j: second joint, 0-based.
    """
    a, b, d = robot.axis[i], robot.axis[j], robot.point[j] - robot.point[i]
    normal = np.cross(a, b)
    length = float(np.linalg.norm(normal))
    if length < PARALLEL_TOLERANCE_RAD:
        return float(np.linalg.norm(np.cross(a, d)))
    return float(abs(d @ normal) / length)


def is_axis_pair_parallel(robot: Robot, i: int, j: int, tol: float = PARALLEL_TOLERANCE_RAD) -> bool:
    """Return whether two axes are parallel, in either sense.

    Args:
        robot: kinematic model.
        i: first joint, 0-based.
        j: second joint, 0-based.
        tol: rad.
    """
    return compute_axis_angle(robot, i, j) <= tol


def has_axis_intersection(robot: Robot, i: int, j: int, tol: float = INTERSECTION_TOLERANCE_M) -> bool:
    """Return whether two axes intersect in one point; parallel axes never do.

    Args:
        robot: kinematic model.
        i: first joint, 0-based.
        j: second joint, 0-based.
        tol: m.
    """
    return not is_axis_pair_parallel(robot, i, j) and compute_axis_distance(robot, i, j) <= tol


def compute_common_point(robot: Robot, joints: tuple[int, ...]) -> tuple[Array, float]:
    """Return the point nearest to the given axes in the least-squares sense, (3,) m, and its largest distance in m.

    Args:
        robot: kinematic model.
        joints: joints, 0-based.
    """
    P = [np.eye(3) - np.outer(robot.axis[i], robot.axis[i]) for i in joints]
    rhs = np.concatenate([Pi @ robot.point[i] for Pi, i in zip(P, joints, strict=True)])
    centre = np.linalg.lstsq(np.vstack(P), rhs, rcond=None)[0]
    gaps = [float(np.linalg.norm(Pi @ (centre - robot.point[i]))) for Pi, i in zip(P, joints, strict=True)]
    return centre, max(gaps)


def is_spherical_wrist(robot: Robot, tol: float = INTERSECTION_TOLERANCE_M) -> bool:
    """Return whether axes 4, 5 and 6 intersect in one point and axis 5 is parallel to neither neighbour.

    Args:
        robot: kinematic model.
        tol: m, maximum distance of an axis from the point.
    """
    if is_axis_pair_parallel(robot, 3, 4) or is_axis_pair_parallel(robot, 4, 5):
        return False
    return compute_common_point(robot, (3, 4, 5))[1] <= tol


def is_three_parallel(
    robot: Robot, tol_rad: float = PARALLEL_TOLERANCE_RAD, tol_m: float = INTERSECTION_TOLERANCE_M
) -> bool:
    """Return whether the arm is of the UR family: 2∥3∥4 on separate lines, axes 5 and 6 meet, 1 and 5 not parallel to
    2.

    Args:
        robot: kinematic model.
        tol_rad: rad, tolerance of parallel axes.
        tol_m: m, tolerance of intersections and separate lines.
    """
    parallel = is_axis_pair_parallel(robot, 1, 2, tol_rad) and is_axis_pair_parallel(robot, 1, 3, tol_rad)
    return (
        parallel
        and not is_axis_pair_parallel(robot, 0, 1, tol_rad)
        and not is_axis_pair_parallel(robot, 3, 4, tol_rad)
        and has_axis_intersection(robot, 4, 5, tol_m)
        and min(compute_axis_distance(robot, 1, 2), compute_axis_distance(robot, 2, 3)) > tol_m
    )
