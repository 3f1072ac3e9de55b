"""Closed-form inverse kinematics of arms with a spherical wrist and parallel axes 2 and 3.

Canonical subproblems (Paden 1986; Murray, Li & Sastry 1994, section 3.3) on the six lines of
:class:`~machopt.kinematics.robot.Robot`, so any zero position, sign or offset of a URDF is supported.
Always eight branches in a fixed order: index = 4·shoulder + 2·elbow + wrist, each 0 or 1, so "the same
branch along the path" is the same index. Compiled pose by pose, without state between poses.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np

from machopt.kinematics.inverse.compiled_vectors import (
    Vector,
    add_vectors,
    compute_angle_about_axis,
    cross_product,
    dot_product,
    rotate_vector,
    wrap_angle,
)
from machopt.kinematics.robot import Robot
from machopt.numerics.array_types import Array
from machopt.numerics.compiled_functions import jit_compile

ArmVectors = tuple[Vector, ...]
ArmConstants = tuple[float, ...]
PARALLEL_TOLERANCE_RAD = 1e-6  # rad; two axes of a URDF with printed decimals count as parallel below this
INTERSECTION_TOLERANCE_M = 2e-6  # m; three axes meet when each passes within this of one point


@dataclass(frozen=True)
class KinematicBranches:
    """All branches for M poses.

    Where a branch does not exist its joints are NaN and ``shortfall`` is the missing length.
    """

    q: Array  # (M, B, 6) rad in (−π, π]
    margin: Array  # (M, 3, B) distance from the shoulder, elbow and wrist singularity
    shortfall: Array  # (M,) m, how far the wrist centre lies outside the reach of every branch; 0 inside

    @property
    def shoulder(self) -> Array:
        """(M, B) m, distance of the wrist centre from the shoulder singularity."""
        return np.asarray(self.margin[:, 0])

    @property
    def elbow(self) -> Array:
        """(M, B) rad, angle of the elbow from the stretched or folded position."""
        return np.asarray(self.margin[:, 1])

    @property
    def wrist(self) -> Array:
        """(M, B) rad, angle between axes 4 and 6 from the aligned position."""
        return np.asarray(self.margin[:, 2])


def find_wrist_centre(robot: Robot) -> Array | None:
    """Return the common point of axes 4, 5 and 6 at q = 0, (3,) m in base_link, or None.

    Args:
        robot: kinematic model.
    """
    A = np.vstack([np.eye(3) - np.outer(h, h) for h in robot.axis[3:]])
    b = np.concatenate([(np.eye(3) - np.outer(h, h)) @ p for h, p in zip(robot.axis[3:], robot.point[3:], strict=True)])
    centre = np.linalg.lstsq(A, b, rcond=None)[0]
    off = np.linalg.norm((A @ centre - b).reshape(3, 3), axis=1)
    return centre if off.max() < INTERSECTION_TOLERANCE_M else None


class SphericalWristSolver:
    """Closed form for a spherical wrist with axes 2 and 3 parallel and axis 1 not parallel to them.

    Raises:
        ValueError: the arm is of another kind (use the general solver).
    """

    branches = 8
    branch_stable = True  # the index is the same assembly mode everywhere

    def __init__(self, robot: Robot) -> None:
        centre = find_wrist_centre(robot)
        if centre is None or not self.is_applicable(robot):
            raise ValueError("the arm has no spherical wrist behind two parallel axes")
        self.robot, self.centre = robot, centre
        self.vectors, self.numbers = compute_arm_constants(robot, centre)

    @staticmethod
    def is_applicable(robot: Robot) -> bool:
        """Return whether the arm has a spherical wrist, axes 2 and 3 parallel, and axis 1 not parallel to them.

        Args:
            robot: kinematic model.
        """
        h = robot.axis
        parallel = np.linalg.norm(np.cross(h[1], h[2])) < PARALLEL_TOLERANCE_RAD
        skewed = np.linalg.norm(np.cross(h[0], h[1])) > 0.1 and np.linalg.norm(np.cross(h[3], h[4])) > 0.1
        return bool(
            parallel and skewed and np.linalg.norm(np.cross(h[4], h[5])) > 0.1 and find_wrist_centre(robot) is not None
        )

    def compute_margins(self, T_base_flange: Array, q: Array) -> None:
        """Return None: no branch can be missed.

        Args:
            T_base_flange: not used.
            q: not used.
        """

    def solve_grid(self, T_base_flange: Array, q: Array | None = None) -> KinematicBranches:
        """Return all branches of a grid of poses, flattened to N·R rows.

        Args:
            T_base_flange: (N, R, 4, 4) flange poses in base_link.
            q: (N·R, 8, 6) rad, filled with the joints; None: a new array.
        """
        return self.solve(T_base_flange.reshape(-1, 4, 4), q)

    def solve(self, T_base_flange: Array, q: Array | None = None) -> KinematicBranches:
        """Return all eight branches.

        Args:
            T_base_flange: (M, 4, 4) flange poses in base_link.
            q: (M, 8, 6) rad, filled with the joints; None: a new array.
        """
        T = np.ascontiguousarray(T_base_flange, float)
        joints = np.empty((len(T), 8, 6)) if q is None else q
        margin, shortfall = np.empty((len(T), 3, 8)), np.empty(len(T))
        _solve_all(self.vectors, self.numbers, T, joints, margin, shortfall)
        return KinematicBranches(joints, margin, shortfall)


def compute_arm_constants(robot: Robot, W: Array) -> tuple[ArmVectors, ArmConstants]:
    """Return the constants of an arm for :func:`compute_spherical_branches`.

    Args:
        robot: kinematic model.
        W: (3,) m, wrist centre in base_link at q = 0.
    """
    h, p, zero = robot.axis, robot.point, robot.T_base_flange_zero
    a, b = p[2] - p[1], W - p[2]
    ha, hb, h45, h56 = h[2] @ a, h[2] @ b, h[4] @ h[3], h[4] @ h[5]
    A3, B3 = a @ b - ha * hb, a @ np.cross(h[2], b)
    A5, B5 = h[3] @ h[5] - h45 * h56, h[3] @ np.cross(h[4], h[5])
    base, reach = a @ a + b @ b + 2 * ha * hb, np.hypot(A3, B3)
    to_zero = zero[:3, :3].T  # directions at q = 0 in the flange frame
    vectors = (*h, p[0], p[0] - p[1], a, b, to_zero @ (W - zero[:3, 3]), to_zero @ h[5], *zero[:3, :3])
    numbers = (
        h[0] @ h[1],
        (W - p[0]) @ h[1],
        base / 2,
        reach,
        np.arctan2(B3, A3),
        h45 * h56,
        np.hypot(A5, B5),
        np.arctan2(B5, A5),
        np.sqrt(base + 2 * reach),
        np.sqrt(max(base - 2 * reach, 0.0)),
    )
    return tuple((float(x), float(y), float(z)) for x, y, z in vectors), tuple(map(float, numbers))


@jit_compile
def _solve_all(vectors: ArmVectors, numbers: ArmConstants, T: Array, q: Array, margin: Array, shortfall: Array) -> None:
    for m in range(len(T)):
        shortfall[m] = compute_spherical_branches(vectors, numbers, T[m], q[m], margin[m])


@jit_compile
def compute_spherical_branches(vectors: ArmVectors, numbers: ArmConstants, T: Array, q: Array, margin: Array) -> float:
    """Compute all eight branches of one pose; return the distance in m of the wrist centre outside every branch's
    reach.

    Args:
        vectors: of the arm (:func:`compute_arm_constants`).
        numbers: of the arm, likewise.
        T: (4, 4) flange in base_link.
        q: (8, 6) rad, filled; NaN where a branch does not exist.
        margin: (3, 8) filled: shoulder in m, elbow in rad, wrist in rad, as in :class:`KinematicBranches`.
    """
    h1, h2, h3, h4, h5, h6, p1, p21, a, b, W, axis6, zx, zy, zz = vectors
    h12, w2, links, reach, centre3, h456, n5, centre5, longest, shortest = numbers
    q[:] = np.nan
    margin[:] = np.nan
    X, Y, Z = (T[0, 0], T[0, 1], T[0, 2]), (T[1, 0], T[1, 1], T[1, 2]), (T[2, 0], T[2, 1], T[2, 2])
    u = (T[0, 3] + dot_product(X, W) - p1[0], T[1, 3] + dot_product(Y, W) - p1[1], T[2, 3] + dot_product(Z, W) - p1[2])
    g = (dot_product(X, axis6), dot_product(Y, axis6), dot_product(Z, axis6))
    # joint 1: the component along axis 2 is untouched by joints 2 and 3
    along = dot_product(u, h1)
    A, B, C = dot_product(u, h2) - along * h12, -dot_product(cross_product(h1, u), h2), w2 - along * h12
    n = math.hypot(A, B)
    half1 = _compute_half_angle(C, n)
    if math.isnan(half1):
        return _clamp_to_zero(abs(C) - n)
    shoulder = math.sin(half1) * n
    centre1, short = math.atan2(B, A), math.inf
    for s in range(2):
        q1 = centre1 + half1 if s == 0 else centre1 - half1
        c1, s1 = math.cos(q1), math.sin(q1)
        # joint 3: distance from axis 2 to the wrist centre
        v = add_vectors(rotate_vector(h1, c1, -s1, u), p21)
        square = dot_product(v, v)
        half3 = _compute_half_angle(square / 2 - links, reach)
        # the chord |v| compared with the longest and the shortest of the two links
        short = min(short, max(math.sqrt(square) - longest, shortest - math.sqrt(square)) if math.isnan(half3) else 0.0)
        for e in range(2):
            first = 4 * s + 2 * e
            margin[0, first] = margin[0, first + 1] = shoulder
            if math.isnan(half3):
                continue
            margin[1, first] = margin[1, first + 1] = min(half3, math.pi - half3)
            q3 = centre3 + half3 if e == 0 else centre3 - half3
            c3, s3 = math.cos(q3), math.sin(q3)
            q2 = compute_angle_about_axis(h2, add_vectors(rotate_vector(h3, c3, s3, b), a), v)
            c2, s2 = math.cos(q2), math.sin(q2)
            # wrist: axis 6 relative to link 3, and axis 4 with joints 4 to 6 at zero
            x = rotate_vector(h3, c3, -s3, rotate_vector(h2, c2, -s2, rotate_vector(h1, c1, -s1, g)))
            y = rotate_vector(h1, c1, s1, rotate_vector(h2, c2, s2, rotate_vector(h3, c3, s3, h4)))
            k = _express_in_flange(X, Y, Z, y)
            y = (dot_product(zx, k), dot_product(zy, k), dot_product(zz, k))
            half5 = _compute_half_angle(dot_product(h4, x) - h456, n5)
            if math.isnan(half5):
                continue
            margin[2, first] = margin[2, first + 1] = min(half5, math.pi - half5)
            for f in range(2):
                out = q[first + f]
                out[0], out[1], out[2], out[4] = q1, q2, q3, centre5 + half5 if f == 0 else centre5 - half5
                _complete_wrist(h4, h5, h6, x, y, out)
    return _clamp_to_zero(short)


@jit_compile
def _express_in_flange(X: Vector, Y: Vector, Z: Vector, y: Vector) -> Vector:
    """Return a vector of base_link in the axes of the flange, by the rows X, Y, Z of its rotation."""
    return (
        X[0] * y[0] + Y[0] * y[1] + Z[0] * y[2],
        X[1] * y[0] + Y[1] * y[1] + Z[1] * y[2],
        X[2] * y[0] + Y[2] * y[1] + Z[2] * y[2],
    )


@jit_compile
def _complete_wrist(h4: Vector, h5: Vector, h6: Vector, x: Vector, y: Vector, q: Array) -> None:
    """Fill joints 4 and 6 of q (6,) rad and wrap all joints; x and y as in :func:`compute_spherical_branches`."""
    c5, s5 = math.cos(q[4]), math.sin(q[4])
    q[3] = compute_angle_about_axis(h4, rotate_vector(h5, c5, s5, h6), x)
    q[5] = -compute_angle_about_axis(h6, rotate_vector(h5, c5, -s5, h4), y)
    for i in range(6):
        q[i] = wrap_angle(q[i])


@jit_compile
def _clamp_to_zero(x: float) -> float:
    """0 for less than 0; NaN stays."""
    return x if not x < 0.0 else 0.0


@jit_compile
def _compute_half_angle(C: float, n: float) -> float:
    """Half the angle between both solutions of n cos(q − q₀) = C, NaN where there is none."""
    ratio = C / n if n > 0.0 else math.nan
    return math.acos(ratio) if abs(ratio) <= 1.0 else math.nan
