"""Inverse kinematics for any 6R arm: closed form where the arm has one, the general solver elsewhere."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Protocol

import numpy as np
from numpy.typing import NDArray

from machopt.domain.reason import Reason
from machopt.model.ik_spherical import Branches, SphericalWristSolver
from machopt.model.robot import Robot

Array = NDArray[np.float64]


@dataclass(frozen=True)
class Margins:
    """Least distance from each singularity that still counts as regular."""

    wrist: float  # rad
    elbow: float  # rad
    shoulder: float  # m
    limit: float  # rad, kept free before each joint limit


class Solver(Protocol):
    """What the planner needs of an inverse kinematics."""

    branches: int
    branch_stable: bool  # the same index is the same assembly mode at every pose

    def solve(self, T_base_flange: Array) -> Branches: ...

    def solve_grid(self, T_base_flange: Array) -> Branches: ...


def solver_for(robot: Robot) -> Solver:
    """The closed form where the wrist is spherical, else the general solver."""
    if SphericalWristSolver.fits(robot):
        return SphericalWristSolver(robot)
    from machopt.model.ik_bridge import GeneralBranches

    return GeneralBranches(robot)


def turns(lower: Array, upper: Array) -> Array:
    """(T, 6) whole turns in rad that can bring an angle of (−π, π] inside the limits, zero first."""
    per_joint = []
    for low, high in zip(lower, upper, strict=True):
        k = [0] + [n for n in (-1, 1) if low <= np.pi + 2 * np.pi * n and high > -np.pi + 2 * np.pi * n]
        per_joint.append(2 * np.pi * np.array(k, float))
    mesh = np.stack(np.meshgrid(*per_joint, indexing="ij"), axis=-1).reshape(-1, 6)
    order = np.argsort(np.abs(mesh).sum(axis=1), kind="stable")
    return mesh[order]


def branch_reasons(branches: Branches, margins: Margins) -> NDArray[np.uint8]:
    """(M, B) reason per branch before joint limits: existence and singularity margins."""
    exists = np.isfinite(branches.q).all(axis=-1)
    out = np.full(exists.shape, Reason.UNREACHABLE, np.uint8)
    out[exists] = Reason.OK
    with np.errstate(invalid="ignore"):
        out[exists & (branches.wrist < margins.wrist)] = Reason.SINGULAR_WRIST
        out[exists & (branches.elbow < margins.elbow)] = Reason.SINGULAR_ELBOW
        out[exists & (branches.shoulder < margins.shoulder)] = Reason.SINGULAR_SHOULDER
    return out


def refine(
    robot: Robot, T_base_tool: Array, seed: Array, T_flange_tool: Array, iterations: int = 4
) -> tuple[Array, Array]:
    """Newton from seeds that are already close, for any 6R arm.

    Args:
        T_base_tool: (..., 4, 4) wanted poses.
        seed: (..., 6) rad.

    Returns:
        q (..., 6) rad and the remaining error (...,), m and rad mixed as max(|dp|, |dφ|).
    """
    q = np.array(seed, float)
    for _ in range(iterations):
        T, J = robot.fk_jacobian(q, T_flange_tool)
        away = pose_error(T, T_base_tool)[..., None]
        try:
            q += np.linalg.solve(J, away)[..., 0]
        except np.linalg.LinAlgError:  # a seed exactly at a singularity; whether it led anywhere the error says
            q += (np.linalg.pinv(J) @ away)[..., 0]
    error = pose_error(robot.fk(q, T_flange_tool), T_base_tool)
    return q, np.maximum(np.linalg.norm(error[..., :3], axis=-1), np.linalg.norm(error[..., 3:], axis=-1))


def pose_error(T: Array, T_wanted: Array) -> Array:
    """Twist (..., 6) that takes T to T_wanted to first order, in the common frame's axes."""
    E = T_wanted[..., :3, :3] @ np.swapaxes(T[..., :3, :3], -1, -2)
    rotation = 0.5 * np.stack(
        [E[..., 2, 1] - E[..., 1, 2], E[..., 0, 2] - E[..., 2, 0], E[..., 1, 0] - E[..., 0, 1]], -1
    )
    return np.concatenate([T_wanted[..., :3, 3] - T[..., :3, 3], rotation], axis=-1)
