"""Coarser grids inside a fine one, so that refining the grid never makes the result worse.

The search over a grid is exact, but the smooth curve near its best sequence is a local optimum. That of a finer grid
may be slightly worse than that of a coarser one. The best sequence of every grid that consists of each k-th rotation,
up to COARSEST, is therefore smoothed too, and the plan with the least objective is selected. Where there is none up to
COARSEST, as in a grid of 10° or 15°, the limit is ROUGH.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, field, replace

import numpy as np

from machopt.data_types.infeasibility_reasons import InfeasibilityReason
from machopt.numerics.parallel_map import count_threads
from machopt.planning.collision_handling.path_check import PathCollisions
from machopt.planning.cost.stiffness_index import CandidateScores
from machopt.planning.pipeline.collision_free_search import CollisionFreeSearch, CollisionFreeSequence
from machopt.planning.sampling.candidate_grid import CandidateGrid
from machopt.planning.sampling.joint_path import JointAssignment, solve_joint_path
from machopt.planning.sequence_search.dynamic_programming import SequenceChoice, choose_sequence
from machopt.planning.smoothing.rotation_smoothing import SmoothedRotation, follow_grid_rotation, smooth_rotation

COARSEST = np.radians(10.0)  # step of the coarsest nested grid
ROUGH = np.radians(45.0)  # the same where none is up to COARSEST
EQUAL = 1e-9  # of the objective: a smaller gain is rounding


def list_nested_strides(rotations: int) -> list[int]:
    """Return every k > 1 for which each k-th rotation is a full grid not coarser than COARSEST, or than ROUGH if none
    is.

    Args:
        rotations: number of rotations of the fine grid.
    """
    for coarsest in (COARSEST, ROUGH):
        most = int(coarsest / (2 * np.pi / rotations) + 1e-6)
        found = [k for k in range(2, most + 1) if rotations % k == 0]
        if found:
            return found
    return []


def thin_grid(candidates: CandidateGrid, scores: CandidateScores, k: int) -> tuple[CandidateGrid, CandidateScores]:
    """Return each k-th rotation, on the same scale; joints and costs are views, because copies would be a third of the
    memory of a long job.

    Args:
        candidates: candidate grid.
        scores: cost of the candidates.
        k: stride.
    """
    coarse = replace(
        candidates,
        phi=candidates.phi[::k],
        q=candidates.q[:, ::k],
        reason=candidates.reason[:, ::k],
        feasible=np.ascontiguousarray(candidates.feasible[:, ::k]),  # the search removes vertices
    )
    crowded, place, late = (
        None if table is None else table[:, ::k] for table in (scores.crowded, scores.place_price, scores.feed_price)
    )
    return coarse, replace(scores, cost=scores.cost[:, ::k], crowded=crowded, place_price=place, feed_price=late)


@dataclass
class NestedGridSearch:
    """Best sequences of the coarser grids inside a search's grid, computed while that is smoothed."""

    search: CollisionFreeSearch
    made: dict[int, SequenceChoice] = field(default_factory=dict)  # stride → choice on the remaining grid
    left: tuple[int, int] = (-1, -1)  # vertices and wide steps of the grid at that time

    def choose(self) -> None:
        """Compute all sequences, on the grid that remains now."""
        if self.left != self._count_left():
            self.made, self.left = {}, self._count_left()
        for k in self.strides():
            self.find_sequence(k)

    def find_sequence(self, k: int) -> tuple[CandidateGrid, CandidateScores, SequenceChoice]:
        """Return each k-th rotation and the best sequence over them.

        Args:
            k: stride.
        """
        search, wide = self.search, self.search.chooser.wide
        candidates, scores = thin_grid(search.candidates, search.scores, k)
        if self.left != self._count_left():  # the grid only loses vertices and gains wide steps
            self.made, self.left = {}, self._count_left()
        if k not in self.made:
            self.made[k] = choose_sequence(
                search.path, candidates, scores, search.velocity, search.options, None, wide if wide.any() else None
            )
        return candidates, scores, self.made[k]

    def strides(self) -> list[int]:
        """Return the strides to examine; none with pins or zones: these are vertices of the fine grid only."""
        options = self.search.options
        return [] if options.fixed or options.steer else list_nested_strides(len(self.search.candidates.phi))

    def _count_left(self) -> tuple[int, int]:
        return int(np.count_nonzero(self.search.candidates.feasible)), int(np.count_nonzero(self.search.chooser.wide))


def choose_best_nested_grid(
    search: CollisionFreeSearch,
    prefer_grid: Callable[[SequenceChoice, JointAssignment, JointAssignment], bool],
    total: Callable[[JointAssignment], float],
) -> CollisionFreeSequence:
    """Return the search result, or the result of a coarser grid inside it where that is better and free of contacts.

    Args:
        search: search on the fine grid.
        prefer_grid: as for :meth:`CollisionFreeSearch.run`.
        total: J of an assignment.
    """
    coarser = NestedGridSearch(search)
    if coarser.strides() and count_threads() > 1:
        search.meanwhile = coarser.choose
    try:
        found = search.run(prefer_grid)
    finally:
        search.meanwhile = None  # breaks a reference cycle that would keep tens of MiB of prices
    if not found.check.free or found.choice.broken or found.choice.dropped.any() or search.hopeless(found.choice):
        return found
    best = total(found.assignment)
    for k in coarser.strides():
        candidates, scores, choice = coarser.find_sequence(k)
        if choice.broken or choice.dropped.any():
            continue
        curve = _compute_assignment(
            search, smooth_rotation(search.path, candidates, scores, choice, search.velocity, search.options)
        )
        for source, assignment in (
            ("smooth", curve),
            ("grid", _compute_assignment(search, follow_grid_rotation(search.path, candidates, choice))),
        ):
            value = total(assignment)
            if value < best * (1 - EQUAL):
                check = _check_assignment(search, assignment)
                if check.free:
                    best, found = value, replace(found, assignment=assignment, check=check, source=source)
    return found


def _compute_assignment(search: CollisionFreeSearch, curve: SmoothedRotation) -> JointAssignment:
    return solve_joint_path(search.path, search.checker.arm, search.checker.robot, curve.phi, curve.seed)


def _check_assignment(search: CollisionFreeSearch, a: JointAssignment) -> PathCollisions:
    """Contacts, and ``lost``: points without a configuration."""
    missing = a.reason != InfeasibilityReason.OK
    check = search.checker.whole(a.phi, np.where(missing[:, None], np.nan, a.q))
    return replace(check, lost=check.lost | missing)
