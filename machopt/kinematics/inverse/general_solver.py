"""Inverse kinematics of any 6R arm: all real branches, batched, every one checked against its pose.

Arms of the UR family (axes 2 ∥ 3 ∥ 4, axes 5 and 6 meeting) use the closed form of
:mod:`~machopt.kinematics.inverse.three_parallel_axes`,
eight branches whose index is the same assembly mode everywhere. Every other arm uses the elimination of
:mod:`~machopt.kinematics.inverse.dialytic_elimination`, up to sixteen branches. Its best formulation is found by trial
when the solver is built (some tenths of a second); nothing is downloaded, derived symbolically or written.
"""

from __future__ import annotations

import itertools
import math
from dataclasses import dataclass, field
from functools import lru_cache
from typing import Literal

import numpy as np
from numpy.typing import NDArray

from machopt.errors import InputError
from machopt.kinematics.axis_geometry import is_spherical_wrist, is_three_parallel
from machopt.kinematics.inverse.dialytic_elimination import DialyticElimination, EliminationChoice
from machopt.kinematics.inverse.grid_solver import fill_grid, label_grid
from machopt.kinematics.inverse.newton_iteration import (
    polish_branches,
    remove_duplicate_solutions,
    solve_from_rough_starts,
)
from machopt.kinematics.inverse.three_parallel_axes import BRANCH_COUNT as PARALLEL_BRANCHES
from machopt.kinematics.inverse.three_parallel_axes import ThreeParallelSolver
from machopt.kinematics.robot import Robot
from machopt.numerics.array_types import Array
from machopt.numerics.rigid_transforms import build_transform, compute_axis_rotation

__all__ = ["GeneralSolver", "is_spherical_wrist", "is_three_parallel", "solve_general"]

GENERIC_BRANCHES = 16  # Primrose 1986: a general 6R arm has at most sixteen
CLOSED_FORM_TOLERANCE_RAD, CLOSED_FORM_TOLERANCE_M = (
    1e-5,
    1e-5,
)  # URDFs print π/2 as 1.5708; Newton refines the closed form
POLISH_RAD = 0.05  # a closed-form root that Newton moves further is another branch
OFFSET_FLANGE_POSE = build_transform(
    compute_axis_rotation(np.array([0.36, 0.48, 0.8]), np.array(2e-3)), np.zeros(3)
)  # flange to a slightly rotated one
SAME_SOLUTION_RAD = 1e-6  # rad; below, two roots are one: a double root is only known to √rounding
NEWTON_STEPS = 12
HALF_ANGLE_PHASES = (
    0.3,
    1.1,
    -0.7,
)  # rad, generic: puts the zeros and poles of the half-angle tangents at no round angle
TRIAL_CONFIGURATIONS = 64, 256  # random configurations for all formulations, then for the four best
MIN_RECALL = 0.9  # of the trial configurations; an arm below has fewer than six independent axes


@dataclass(frozen=True, kw_only=True)
class GeneralSolver:
    """All branches of one arm. Build it with :meth:`for_robot`."""

    robot: Robot
    kind: Literal["three_parallel", "general"]
    branches: int  # 8 or 16, the second dimension of every result
    branch_stable: bool  # the same index is the same assembly mode at every pose
    recall: float  # share of the trial configurations found again while building; 1 for the closed form, NaN untried
    closed: ThreeParallelSolver | None = field(repr=False, default=None)
    eliminations: tuple[DialyticElimination, ...] = field(
        repr=False, default=()
    )  # best first, spares for doubtful poses

    @classmethod
    def for_robot(cls, robot: Robot) -> GeneralSolver:
        """Classify the arm and choose the formulation.

        Args:
            robot: kinematic model.

        Raises:
            InputError: no formulation finds the arm's own random configurations again; it cannot rotate and move
                freely in all six directions (two axes on one line, four axes parallel or through one point).
        """
        if is_three_parallel(robot, CLOSED_FORM_TOLERANCE_RAD, CLOSED_FORM_TOLERANCE_M):
            return cls(
                robot=robot,
                kind="three_parallel",
                branches=PARALLEL_BRANCHES,
                branch_stable=True,
                recall=1.0,
                closed=ThreeParallelSolver.for_robot(robot),
            )
        recall, eliminations = _select_eliminations(robot)
        if recall < MIN_RECALL:
            raise InputError(
                f"the inverse kinematics of arm {', '.join(robot.joints)} finds only {100 * recall:.0f} % of its own "
                f"configurations again; six axes that move the flange in all six directions would work",
                where="robot.arm_joints",
            )
        return cls._with_eliminations(robot, recall, eliminations)

    @classmethod
    def with_first_elimination(cls, robot: Robot) -> GeneralSolver:
        """Return a solver whose formulation was not chosen by trials: for warming up, where speed counts.

        Args:
            robot: kinematic model.
        """
        return cls._with_eliminations(robot, math.nan, (DialyticElimination.build(robot, _list_choices()[0]),))

    @classmethod
    def _with_eliminations(
        cls, robot: Robot, recall: float, eliminations: tuple[DialyticElimination, ...]
    ) -> GeneralSolver:
        return cls(
            robot=robot,
            kind="general",
            branches=GENERIC_BRANCHES,
            branch_stable=False,
            recall=recall,
            eliminations=eliminations,
        )

    def solve(self, T_base_flange: Array) -> Array:
        """All branches of M poses, each exact to 1e-9 m and 1e-9 rad by forward kinematics.

        Args:
            T_base_flange: (M, 4, 4).

        Returns:
            (M, B, 6) rad in (−π, π], NaN where the branch does not exist. ``three_parallel``: the index is the
            assembly mode, 4·shoulder + 2·wrist + elbow, and roots that coincide at a singularity appear twice.
            ``general``: no order, no duplicates, existing ones first.
        """
        T = np.ascontiguousarray(T_base_flange, float)
        if self.closed is not None:
            return self._solve_closed(self.closed, T)
        return self._solve_general(T)

    def solve_grid(self, T_base_flange: Array) -> Array:
        """Return all branches on a grid of neighbouring poses, labelled by continuity.

        For general arms a coarse grid is solved and solutions are tracked in between. Where the number of solutions
        changes (folds, jumps of the path), the poses in between are solved too. A pair of solutions that appears and
        disappears strictly between coarse poses (8 points, 4 rotations) can be missed; ``solve`` misses none.

        Args:
            T_base_flange: (N, R, 4, 4), neighbours along both axes close to each other.

        Returns:
            (N, R, B, 6) rad in (−π, π]. The index continues along the points (first axis) wherever the solution
            does; along the rotations too, as far as both are possible.
        """
        T = np.ascontiguousarray(T_base_flange, float)
        N, R = T.shape[:2]
        if self.closed is not None or N * R == 0:
            return self.solve(T.reshape(-1, 4, 4)).reshape(N, R, self.branches, 6)
        q = fill_grid(self.robot, T, self._solve_general, self.branches)
        return label_grid(q)

    def _solve_closed(self, closed: ThreeParallelSolver, T: Array) -> Array:
        q = closed.solve(T)
        robot = self.robot
        polish_branches(robot.axis, robot.point, robot.T_base_flange_zero, T, q, NEWTON_STEPS, POLISH_RAD)
        return q

    def _solve_general(self, T: Array) -> Array:
        out = np.full((len(T), self.branches, 6), np.nan)
        pending = np.flatnonzero(np.isfinite(T).all(axis=(1, 2)))
        for elimination in self.eliminations:
            both = np.concatenate([out[pending], self._find_real_solutions(elimination, T[pending])], axis=1)
            pose = np.repeat(np.arange(len(pending)), 2 * self.branches)
            error = np.where(np.isfinite(both[..., 0]), 0.0, np.inf).ravel()
            out[pending] = remove_duplicate_solutions(
                both.reshape(-1, 6), pose, error, len(pending), self.branches, SAME_SOLUTION_RAD
            )
            # complex roots come in pairs, so an odd number of real ones means that one was lost
            count = np.isfinite(out[pending, :, 0]).sum(axis=1)
            pending = pending[count % 2 == 1]
        return out

    def _find_real_solutions(self, elimination: DialyticElimination, T: Array) -> Array:
        """Return branches (M, B, 6) by one elimination; where two share its angle also from a pose close by.

        A double eigenvalue spans a plane of monomials, and the eigenvectors are a mixture of the two solutions.
        Where the forearm lies in the plane of the arm (q₄ = 0 or π: every path with an upright tool) this is always the
        case.
        """
        rough, pose = elimination.find_candidates(T)
        shared = np.unique(elimination.find_shared_eigenvalues(rough, pose))
        if len(shared):
            nearby_q, nearby_pose = elimination.find_candidates(T[shared] @ OFFSET_FLANGE_POSE)
            rough, pose = np.concatenate([rough, nearby_q]), np.concatenate([pose, shared[nearby_pose]])
        q, error = self._refine_by_newton(T, pose, rough)
        return remove_duplicate_solutions(q, pose, error, len(T), self.branches, SAME_SOLUTION_RAD)

    def _refine_by_newton(self, T: Array, pose: NDArray[np.int64], q: Array) -> tuple[Array, Array]:
        robot = self.robot
        pose = np.ascontiguousarray(pose)  # np.nonzero gives a view: a type of its own, compiled once more
        q, error = solve_from_rough_starts(robot.axis, robot.point, robot.T_base_flange_zero, T, pose, q, NEWTON_STEPS)
        return q, error


def solve_general(robot: Robot, T_base_flange: Array) -> Array:
    """Return all branches (M, B, 6) in rad; a new solver is built, so use :class:`GeneralSolver` for repeated calls.

    Args:
        robot: kinematic model.
        T_base_flange: (M, 4, 4) flange poses in base_link.
    """
    return GeneralSolver.for_robot(robot).solve(T_base_flange)


@dataclass(frozen=True)
class _ArmGeometry:
    """An arm as a key: arms of the same lines and flange are equal."""

    lines: bytes
    robot: Robot = field(repr=False, compare=False)


def _select_eliminations(robot: Robot) -> tuple[float, tuple[DialyticElimination, ...]]:
    """Return the recall of the best formulation on the arm's own configurations, with it and two alternatives."""
    lines = b"".join(np.ascontiguousarray(a).tobytes() for a in (robot.axis, robot.point, robot.T_base_flange_zero))
    recall, ranked = _rank_eliminations(_ArmGeometry(lines, robot))
    return recall, tuple(DialyticElimination.build(robot, c) for c in ranked)


@lru_cache(maxsize=32)  # a command builds the solver of one arm several times
def _rank_eliminations(arm: _ArmGeometry) -> tuple[float, tuple[EliminationChoice, ...]]:
    robot = arm.robot
    ranked = sorted(_list_choices(), key=lambda c: _test_elimination(robot, c, TRIAL_CONFIGURATIONS[0]), reverse=True)[
        :4
    ]
    scores = {c: _test_elimination(robot, c, TRIAL_CONFIGURATIONS[1]) for c in ranked}
    ranked = sorted(ranked, key=scores.__getitem__, reverse=True)[:3]
    return scores[ranked[0]][0], tuple(ranked)


def _list_choices() -> list[EliminationChoice]:
    return [
        EliminationChoice(reverse, k, e, u, HALF_ANGLE_PHASES)
        for reverse, k, (e, u) in itertools.product((False, True), (1, 2, 3), ((0, 2), (1, 2), (2, 1)))
    ]


def _test_elimination(robot: Robot, choice: EliminationChoice, count: int) -> tuple[float, float, float]:
    """Recall, mean number of solutions and minus the mean number of candidates: more is better, in this order."""
    q = np.random.default_rng(0).uniform(-np.pi, np.pi, (count, 6))
    T = robot.compute_fk(q)
    elimination = DialyticElimination.build(robot, choice)
    rough, pose = elimination.find_candidates(T)
    solved, error = solve_from_rough_starts(
        robot.axis, robot.point, robot.T_base_flange_zero, T, pose, rough, NEWTON_STEPS
    )
    found = remove_duplicate_solutions(solved, pose, error, count, GENERIC_BRANCHES, SAME_SOLUTION_RAD)
    off = np.abs(np.remainder(found - q[:, None] + np.pi, 2 * np.pi) - np.pi).max(axis=-1)
    recall = float(np.mean((off < 1e-4).any(axis=1)))
    return recall, float(np.isfinite(found[..., 0]).sum() / count), -len(rough) / count
