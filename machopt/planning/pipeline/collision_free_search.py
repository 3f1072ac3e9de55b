"""Search for the best collision-free sequence: choose, check, exclude what collides, choose again.

::

    choose ─► smooth ─► check ─► free: done
      ▲                   │
      │                   ▼ a contact: narrower corridor for the next curve, a few times; then its runs follow the grid
      │                   │ the sequence's own vertices or edges collide
      └── certify ◄── choose the stretch again ◄─┴─► check the neighbours of the contacts

A vertex (station, rotation, branch) is excluded only for a contact of its own pose. An edge (two vertices of
neighbouring stations) is excluded only for a contact or a missing pose between its ends. Exclusions are permanent, and
nothing else is excluded. The search therefore ends (each round excludes something). A station without vertices, or
without a feasible edge, is infeasible on this grid.

Only the stretch around a contact is chosen again (:mod:`machopt.planning.sequence_search.local_replanning`), until
the sequence is free. This loses nothing: afterwards the whole path is chosen once more on the remaining grid. The
sequence is kept only if it is within :data:`machopt.planning.sequence_search.worst_value_constraint.GAP` of the bound
of that choice, the accuracy of a choice of the whole path. Otherwise the whole choice replaces it and is checked.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from machopt.data_types.infeasibility_reasons import InfeasibilityReason
from machopt.data_types.plan_options import PlanOptions
from machopt.numerics.array_types import Array
from machopt.numerics.parallel_map import run_two_in_threads
from machopt.planning.collision_handling.exclusions import ExclusionTracker
from machopt.planning.collision_handling.path_check import PathCollisionChecker, PathCollisions
from machopt.planning.cost.stiffness_index import CandidateScores
from machopt.planning.sampling.candidate_grid import CandidateGrid
from machopt.planning.sampling.joint_path import JointAssignment, solve_joint_path
from machopt.planning.sequence_search.dynamic_programming import SequenceChoice
from machopt.planning.sequence_search.forbidden_transitions import ForbiddenTransitions
from machopt.planning.sequence_search.local_replanning import IncrementalSequenceSearch
from machopt.planning.sequence_search.worst_value_constraint import GAP
from machopt.planning.smoothing.rotation_smoothing import SmoothedRotation, follow_grid_rotation, smooth_rotation
from machopt.planning.stations.planning_path import PlanningPath

EVERY = 16  # every n-th station of the first choice is checked first
STATIONS = 48  # number of stations whose edges are checked in the first round; doubled in each next round
SMOOTHINGS = 4  # attempts with a narrower corridor each, before a colliding run follows the grid
MOST_SAVED = (
    0.04  # share of J that a curve saves against its grid sequence: twice the maximum of six jobs with 5° to 15° grids
)
ROUNDS = 1000  # each round excludes something, so the search ends by itself; this limits its duration


@dataclass(frozen=True, kw_only=True)
class CollisionFreeSequence:
    """Result of the search."""

    assignment: JointAssignment
    source: str  # "smooth", "grid" or "smooth and grid"
    choice: SequenceChoice
    check: PathCollisions
    rounds: int
    pairs: NDArray[np.int32]  # (S, R, B) pair for which a vertex was excluded, else −1
    banned: dict[int, int]  # station → pair of an excluded edge into it, −1 where it contains no valid pose
    edges: ForbiddenTransitions
    wide: NDArray[np.bool_]  # (S,) the rotation may change there at reduced feed
    looked: NDArray[np.bool_]  # (S, R, B) vertices whose own pose was checked, except those excluded by the look-ahead


@dataclass(kw_only=True)
class CollisionFreeSearch:
    """Search of one path; ``candidates`` loses what collides, in place."""

    path: PlanningPath
    candidates: CandidateGrid
    scores: CandidateScores
    velocity: Array  # (6,) rad/s
    options: PlanOptions
    checker: PathCollisionChecker
    progress: Callable[[str], None] = lambda _: None
    first: SequenceChoice | None = None  # first choice of the full grid, if made in advance (:meth:`begin`)
    below: float = np.inf  # J of a known plan: no curve is computed if it would have to save MOST_SAVED
    meanwhile: Callable[[], None] | None = None  # compiled work that runs during a smoothing, where a core is idle

    def __post_init__(self) -> None:
        self.rounds = 0
        self.strikes = ExclusionTracker(
            path=self.path, candidates=self.candidates, checker=self.checker, progress=self.progress
        )
        self.chooser = IncrementalSequenceSearch(
            path=self.path,
            candidates=self.candidates,
            scores=self.scores,
            velocity=self.velocity,
            options=self.options,
            wide=np.zeros(len(self.candidates.feasible), bool),
        )

    def resume(self, sequence: CollisionFreeSequence) -> None:
        """Start with the exclusions of an earlier search over the same candidates.

        Args:
            sequence: result of the earlier search.
        """
        exclusions = self.strikes
        exclusions.pairs[:], exclusions.looked[:], self.chooser.wide[:] = sequence.pairs, sequence.looked, sequence.wide
        exclusions.edges, exclusions.banned = sequence.edges, dict(sequence.banned)

    def begin(self) -> None:
        """Make the first choice, which needs no contact checks; :meth:`run` then starts with it."""
        self.first = self.chooser.whole(self.strikes.edges)

    def run(
        self, prefer_grid: Callable[[SequenceChoice, JointAssignment, JointAssignment], bool]
    ) -> CollisionFreeSequence:
        """Search to the end.

        Args:
            prefer_grid: called with the choice, the smooth and the plain assignment; returns whether the plain one is
                better.
        """
        budget, smoothings, grid_is_free = STATIONS, 0, False
        choice, self.first = self.first or self._choose(), None
        if self.strikes.chosen(choice, EVERY):  # a curve through contacts is not computed
            choice = self._choose_again(choice)
        while True:
            self.rounds += 1
            plain = self._compute_assignment(follow_grid_rotation(self.path, self.candidates, choice))
            partial = bool(choice.dropped.any() or choice.broken)
            if partial and (not grid_is_free or not self.options.allow_gaps):
                source, found, check = "grid", plain, self._check_assignment(plain, choice)
                if check.free and self.options.allow_gaps and not choice.dropped.all():
                    grid_is_free = True  # the remaining grid is smoothed
                    continue
                if check.free:
                    break
            elif self.hopeless(choice):
                source, found, check = "grid", plain, self._check_assignment(plain, choice)
                if check.free:
                    break
            else:
                source, found = "smooth", self._compute_assignment(self._smooth(choice))
                check = self._check_assignment(found, choice)
                if check.free:
                    if prefer_grid(choice, found, plain):
                        grid = self._check_assignment(plain, choice)
                        if grid.free:
                            source, found, check = "grid", plain, grid
                    break
                excluded = self.strikes.along(choice, found, check)  # narrower corridor for the next curve
                if not self.strikes.chosen(choice) and not self.strikes.gone(choice):
                    grid = self._check_assignment(plain, choice)
                    if grid.free:
                        grid_is_free = True
                        if excluded and smoothings < SMOOTHINGS:
                            smoothings += 1
                            continue
                        found, check, source = self._mix_curve_and_grid(found, check, plain, grid)
                        break
                    source, found, check = "grid", plain, grid
            if self.rounds >= ROUNDS:
                break
            if source == "grid" and not self.strikes.chosen(choice):
                self.strikes.grid(choice, found, check, budget)
            budget, grid_is_free = 2 * budget, False
            choice = self._choose_again(choice)
        return self._build_result(self._remove_breaks(found, choice), source, choice, check)

    def _build_result(
        self, assignment: JointAssignment, source: str, choice: SequenceChoice, check: PathCollisions
    ) -> CollisionFreeSequence:
        """Return the result with the exclusions so far."""
        return CollisionFreeSequence(
            assignment=assignment,
            source=source,
            choice=choice,
            check=check,
            rounds=self.rounds,
            pairs=self.strikes.pairs,
            banned=self.strikes.banned,
            edges=self.strikes.edges,
            wide=self.chooser.wide,
            looked=self.strikes.looked,
        )

    def hopeless(self, choice: SequenceChoice) -> bool:
        """Return whether no curve near a choice can be better than the known plan.

        Args:
            choice: sequence of the grid.
        """
        return choice.total * (1.0 - MOST_SAVED) > self.below

    def _choose_again(self, choice: SequenceChoice) -> SequenceChoice:
        """Return a new choice in place of one that has lost vertices or edges, with vertices that are free by
        themselves.
        """
        while self.rounds < ROUNDS:
            local = self.chooser.around(choice, self.strikes.edges)
            if local is None:
                choice = self._choose()
                if not self.strikes.chosen(choice):
                    return choice
            else:
                choice = local
                if not self.strikes.chosen(choice):
                    whole = self._choose()
                    if choice.total * (1.0 - GAP) <= whole.bound * (1.0 + 1e-12):
                        return replace(choice, bound=min(choice.total, whole.bound), reached=whole.reached)
                    choice = whole
                    if not self.strikes.chosen(choice):
                        return choice
            self.rounds += 1
        return self._choose()

    def _choose(self) -> SequenceChoice:
        self.progress("choose")
        return self.chooser.whole(self.strikes.edges)

    def _smooth(self, choice: SequenceChoice) -> SmoothedRotation:
        self.progress("smooth")

        def curve() -> SmoothedRotation:
            return smooth_rotation(self.path, self.candidates, self.scores, choice, self.velocity, self.options)

        return curve() if self.meanwhile is None else run_two_in_threads(curve, self.meanwhile)[0]

    def _compute_assignment(self, smoothed: SmoothedRotation) -> JointAssignment:
        return solve_joint_path(self.path, self.checker.arm, self.checker.robot, smoothed.phi, smoothed.seed)

    def _check_assignment(self, a: JointAssignment, choice: SequenceChoice) -> PathCollisions:
        """Return the contacts, and ``lost``: points covered by the choice but not by the assignment."""
        self.progress("check")
        cuts = tuple(self.path.stations[list(choice.broken)].tolist())
        known = np.where((a.reason == InfeasibilityReason.OK)[:, None], a.q, np.nan)
        found = self.checker.whole(a.phi, known, cuts)
        return replace(
            found, lost=found.lost | find_covered_points(self.path, choice) & (a.reason != InfeasibilityReason.OK)
        )

    def _remove_breaks(self, a: JointAssignment, choice: SequenceChoice) -> JointAssignment:
        """Remove the points between the stations on either side of a break, which belong to neither."""
        lost = np.zeros(len(a.reason), bool)
        for s in choice.broken:
            lost[int(self.path.stations[s - 1]) + 1 : int(self.path.stations[s])] = True
        return (
            replace(a.marked(lost, InfeasibilityReason.NO_PATH), q=np.where(lost[:, None], np.nan, a.q))
            if lost.any()
            else a
        )

    def _mix_curve_and_grid(
        self, curve: JointAssignment, check: PathCollisions, plain: JointAssignment, grid: PathCollisions
    ) -> tuple[JointAssignment, PathCollisions, str]:
        """The smooth curve, and the grid's sequence in the runs where that collides."""
        bad = np.unique(self.path.run[check.hit | check.lost])
        take = np.isin(self.path.run, bad)
        if take.all():
            return plain, grid, "grid"

        mixed = JointAssignment(
            **{
                name: np.where(take.reshape(-1, *(1,) * (values.ndim - 1)), values, getattr(curve, name))
                for name, values in vars(plain).items()
            }
        )
        checked = PathCollisions(
            np.where(take, grid.hit, check.hit),
            np.where(take, grid.pair, check.pair).astype(np.int32),
            np.where(take, grid.lost, check.lost),
        )
        return mixed, checked, "smooth and grid"


def find_covered_points(path: PlanningPath, choice: SequenceChoice) -> NDArray[np.bool_]:
    """Return (P,) points that the choice covers: kept stations and the points between joined ones.

    Args:
        path: planning points.
        choice: sequence of the grid.
    """
    st = path.stations
    out = np.zeros(len(path.index), bool)
    has_vertex = ~choice.dropped
    out[st[has_vertex]] = True
    for s in np.flatnonzero(has_vertex[1:] & has_vertex[:-1]) + 1:
        if path.run[st[s]] == path.run[st[s - 1]] and s not in choice.broken:
            out[st[s - 1] : st[s]] = True
    return out
