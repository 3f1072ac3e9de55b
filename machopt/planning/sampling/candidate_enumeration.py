"""Every branch, turn and rotation at every station, with a reason where it cannot be used."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from machopt.data_types.infeasibility_reasons import InfeasibilityReason
from machopt.data_types.plan_options import PlanOptions
from machopt.data_types.steering_rules import format_steering_rule, is_inside_zone, select_steered_rows
from machopt.errors import CellError
from machopt.kinematics.inverse.solver import (
    check_branches,
    shift_angles,
)
from machopt.numerics.array_types import Array, Bools, compute_any_last
from machopt.numerics.parallel_map import map_in_threads
from machopt.numerics.rigid_transforms import invert_transform, wrap_angle
from machopt.planning.sampling.candidate_grid import CandidateGrid
from machopt.planning.sampling.planning_arm import PlanningArm
from machopt.planning.stations.fixed_rotations import find_fixed_rotations
from machopt.planning.stations.planning_path import PlanningPath, compute_tcp_poses

CHUNK = 4_096  # poses per block of the closed form: intermediate results fit a core's cache
MET = 1e-6  # rad: nearer than this a vertex has the rotation that the user fixed
TRACKED = 16_384  # poses per block of the general solver, which labels branches by continuity


@dataclass(frozen=True, kw_only=True)
class _GridBlock:
    """Configurations of some neighbouring stations, n of them."""

    turns: NDArray[np.intp]  # (t,) whole turns that occur
    fits: NDArray[np.bool_]  # (n, R, A, t)
    branch: NDArray[np.intp]  # (b,) branches that fit somewhere in the block, or all
    q: Array  # (n, R, b, 6) rad


@dataclass(frozen=True, kw_only=True)
class _GridSolver:
    """Inverse kinematics of every station and rotation, block by block."""

    arm: PlanningArm
    phi: Array  # (R,) rad
    nudge: Array  # (S,) rad
    turning: tuple[Array, Array, Array]  # (S, 1, 4, 4) each, of _turning_poses
    reason: NDArray[np.uint8]  # (S, R, A), written by each block
    shortfall: Array  # (S,) m, the same
    size: int  # stations of a block

    def solve(self, start: int) -> tuple[Array, NDArray[np.bool_]]:
        """Write reason and shortfall of a block; return its joints (n, R, A, 6) and what fits (n, R, A, T).

        Args:
            start: first station.
        """
        arm, rows, R = self.arm, slice(start, start + self.size), len(self.phi)
        still, cosine, sine = self.turning
        angle = (self.phi + self.nudge[rows, None])[..., None, None]
        poses = still[rows] + np.cos(angle) * cosine[rows]
        poses += np.sin(angle) * sine[rows]
        n, A = len(poses), arm.solver.branches
        branches = arm.solver.solve_grid(poses, np.empty((n * R, A, 6)))
        shift_angles(arm.origin, branches.q)
        why, fits = check_branches(branches, arm.margins, arm.windings, arm.lower, arm.upper)
        self.reason[rows] = why.reshape(n, R, A)
        self.shortfall[rows] = branches.shortfall.reshape(n, R).min(axis=1)
        return branches.q.reshape(n, R, A, 6), fits.reshape(n, R, A, -1)

    def block(self, start: int, every: bool) -> _GridBlock:
        """Return the configurations of a block.

        Args:
            start: first station.
            every: keep all branches, usable or not.
        """
        q, fits = self.solve(start)
        occurs: Bools = np.asarray(fits.any(axis=(0, 1)))  # (A, T)
        turns = np.flatnonzero(occurs.any(axis=0))
        branch = np.arange(len(occurs)) if every else np.flatnonzero(occurs.any(axis=1))
        occurring_q = q if len(branch) == len(occurs) else np.ascontiguousarray(q[:, :, branch])
        return _GridBlock(turns=turns, fits=fits[..., turns], branch=branch, q=occurring_q)

    def joints(self, blocks: list[_GridBlock | None], branch: NDArray[np.intp]) -> Array:
        """Return (S, R, B, 6) the joints of some branches; a block that lacks one of them is solved again.

        Args:
            blocks: all blocks in order; each is released once its joints are copied.
            branch: (B,) branch numbers.
        """
        out = np.empty((len(self.shortfall), len(self.phi), len(branch), 6))
        for k, block in enumerate(blocks):
            assert block is not None
            rows = slice(k * self.size, (k + 1) * self.size)
            if np.isin(branch, block.branch).all():
                out[rows] = block.q[:, :, np.searchsorted(block.branch, branch)]
            else:
                reason = self.reason[rows].copy()  # with what the user forbids
                out[rows] = self.solve(k * self.size)[0][:, :, branch]
                self.reason[rows] = reason
            blocks[k] = None
        return out


def enumerate_candidates(
    path: PlanningPath, arm: PlanningArm, options: PlanOptions, every_branch: bool = False
) -> CandidateGrid:
    """Solve the inverse kinematics of every station × rotation and remove what violates limits and margins.

    A branch that is usable at no vertex is left out: of the branches of an arm, rarely more than half are usable on one
    path, and time and memory of the search follow their number. Where branches have no fixed number, all are kept.

    Args:
        path: planning points.
        arm: arm model.
        options: plan options.
        every_branch: keep the branches that are usable nowhere.
    """
    R = max(round(2 * np.pi / options.rotation_step), 1)
    phi: Array = np.asarray(np.arange(R) * (2 * np.pi / R) - np.pi, float)
    S, A = len(path.stations), arm.solver.branches
    grid = _GridSolver(
        arm=arm,
        phi=phi,
        nudge=_compute_nudges(path, phi, options),
        turning=_compute_turning_poses(path, arm),
        reason=np.empty((S, R, A), np.uint8),
        shortfall=np.empty(S),
        size=max((CHUNK if arm.solver.branch_stable else TRACKED) // R, 1),
    )
    every = every_branch or not arm.solver.branch_stable
    solved = map_in_threads(lambda start: grid.block(start, every), range(0, S, grid.size))
    used = np.unique(np.concatenate([[0], *(one.turns for one in solved)]))  # at least one turn
    feasible = np.zeros((S, R, A, len(used)), bool)
    for k, one in enumerate(solved):
        feasible[k * grid.size : (k + 1) * grid.size][..., np.searchsorted(used, one.turns)] = one.fits
    _forbid_by_user(path, phi, options, grid.reason, feasible, grid.nudge, numbered=arm.solver.branch_stable)
    occurs: Bools = np.asarray(feasible.any(axis=(0, 1)))  # (A, T)
    left = np.asarray(occurs.any(axis=0))
    left[0] = True
    is_occurring = np.ones(A, bool) if every else np.asarray(occurs.any(axis=1))
    is_occurring[0] |= not is_occurring.any()
    branch = np.flatnonzero(is_occurring)
    blocks: list[_GridBlock | None] = [*solved]
    del solved, one  # so that each block is freed once its joints are copied
    q = grid.joints(blocks, branch)
    if not (left.all() and is_occurring.all()):
        feasible = np.ascontiguousarray(feasible[:, :, is_occurring][..., left])
    reason = grid.reason if is_occurring.all() else np.ascontiguousarray(grid.reason[:, :, is_occurring])
    _forbid_unstable(path, arm, q, reason, feasible)
    return CandidateGrid(
        phi=phi,
        branch=branch,
        q=q,
        turns=arm.windings[used[left]],
        reason=reason,
        feasible=feasible,
        stable=arm.solver.branch_stable,
        shortfall=grid.shortfall,
        nudge=grid.nudge,
        dropped=None if is_occurring.all() else np.ascontiguousarray(grid.reason[:, :, ~is_occurring]),
    )


def _forbid_unstable(
    path: PlanningPath, arm: PlanningArm, q: Array, reason: NDArray[np.uint8], feasible: NDArray[np.bool_]
) -> None:
    """Remove the vertices below the least ratio of stability from ``feasible``, with the reason."""
    if arm.stability is None:
        return
    s, r, b = np.nonzero(compute_any_last(feasible))
    bad = arm.stability.find_violations(arm, path, path.stations[s].astype(np.intp), q[s, r, b])
    s, r, b = s[bad], r[bad], b[bad]
    feasible[s, r, b] = False
    reason[s, r, b] = InfeasibilityReason.UNSTABLE


def solve_station(
    path: PlanningPath, arm: PlanningArm, candidates: CandidateGrid, station: int
) -> tuple[Array, NDArray[np.uint8]]:
    """Return all branches of the arm at every rotation of a station, usable or not.

    Args:
        path: planning points.
        arm: arm model.
        candidates: grid of rotations.
        station: station index.

    Returns:
        Joints (R, A, 6) rad, and (R, A) the reason without what the user forbids.
    """
    q, reason = solve_stations(path, arm, candidates, np.array([station], np.intp))
    return q[0], reason[0]


def solve_stations(
    path: PlanningPath, arm: PlanningArm, candidates: CandidateGrid, stations: NDArray[np.intp]
) -> tuple[Array, NDArray[np.uint8]]:
    """Return all branches of the arm at every rotation of some stations, usable or not.

    Args:
        path: planning points.
        arm: arm model.
        candidates: grid of rotations.
        stations: (S,) station indices.

    Returns:
        Joints (S, R, A, 6) rad, and (S, R, A) the reason without what the user forbids.
    """
    rows = path.stations[stations]
    poses = arm.in_base(path.external[rows], compute_tcp_poses(path, rows, candidates.phi_at()[stations]))
    branches = arm.solver.solve((poses @ invert_transform(arm.T_flange_tcp)).reshape(-1, 4, 4))
    shift_angles(arm.origin, branches.q)
    reason = check_branches(branches, arm.margins, arm.windings, arm.lower, arm.upper)[0]
    shape = (len(stations), -1)
    return branches.q.reshape(*shape, *branches.q.shape[1:]), reason.reshape(*shape, reason.shape[1])


def _compute_turning_poses(path: PlanningPath, arm: PlanningArm) -> tuple[Array, Array, Array]:
    """(S, 1, 4, 4) each: the flange poses of a station are the first + cos φ · the second + sin φ · the third."""
    phi = np.broadcast_to([0.0, np.pi, 0.5 * np.pi], (len(path.stations), 3))
    there = arm.in_base(path.external[path.stations], compute_tcp_poses(path, path.stations, phi))
    poses = there @ invert_transform(arm.T_flange_tcp)
    ahead, back, across = poses[:, 0:1], poses[:, 1:2], poses[:, 2:3]
    still = 0.5 * (ahead + back)
    return still, 0.5 * (ahead - back), across - still


def _compute_nudges(path: PlanningPath, phi: Array, options: PlanOptions) -> Array:
    """Return (S,) rad: shift of the grid where the user fixed a rotation, and along the plunges joined to it.

    The rotation is kept along a plunge, so all of its stations use one grid.
    """
    st = path.stations
    out = np.zeros(len(st))
    plunged = np.r_[0, np.cumsum(~path.plunge)]
    joined = np.zeros(len(st), bool)  # joined to the previous station by plunges only
    for s in range(1, len(st)):
        joined[s] = path.run[st[s]] == path.run[st[s - 1]] and plunged[st[s] + 1] == plunged[st[s - 1] + 1]
    part = np.cumsum(~joined)
    row_of = {int(row): s for s, row in enumerate(st)}
    for row, target in find_fixed_rotations(path, options).items():
        if row in row_of:
            away = np.asarray(wrap_angle(target - phi))
            out[part == part[row_of[row]]] = away[np.abs(away).argmin()]
    return out


def _forbid_by_user(
    path: PlanningPath,
    phi: Array,
    options: PlanOptions,
    reason: NDArray[np.uint8],
    feasible: NDArray[np.bool_],
    nudge: Array | None = None,
    *,
    numbered: bool = True,
) -> None:
    """Apply the user's rotation bounds, fixed rotations, zones and branches as masks on gamma and branch.

    ``numbered``: a branch has the same number at every pose. Otherwise a request refers to another branch at every
    point.
    """
    moved = phi[None, :] + (0.0 if nudge is None else nudge[:, None])
    gamma = np.asarray(wrap_angle(moved + path.offset[path.stations][:, None]))  # (S, R)
    low, high = options.rotation_range
    outside = (gamma < low - 1e-9) | (gamma > high + 1e-9)
    index = path.index[path.stations]
    row_of = {int(row): s for s, row in enumerate(path.stations)}
    for row, target in find_fixed_rotations(path, options).items():
        if row in row_of:
            off = np.abs(wrap_angle(np.broadcast_to(moved, outside.shape)[row_of[row]] - target))
            # two pins of one plunge share a grid: if they differ, it cannot meet both
            outside[row_of[row]] = off > (MET if nudge is not None else off.min() + 1e-9)
    other = np.zeros((len(index), feasible.shape[2]), bool)  # (S, B) forbidden branches
    for wish in options.steer:
        rows = select_steered_rows(wish, index)
        if wish.forbid is not None:
            outside[rows] |= is_inside_zone(gamma[rows], wish.forbid)
        if wish.branch is not None and not numbered:
            raise CellError(
                f"{format_steering_rule(wish)}: branches of this arm have no numbers that hold from pose to "
                f"pose (its last three axes "
                "meet in no point, and axes 2 to 4 are not parallel); a pinned or preferred rotation would work",
                file="options",
                where="steer",
            )
        if wish.branch is not None and wish.branch >= feasible.shape[2]:
            raise CellError(
                f"{format_steering_rule(wish)}: this arm has the branches 0 to {feasible.shape[2] - 1}",
                file="options",
                where="steer",
            )
        if wish.branch is not None:
            other[rows] |= np.arange(feasible.shape[2]) != wish.branch
    blocked = outside[:, :, None] | other[:, None, :]
    feasible[blocked] = False
    reason[blocked & (reason == InfeasibilityReason.OK)] = InfeasibilityReason.BOUNDS
