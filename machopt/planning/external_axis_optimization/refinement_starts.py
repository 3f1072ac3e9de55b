"""Plans that the refinement begins with: at home, at one value per operation, or moving along the path.

The joint values must be the same over a run, so operations that share a run share a value. For each such group a grid
of values covers the ranges of its joints, first coarse and then finer around the best. Each value is assessed at some
stations (:mod:`machopt.planning.external_axes.fixed_value_search`), where the best sequence has the mean m, the worst w
and motion. c₀, the unit of the index, is the median over the candidates of all values. The best few are then planned in
full (:func:`machopt.planning.pipeline.path_planner.plan_path`), with home among them where it may win, and the best
plan is selected: fewest points lost, then least J. Joints that may move along the path are first kept at such values
too, where any reaches all of it. The curves of :mod:`machopt.planning.external_axes.moving_axis_search`, of all of them
or of some, are planned in full as well, and never selected where they are worse.

    J = Σ share·(m + motion) + w_worst·max w + Σ price·|Δe|

Candidates are planned in the order of their estimates, until the estimates show that no other is among the best.
"""

from __future__ import annotations

import heapq
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, field, replace

import numpy as np

from machopt.data_types.cell import Cell
from machopt.data_types.plan_options import ExternalJointOptions, PlanOptions
from machopt.data_types.steering_rules import list_constrained_points, resolve_steering
from machopt.data_types.toolpath import Toolpath
from machopt.numerics.array_types import Array
from machopt.planning.external_axes.fixed_value_search import STEP, FixedValueSearch
from machopt.planning.external_axes.moving_axes import (
    compute_moving_axis_path,
    list_moving_subsets,
    list_partly_fixed_groups,
)
from machopt.planning.external_axes.moving_axis_search import AxisCurveSearch
from machopt.planning.external_axes.operation_groups import OperationGroup, build_operation_groups
from machopt.planning.external_axes.positioner_azimuth_following import list_following_paths
from machopt.planning.external_axis_optimization.refinement_restarts import (
    SHORT,
    count_lost_points,
    count_unreached_points,
)
from machopt.planning.motion.trajectory_builder import has_motion
from machopt.planning.pipeline.path_planner import PathVariant, plan_path
from machopt.planning.pipeline.plan_data_types import Plan
from machopt.planning.pipeline.planning_setup import PlanningSetup, StageTimings, prepare_planning
from machopt.planning.stations.path_subset import list_run_points
from machopt.planning.stations.planning_path import PlanningPath, build_planning_path

PLANNED = 3  # values planned in full where all can be driven
TRIED = 8  # where the first ones cannot
MOVES_TRIED = 3  # the same where the joints may move along the path
WEIGHTS = 0.3, 2.0  # of the travel's weight: starts that follow the tool farther, or less far
FOLLOWING = 2  # motions that follow the tool and are examined further
UNSURE = 0.019  # share of J by which the expected value of a candidate may be too high: the 95 % quantile over 80
# candidates of 16 random jobs (benchmarks/external_axis_gap.py --estimates --random 16 --seed 40); worst 9.5 %
USED = 2  # plans with moving joints that the refinement may begin with

Key = tuple[float, float]  # points lost and breaks; ranking value: less is better


@dataclass(frozen=True, kw_only=True)
class SearchRequest:
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


def are_locked(groups: Sequence[OperationGroup]) -> bool:
    return all((g.low == g.high).all() and not g.moves.any() for g in groups)


@dataclass(frozen=True)
class RefinementStarts:
    """Plans that the refinement begins with."""

    best: Plan
    fixed: tuple[Plan, ...] = ()  # the best one with fixed joints, where others may move; may be the same
    others: tuple[Plan, ...] = ()  # further ones with moving joints, best first


def find_refinement_starts(request: SearchRequest) -> RefinementStarts:
    """Return the best plan over grids of values, and along a curve between them where the joints may move."""
    request = replace(request, options=resolve_steering(request.options, request.toolpath))
    options, before = request.options, request.before
    with request.clock.stage("prepare"):
        setup = prepare_planning(request.cell, options, request.toolpath) if before is None else before.setup
        path = build_planning_path(request.toolpath, list_constrained_points(options))
        groups = build_operation_groups(request.cell, request.toolpath, path, request.axes, options.steer)
    if are_locked(groups):
        at = _spread(path, groups, [g.low for g in groups])
        return RefinementStarts(request.planned(request.scale, setup, at))
    with request.clock.stage("external"):
        search = FixedValueSearch(setup, options, path, groups, request.axes, request.scale)
        search.assess()
    tries = _Tries(request=request, setup=setup, path=path, groups=groups, search=search)
    moves = any(g.moves.any() for g in groups)
    return tries.moving() if moves else RefinementStarts(tries.fixed(TRIED)[1])


@dataclass(frozen=True, kw_only=True)
class _Tries:
    """Full plans of candidate values, and the selection of the best."""

    request: SearchRequest
    setup: PlanningSetup
    path: PlanningPath
    groups: list[OperationGroup]
    search: FixedValueSearch
    known: dict[tuple[bytes, float], tuple[Key, Plan]] = field(default_factory=dict)  # by values and rotation step

    def _plan_with_values(self, external: Array, options: PlanOptions | None = None) -> tuple[Key, Plan]:
        """Return the plan with given (P, E) external joints; a curve may be one value that is already planned."""
        request = self.request if options is None else replace(self.request, options=options)
        key = (external + 0.0).tobytes(), request.options.rotation_step  # -0 is 0
        if key not in self.known:
            while len(self.known) > PLANNED:  # each plan holds all of its configurations
                self.known.pop(next(iter(self.known)))
            found = request.planned(self.search.scale, self.setup, external)
            self.known[key] = (count_lost_points(found), self.search.worth.plan(found)), found
        return self.known[key]

    def fixed(self, tried: int) -> tuple[Key, Plan]:
        """Return the best plan with one value per group, among the best few by the estimate and home.

        Args:
            tried: maximum number of full plans.
        """
        search, groups = self.search, self.groups
        every, estimates = list[tuple[Key, Plan]](), list[float]()
        seen: list[list[Array]] = []
        whole = 0
        while len(seen) < tried and whole < PLANNED:
            values = search.chain()
            if values is None or not _may_win(search.estimate(values), estimates, every, 1):
                break
            seen.append(values)
            estimates.append(search.estimate(values))
            every.append(self._plan_with_values(_spread(self.path, groups, values)))
            lost = _list_lost_groups(every[-1][1], groups)
            bad = [n for n in lost if np.ptp([groups[n].low, groups[n].high], axis=0).any()]
            whole += not bad
            for n in bad or ([0] if len(groups) == 1 else []):
                search.exclude(n, values[n], 0.5 if bad else 0.25)
            if not bad and len(groups) > 1:
                break
        home = search.at_home()
        is_new = not any(np.array_equal(home, values) for values in seen)
        if is_new and _may_win(search.estimate(home), estimates, every, 1):
            every.append(self._plan_with_values(_spread(self.path, groups, home)))
        return min(every, key=lambda one: one[0])

    def moving(self) -> RefinementStarts:
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
            return RefinementStarts(found)  # no position satisfies the requests, or reaches all of the path
        best = best or self.fixed(MOVES_TRIED)
        fixed = (best[1],) if best[0][0] == 0 else ()
        complete = tuple(plan for k, plan in others if k[0] == 0)
        if not key < best[0]:
            return RefinementStarts(best[1], fixed, (found, *complete) if key[0] == 0 else complete)
        if fixed:  # there is an alternative if this one cannot be driven
            with self.request.clock.stage("external"):
                drives = has_motion(found, self.request.toolpath)
            if not drives:
                return RefinementStarts(best[1], fixed, complete)
        return RefinementStarts(found, fixed, complete)

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

    def _select_weights(
        self, curves: AxisCurveSearch, groups: list[OperationGroup], stands: list[Array]
    ) -> list[Sequence[ExternalJointOptions]]:
        """Return the options of the joints, and with other weights of their travel.

        Of a long path, of which one curve is planned, only those weights that lead to a better curve on the coarse grid
        of values.
        """
        axes = self.request.axes
        every = [axes, *([replace(axis, weight=w * axis.weight) for axis in axes] for w in WEIGHTS)]
        if len(self.path.index) <= SHORT:
            return every
        ways = [compute_moving_axis_path(curves, self.path, groups, own, stands, is_coarse=True) for own in every]
        rates = [self.search.rate_along(at) for at in ways]
        return [own for own, rate in zip(every, rates, strict=True) if own is axes or rate < rates[0]]

    def _plan_moving_joints(
        self, tries: list[list[OperationGroup]], stands: list[Array], turns: bool = False
    ) -> list[tuple[Key, Plan]]:
        """Return plans with the joints moving where they may, all or some
        (:func:`machopt.planning.external_axes.moving_axes.list_moving_subsets`), the best first.

        Where all of these have breaks, whole turns of the arm's joints are counted, and the other joints may keep a
        different value (:func:`machopt.planning.external_axes.moving_axes.list_partly_fixed_groups`). Curves that may
        be among the best two are examined at 15°; of a long path only the best one that reaches all of it, because the
        refinement removes small differences.
        """
        search = self.search
        with self.request.clock.stage("external"):
            curves = AxisCurveSearch(setup=self.setup, options=self.request.options, scale=search.scale, turns=turns)
            variants = [(tries[0], axes) for axes in self._select_weights(curves, tries[0], stands)]
            variants += [(some, self.request.axes) for some in tries[1:]]
            ways = [compute_moving_axis_path(curves, self.path, some, axes, stands) for some, axes in variants]
            curves.tables.clear()
            following = list_following_paths(self.setup, self.path, self.groups, stands)
            following += list_following_paths(self.setup, self.path, self.groups, search.at_home())
            ways += sorted(following, key=search.rate_along)[:FOLLOWING]
        looks = replace(self.request.options, rotation_step=max(self.request.options.rotation_step, STEP))
        if len(ways) > 1:
            assessed: list[tuple[Key, Plan]] = []
            estimates: list[float] = []
            for estimate, at in self._order_by_estimate(ways):
                estimates.append(estimate)
                if not _may_win(estimate, estimates, assessed, USED):
                    break
                assessed.append(self._plan_with_values(at, looks))
                if len(self.path.index) > SHORT and not assessed[-1][0][0]:
                    break
            ranked = sorted(assessed, key=lambda one: one[0])
            if looks.rotation_step == self.request.options.rotation_step:
                return ranked
            ways = [ranked[0][1].path.external]
        return [self._plan_with_values(ways[0])]

    def _order_by_estimate(self, ways: Sequence[Array]) -> Iterator[tuple[float, Array]]:
        """Yield the (P, E) motions with their estimates, least first.

        The rating of a motion is a quick lower bound of its estimate: fewer costs count in it. A motion is estimated
        when its rating is the least one.
        """
        search, clock = self.search, self.request.clock
        with clock.stage("external"):
            waiting = [(search.rate_along(at), n, False) for n, at in enumerate(ways)]
        heapq.heapify(waiting)
        while waiting:
            value, n, is_estimate = heapq.heappop(waiting)
            if is_estimate:
                yield value, ways[n]
                continue
            with clock.stage("external"):
                heapq.heappush(waiting, (search.estimate_along(ways[n]), n, True))


def _may_win(estimate: float, estimates: Sequence[float], planned: Sequence[tuple[Key, Plan]], count: int) -> bool:
    """Return whether a plan may be among the best ``count`` by its estimate; estimates and plans are in the same order.

    The estimate leaves out the clearance: the smallest share by which a full plan exceeded its estimate is expected.
    """
    known = [(key[1], key[1] / own) for (key, _), own in zip(planned, estimates, strict=False) if not key[0]]
    if len(known) < count:
        return True
    expected = estimate * min(share for _, share in known)
    return expected * (1.0 - UNSURE) <= sorted(value for value, _ in known)[count - 1]


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
