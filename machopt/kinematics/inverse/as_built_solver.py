"""Inverse kinematics of an as-built arm: branches of the nominal arm, refined to the as-built axes by Newton's method.

An as-built arm generally has no closed form (axes 4, 5 and 6 miss each other by tenths of a millimetre). Its branches
are near those of the nominal arm, so each keeps its index.
"""

from __future__ import annotations

import numpy as np

from machopt.kinematics import product_of_exponentials
from machopt.kinematics.inverse.spherical_wrist import KinematicBranches
from machopt.kinematics.robot import Robot
from machopt.numerics.array_types import Array
from machopt.numerics.compiled_functions import jit_compile

MAX_ITERATIONS = 12
CONVERGENCE = 1e-12  # m and rad, where another iteration changes nothing
POSE_TOLERANCE = 1e-9  # m and rad: with a larger pose error the branch does not exist
MAX_BRANCH_DISTANCE_RAD = 0.5  # rad from the nominal branch: a larger distance means another one


class AsBuiltSolver:
    """Branches of an as-built arm.

    Args:
        robot: as-built arm with ``nominal``.
        drawn: solver of the nominal arm.
    """

    def __init__(self, robot: Robot, drawn: object) -> None:
        self.robot, self._drawn = robot, drawn
        self.branches: int = drawn.branches  # type: ignore[attr-defined]  # ik.Solver, which imports this file
        self.branch_stable: bool = drawn.branch_stable  # type: ignore[attr-defined]
        zero = np.array(robot.T_base_flange_zero, float, order="C")
        self._lines = np.array(robot.axis, float, order="C"), np.array(robot.point, float, order="C"), zero

    def solve(self, T_base_flange: Array) -> KinematicBranches:
        """Return all branches; those that the as-built arm does not reach are NaN.

        Args:
            T_base_flange: (M, 4, 4) flange poses in base_link.
        """
        return self._refine_branches(self._drawn.solve(T_base_flange), T_base_flange)  # type: ignore[attr-defined]

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
            q: (N·R, B, 6) rad, filled with the joints; None: a new array.
        """
        found = self._drawn.solve_grid(T_base_flange, q)  # type: ignore[attr-defined]
        return self._refine_branches(found, T_base_flange.reshape(-1, 4, 4))

    def _refine_branches(self, branches: KinematicBranches, T: Array) -> KinematicBranches:
        refine_branches(*self._lines, np.ascontiguousarray(T, float), branches.q)
        return branches


@jit_compile
def refine_branches(axis: Array, point: Array, zero: Array, T: Array, q: Array) -> None:
    """Refine every branch by Newton's method, in place; NaN where it does not converge.

    Args:
        axis: (6, 3) unit, lines of the arm in base_link at q = 0.
        point: (6, 3) m, a point of each.
        zero: (4, 4) flange pose at q = 0.
        T: (M, 4, 4) flange poses.
        q: (M, B, 6) rad, branches; changed.
    """
    here, J, A = np.empty((1, 4, 4)), np.empty((1, 6, 6)), np.empty((6, 7))
    at, start = np.empty((1, 6)), np.empty(6)
    for m in range(len(T)):
        for b in range(q.shape[1]):
            if np.isnan(q[m, b, 0]):
                continue
            for i in range(6):
                at[0, i] = start[i] = q[m, b, i]
            there = False
            for _ in range(MAX_ITERATIONS):
                product_of_exponentials.compute_jacobians(axis, point, zero, at, here, J)
                off = compute_pose_difference(here[0], T[m], A)
                there = off < POSE_TOLERANCE
                if off < CONVERGENCE or not solve_newton_step(J[0], A):
                    break
                distance = 0.0
                for i in range(6):
                    at[0, i] += A[i, 6]
                    distance = max(distance, abs(at[0, i] - start[i]))
                if not distance < MAX_BRANCH_DISTANCE_RAD:
                    there = False
                    break
            for i in range(6):
                q[m, b, i] = wrap_angle(at[0, i]) if there else np.nan


@jit_compile
def wrap_angle(angle: float) -> float:
    """Return the same angle in (−π, π].

    Args:
        angle: rad.
    """
    return float(np.pi - np.mod(np.pi - angle, 2.0 * np.pi)) if abs(angle) > np.pi else angle


@jit_compile
def compute_pose_difference(T: Array, target: Array, A: Array) -> float:
    """Write the twist from T to another pose into the last column of A; return its largest entry, m or rad.

    Args:
        T: (4, 4) present pose.
        target: (4, 4) target pose.
        A: (6, 7) receives the twist in column 6.
    """
    most = 0.0
    for r in range(3):
        A[r, 6] = target[r, 3] - T[r, 3]
        a, b = (r + 1) % 3, (r + 2) % 3
        turn = 0.0
        for k in range(3):  # E = wanted Rᵀ; half of E[b, a] − E[a, b]
            turn += target[b, k] * T[a, k] - target[a, k] * T[b, k]
        A[r + 3, 6] = 0.5 * turn
        most = max(most, abs(A[r, 6]), abs(A[r + 3, 6]))
    return most


@jit_compile
def solve_newton_step(J: Array, A: Array) -> bool:
    """Solve J x = A[:, 6] by elimination with pivoting; return False where J is singular.

    Args:
        J: (6, 6) Jacobian.
        A: (6, 7) right-hand side in column 6, which receives x; the rest is overwritten.
    """
    for r in range(6):
        for c in range(6):
            A[r, c] = J[r, c]
    for c in range(6):
        best = c
        for r in range(c + 1, 6):
            if abs(A[r, c]) > abs(A[best, c]):
                best = r
        if abs(A[best, c]) < 1e-9:
            return False
        for k in range(c, 7):
            A[c, k], A[best, k] = A[best, k], A[c, k]
        for r in range(6):
            if r != c:
                f = A[r, c] / A[c, c]
                for k in range(c, 7):
                    A[r, k] -= f * A[c, k]
    for r in range(6):
        A[r, 6] /= A[r, r]
    return True
