"""The coarser grids inside a fine one: what they lead to is never lost by refining.

The search over a grid is exact, the smooth curve beside its best sequence is a local optimum: a finer grid's may be a
little worse than a coarser one's. So the best sequence of every grid that is made of each k-th rotation, up to
COARSEST, is smoothed too, and the plan with the least objective is taken. Where there is none up to COARSEST, as in a
grid of 10° or 15°, it is up to ROUGH.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, field, replace

import numpy as np

from machopt.domain.reason import Reason
from machopt.model.threads import cores
from machopt.plan.choice.choose import Choice, choose
from machopt.plan.configurations.candidates import Candidates
from machopt.plan.configurations.realise import Assignment, realise
from machopt.plan.contacts.check import PathCheck
from machopt.plan.cost.score import Scores
from machopt.plan.pipeline.search import Found, Search
from machopt.plan.smoothing.smooth import Smoothed, follow_grid, smooth

COARSEST = np.radians(10.0)  # step of the coarsest grid looked at inside a fine one
ROUGH = np.radians(45.0)  # and inside one without any up to COARSEST
EQUAL = 1e-9  # of the objective: a smaller gain is rounding


def strides(rotations: int) -> list[int]:
    """Every k > 1 for which each k-th of the rotations is a whole grid not coarser than COARSEST, or than ROUGH where
    none is."""
    for coarsest in (COARSEST, ROUGH):
        most = int(coarsest / (2 * np.pi / rotations) + 1e-6)
        found = [k for k in range(2, most + 1) if rotations % k == 0]
        if found:
            return found
    return []


def thinned(candidates: Candidates, scores: Scores, k: int) -> tuple[Candidates, Scores]:
    """Each k-th rotation, on the same scale."""
    feasible = np.ascontiguousarray(candidates.feasible[:, ::k])
    coarse = replace(
        candidates,
        phi=candidates.phi[::k],
        q=np.ascontiguousarray(candidates.q[:, ::k]),
        reason=candidates.reason[:, ::k],
        feasible=feasible,
    )
    crowded = None if scores.crowded is None else np.ascontiguousarray(scores.crowded[:, ::k])
    return coarse, replace(scores, cost=np.ascontiguousarray(scores.cost[:, ::k]), crowded=crowded)


@dataclass
class Coarser:
    """The best sequences of the coarser grids inside a search's grid, made while that is smoothed."""

    search: Search
    made: dict[int, Choice] = field(default_factory=dict)  # stride → choice on what was left of the grid
    left: tuple[int, int] = (-1, -1)  # vertices and wide steps of the grid when they were made

    def choose(self) -> None:
        """All of them, on what is left of the grid now."""
        if self.left != self._left():
            self.made, self.left = {}, self._left()
        for k in self.strides():
            self.of(k)

    def of(self, k: int) -> tuple[Candidates, Scores, Choice]:
        """Each k-th rotation and the best sequence over them."""
        search, wide = self.search, self.search.chooser.wide
        candidates, scores = thinned(search.candidates, search.scores, k)
        if self.left != self._left():  # the grid loses vertices and gains wide steps, never the other way
            self.made, self.left = {}, self._left()
        if k not in self.made:
            self.made[k] = choose(
                search.path, candidates, scores, search.velocity, search.options, None, wide if wide.any() else None
            )
        return candidates, scores, self.made[k]

    def strides(self) -> list[int]:
        """Of the grids to be looked at; none with pins or zones: these are vertices of the fine grid only."""
        options = self.search.options
        return [] if options.fixed or options.steer else strides(len(self.search.candidates.phi))

    def _left(self) -> tuple[int, int]:
        return int(np.count_nonzero(self.search.candidates.feasible)), int(np.count_nonzero(self.search.chooser.wide))


def best_of_nested(
    search: Search, prefer_grid: Callable[[Choice, Assignment, Assignment], bool], total: Callable[[Assignment], float]
) -> Found:
    """What the search finds, or what a coarser grid inside it leads to where that is better and free of contacts.

    Args:
        prefer_grid: as for :meth:`Search.run`.
        total: J of an assignment.
    """
    coarser = Coarser(search)
    if coarser.strides() and cores() > 1:
        search.meanwhile = coarser.choose
    try:
        found = search.run(prefer_grid)
    finally:
        search.meanwhile = None  # else the two hold each other, and tens of MiB of prices with them
    if not found.check.free or found.choice.broken or found.choice.dropped.any() or search.hopeless(found.choice):
        return found
    best = total(found.assignment)
    for k in coarser.strides():
        candidates, scores, choice = coarser.of(k)
        if choice.broken or choice.dropped.any():
            continue
        curve = _realised(search, smooth(search.path, candidates, scores, choice, search.velocity, search.options))
        for source, assignment in (
            ("smooth", curve),
            ("grid", _realised(search, follow_grid(search.path, candidates, choice))),
        ):
            value = total(assignment)
            if value < best * (1 - EQUAL):
                check = _checked(search, assignment)
                if check.free:
                    best, found = value, replace(found, assignment=assignment, check=check, source=source)
    return found


def _realised(search: Search, curve: Smoothed) -> Assignment:
    return realise(search.path, search.checker.arm, search.checker.robot, curve.phi, curve.seed)


def _checked(search: Search, a: Assignment) -> PathCheck:
    """Contacts, and ``lost``: points without a configuration."""
    missing = a.reason != Reason.OK
    check = search.checker.whole(a.phi, np.where(missing[:, None], np.nan, a.q))
    return replace(check, lost=check.lost | missing)
