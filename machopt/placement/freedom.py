"""What a place promises where external joints may choose: :mod:`machopt.placement.outlook` over a grid of their values.

At each station the least cost over rotations and branches is taken for every value e of a grid. Operations that share a
value take the one whose worst station is least, joints that move along the path the best one at each station:

    bound = max over groups of  min over shared values of  max over stations of  min over moving values of  least cost

It holds over the grids of rotations and of e, not over what lies between the values of e: a whole plan chooses these
more finely (:mod:`machopt.plan.best.external`) and may come out below. What joints that move along come to is the bound
itself, as the way between their values is not looked for here.
"""

from __future__ import annotations

from collections.abc import Sequence
from itertools import product

import numpy as np
from numpy.typing import NDArray

from machopt.arrays import Array
from machopt.domain.options import PlanOptions
from machopt.domain.reason import Reason
from machopt.placement.outlook import Outlook, furthest
from machopt.plan.choice.choose import choose
from machopt.plan.configurations.candidates import PlanningArm, enumerate_candidates
from machopt.plan.cost.engagement import sideways
from machopt.plan.cost.score import directions, score_candidates
from machopt.plan.external.groups import Group
from machopt.plan.pipeline.setup import Setup, standing
from machopt.plan.stations.path import Path
from machopt.plan.stations.subpath import part_of

VALUES = {1: 9, 2: 5}  # of each joint, by how many are free; 3 where it is three
STATIONS = 48  # of a group that are looked at; the fewer, the lower the bound
TRIED = 3  # values of a group whose best sequence is looked for


def free_outlook(setup: Setup, arm: PlanningArm, path: Path, options: PlanOptions, groups: Sequence[Group]) -> Outlook:
    """Look at a place.

    Args:
        setup: of the cell, for its springs; its arm is that of another place.
        arm: with the workpiece at the place.
        path: as planned, with its stations.
        groups: operations that share values.
    """
    found: list[Outlook] = []
    for group in groups:
        found.append(_of_group(setup, arm, part_of(path, group.runs, STATIONS), options, group))
        if not found[-1].reached:
            return found[-1]
    worst = max(found, key=lambda one: one.bound)
    share = np.array([group.share for group in groups])
    share = share / share.sum() if share.sum() > 0 else np.full(len(groups), 1.0 / len(groups))
    mean = float(share @ [one.mean for one in found])
    return Outlook(worst.bound, max(one.worst for one in found), mean, worst.point)


def _of_group(setup: Setup, arm: PlanningArm, part: Path, options: PlanOptions, group: Group) -> Outlook:
    values = grid_of(group, setup.cell.external_home)
    least, reason = _least(setup, arm, part, options, values)
    shared, which = np.unique(values[:, ~group.moving], axis=0, return_inverse=True)
    of_shared = [np.flatnonzero(which.reshape(-1) == n) for n in range(len(shared))]
    best = np.stack([least[rows].min(axis=0) for rows in of_shared])  # (K, S)
    reached = np.isfinite(best) | ~part.may_touch[part.stations]
    counted = np.flatnonzero(part.counted[part.stations])

    def point(s: int) -> int:
        return round(float(part.index[part.stations[s]]))

    if not reached.all(axis=1).any():
        n = int(reached.sum(axis=1).argmax())
        s = int(reached[n].argmin())
        return Outlook(np.inf, np.inf, np.inf, point(s), Reason(int(reason[of_shared[n], s].max())))
    if not len(counted):
        return Outlook(0.0, 0.0, 0.0, 0)
    worst = np.where(reached.all(axis=1), best[:, counted].max(axis=1), np.inf)
    n = int(worst.argmin())
    bound, at = float(worst[n]), int(counted[best[n, counted].argmax()])
    if len(values) > len(shared):
        return Outlook(bound, bound, float(best[n, counted].mean()), point(at))
    order = np.argsort(worst, kind="stable")[:TRIED]
    known = [
        _in_sequence(setup, arm, standing(part, values[of_shared[k][0]]), options, counted)
        for k in order
        if np.isfinite(worst[k])
    ]
    return Outlook(bound, *min(known), point(at))


def _least(
    setup: Setup, arm: PlanningArm, part: Path, options: PlanOptions, values: Array
) -> tuple[Array, NDArray[np.int64]]:
    """(G, S) the least cost of each station at values (G, E), inf where there is none; and why."""
    least = np.full((len(values), len(part.stations)), np.inf)
    reason = np.zeros(least.shape, np.int64)
    across = sideways(part)
    for k, value in enumerate(values):
        there = standing(part, value)
        candidates = enumerate_candidates(there, arm, options)
        reason[k] = [int(furthest(candidates, s)) for s in range(len(part.stations))]
        if candidates.feasible.any():
            d = directions(there, arm, setup.elasticity, options.force, across)
            cost = score_candidates(there, candidates, setup.elasticity, d, options).cost
            least[k] = np.where(np.isfinite(cost), cost, np.inf).min(axis=(1, 2))
    return least, reason


def _in_sequence(
    setup: Setup, arm: PlanningArm, there: Path, options: PlanOptions, counted: NDArray[np.intp]
) -> tuple[float, float]:
    """Worst and mean index of the grid's best sequence at one value; inf where there is none."""
    candidates = enumerate_candidates(there, arm, options)
    d = directions(there, arm, setup.elasticity, options.force)
    scores = score_candidates(there, candidates, setup.elasticity, d, options)
    choice = choose(there, candidates, scores, setup.cell.limits.velocity[:6], options)
    if choice.broken or choice.dropped.any():
        return np.inf, np.inf
    cost = scores.cost[counted, choice.rotation[counted], choice.branch[counted]]
    return float(cost.max()), float(cost.mean())


def grid_of(group: Group, home: Array) -> Array:
    """(G, E) the values that are tried: home, or what is nearest to it, and an even grid over the ranges."""
    count = VALUES.get(int((group.high > group.low).sum()), 3)
    axes = [np.linspace(a, b, count if b > a else 1) for a, b in zip(group.low, group.high, strict=True)]
    return np.unique(np.array([np.clip(home, group.low, group.high), *product(*axes)]), axis=0)
