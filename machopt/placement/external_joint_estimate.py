"""Estimate of a place with free external joints: :mod:`machopt.placement.placement_estimate` over a grid of their
values.

At each station the least cost over rotations and branches is computed for every value e of a grid. Operations that
share a value use the one whose worst station is least, joints that move along the path the best one at each station:

    bound = max over groups of  min over shared values of  max over stations of  min over moving values of  least cost

It holds over the grids of rotations and of e, not between the values of e: a full plan chooses these
more finely (:mod:`machopt.planning.external_axis_optimization.coarse_to_fine_search`) and may be below. For
joints that move along the path the estimate is the bound itself, because no curve between their values is computed
here.
"""

from __future__ import annotations

from collections.abc import Sequence
from itertools import product

import numpy as np
from numpy.typing import NDArray

from machopt.data_types.infeasibility_reasons import InfeasibilityReason
from machopt.data_types.plan_options import PlanOptions
from machopt.numerics.array_types import Array
from machopt.placement.placement_estimate import PlacementEstimate, find_unreachable_reason
from machopt.planning.cost.process_force_direction import compute_sideways_directions
from machopt.planning.cost.stiffness_index import compute_load_directions, score_candidates
from machopt.planning.external_axes.operation_groups import OperationGroup
from machopt.planning.pipeline.planning_setup import PlanningSetup, fix_external_axes
from machopt.planning.sampling.candidate_enumeration import enumerate_candidates
from machopt.planning.sampling.planning_arm import PlanningArm
from machopt.planning.sequence_search.dynamic_programming import choose_sequence
from machopt.planning.stations.path_subset import select_path_runs
from machopt.planning.stations.planning_path import PlanningPath

VALUES_PER_JOINT = {1: 9, 2: 5}  # of each joint, by how many are free; 3 where it is three
MAX_STATIONS = 48  # maximum number of stations of a group; the fewer, the lower the bound
SEQUENCES_TRIED = 3  # values of a group whose best sequence is computed


def estimate_with_external_joints(
    setup: PlanningSetup, arm: PlanningArm, path: PlanningPath, options: PlanOptions, groups: Sequence[OperationGroup]
) -> PlacementEstimate:
    """Return the estimate of a place.

    Args:
        setup: of the cell, for its springs; its arm is that of another place.
        arm: with the workpiece at the place.
        path: as planned, with its stations.
        options: plan options.
        groups: operations that share values.
    """
    found: list[PlacementEstimate] = []
    for group in groups:
        found.append(_estimate_group(setup, arm, select_path_runs(path, group.runs, MAX_STATIONS), options, group))
        if not found[-1].is_reachable:
            return found[-1]
    worst = max(found, key=lambda one: one.bound)
    share = np.array([group.share for group in groups])
    share = share / share.sum() if share.sum() > 0 else np.full(len(groups), 1.0 / len(groups))
    mean = float(share @ [one.mean for one in found])
    return PlacementEstimate(worst.bound, max(one.worst for one in found), mean, worst.point)


def _estimate_group(
    setup: PlanningSetup, arm: PlanningArm, part: PlanningPath, options: PlanOptions, group: OperationGroup
) -> PlacementEstimate:
    values = build_external_joint_grid(group, setup.cell.external_home)
    least, reason = _compute_least_cost(setup, arm, part, options, values)
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
        return PlacementEstimate(
            np.inf, np.inf, np.inf, point(s), InfeasibilityReason(int(reason[of_shared[n], s].max()))
        )
    if not len(counted):
        return PlacementEstimate(0.0, 0.0, 0.0, 0)
    worst = np.where(reached.all(axis=1), best[:, counted].max(axis=1), np.inf)
    n = int(worst.argmin())
    bound, at = float(worst[n]), int(counted[best[n, counted].argmax()])
    if len(values) > len(shared):
        return PlacementEstimate(bound, bound, float(best[n, counted].mean()), point(at))
    order = np.argsort(worst, kind="stable")[:SEQUENCES_TRIED]
    known = [
        _estimate_best_sequence(setup, arm, fix_external_axes(part, values[of_shared[k][0]]), options, counted)
        for k in order
        if np.isfinite(worst[k])
    ]
    return PlacementEstimate(bound, *min(known), point(at))


def _compute_least_cost(
    setup: PlanningSetup, arm: PlanningArm, part: PlanningPath, options: PlanOptions, values: Array
) -> tuple[Array, NDArray[np.int64]]:
    """Return (G, S) the least cost of each station at values (G, E), inf where there is none; and the reason."""
    least = np.full((len(values), len(part.stations)), np.inf)
    reason = np.zeros(least.shape, np.int64)
    across = compute_sideways_directions(part)
    for k, value in enumerate(values):
        there = fix_external_axes(part, value)
        candidates = enumerate_candidates(there, arm, options)
        reason[k] = [int(find_unreachable_reason(candidates, s)) for s in range(len(part.stations))]
        if candidates.feasible.any():
            d = compute_load_directions(there, arm, setup.elasticity, options.force, across)
            cost = score_candidates(there, candidates, setup.elasticity, d, options).cost
            least[k] = np.where(np.isfinite(cost), cost, np.inf).min(axis=(1, 2))
    return least, reason


def _estimate_best_sequence(
    setup: PlanningSetup, arm: PlanningArm, there: PlanningPath, options: PlanOptions, counted: NDArray[np.intp]
) -> tuple[float, float]:
    """Worst and mean index of the grid's best sequence at one value; inf where there is none."""
    candidates = enumerate_candidates(there, arm, options)
    d = compute_load_directions(there, arm, setup.elasticity, options.force)
    scores = score_candidates(there, candidates, setup.elasticity, d, options)
    choice = choose_sequence(there, candidates, scores, setup.cell.limits.velocity[:6], options)
    if choice.broken or choice.dropped.any():
        return np.inf, np.inf
    cost = scores.cost[counted, choice.rotation[counted], choice.branch[counted]]
    return float(cost.max()), float(cost.mean())


def build_external_joint_grid(group: OperationGroup, home: Array) -> Array:
    """Return the (G, E) tried values: home, or the nearest allowed value, and an even grid over the ranges.

    Args:
        group: group of operations.
        home: (E,) m or rad.
    """
    count = VALUES_PER_JOINT.get(int((group.high > group.low).sum()), 3)
    axes = [np.linspace(a, b, count if b > a else 1) for a, b in zip(group.low, group.high, strict=True)]
    return np.unique(np.array([np.clip(home, group.low, group.high), *product(*axes)]), axis=0)
