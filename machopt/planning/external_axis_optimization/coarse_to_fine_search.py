"""Coarse-to-fine search for the external joints: at home, at one value per operation, or moving along the path.

The joint values must be the same over a run, so operations that share a run share a value. For each such group a grid
of values covers the ranges of its joints, first coarse and then finer around the best. Each value is assessed at some
stations (:mod:`machopt.planning.external_axes.fixed_value_search`), where the best sequence has the mean m, the worst w
and motion. c₀, the unit of the index, is the median over the candidates of all values. The best few are then planned in
full (:func:`machopt.planning.pipeline.path_planner.plan_path`), with home among them, and the best plan is selected:
fewest points lost, then least J. Joints that may move along the path are first kept at such values too, where any
reaches all of it. The curve of :mod:`machopt.planning.external_axes.moving_axis_search`, of all of them or of some, is
planned in full as well, and never selected where it is worse.

    J = Σ share·(m + motion) + w_worst·max w + Σ price·|Δe|
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace

import numpy as np

from machopt.data_types.cell import Cell
from machopt.data_types.plan_options import ExternalJointOptions, PlanOptions
from machopt.data_types.steering_rules import list_constrained_points, resolve_steering
from machopt.data_types.toolpath import Toolpath
from machopt.numerics.array_types import Array
from machopt.planning.continuous_refinement.plan_improvement import (
    PASSES,
    RefinementJob,
    is_drivable,
    plan_on_other_grid,
    refine_plan,
)
from machopt.planning.continuous_refinement.refinement import TRUST
from machopt.planning.external_axes.axis_modes import resolve_axis_options
from machopt.planning.external_axes.fixed_value_search import STEP, FixedValueSearch
from machopt.planning.external_axes.moving_axes import (
    compute_moving_axis_path,
    list_moving_subsets,
    list_partly_fixed_groups,
)
from machopt.planning.external_axes.moving_axis_search import AxisCurveSearch
from machopt.planning.external_axes.operation_groups import OperationGroup, build_operation_groups
from machopt.planning.external_axes.plan_ranking import AxisPlanRanking
from machopt.planning.external_axes.position_constraints import check_known_axes_and_places
from machopt.planning.external_axes.positioner_azimuth_following import list_following_paths
from machopt.planning.external_axis_optimization.refinement_restarts import (
    SHORT,
    count_lost_points,
    count_unreached_points,
    has_stalled,
    leap_to_better_sequences,
    refine_other_starts,
)
from machopt.planning.motion.trajectory_builder import has_motion
from machopt.planning.pipeline.path_planner import PathVariant, plan_path
from machopt.planning.pipeline.plan_data_types import Plan
from machopt.planning.pipeline.planning_setup import PlanningSetup, StageTimings, prepare_planning
from machopt.planning.stations.path_subset import list_run_points
from machopt.planning.stations.planning_path import PlanningPath, build_planning_path

PLANNED = 3  # values planned in full where all can be driven
TRIED = 8  # where the first ones cannot
AS_GOOD = 1.15  # times the best estimate: threshold for planning home in full, and for a second refinement
FIXED_NEAR = 1.05  # times the best J: threshold for improving the best fixed plan by sequences
MOVES_TRIED = 3  # the same where the joints may move along the path
TRUSTS = TRUST, np.radians(25.0)  # rad, trust regions: each leads to another local optimum, the best is selected
FAR = (np.radians(40.0),)  # the same for long paths, which are refined once to save time
ONCE = 1  # passes of a long path before improvement by a sequence, which replaces the other passes
WEIGHTS = 0.3, 2.0  # of the travel's weight: starts that follow the tool farther, or less far
FOLLOWING = 2  # motions that follow the tool and are examined further
AS_NEAR = 1.5  # times the least estimate: threshold for planning a curve of moving joints
EQUAL = 1.05  # factor by which the estimate of another curve has to be better than with the objective's own weights

Key = tuple[float, float]  # points lost and breaks; ranking value: less is better


@dataclass(frozen=True, kw_only=True)
class _SearchRequest:
    """Planning request."""

    cell: Cell
    toolpath: Toolpath
    options: PlanOptions
    axes: Sequence[ExternalJointOptions]
    clock: StageTimings
    before: Plan | None  # of the same job with other user requests
    scale: float | None  # c₀ of a plan that this one belongs to
    is_coarse: bool = False  # a search on a finer grid follows, with its own improvement by a sequence

    def planned(self, scale: float | None, setup: PlanningSetup | None = None, external: Array | None = None) -> Plan:
        """Plan in full with given external joints.

        Args:
            scale: c₀; None: of the plan itself.
            setup: planning setup; None: it is built.
            external: (P, E) m or rad, external joints along the path; None: at home.
        """
        return plan_path(
            self.cell,
            self.toolpath,
            self.options,
            self.clock,
            setup=setup,
            variant=PathVariant(external=external),
            scale=scale,
            before=self.before,
        )


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
    request = _SearchRequest(
        cell=cell, toolpath=toolpath, options=options, axes=axes, clock=clock, before=before, scale=scale
    )
    if not options.is_searched or options.rotation_step >= STEP or _has_fixed_joints(request):
        return _search_refined(request)
    coarse = _search_refined(replace(request, options=replace(options, rotation_step=STEP), is_coarse=True))
    ranking = AxisPlanRanking.build(coarse.setup, axes)
    job = RefinementJob(toolpath=toolpath, groups=(), worth=ranking, clock=clock, before=before)
    found = plan_on_other_grid(coarse, options.rotation_step, job)
    if not count_lost_points(found):
        return found if found.over_external is not None else _improve_coarser_plan(found, request)
    # Where few rotations are feasible, a finer grid may find some that the coarse one misses.
    other = _search_refined(request)
    return min(found, other, key=_build_ranking_key(found.setup, axes))


def _search_refined(request: _SearchRequest) -> Plan:
    """The best plan on one grid of rotations."""
    toolpath, clock, before = request.toolpath, request.clock, request.before
    starts = _search_coarse_to_fine(request)
    found = starts.best
    groups = build_operation_groups(request.cell, toolpath, found.path, request.axes, found.options.steer)
    if _are_locked(groups):
        return found
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
    for one in sorted(every, key=lambda one: (key(one), one.over_external is None)):
        if one.chosen is found.chosen or (key(one) < key(found) and is_drivable(one, toolpath, clock)):
            return one
    return found


def _improve_coarser_plan(plan: Plan, request: _SearchRequest) -> Plan:
    """Return the improvement by sequences of a plan that a finer rotation grid has made better."""
    toolpath, clock = request.toolpath, request.clock
    groups = build_operation_groups(request.cell, toolpath, plan.path, request.axes, plan.options.steer)
    ranking = AxisPlanRanking.build(plan.setup, request.axes)
    job = RefinementJob(toolpath=toolpath, groups=groups, worth=ranking, clock=clock, before=request.before)
    led = leap_to_better_sequences(plan, job)
    for one in sorted(led[1:], key=_build_ranking_key(plan.setup, request.axes)):
        if is_drivable(one, toolpath, clock):
            return one
    return led[0]


def _has_fixed_joints(request: _SearchRequest) -> bool:
    options = resolve_steering(request.options, request.toolpath)
    path = build_planning_path(request.toolpath, list_constrained_points(options))
    return _are_locked(build_operation_groups(request.cell, request.toolpath, path, request.axes, options.steer))


def _are_locked(groups: Sequence[OperationGroup]) -> bool:
    return all((g.low == g.high).all() and not g.moves.any() for g in groups)


def _build_ranking_key(setup: PlanningSetup, axes: Sequence[ExternalJointOptions]) -> Callable[[Plan], Key]:
    worth = AxisPlanRanking.build(setup, axes)
    return lambda one: (count_lost_points(one), worth.plan(one))


@dataclass(frozen=True)
class _Starts:
    """Plans that the refinement begins with."""

    best: Plan
    fixed: tuple[Plan, ...] = ()  # the best one with fixed joints, where others may move; may be the same
    others: tuple[Plan, ...] = ()  # further ones with moving joints, best first


def _search_coarse_to_fine(request: _SearchRequest) -> _Starts:
    """Return the best plan over grids of values, and along a curve between them where the joints may move."""
    request = replace(request, options=resolve_steering(request.options, request.toolpath))
    options, before = request.options, request.before
    with request.clock.stage("prepare"):
        setup = prepare_planning(request.cell, options, request.toolpath) if before is None else before.setup
        path = build_planning_path(request.toolpath, list_constrained_points(options))
        groups = build_operation_groups(request.cell, request.toolpath, path, request.axes, options.steer)
    if _are_locked(groups):
        at = _spread(path, groups, [g.low for g in groups])
        return _Starts(request.planned(request.scale, setup, at))
    with request.clock.stage("external"):
        search = FixedValueSearch(setup, options, path, groups, request.axes, request.scale)
        search.judge()
    tries = _Tries(request=request, setup=setup, path=path, groups=groups, search=search)
    moves = any(g.moves.any() for g in groups)
    return tries.moving() if moves else _Starts(tries.fixed(TRIED)[1])


@dataclass(frozen=True, kw_only=True)
class _Tries:
    """Full plans of candidate values, and the selection of the best."""

    request: _SearchRequest
    setup: PlanningSetup
    path: PlanningPath
    groups: list[OperationGroup]
    search: FixedValueSearch

    def _plan_with_values(self, external: Array, options: PlanOptions | None = None) -> tuple[Key, Plan]:
        request = self.request if options is None else replace(self.request, options=options)
        found = request.planned(self.search.scale, self.setup, external)
        return (count_lost_points(found), self.search.worth.plan(found)), found

    def fixed(self, tried: int) -> tuple[Key, Plan]:
        """Return the best plan with one value per group, among the best few by the estimate and home.

        Args:
            tried: maximum number of full plans.
        """
        search, groups = self.search, self.groups
        every: list[tuple[Key, Plan]] = []
        seen: list[list[Array]] = []
        whole = 0
        while len(seen) < tried and whole < PLANNED:
            values = search.chain()
            if values is None:
                break
            seen.append(values)
            every.append(self._plan_with_values(_spread(self.path, groups, values)))
            lost = _list_lost_groups(every[-1][1], groups)
            bad = [n for n in lost if np.ptp([groups[n].low, groups[n].high], axis=0).any()]
            whole += not bad
            for n in bad or ([0] if len(groups) == 1 else []):
                search.exclude(n, values[n], 0.5 if bad else 0.25)
            if not bad and len(groups) > 1:
                break
        home = search.at_home()
        if not any(np.array_equal(home, values) for values in seen):
            best = min((key for key, _ in every), default=None)
            if best is None or best[0] or search.estimate(home) <= AS_GOOD * search.estimate(seen[0]):
                every.append(self._plan_with_values(_spread(self.path, groups, home)))
        return min(every, key=lambda one: one[0])

    def moving(self) -> _Starts:
        """Return the best plan with the joints moving where they may; with fixed values where these are better.

        Where no fixed value reaches all stations, fixed values are planned only if moving joints fail too.
        """
        search = self.search
        best = None if search.out_of_reach else self.fixed(MOVES_TRIED)
        if best is None:
            with self.request.clock.stage("external"):
                fixed_values = search.chain() or search.at_home()
        else:
            fixed_values = [best[1].path.external[list_run_points(self.path, g.runs)[0]] for g in self.groups]
        ways = list_moving_subsets(self.groups, fixed_values, self.request.cell.external_home)
        (key, found), *others = self._plan_moving_joints(ways, fixed_values)
        if any(not b.pair for b in found.breaks) and (best is None or best[0][0]):
            wound = self._plan_moving_joints([*ways, *list_partly_fixed_groups(self.groups)], fixed_values, turns=True)[
                0
            ]
            key, found = min((key, found), wound, key=lambda one: one[0])
        contacts = count_unreached_points(found) or any(b.pair for b in found.breaks)
        if contacts and (best is None or best[0][0]) and self.setup.collision is not None:
            key, found = min((key, found), self._clear_of_contacts(fixed_values), key=lambda one: one[0])
        if any(g.must.any() for g in self.groups) or (best is None and not key[0]):
            return _Starts(found)  # no position satisfies the requests, or reaches all of the path
        best = best or self.fixed(MOVES_TRIED)
        fixed = (best[1],) if best[0][0] == 0 else ()
        complete = tuple(plan for k, plan in others if k[0] == 0)
        if not key < best[0]:
            return _Starts(best[1], fixed, (found, *complete) if key[0] == 0 else complete)
        if fixed:  # there is an alternative if this one cannot be driven
            with self.request.clock.stage("external"):
                drives = has_motion(found, self.request.toolpath)
            if not drives:
                return _Starts(best[1], fixed, complete)
        return _Starts(found, fixed, complete)

    def _clear_of_contacts(self, stands: list[Array]) -> tuple[Key, Plan]:
        """Return the plan along a curve of contact-free poses: for cells where arm or part collide at every fixed
        value.

        Checking every pose costs more than the curve, so this is tried last, and not for breaks without a contact.
        """
        search = self.search
        with self.request.clock.stage("external"):
            curves = AxisCurveSearch(setup=self.setup, options=self.request.options, scale=search.scale, clear=True)
            way = compute_moving_axis_path(curves, self.path, self.groups, self.request.axes, stands)
        return self._plan_with_values(way)

    def _plan_moving_joints(
        self, tries: list[list[OperationGroup]], stands: list[Array], turns: bool = False
    ) -> list[tuple[Key, Plan]]:
        """Return plans with the joints moving where they may, all or some
        (:func:`machopt.planning.external_axes.moving_axes.list_moving_subsets`), the best first.

        Where all of these have breaks, whole turns of the arm's joints are counted, and the other joints may keep a
        different value (:func:`machopt.planning.external_axes.moving_axes.list_partly_fixed_groups`). Curves whose
        estimate is far from the best are not examined further, the others at 15°; of a long path only the best one
        that reaches all of it, because the refinement removes small differences.
        """
        search = self.search
        with self.request.clock.stage("external"):
            scaled = [[replace(axis, weight=w * axis.weight) for axis in self.request.axes] for w in WEIGHTS]
            curves = AxisCurveSearch(setup=self.setup, options=self.request.options, scale=search.scale, turns=turns)
            variants = [(tries[0], self.request.axes), *((tries[0], axes) for axes in scaled)]
            variants += [(some, self.request.axes) for some in tries[1:]]
            ways = [compute_moving_axis_path(curves, self.path, some, axes, stands) for some, axes in variants]
            curves.tables.clear()
            following = list_following_paths(self.setup, self.path, self.groups, stands)
            following += list_following_paths(self.setup, self.path, self.groups, search.at_home())
            ways += sorted(following, key=search.rate_along)[:FOLLOWING]
            if len(ways) > 1:
                estimates = [search.estimate_along(at) for at in ways]
                near = AS_NEAR * min(estimates)
                order = np.argsort([estimates[0] / EQUAL, *estimates[1:]], kind="stable").tolist()
                ways = [ways[k] for k in order if estimates[k] <= near]
        looks = replace(self.request.options, rotation_step=max(self.request.options.rotation_step, STEP))
        if len(ways) > 1:
            assessed: list[tuple[Key, Plan]] = []
            for at in ways:
                assessed.append(self._plan_with_values(at, looks))
                if len(self.path.index) > SHORT and not assessed[-1][0][0]:
                    break
            order = sorted(range(len(assessed)), key=lambda k: assessed[k][0])
            if looks.rotation_step == self.request.options.rotation_step:
                return [assessed[k] for k in order]
            ways = [ways[order[0]]]
        return [self._plan_with_values(ways[0])]


def _list_lost_groups(plan: Plan, groups: Sequence[OperationGroup]) -> list[int]:
    """Groups with points that have no configuration, or with breaks."""
    path = plan.path
    runs = set(path.run[plan.missing[path.may_touch[plan.missing]]].tolist())
    for b in plan.breaks:
        if np.isfinite(b.after):
            runs.add(int(path.run[np.searchsorted(path.index, b.after - 1e-9)]))
    return [n for n, group in enumerate(groups) if runs & set(group.runs)]


def _spread(path: PlanningPath, groups: Sequence[OperationGroup], values: Sequence[Array]) -> Array:
    """(P, E) the values of the groups at the planning points."""
    out = np.empty((len(path.index), len(values[0])))
    for group, value in zip(groups, values, strict=True):
        out[list_run_points(path, group.runs)] = value
    return out
