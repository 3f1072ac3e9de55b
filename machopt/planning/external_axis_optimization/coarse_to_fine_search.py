"""Optimisation of the external joints: starts of a coarse search, refined, then planned on a finer rotation grid.

The starts (:mod:`machopt.planning.external_axis_optimization.refinement_starts`) are refined and improved by better
sequences (:mod:`~machopt.planning.external_axis_optimization.refinement_restarts`). The results are ranked. The best
one that can be driven is planned in full once more, with the rotation grid of the options.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace

import numpy as np

from machopt.data_types.cell import Cell
from machopt.data_types.plan_options import ExternalJointOptions, PlanOptions
from machopt.data_types.steering_rules import list_constrained_points, resolve_steering
from machopt.data_types.toolpath import Toolpath
from machopt.planning.continuous_refinement.plan_improvement import (
    GAINS,
    PASSES,
    RefinementJob,
    is_drivable,
    plan_on_other_grid,
    refine_plan,
)
from machopt.planning.continuous_refinement.refinement import TRUST
from machopt.planning.external_axes.axis_modes import resolve_axis_options
from machopt.planning.external_axes.fixed_value_search import STEP
from machopt.planning.external_axes.operation_groups import build_operation_groups
from machopt.planning.external_axes.plan_ranking import AxisPlanRanking
from machopt.planning.external_axes.position_constraints import check_known_axes_and_places
from machopt.planning.external_axis_optimization.refinement_restarts import (
    SHORT,
    count_lost_points,
    has_stalled,
    leap_to_better_sequences,
    refine_other_starts,
)
from machopt.planning.external_axis_optimization.refinement_starts import (
    Key,
    SearchRequest,
    are_locked,
    find_refinement_starts,
)
from machopt.planning.pipeline.plan_data_types import Plan
from machopt.planning.pipeline.planning_setup import PlanningSetup, StageTimings
from machopt.planning.stations.planning_path import build_planning_path

AS_GOOD = 1.15  # times the best ranking value: threshold for a second refinement of fixed joints
FIXED_NEAR = 1.05  # times the best J: threshold for improving the best fixed plan by sequences
TRUSTS = TRUST, np.radians(25.0)  # rad, trust regions: each leads to another local optimum, the best is selected
FAR = (np.radians(40.0),)  # the same for long paths, which are refined once to save time
ONCE = 1  # passes of a long path before improvement by a sequence, which replaces the other passes


def find_best_external_axis_plan(
    cell: Cell,
    toolpath: Toolpath,
    options: PlanOptions,
    timings: StageTimings | None = None,
    before: Plan | None = None,
    *,
    scale: float | None = None,
) -> Plan:
    """Plan one toolpath in a cell with external joints.

    See :func:`machopt.planning.external_axis_optimization.single_toolpath_planning.find_best_plan`.

    Args:
        cell: robot cell with external joints.
        toolpath: toolpath of one tool.
        options: plan options.
        timings: receives the duration of the stages.
        before: a plan that differs only in the user's requests.
        scale: c₀ of a plan that this one belongs to; None: of its own.
    """
    clock = timings or StageTimings()
    axes = resolve_axis_options(cell, options)
    check_known_axes_and_places(cell, options.steer)
    request = SearchRequest(
        cell=cell, toolpath=toolpath, options=options, axes=axes, clock=clock, before=before, scale=scale
    )
    if not options.is_searched or options.rotation_step >= STEP or _has_fixed_joints(request):
        return _search_refined(request)
    coarse = replace(request, options=replace(options, rotation_step=STEP), is_coarse=True)
    whole: list[Plan] = []
    for one in _rank_refined_plans(coarse).plans:
        whole = _complete_plan(one, request)
        if count_lost_points(whole[0]):
            break
        for finer in whole:
            if is_drivable(finer, toolpath, clock):
                return finer
    if not count_lost_points(whole[0]):
        return whole[0]
    # Where few rotations are feasible, a finer grid may find some that the coarse one misses.
    other = _search_refined(request)
    return min(whole[0], other, key=_build_ranking_key(whole[0].setup, axes))


def _complete_plan(plan: Plan, request: SearchRequest) -> list[Plan]:
    """Return the plans that follow from a refined one on the rotation grid of the request, best first.

    Where the search finds a much better rotation, it is refined again, and better sequences around it are searched.
    """
    groups = build_operation_groups(request.cell, request.toolpath, plan.path, request.axes, plan.options.steer)
    ranking = AxisPlanRanking.build(plan.setup, request.axes)
    job = RefinementJob(
        toolpath=request.toolpath, groups=groups, worth=ranking, clock=request.clock, before=request.before
    )
    step = request.options.rotation_step
    best, *own = plan_on_other_grid(plan, step, job)
    gained = ranking.plan(own[0]) - ranking.plan(best) if own else np.inf
    if count_lost_points(best) or best.over_external is not None or gained < GAINS * best.chosen.objective.total:
        return [best, *own]
    further = refine_plan(best, job)
    if further is not best:
        best, *own = plan_on_other_grid(further, step, job)
    led = leap_to_better_sequences(best, job)
    key = _build_ranking_key(plan.setup, request.axes)
    better = sorted((min(plan_on_other_grid(one, step, job), key=key) for one in led[1:]), key=key)
    return [*better, led[0], *own]


@dataclass(frozen=True)
class _RankedPlans:
    """Refined plans, best first; the last one is the plan that the refinement began with."""

    plans: list[Plan]
    complete: tuple[Plan, ...]  # those that were planned in full


def _search_refined(request: SearchRequest) -> Plan:
    """Return the best plan on one grid of rotations."""
    ranked = _rank_refined_plans(request)
    first = ranked.plans[-1]
    key = _build_ranking_key(first.setup, request.axes)
    for one in ranked.plans[:-1]:
        is_complete = any(one.chosen is known.chosen for known in ranked.complete)
        for whole in [one] if is_complete else _complete_plan(one, request):
            if key(whole) < key(first) and is_drivable(whole, request.toolpath, request.clock):
                return whole
    return first


def _rank_refined_plans(request: SearchRequest) -> _RankedPlans:
    """Return the refined plans of one grid of rotations."""
    toolpath, clock, before = request.toolpath, request.clock, request.before
    starts = find_refinement_starts(request)
    found = starts.best
    groups = build_operation_groups(request.cell, toolpath, found.path, request.axes, found.options.steer)
    if are_locked(groups):
        return _RankedPlans([found], (found,))
    worth, key = AxisPlanRanking.build(found.setup, request.axes), _build_ranking_key(found.setup, request.axes)
    # The best fixed plan is a local optimum of its own, so that the moving plan is never worse.
    job = RefinementJob(toolpath=toolpath, groups=groups, worth=worth, clock=clock, before=before)
    still = replace(job, groups=[replace(g, moving=np.zeros_like(g.moving)) for g in groups])
    best, rivals, every = found, list(starts.fixed), list[Plan]()
    fixed_plan: Plan | None = None
    long = len(found.path.index) > SHORT
    passes = ONCE if long and not (found.options.fixed or found.options.steer) else PASSES
    for trust in FAR if long else TRUSTS:
        every.append(refine_plan(found, job, worth.plan(best), trust, passes=passes))
        best = min(best, every[-1], key=key)
        near = []
        for other in rivals:
            every.append(refine_plan(other, still, AS_GOOD * worth.plan(best), trust))
            if worth.plan(every[-1]) < AS_GOOD * worth.plan(best):
                near.append(other)
                fixed_plan = every[-1] if fixed_plan is None else min(fixed_plan, every[-1], key=key)
            best = min(best, every[-1], key=key)
        rivals = near
    led = leap_to_better_sequences(best, job)
    if passes < PASSES and len(led) == 1:  # no sequence improved the plan, so the remaining passes are still to be done
        further = refine_plan(best, job, trust=FAR[0])
        if further is not best:
            led += [further] if request.is_coarse else leap_to_better_sequences(further, job)
    every += led
    if not long and has_stalled(led[-1]):
        other_starts = [start for start in (*starts.fixed, *starts.others) if start is not found]
        every += refine_other_starts(sorted(other_starts, key=worth.plan), job, TRUSTS[0])
    if fixed_plan is not None and worth.plan(fixed_plan) <= FIXED_NEAR * worth.plan(min(every, key=key)):
        every += [replace(p, over_external=None) for p in leap_to_better_sequences(fixed_plan, still)]
    every.sort(key=lambda one: (key(one), one.over_external is None))
    ahead = [one for one in every if key(one) < key(found)]
    last = next((one for one in every if one.chosen is found.chosen), found)
    return _RankedPlans([*ahead, last], (found, *starts.fixed, *starts.others))


def _has_fixed_joints(request: SearchRequest) -> bool:
    options = resolve_steering(request.options, request.toolpath)
    path = build_planning_path(request.toolpath, list_constrained_points(options))
    return are_locked(build_operation_groups(request.cell, request.toolpath, path, request.axes, options.steer))


def _build_ranking_key(setup: PlanningSetup, axes: Sequence[ExternalJointOptions]) -> Callable[[Plan], Key]:
    worth = AxisPlanRanking.build(setup, axes)
    return lambda one: (count_lost_points(one), worth.plan(one))
