"""The best sequence that really is free: choose, look, strike out what itself collides, choose again.

::

    choose ─► smooth ─► check ─► free: done
      ▲                   │
      │                   ▼ a contact: less room for the next curve, a few times; then its runs follow the grid
      │                   │ the choice's own vertices or ways collide
      └── certify ◄── choose the stretch again ◄─┴─► look at what lies near the contacts

A vertex (station, rotation, branch) is struck out only for a contact of its own pose, an edge (two vertices of
neighbouring stations) only for a contact or a missing pose on its own way. What is struck out is so for good, and
nothing else ever is: the search ends (each round strikes something out), and a station without vertices, or without
an edge that leads on, is infeasible on this grid.

Only the stretch around a contact is chosen again (:mod:`machopt.planning.sequence_search.incremental_search`), until
what the sequence
takes is free. That loses nothing: then the whole path is chosen once more on what is left of the grid, and the sequence
stays only if it costs no more than the bound of that choice allows,
:data:`machopt.planning.sequence_search.worst_value_constraint.GAP`, which is
what a choice of the whole path claims for itself. Else the whole choice takes its place, and is looked at in turn.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from machopt.data_types.infeasibility_reasons import InfeasibilityReason
from machopt.data_types.plan_options import PlanOptions
from machopt.numerics.array_types import Array
from machopt.numerics.worker_threads import run_two_in_threads
from machopt.planning.collision_handling.exclusions import ExclusionTracker
from machopt.planning.collision_handling.path_check import PathCollisionChecker, PathCollisions
from machopt.planning.cost.stiffness_index import CandidateScores
from machopt.planning.sampling.configurations import CandidateGrid
from machopt.planning.sampling.joint_path import JointAssignment, solve_joint_path
from machopt.planning.sequence_search.dynamic_programming import SequenceChoice
from machopt.planning.sequence_search.forbidden_transitions import ForbiddenTransitions
from machopt.planning.sequence_search.incremental_search import IncrementalSequenceSearch
from machopt.planning.sequence_search.worst_value_constraint import GAP
from machopt.planning.smoothing.rotation_smoothing import SmoothedRotation, follow_grid_rotation, smooth_rotation
from machopt.planning.stations.planning_path import PlanningPath

EVERY = 16  # of the first choice's stations is looked at before anything else
STATIONS = 48  # whose ways are looked at in the first round; twice as many in each next
SMOOTHINGS = 4  # with less room each, before a run that collides follows the grid
MOST_SAVED = 0.04  # of J, by a curve beside a sequence of the grid: twice the most of six jobs with grids of 5° to 15°
ROUNDS = 1000  # each strikes something out, so the search ends by itself; an answer this far away is not waited for


@dataclass(frozen=True, kw_only=True)
class CollisionFreeSequence:
    """What the search came to."""

    assignment: JointAssignment
    source: str  # "smooth", "grid" or "smooth and grid"
    choice: SequenceChoice
    check: PathCollisions
    rounds: int
    pairs: NDArray[np.int32]  # (S, R, B) pair that a vertex was struck out for, −1 else
    banned: dict[int, int]  # station → pair of a way into it that was struck out, −1 where no pose is on it
    edges: ForbiddenTransitions
    wide: NDArray[np.bool_]  # (S,) the rotation may turn there while the feed waits
    looked: NDArray[np.bool_]  # (S, R, B) vertices whose own pose was looked at, but for those struck out ahead


@dataclass(kw_only=True)
class CollisionFreeSearch:
    """One path's search; ``candidates`` lose what collides, in place."""

    path: PlanningPath
    candidates: CandidateGrid
    scores: CandidateScores
    velocity: Array  # (6,) rad/s
    options: PlanOptions
    checker: PathCollisionChecker
    progress: Callable[[str], None] = lambda _: None
    first: SequenceChoice | None = None  # of all the grid, where it was made ahead (:meth:`begin`)
    below: float = np.inf  # J of what there is already: no curve is looked for where that would have to save MOST_SAVED
    meanwhile: Callable[[], None] | None = None  # compiled work to be done beside a smoothing, where a core is idle

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

    def resume(self, found: CollisionFreeSequence) -> None:
        """Begin with what an earlier search over the same candidates found out."""
        struck = self.strikes
        struck.pairs[:], struck.looked[:], self.chooser.wide[:] = found.pairs, found.looked, found.wide
        struck.edges, struck.banned = found.edges, dict(found.banned)

    def begin(self) -> None:
        """Make the first choice, which asks for no contacts: :meth:`run` then begins with it."""
        self.first = self.chooser.whole(self.strikes.edges)

    def run(
        self, prefer_grid: Callable[[SequenceChoice, JointAssignment, JointAssignment], bool]
    ) -> CollisionFreeSequence:
        """Search to the end.

        Args:
            prefer_grid: told the choice, the smooth and the plain assignment, whether the plain one is better.
        """
        budget, smoothings, grid_is_free = STATIONS, 0, False
        choice, self.first = self.first or self._choose(), None
        if self.strikes.chosen(choice, EVERY):  # a curve through contacts is not worth its time
            choice = self._again(choice)
        while True:
            self.rounds += 1
            plain = self._realised(follow_grid_rotation(self.path, self.candidates, choice))
            partial = bool(choice.dropped.any() or choice.broken)
            if partial and (not grid_is_free or not self.options.allow_gaps):
                source, found, check = "grid", plain, self._checked(plain, choice)
                if check.free and self.options.allow_gaps and not choice.dropped.all():
                    grid_is_free = True  # what is left is worth smoothing
                    continue
                if check.free:
                    break
            elif self.hopeless(choice):
                source, found, check = "grid", plain, self._checked(plain, choice)
                if check.free:
                    break
            else:
                source, found = "smooth", self._realised(self._smooth(choice))
                check = self._checked(found, choice)
                if check.free:
                    if prefer_grid(choice, found, plain):
                        grid = self._checked(plain, choice)
                        if grid.free:
                            source, found, check = "grid", plain, grid
                    break
                struck = self.strikes.along(choice, found, check)  # less room for the next curve
                if not self.strikes.chosen(choice) and not self.strikes.gone(choice):
                    grid = self._checked(plain, choice)
                    if grid.free:
                        grid_is_free = True
                        if struck and smoothings < SMOOTHINGS:
                            smoothings += 1
                            continue
                        found, check, source = self._mixed(found, check, plain, grid)
                        break
                    source, found, check = "grid", plain, grid
            if self.rounds >= ROUNDS:
                break
            if source == "grid" and not self.strikes.chosen(choice):
                self.strikes.grid(choice, found, check, budget)
            budget, grid_is_free = 2 * budget, False
            choice = self._again(choice)
        return CollisionFreeSequence(
            assignment=self._without_breaks(found, choice),
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
        """No curve beside a choice comes near to what there is already."""
        return choice.total * (1.0 - MOST_SAVED) > self.below

    def _again(self, choice: SequenceChoice) -> SequenceChoice:
        """A choice in place of one that has lost vertices or ways, with vertices that are free by themselves."""
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

    def _realised(self, smoothed: SmoothedRotation) -> JointAssignment:
        return solve_joint_path(self.path, self.checker.arm, self.checker.robot, smoothed.phi, smoothed.seed)

    def _checked(self, a: JointAssignment, choice: SequenceChoice) -> PathCollisions:
        """Contacts, and ``lost``: what the choice covers but the assignment does not."""
        self.progress("check")
        cuts = tuple(self.path.stations[list(choice.broken)].tolist())
        known = np.where((a.reason == InfeasibilityReason.OK)[:, None], a.q, np.nan)
        found = self.checker.whole(a.phi, known, cuts)
        return replace(
            found, lost=found.lost | find_covered_points(self.path, choice) & (a.reason != InfeasibilityReason.OK)
        )

    def _without_breaks(self, a: JointAssignment, choice: SequenceChoice) -> JointAssignment:
        """Points between the stations on either side of a break belong to neither."""
        lost = np.zeros(len(a.reason), bool)
        for s in choice.broken:
            lost[int(self.path.stations[s - 1]) + 1 : int(self.path.stations[s])] = True
        return (
            replace(a.marked(lost, InfeasibilityReason.NO_PATH), q=np.where(lost[:, None], np.nan, a.q))
            if lost.any()
            else a
        )

    def _mixed(
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
    """(P,) points that the choice covers: between kept stations that are joined, and these themselves."""
    st = path.stations
    out = np.zeros(len(path.index), bool)
    kept = ~choice.dropped
    out[st[kept]] = True
    for s in np.flatnonzero(kept[1:] & kept[:-1]) + 1:
        if path.run[st[s]] == path.run[st[s - 1]] and s not in choice.broken:
            out[st[s - 1] : st[s]] = True
    return out
