"""Inverse kinematics for any 6R arm: closed form where the arm has one, the general solver elsewhere."""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import Protocol

import numpy as np
from numpy.typing import NDArray

from machopt.data_types.infeasibility_reasons import InfeasibilityReason
from machopt.errors import TooManyArmJointsError
from machopt.kinematics.inverse.as_built_solver import AsBuiltSolver
from machopt.kinematics.inverse.spherical_wrist import KinematicBranches, SphericalWristSolver
from machopt.kinematics.robot import Robot
from machopt.numerics.array_types import Array
from machopt.numerics.compiled_functions import jit_compile

OK, LIMIT, UNREACHABLE = (
    int(InfeasibilityReason.OK),
    int(InfeasibilityReason.LIMIT),
    int(InfeasibilityReason.UNREACHABLE),
)
SHOULDER, ELBOW, WRIST = (
    int(InfeasibilityReason.SINGULAR_SHOULDER),
    int(InfeasibilityReason.SINGULAR_ELBOW),
    int(InfeasibilityReason.SINGULAR_WRIST),
)


@dataclass(frozen=True)
class SingularityMargins:
    """Minimum distance from each singularity."""

    wrist: float  # rad
    elbow: float  # rad
    shoulder: float  # m
    limit: float  # rad, kept free before each joint limit


class InverseKinematicsSolver(Protocol):
    """Interface of an inverse kinematics solver."""

    branches: int
    branch_stable: bool  # the same index is the same assembly mode at every pose

    def solve(self, T_base_flange: Array) -> KinematicBranches:
        """Return all branches.

        Args:
            T_base_flange: (M, 4, 4) flange poses in base_link.
        """

    def solve_grid(self, T_base_flange: Array, q: Array | None = None) -> KinematicBranches:
        """Return all branches of a grid of poses, flattened to N·R rows.

        Args:
            T_base_flange: (N, R, 4, 4) flange poses in base_link.
            q: (N·R, B, 6) rad, filled with the joints; None: a new array.
        """

    def compute_margins(self, T_base_flange: Array, q: Array) -> KinematicBranches | None:
        """Return the margins of configurations that are known to reach their poses, as branches (M, 1, 6).

        A general solver finds its branches numerically and may miss a pair of them; a configuration confirmed by
        forward
        kinematics exists anyway. None for solvers in closed form, which miss none.

        Args:
            T_base_flange: (M, 4, 4) flange poses in base_link.
            q: (M, 6) rad.
        """


def build_solver(robot: Robot) -> InverseKinematicsSolver:
    """Return the solver of an arm: closed form for a spherical wrist, else the general solver.

    Linkages and as-built geometry wrap the solver of the uncoupled or nominal arm.

    Args:
        robot: kinematic model.

    Raises:
        TooManyArmJointsError: the arm has more than six joints.
    """
    if len(robot.joints) > 6:
        raise TooManyArmJointsError(
            f"the arm has {len(robot.joints)} joints ({', '.join(robot.joints)}); a motion can be planned for six",
            where="robot.arm_joints",
        )
    if robot.coupling is not None:
        return LinkageSolver(robot, build_solver(robot.uncoupled_robot))
    if robot.nominal is not None:
        return AsBuiltSolver(robot, build_solver(robot.nominal))
    if SphericalWristSolver.is_applicable(robot):
        return SphericalWristSolver(robot)
    from machopt.kinematics.inverse.general_solver_adapter import GeneralBranches

    return GeneralBranches(robot)


class LinkageSolver:
    """Solver of an arm with a linkage, from a solver of its lines, which rotate by C q: q = C⁻¹ θ.

    C contains integers and so does its inverse, so angles that differ by full turns still do.
    """

    def __init__(self, robot: Robot, lines: InverseKinematicsSolver) -> None:
        self.robot, self.lines = robot, lines
        self.branches, self.branch_stable = lines.branches, lines.branch_stable

    def solve(self, T_base_flange: Array) -> KinematicBranches:
        """Return all branches.

        Args:
            T_base_flange: (M, 4, 4) flange poses in base_link.
        """
        return self._convert_to_joints(self.lines.solve(T_base_flange), None)

    def solve_grid(self, T_base_flange: Array, q: Array | None = None) -> KinematicBranches:
        """Return all branches of a grid of poses, flattened to N·R rows.

        Args:
            T_base_flange: (N, R, 4, 4) flange poses in base_link.
            q: (N·R, B, 6) rad, filled with the joints; None: a new array.
        """
        return self._convert_to_joints(self.lines.solve_grid(T_base_flange, q), q)

    def compute_margins(self, T_base_flange: Array, q: Array) -> KinematicBranches | None:
        """Return the margins of known configurations, as branches (M, 1, 6); None where none can be missed.

        Args:
            T_base_flange: (M, 4, 4) flange poses in base_link.
            q: (M, 6) rad.
        """
        found = self.lines.compute_margins(T_base_flange, self.robot.compute_line_angles(q))
        return None if found is None else replace(found, q=q[:, None])

    def _convert_to_joints(self, branches: KinematicBranches, out: Array | None) -> KinematicBranches:
        q = self.robot.compute_joint_positions(branches.q)
        q = np.pi - np.remainder(np.pi - q, 2 * np.pi)
        if out is not None:
            out[:] = q
            q = out
        return replace(branches, q=q)


def list_whole_turns(lower: Array, upper: Array) -> Array:
    """Return the (T, J) whole turns in rad that can bring angles of (−π, π] inside the limits, zero first.

    Args:
        lower: (J,) rad.
        upper: (J,) rad.
    """
    per_joint = []
    for low, high in zip(lower, upper, strict=True):
        k = [0] + [n for n in (-1, 1) if low <= np.pi + 2 * np.pi * n and high > -np.pi + 2 * np.pi * n]
        per_joint.append(2 * np.pi * np.array(k, float))
    mesh = np.stack(np.meshgrid(*per_joint, indexing="ij"), axis=-1).reshape(-1, len(lower))
    order = np.argsort(np.abs(mesh).sum(axis=1), kind="stable")
    return mesh[order]


def choose_angle_origin(lower: Array, upper: Array) -> tuple[Array, Array]:
    """Choose the origin of each joint's angles so that few whole turns cover its range.

    A joint of ±350° has three turns of angles in (−π, π], of which each angle uses two. With −350° as origin it has
    two.

    Args:
        lower: (6,) rad.
        upper: (6,) rad.

    Returns:
        (6,) rad, the origin, angles are in [origin, origin + 2π); (T, 6) rad, the turns that can bring these
        inside the limits, zero first.
    """
    origin = np.full(6, -np.pi)
    per_joint: list[Array] = []
    for i, (low, high) in enumerate(zip(lower, upper, strict=True)):
        k = list_whole_turns(np.array([low]), np.array([high]))[:, 0]
        needed = int(np.ceil((high - low) / (2 * np.pi)))
        if 0 < needed < len(k):
            origin[i], k = low, np.asarray(np.arange(needed) * (2 * np.pi))
        per_joint.append(k)
    return origin, np.stack(np.meshgrid(*per_joint, indexing="ij"), axis=-1).reshape(-1, 6)


def shift_angles(origin: Array, q: Array) -> None:
    """Shift angles of (−π, π] into [origin, origin + 2π), in place.

    Args:
        origin: (6,) rad.
        q: (..., 6) rad; changed.
    """
    for i in np.flatnonzero(origin != -np.pi):
        q[..., i] += (
            2 * np.pi * np.ceil((origin[i] - 1e-12 - q[..., i]) / (2 * np.pi))
        )  # a value on the limit counts as inside


def compute_branch_reasons(branches: KinematicBranches, margins: SingularityMargins) -> NDArray[np.uint8]:
    """Return the (M, B) infeasibility reason per branch without joint limits: existence and singularity margins.

    Args:
        branches: all branches of M poses.
        margins: minimum distances from singularities.
    """
    return check_branches(branches, margins, np.empty((0, 6)), np.empty(6), np.empty(6))[0]


def check_branches(
    branches: KinematicBranches, margins: SingularityMargins, turns: Array, lower: Array, upper: Array
) -> tuple[NDArray[np.uint8], NDArray[np.bool_]]:
    """Return the infeasibility reason of each branch.

    Args:
        branches: all branches of M poses.
        margins: minimum distances from singularities.
        turns: (T, 6) rad; where there are any, a branch that exists and is regular needs one that fits the limits.
        lower: (6,) rad.
        upper: (6,) rad.

    Returns:
        (M, B) Reason, and (M, B, T): whether the branch is usable with this turn.
    """
    M, B = branches.q.shape[:2]
    reason, fits = np.empty((M, B), np.uint8), np.empty((M, B, len(turns)), bool)
    least = np.array([margins.shoulder, margins.elbow, margins.wrist])
    _check_branches(branches.q, branches.margin, least, turns, lower, upper, reason, fits)
    return reason, fits


@jit_compile
def _check_branches(
    q: Array,
    margin: Array,
    least: Array,
    turns: Array,
    lower: Array,
    upper: Array,
    reason: NDArray[np.uint8],
    fits: NDArray[np.bool_],
) -> None:
    for m in range(q.shape[0]):
        for b in range(q.shape[1]):
            exists = True
            for i in range(6):
                exists = exists and np.isfinite(q[m, b, i])
            why = OK
            if not exists:
                why = UNREACHABLE
            elif margin[m, 0, b] < least[0]:  # the singularity nearest to the base is reported
                why = SHOULDER
            elif margin[m, 1, b] < least[1]:
                why = ELBOW
            elif margin[m, 2, b] < least[2]:
                why = WRIST
            some = len(turns) == 0
            for t in range(len(turns)):
                inside = why == OK
                for i in range(6):
                    inside = inside and lower[i] <= q[m, b, i] + turns[t, i] <= upper[i]
                fits[m, b, t] = inside
                some = some or inside
            reason[m, b] = LIMIT if why == OK and not some else why


def refine_by_newton(
    robot: Robot, T_base_tool: Array, seed: Array, T_flange_tool: Array, iterations: int = 4
) -> tuple[Array, Array]:
    """Run Newton's method from close seeds, for any 6R arm.

    Args:
        robot: kinematic model.
        T_base_tool: (..., 4, 4) target poses.
        seed: (..., 6) rad.
        T_flange_tool: (4, 4) tool frame relative to the flange.
        iterations: number of steps.

    Returns:
        q (..., 6) rad and the remaining error (...,), m and rad mixed as max(|dp|, |dφ|).
    """
    q = np.array(seed, float)
    for _ in range(iterations):
        T, J = robot.compute_fk_jacobian(q, T_flange_tool)
        away = compute_pose_error(T, T_base_tool)[..., None]
        try:
            q += np.linalg.solve(J, away)[..., 0]
        except np.linalg.LinAlgError:  # a seed exactly at a singularity; the error shows whether it converged
            q += (np.linalg.pinv(J) @ away)[..., 0]
    error = compute_pose_error(robot.compute_fk(q, T_flange_tool), T_base_tool)
    return q, np.maximum(np.linalg.norm(error[..., :3], axis=-1), np.linalg.norm(error[..., 3:], axis=-1))


def compute_pose_error(T: Array, T_wanted: Array) -> Array:
    """Return the twist (..., 6) that moves T to T_wanted to first order, in the common frame's axes.

    Args:
        T: (..., 4, 4) present pose.
        T_wanted: (..., 4, 4) target pose.
    """
    E = T_wanted[..., :3, :3] @ np.swapaxes(T[..., :3, :3], -1, -2)
    rotation = 0.5 * np.stack(
        [E[..., 2, 1] - E[..., 1, 2], E[..., 0, 2] - E[..., 2, 0], E[..., 1, 0] - E[..., 0, 1]], -1
    )
    return np.concatenate([T_wanted[..., :3, 3] - T[..., :3, 3], rotation], axis=-1)
