"""Every branch, turn and rotation at every station, with a reason where it cannot be used."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from machopt.data_types.cell import Cell
from machopt.data_types.infeasibility_reasons import InfeasibilityReason
from machopt.data_types.plan_options import PlanOptions
from machopt.data_types.steering_rules import format_steering_rule, is_inside_zone, select_steered_rows
from machopt.errors import CellError
from machopt.kinematics.inverse.solver import (
    InverseKinematicsSolver,
    SingularityMargins,
    check_branches,
    choose_angle_origin,
    list_whole_turns,
    shift_angles,
)
from machopt.kinematics.machine import Machine
from machopt.numerics.array_types import Array, Bools, compute_any_last
from machopt.numerics.parallel_map import map_in_threads
from machopt.numerics.rigid_transforms import invert_transform, wrap_angle
from machopt.planning.stations.fixed_rotations import find_fixed_rotations
from machopt.planning.stations.planning_path import PlanningPath, compute_tcp_poses

CHUNK = 4_096  # poses per block of the closed form: intermediate results fit a core's cache
MET = 1e-6  # rad: nearer than this a vertex has the rotation that the user fixed
TRACKED = 16_384  # poses per block of the general solver, which labels branches by continuity


@dataclass(frozen=True, kw_only=True)
class PlanningArm:
    """Kinematics of the cell for the planning steps."""

    solver: InverseKinematicsSolver
    machine: Machine  # pose of the workpiece in base_link, by the external joints
    T_flange_tcp: Array  # (4, 4)
    lower: Array  # (6,) rad, reduced by the limit margin
    upper: Array  # (6,)
    turns: Array  # (K, 6) rad, whole turns that can bring joints in (−π, π] inside the limits
    origin: Array  # (6,) rad, candidates' joints are counted from it: in [origin, origin + 2π)
    windings: Array  # (T, 6) rad, whole turns that can bring these joints inside the limits
    margins: SingularityMargins

    @classmethod
    def of(cls, cell: Cell, solver: InverseKinematicsSolver, machine: Machine, options: PlanOptions) -> PlanningArm:
        """Return the arm model of a cell with the margins of the options.

        Args:
            cell: robot cell with true angles.
            solver: inverse kinematics.
            machine: kinematics of the external joints.
            options: plan options with margins.
        """
        lower = cell.limits.lower[:6] + options.limit_margin
        upper = cell.limits.upper[:6] - options.limit_margin
        origin, windings = choose_angle_origin(lower, upper)
        return cls(
            solver=solver,
            origin=origin,
            windings=windings,
            machine=machine,
            T_flange_tcp=cell.tool.T_flange_tcp,
            lower=lower,
            upper=upper,
            turns=list_whole_turns(lower, upper),
            margins=SingularityMargins(
                options.singularity_wrist, options.singularity_elbow, options.singularity_shoulder, options.limit_margin
            ),
        )

    def in_base(self, external: Array, poses: Array) -> Array:
        """Return poses converted from the workpiece frame to base_link.

        Args:
            external: (n, E) m or rad, external joints.
            poses: (n, …, 4, 4) in the workpiece frame.
        """
        T = self._stands(external)
        return np.asarray(T.reshape(*T.shape[:-2], *(1,) * (poses.ndim - T.ndim), 4, 4) @ poses)

    def directions(self, external: Array, v: Array) -> Array:
        """Return directions (n, 3) converted from the workpiece frame to base_link.

        Args:
            external: (n, E) m or rad, external joints.
            v: (n, 3) in the workpiece frame.
        """
        return _turned(self._stands(external)[..., :3, :3], v)

    def back(self, external: Array, v: Array) -> Array:
        """Return directions (n, 3) converted from base_link to the workpiece frame.

        Args:
            external: (n, E) m or rad, external joints.
            v: (n, 3) in base_link.
        """
        return _turned(np.swapaxes(self._stands(external)[..., :3, :3], -1, -2), v)

    def places(self, external: Array, p: Array) -> Array:
        """Return points (n, 3) in m converted from the workpiece frame to base_link.

        Args:
            external: (n, E) m or rad, external joints.
            p: (n, 3) m in the workpiece frame.
        """
        T = self._stands(external)
        return np.asarray(_turned(T[..., :3, :3], p) + T[..., :3, 3])

    def _stands(self, external: Array) -> Array:
        """T_base_workpiece (n, 4, 4), or (4, 4) where no joint moves it."""
        return (
            self.machine.compute_T_base_workpiece(external)
            if self.machine.external_count
            else self.machine.T_base_workpiece_zero
        )


def _turned(R: Array, v: Array) -> Array:
    return np.asarray(v @ R.T if R.ndim == 2 else np.einsum("nij,nj->ni", R, v))


@dataclass(frozen=True, kw_only=True)
class CandidateGrid:
    """Candidate configurations with S stations, R rotations, B branches, T turns."""

    phi: Array  # (R,) rad, the grid about the transported reference, full circle
    q: Array  # (S, R, B, 6) rad in [origin, origin + 2π), NaN where the branch does not exist
    turns: Array  # (T, 6) rad, the whole turns that occur; q + turns[t] are the joints of the robot
    reason: NDArray[np.uint8]  # (S, R, B) Reason; OK where at least one turn lies within the limits
    feasible: NDArray[np.bool_]  # (S, R, B, T)
    stable: bool  # the branch index is the same assembly mode at every pose
    shortfall: Array  # (S,) m, least missing reach over the rotations; 0 where some rotation is reached
    nudge: Array | None = (
        None  # (S,) rad, added to phi where the user fixed a rotation between grid steps; None: nowhere
    )
    shut: Bools | None = None  # (B, B) forbidden branch changes of rapid moves; None: all are permitted

    @property
    def usable(self) -> Bools:
        """(S, R, B) whether any turn is feasible."""
        return compute_any_last(self.feasible)

    def phi_at(self, rotation: NDArray[np.integer[Any]] | None = None) -> Array:
        """Return the rotation in rad: (S, R) of every vertex, or (S,) of one index per station.

        Args:
            rotation: (S,) rotation index at each station; None: all rotations.
        """
        nudge = np.zeros(len(self.q)) if self.nudge is None else self.nudge
        if rotation is None:
            return np.asarray(self.phi[None, :] + nudge[:, None])
        return np.asarray(self.phi[rotation] + nudge)

    def phi_of(self, stations: NDArray[np.integer[Any]], rotation: NDArray[np.integer[Any]]) -> Array:
        """Return the (n,) rotation in rad at some stations.

        Args:
            stations: (n,) station index.
            rotation: (n,) rotation index.
        """
        return np.asarray(self.phi[rotation] + (0.0 if self.nudge is None else self.nudge[stations]))

    def reason_of_rotation(self) -> NDArray[np.uint8]:
        """Return (S, R) OK where any branch is feasible, else the reason of the branch that came furthest."""
        ok = compute_any_last(self.reason == InfeasibilityReason.OK)
        return np.where(
            ok, InfeasibilityReason.OK, np.where(self.reason == InfeasibilityReason.OK, 0, self.reason).max(axis=2)
        ).astype(np.uint8)


def enumerate_candidates(path: PlanningPath, arm: PlanningArm, options: PlanOptions) -> CandidateGrid:
    """Solve the inverse kinematics of every station × rotation and remove what violates limits and margins.

    Args:
        path: planning points.
        arm: arm model.
        options: plan options.
    """
    R = max(round(2 * np.pi / options.rotation_step), 1)
    phi: Array = np.asarray(np.arange(R) * (2 * np.pi / R) - np.pi, float)
    S, B, T = len(path.stations), arm.solver.branches, len(arm.windings)
    q = np.empty((S, R, B, 6))
    reason = np.empty((S, R, B), np.uint8)
    shortfall = np.empty(S)
    nudge = _nudges(path, phi, options)
    still, cosine, sine = _turning_poses(path, arm)

    def block(start: int) -> tuple[NDArray[np.intp], NDArray[np.bool_]]:
        """The turns that occur among ``size`` stations, and which fit where (n, R, B, len)."""
        rows = slice(start, start + size)
        angle = (phi + nudge[rows, None])[..., None, None]
        poses = still[rows] + np.cos(angle) * cosine[rows]
        poses += np.sin(angle) * sine[rows]
        n = len(poses)
        branches = arm.solver.solve_grid(poses, q[rows].reshape(n * R, B, 6))
        shift_angles(arm.origin, branches.q)
        why, fits = check_branches(branches, arm.margins, arm.windings, arm.lower, arm.upper)
        reason[rows] = why.reshape(n, R, B)
        shortfall[rows] = branches.shortfall.reshape(n, R).min(axis=1)
        occur = np.flatnonzero(fits.any(axis=(0, 1)))
        return occur, fits.reshape(n, R, B, T)[..., occur]

    size = max((CHUNK if arm.solver.branch_stable else TRACKED) // R, 1)
    starts = range(0, S, size)
    parts = map_in_threads(block, starts)
    used = np.unique(np.concatenate([[0], *(occur for occur, _ in parts)]))  # at least one turn
    feasible = np.zeros((S, R, B, len(used)), bool)
    for start, (occur, fits) in zip(starts, parts, strict=True):
        feasible[start : start + size][..., np.searchsorted(used, occur)] = fits
    _forbid_by_user(path, phi, options, reason, feasible, nudge, numbered=arm.solver.branch_stable)
    left = np.asarray(feasible.any(axis=(0, 1)).any(axis=0))  # this order is faster than all axes at once
    left[0] = True
    if not left.all():
        used, feasible = used[left], np.ascontiguousarray(feasible[..., left])
    return CandidateGrid(
        phi=phi,
        q=q,
        turns=arm.windings[used],
        reason=reason,
        feasible=feasible,
        stable=arm.solver.branch_stable,
        shortfall=shortfall,
        nudge=nudge,
    )


def _turning_poses(path: PlanningPath, arm: PlanningArm) -> tuple[Array, Array, Array]:
    """(S, 1, 4, 4) each: the flange poses of a station are the first + cos φ · the second + sin φ · the third."""
    phi = np.broadcast_to([0.0, np.pi, 0.5 * np.pi], (len(path.stations), 3))
    there = arm.in_base(path.external[path.stations], compute_tcp_poses(path, path.stations, phi))
    poses = there @ invert_transform(arm.T_flange_tcp)
    ahead, back, across = poses[:, 0:1], poses[:, 1:2], poses[:, 2:3]
    still = 0.5 * (ahead + back)
    return still, 0.5 * (ahead - back), across - still


def _nudges(path: PlanningPath, phi: Array, options: PlanOptions) -> Array:
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
