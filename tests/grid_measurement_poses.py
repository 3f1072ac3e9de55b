"""Measurement poses for a stiffness grid: corners and centre of every cell in three configurations (jiao2022 section
2).

Adjacent cells share corners, so a grid of cubes needs far fewer positions than nine per cell; a shared position counts
for all its cells. Unreachable poses are listed with their reason.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from machopt.collision.collision_model import CollisionModel
from machopt.data_types.cell import Cell
from machopt.data_types.infeasibility_reasons import InfeasibilityReason
from machopt.kinematics.inverse.solver import (
    InverseKinematicsSolver,
    SingularityMargins,
    compute_branch_reasons,
    list_whole_turns,
)
from machopt.kinematics.robot import Robot
from machopt.measurement.identification.grid_stiffness.grid_cells import GridRegion
from machopt.numerics.rigid_transforms import build_transform, compute_axis_rotation, invert_transform

Array = NDArray[np.float64]
Ints = NDArray[np.int64]
Bools = NDArray[np.bool_]

ANGLES = (0.0, np.deg2rad(-10.0), np.deg2rad(10.0))  # jiao2022 section 5.1: 3 × 9 = 27 configurations per cell


@dataclass(frozen=True)
class GridPlan:
    """S positions in A postures each, ordered by position; M = S·A poses."""

    region: GridRegion
    position: Array  # (S, 3) m of the TCP in base_link: corners with x fastest, then centres in the order of the cells
    angle: Array  # (A,) rad about the tool's y axis
    T_base_tcp: Array  # (M, 4, 4)
    q: Array  # (M, 6) rad, NaN without a valid configuration
    branch: Ints  # (M,) of the inverse kinematics, −1 without a valid configuration
    reason: NDArray[np.uint8]  # (M,) Reason
    members: Ints  # (G, 9) positions of each cell: its corners, then its centre

    @property
    def reached(self) -> Bools:
        """Whether each pose (M,) is reachable."""
        return np.asarray(self.reason == InfeasibilityReason.OK)

    def of_cell(self, cell: int) -> Ints:
        """Return the (9·A,) poses of one cell, 27 with three postures."""
        A = len(self.angle)
        return np.asarray((self.members[cell][:, None] * A + np.arange(A)).reshape(-1), np.int64)


def grid_plan(
    cell: Cell,
    robot: Robot,
    solver: InverseKinematicsSolver,
    region: GridRegion,
    margins: SingularityMargins,
    *,
    posture: Array | None = None,
    angles: tuple[float, ...] = ANGLES,
    branch: int | None = None,
    collision: CollisionModel | None = None,
) -> GridPlan:
    """Return poses that sample every cell of a grid.

    Args:
        cell: home position, joint limits and tool.
        robot: the cell's arm.
        solver: its inverse kinematics.
        region: the grid, in base_link.
        margins: distance from singularities and joint limits.
        posture: (3, 3) TCP axes in base_link of the initial posture; None: parallel to the grid edges, nearest to home.
        angles: rad, rotations of the posture about the tool's y axis.
        branch: of the inverse kinematics; None: the branch with most valid poses (home's first of equals), or, where a
            branch is not a constant assembly mode, at each pose the configuration nearest to home.
        collision: model to check each pose with, without permitted contacts; None: no collision check.

    Source:
        jiao2022 sections 2.2 and 5.1, fig. 1. The paper rotates about any axis; its experiment uses y.
    """
    position, members = _positions(region)
    R = _along_edges(robot.compute_fk(cell.home, cell.tool.T_flange_tcp)[:3, :3]) if posture is None else posture
    turned = R @ compute_axis_rotation(np.array([0.0, 1.0, 0.0]), np.array(angles))
    poses = build_transform(
        np.broadcast_to(turned, (len(position), len(angles), 3, 3)),
        np.broadcast_to(position[:, None], (len(position), len(angles), 3)),
    ).reshape(-1, 4, 4)
    T_tcp_flange = invert_transform(cell.tool.T_flange_tcp)
    solved = solver.solve(poses @ T_tcp_flange)
    reason = compute_branch_reasons(solved, margins)
    q = _nearest_turn(solved.q, cell, margins)
    reason[(reason == InfeasibilityReason.OK) & ~np.isfinite(q).all(axis=-1)] = InfeasibilityReason.LIMIT
    if branch is not None:
        chosen = np.full(len(poses), branch)
    elif solver.branch_stable:
        chosen = np.full(len(poses), _most_serving(reason, solver, robot.compute_fk(cell.home), cell.home))
    else:
        far = np.where(reason == InfeasibilityReason.OK, np.abs(q - cell.home).sum(axis=-1), np.inf)
        chosen = np.where(np.isfinite(far).any(axis=1), far.argmin(axis=1), reason.argmax(axis=1))
    rows = np.arange(len(poses))
    why, chosen_q = reason[rows, chosen], q[rows, chosen]
    if collision is not None:
        ok = np.flatnonzero(why == InfeasibilityReason.OK)
        why[ok[collision.check_configurations(chosen_q[ok], np.zeros(len(ok), bool)).hit]] = (
            InfeasibilityReason.COLLIDING
        )
    serves = why == InfeasibilityReason.OK
    return GridPlan(
        region,
        position,
        np.array(angles),
        poses,
        np.where(serves[:, None], chosen_q, np.nan),
        np.where(serves, chosen, -1).astype(np.int64),
        why,
        members,
    )


def _positions(region: GridRegion) -> tuple[Array, Ints]:
    nodes = np.array(region.shape) + 1
    lattice = np.stack(np.unravel_index(np.arange(np.prod(nodes)), nodes, order="F"), axis=1)
    lower = np.stack(np.unravel_index(np.arange(len(region)), region.shape, order="F"), axis=1)
    corner = lower[:, None] + np.array(list(np.ndindex(2, 2, 2)))  # (G, 8, 3)
    number = corner @ np.array([1, nodes[0], nodes[0] * nodes[1]])
    centre = len(lattice) + np.arange(len(region))
    position = np.concatenate([region.origin + region.cell * lattice, region.centres()])
    return position, np.concatenate([number, centre[:, None]], axis=1).astype(np.int64)


def _along_edges(R: Array) -> Array:
    """Return the rotation by quarter turns about base axes that is nearest to R (3, 3)."""
    axes = np.concatenate([np.eye(3), -np.eye(3)])
    found = [np.stack([x, y, np.cross(x, y)], axis=1) for x in axes for y in axes if abs(x @ y) < 0.5]
    return max(found, key=lambda F: float(np.sum(F * R)))


def _nearest_turn(q: Array, cell: Cell, margins: SingularityMargins) -> Array:
    """Shift each configuration (M, B, 6) by whole turns to the one within the limits that is nearest to home; NaN if
    there is none."""
    lower, upper = cell.limits.lower[:6] + margins.limit, cell.limits.upper[:6] - margins.limit
    best, least = np.full(q.shape, np.nan), np.full(q.shape[:-1], np.inf)
    for turn in list_whole_turns(lower, upper):
        values = q + turn
        with np.errstate(invalid="ignore"):
            inside = ((values >= lower) & (values <= upper)).all(axis=-1)
        far = np.where(inside, np.abs(values - cell.home).sum(axis=-1), np.inf)
        better = far < least
        best[better], least[better] = values[better], far[better]
    return best


def _most_serving(reason: NDArray[np.uint8], solver: InverseKinematicsSolver, T_base_flange: Array, home: Array) -> int:
    served = (reason == InfeasibilityReason.OK).sum(axis=0)
    at_home = solver.solve(T_base_flange[None]).q[0]
    off = np.abs(np.angle(np.exp(1j * (at_home - home)))).sum(axis=-1)
    own = int(np.nanargmin(off)) if np.isfinite(off).any() else 0
    return own if served[own] == served.max() else int(served.argmax())
