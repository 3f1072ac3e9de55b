"""Adapter of the general solver to the planner's interface: branches with their singularity margins."""

from __future__ import annotations

import math

import numpy as np

from machopt.kinematics.inverse.compiled_vectors import Vector, add_vectors, cross_product, dot_product, rotate_vector
from machopt.kinematics.inverse.general_solver import GeneralSolver
from machopt.kinematics.inverse.spherical_wrist import KinematicBranches
from machopt.kinematics.robot import Robot
from machopt.numerics.array_types import Array
from machopt.numerics.compiled_functions import jit_compile
from machopt.numerics.rigid_transforms import normalise_vectors

CHARACTERISTIC_LENGTH_M = 0.5  # m, makes the linear rows of the Jacobian comparable with the angular ones


class GeneralBranches:
    """Solver of any 6R arm. Where the wrist is not spherical there is no wrist centre, so margins are defined as
    follows.

    Three parallel axes (2, 3, 4): wrist = angle between axes 4 and 6; elbow = angle of the two links from
    one line; shoulder = distance of the point where axis 5 meets axis 6 from the plane of axes 1 and 2.
    Other arms: the least singular value of the Jacobian (linear rows over CHARACTERISTIC_LENGTH_M), assigned to the
    group
    of joints that its joint motion moves most; the other margins are infinite there.
    """

    def __init__(self, robot: Robot) -> None:
        self.robot, self.general = robot, GeneralSolver.for_robot(robot)
        self.branches, self.branch_stable = self.general.branches, self.general.branch_stable
        self._seen = _list_axis_vectors(robot) if self.general.kind == "three_parallel" else None
        reach = np.linalg.norm(np.diff(np.vstack([robot.point, robot.T_base_flange_zero[None, :3, 3]]), axis=0), axis=1)
        self._reach = float(reach[1:].sum())  # m, from axis 2 outwards: no pose beyond it can be reached

    def solve(self, T_base_flange: Array) -> KinematicBranches:
        """Return all branches.

        Args:
            T_base_flange: (M, 4, 4) flange poses in base_link.
        """
        return self._compute_margins_of_branches(T_base_flange, self.general.solve(T_base_flange))

    def solve_grid(self, T_base_flange: Array, q: Array | None = None) -> KinematicBranches:
        """Return all branches of a grid of neighbouring poses, flattened to N·R rows; this needs far fewer full
        solutions.

        Args:
            T_base_flange: (N, R, 4, 4) flange poses in base_link.
            q: (N·R, B, 6) rad, filled with the joints; None: a new array.
        """
        N, R = T_base_flange.shape[:2]
        found = self.general.solve_grid(T_base_flange).reshape(N * R, self.branches, 6)
        if q is not None:
            q[:] = found
            found = q
        return self._compute_margins_of_branches(T_base_flange.reshape(N * R, 4, 4), found)

    def compute_margins(self, T_base_flange: Array, q: Array) -> KinematicBranches:
        """Return the margins of one known configuration per pose, as branches (M, 1, 6).

        Args:
            T_base_flange: (M, 4, 4) flange poses in base_link.
            q: (M, 6) rad.
        """
        return self._compute_margins_of_branches(T_base_flange, np.ascontiguousarray(q[:, None]))

    def _compute_margins_of_branches(self, T: Array, q: Array) -> KinematicBranches:
        exists = np.asarray(np.isfinite(q).all(axis=-1))
        margin = np.full((len(q), 3, q.shape[1]), np.nan)
        if self._seen is not None:
            _compute_three_parallel_margins(self._seen, q, margin)
        elif exists.any():
            np.swapaxes(margin, 1, 2)[exists] = np.stack(self._compute_jacobian_margins(q[exists]), axis=-1)
        # distance from axis 2 to the flange minus the longest the arm can make: a lower bound of the shortfall
        beyond = np.linalg.norm(T[:, :3, 3] - self.robot.point[1], axis=1) - self._reach
        short = np.where(exists.any(axis=1), 0.0, np.maximum(beyond, 0.0))
        return KinematicBranches(q, margin, short)

    def _compute_jacobian_margins(self, q: Array) -> tuple[Array, Array, Array]:
        _, J = self.robot.compute_fk_jacobian(q)
        J = J.copy()
        J[:, :3] /= CHARACTERISTIC_LENGTH_M
        _, sigma, Vt = np.linalg.svd(J)
        weight = Vt[:, -1] ** 2
        group = np.stack([weight[:, 0], weight[:, 1:3].sum(axis=1), weight[:, 3:].sum(axis=1)], axis=1).argmax(axis=1)
        out = [np.where(group == g, sigma[:, -1], np.inf) for g in range(3)]
        return out[0] * CHARACTERISTIC_LENGTH_M, out[1], out[2]


def _list_axis_vectors(robot: Robot) -> tuple[Vector, ...]:
    """Return the vectors of an arm that :func:`_compute_three_parallel_margins` needs."""
    h, p = robot.axis, robot.point
    across = p[2] - p[1] - ((p[2] - p[1]) @ h[1]) * h[1]  # the upper arm, normal to the parallel axes
    rows = (*h[1:], *p[:5], across, normalise_vectors(np.cross(h[0], h[1])))
    return tuple((float(x), float(y), float(z)) for x, y, z in rows)


@jit_compile
def _compute_three_parallel_margins(vectors: tuple[Vector, ...], q: Array, margin: Array) -> None:
    """Fill margin (M, 3, B) of branches q (M, B, 6), NaN where there is none: shoulder in m, elbow and wrist in rad.

    Each is computed in the frame of the link that the angle belongs to, so that no chain of poses is needed.
    """
    h2, h3, h4, h5, h6, p1, p2, p3, p4, p5, upper, normal = vectors
    link = (p4[0] - p3[0], p4[1] - p3[1], p4[2] - p3[2])
    for m in range(len(q)):
        for b in range(q.shape[1]):
            if math.isnan(q[m, b, 0]):
                continue
            c3, s3 = math.cos(q[m, b, 2]), math.sin(q[m, b, 2])
            fore = rotate_vector(h3, c3, s3, link)
            parallel_part = dot_product(fore, h2)
            fore = (fore[0] - parallel_part * h2[0], fore[1] - parallel_part * h2[1], fore[2] - parallel_part * h2[2])
            x = _rotate_point(h4, p4, math.cos(q[m, b, 3]), math.sin(q[m, b, 3]), p5)  # where axes 5 and 6 meet
            x = _rotate_point(h2, p2, math.cos(q[m, b, 1]), math.sin(q[m, b, 1]), _rotate_point(h3, p3, c3, s3, x))
            margin[m, 0, b] = abs(dot_product((x[0] - p1[0], x[1] - p1[1], x[2] - p1[2]), normal))
            margin[m, 1, b] = _compute_line_angle(upper, fore)
            margin[m, 2, b] = _compute_line_angle(h4, rotate_vector(h5, math.cos(q[m, b, 4]), math.sin(q[m, b, 4]), h6))


@jit_compile
def _rotate_point(h: Vector, p: Vector, c: float, s: float, x: Vector) -> Vector:
    """A point x turned about the line through p along h."""
    return add_vectors(rotate_vector(h, c, s, (x[0] - p[0], x[1] - p[1], x[2] - p[2])), p)


@jit_compile
def _compute_line_angle(a: Vector, b: Vector) -> float:
    """Angle between two lines, 0 … π/2."""
    n = cross_product(a, b)
    return math.atan2(math.sqrt(dot_product(n, n)), abs(dot_product(a, b)))
