"""The coarser grids inside a fine one: what they lead to is never lost by refining.

The search over a grid is exact, the smooth curve beside its best sequence is a local optimum: a finer grid's may be a
little worse than a coarser one's. So the best sequence of every grid that is made of each k-th rotation, up to
COARSEST, is smoothed too, and the plan with the least objective is taken.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace

import numpy as np

from machopt.domain.reason import Reason
from machopt.plan.candidates import Candidates
from machopt.plan.check import PathCheck
from machopt.plan.choose import choose
from machopt.plan.realise import Assignment, realise
from machopt.plan.score import Scores
from machopt.plan.search import Found, Search
from machopt.plan.smooth import Smoothed, follow_grid, smooth

COARSEST = np.radians(10.0)  # step of the coarsest grid looked at
EQUAL = 1e-9  # of the objective: a smaller gain is rounding


def strides(rotations: int) -> list[int]:
    """Every k > 1 for which each k-th of the rotations is a whole grid not coarser than COARSEST."""
    most = int(COARSEST / (2 * np.pi / rotations) + 1e-6)
    return [k for k in range(2, most + 1) if rotations % k == 0]


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


def best_of_nested(search: Search, found: Found, total: Callable[[Assignment], float]) -> Found:
    """What the search found, or what a coarser grid inside it leads to where that is better and free of contacts.

    Args:
        total: J of an assignment.
    """
    pinned = search.options.fixed or search.options.steer  # vertices, and ends of zones, of the fine grid only
    if not found.check.free or found.choice.broken or found.choice.dropped.any() or pinned:
        return found
    best = total(found.assignment)
    for k in strides(len(search.candidates.phi)):
        candidates, scores = thinned(search.candidates, search.scores, k)
        wide = found.wide if found.wide.any() else None
        choice = choose(search.path, candidates, scores, search.velocity, search.options, None, wide)
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
