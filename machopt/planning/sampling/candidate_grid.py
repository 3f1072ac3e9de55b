"""Grid of candidate configurations: every station, rotation, branch and whole turn, with joints and reasons."""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from machopt.data_types.infeasibility_reasons import InfeasibilityReason
from machopt.numerics.array_types import Array, Bools, compute_any_last


@dataclass(frozen=True, kw_only=True)
class CandidateGrid:
    """Candidate configurations with S stations, R rotations, B branches, T turns."""

    phi: Array  # (R,) rad, the grid about the transported reference, full circle
    branch: NDArray[np.intp]  # (B,) number of each branch of this grid among those of the arm
    q: Array  # (S, R, B, 6) rad in [origin, origin + 2π), NaN where the branch does not exist
    turns: Array  # (T, 6) rad, the whole turns that occur; q + turns[t] are the joints of the robot
    reason: NDArray[np.uint8]  # (S, R, B) Reason; OK where at least one turn lies within the limits
    feasible: NDArray[np.bool_]  # (S, R, B, T)
    stable: bool  # the branch index is the same assembly mode at every pose
    shortfall: Array  # (S,) m, least missing reach over the rotations; 0 where some rotation is reached
    nudge: Array | None = (
        None  # (S,) rad, added to phi where the user fixed a rotation between grid steps; None: nowhere
    )
    shut: Bools | None = None  # (A, A) forbidden branch changes of rapid moves, by number; None: all are permitted
    dropped: NDArray[np.uint8] | None = None  # (S, R, D) Reason of the arm's branches that are usable nowhere

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

    def without_joints(self) -> CandidateGrid:
        """Return the grid without its joints, (S, R, B, 0), its largest table, and with one turn for all of them.

        Only the search needs either.
        """
        return replace(self, q=np.empty((*self.q.shape[:3], 0)), feasible=self.usable[..., None])

    def reason_of_rotation(self) -> NDArray[np.uint8]:
        """Return (S, R) OK where any branch is feasible, else the reason of the branch that came furthest."""
        ok = compute_any_last(self.reason == InfeasibilityReason.OK)
        furthest = np.where(self.reason == InfeasibilityReason.OK, 0, self.reason).max(axis=2)
        if self.dropped is not None:
            furthest = np.maximum(furthest, self.dropped.max(axis=2))
        return np.where(ok, InfeasibilityReason.OK, furthest).astype(np.uint8)

    def reasons_at(self, station: int) -> NDArray[np.uint8]:
        """Return (R, A) the reasons of all branches of the arm at a station, the branches in no particular order.

        Args:
            station: station index.
        """
        own = self.reason[station]
        return own if self.dropped is None else np.concatenate([own, self.dropped[station]], axis=-1)

    def is_out_of_reach(self) -> Bools:
        """Return (S,) whether no branch of the arm reaches the station at any rotation."""
        out = np.asarray((self.reason == InfeasibilityReason.UNREACHABLE).all(axis=(1, 2)))
        if self.dropped is not None:
            out &= (self.dropped == InfeasibilityReason.UNREACHABLE).all(axis=(1, 2))
        return out

    def expand_branches(self, numbers: NDArray[np.intp]) -> CandidateGrid:
        """Return the grid with further branches of the arm, none of which is usable.

        Args:
            numbers: (B',) ascending branch numbers, which include those of the grid.
        """
        if np.array_equal(numbers, self.branch):
            return self
        to = np.searchsorted(numbers, self.branch)
        reason = np.full((*self.reason.shape[:2], len(numbers)), InfeasibilityReason.UNREACHABLE, np.uint8)
        reason[..., to] = self.reason
        if self.dropped is not None:
            reason[..., np.setdiff1d(np.arange(len(numbers)), to)] = self.dropped.max(axis=2, keepdims=True)
        return replace(
            self,
            branch=numbers,
            q=spread_branches(self.q, to, len(numbers), np.nan, axis=2),
            reason=reason,
            feasible=spread_branches(self.feasible, to, len(numbers), False, axis=2),
        )


def spread_branches(table: Any, to: NDArray[np.intp], count: int, fill: Any, axis: int) -> Any:
    """Return a table with more branches: those of ``table`` at the places ``to``, ``fill`` elsewhere.

    Args:
        table: array with branches along ``axis``.
        to: (B,) place of each branch of the table.
        count: branches of the result.
        fill: value of the other branches.
        axis: axis of the branches.
    """
    out = np.full((*table.shape[:axis], count, *table.shape[axis + 1 :]), fill, table.dtype)
    out[(slice(None),) * axis + (to,)] = table
    return out
