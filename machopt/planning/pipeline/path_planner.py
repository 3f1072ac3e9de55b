"""Pipeline of the plan of one path; every step's result is stored (:mod:`machopt.planning.pipeline.plan`).

::

    path ─► candidates ─► score ─► choose ─► smooth ─► realise ─► check ─► timeline
                             ▲        └───────────◄───────────────┘ exclude what collides, choose again (search)
                                            (refine ─► compensate ─► timeline, where requested)
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from contextlib import AbstractContextManager
from dataclasses import dataclass, replace

import numpy as np

from machopt.data_types.cell import Cell
from machopt.data_types.infeasibility_reasons import InfeasibilityReason
from machopt.data_types.plan_options import PlanOptions
from machopt.data_types.steering_rules import (
    is_inside_zone,
    list_constrained_points,
    resolve_steering,
    select_steered_rows,
)
from machopt.data_types.toolpath import Toolpath
from machopt.numerics.array_types import Array, Bools
from machopt.numerics.parallel_map import run_two_in_threads
from machopt.numerics.rigid_transforms import wrap_angle
from machopt.planning.baselines import plan_cam_default, plan_jiao2022
from machopt.planning.collision_handling.gouge_check import find_gouges
from machopt.planning.collision_handling.path_check import PathCollisionChecker, PathCollisions
from machopt.planning.cost.clearance_cost import compute_path_crowding
from machopt.planning.cost.held_feed import compute_lost_time
from machopt.planning.cost.objective import PlanObjective, compute_objective
from machopt.planning.cost.stiffness_index import (
    CandidateScores,
    LoadDirections,
    compute_configuration_cost,
    compute_load_directions,
    score_candidates,
)
from machopt.planning.pipeline.collision_free_search import CollisionFreeSearch, CollisionFreeSequence
from machopt.planning.pipeline.nested_grids import choose_best_nested_grid
from machopt.planning.pipeline.place_pricing import PlacePricing, price_places
from machopt.planning.pipeline.plan import Plan
from machopt.planning.pipeline.planning_setup import (
    PlanningSetup,
    ScoredAssignment,
    StageTimings,
    fix_external_axes,
    prepare_planning,
)
from machopt.planning.pipeline.sequence_breaks import find_configuration_jumps, find_sequence_breaks
from machopt.planning.pipeline.vertex_prices import add_vertex_prices
from machopt.planning.sampling.candidate_grid import CandidateGrid
from machopt.planning.sampling.configurations import enumerate_candidates
from machopt.planning.sampling.joint_path import JointAssignment
from machopt.planning.sequence_search.dynamic_programming import SequenceChoice, choose_sequence
from machopt.planning.sequence_search.worst_index_across_swings import compute_worst_index, find_hidden_points
from machopt.planning.smoothing.rotation_smoothing import follow_grid_rotation
from machopt.planning.stations.fixed_rotations import find_fixed_rotations
from machopt.planning.stations.planning_path import PlanningPath, build_planning_path
from machopt.planning.stations.tilt_curve import TiltCurve

PAPER, DEFAULT = "jiao2022", "cam default"  # sources of assignments without a search
PINNED = 1e-6  # rad, tolerance of a pin
BOUND_SLACK = np.radians(0.05)  # tolerance of the user's rotation bounds for the baselines


def plan_path(
    cell: Cell,
    toolpath: Toolpath,
    options: PlanOptions,
    timings: StageTimings | None = None,
    *,
    setup: PlanningSetup | None = None,
    external: Array | None = None,
    scale: float | None = None,
    before: Plan | None = None,
    below: float = np.inf,
    tilt: TiltCurve | None = None,
) -> Plan:
    """Plan one toolpath in one cell; infeasible points are data in the result, never an exception.

    Args:
        cell: robot cell.
        toolpath: toolpath of one tool.
        options: plan options.
        timings: receives the duration of the stages.
        setup: of the same cell and options, prepared before; None: it is prepared here.
        external: (P, E) m or rad, external joints at the planning points; None: at home.
        scale: c₀, where plans are compared that have other candidates; None: of its own.
        before: a plan of the same job with other pins, zones, preferences or branches; unchanged parts are reused.
        below: J of a plan with the same external joints: where the search is far from it, no curve is computed.
        tilt: tilted tool axes; the baselines keep those of the CAM file. None: the CAM file's.
    """
    clock = timings or StageTimings()
    options = resolve_steering(options, toolpath)
    setup = before.setup if before is not None and setup is None else setup

    def stage(name: str) -> AbstractContextManager[None]:
        return clock.stage(name)

    with stage("prepare"):
        setup = prepare_planning(cell, options) if setup is None else setup
        at_home = fix_external_axes(build_planning_path(toolpath, list_constrained_points(options)), cell.external_home)
        path = at_home if external is None else fix_external_axes(at_home, external)
        path = path if tilt is None else tilt.tilt_path(path)
        d = compute_load_directions(path, setup.arm, setup.elasticity, options.force)
        is_at_home = path is at_home or np.array_equal(path.external, at_home.external)
        same = is_at_home and tilt is None
        d_home = d if is_at_home else compute_load_directions(at_home, setup.arm, setup.elasticity, options.force)
    gouges = None
    if options.gouge is not None:
        with stage("gouges"):
            gouges = find_gouges(path, cell, options.gouge)
    with stage("candidates"):
        candidates = enumerate_candidates(path, setup.arm, options)
    with stage("score"):
        scores = score_candidates(path, candidates, setup.elasticity, d, options)
        scores = scores if scale is None else replace(scores, scale=scale)
        scores = add_vertex_prices(scores, path, setup, candidates, options)
        pricing = PlacePricing.build(toolpath, path, setup, d, options)
        if pricing is not None:
            scores = replace(scores, place_price=pricing.price_grid(candidates))

    scored = _scorer(path, setup, d, scores, options, pricing)
    search = _search(path, setup, candidates, scores, options, clock) if options.is_searched else None
    if search is not None:
        search.below = below
    with stage("baselines"):  # and, in parallel, the first choice, which needs no contact checks
        begin = search.begin if search is not None else lambda: None
        (by_file, by_paper), _ = run_two_in_threads(lambda: _yardsticks(before, at_home, d_home, setup, options), begin)
        priced_home = pricing if pricing is None or same else pricing.with_path(at_home, d_home)
        default, paper = map(_scorer(at_home, setup, d_home, scores, options, priced_home), (by_file, by_paper))

    found: CollisionFreeSequence | None = None
    if search is not None:
        found = _searched(search, scored, clock)
        choice = found.choice
        with stage("compare"):
            picked = _picked(found, scored, (paper, default) if same else (), path, options)
    else:
        choice = choose_sequence(path, candidates, scores, setup.cell.limits.velocity[:6], options)
        chosen, source = (paper, PAPER) if options.method == "jiao2022" else (default, DEFAULT)
        a = chosen.assignment
        checker = PathCollisionChecker.of(path, setup.arm, setup.robot, setup.collision, options)
        picked = _Picked(
            chosen, source, checker.whole(a.phi, np.where((a.reason == InfeasibilityReason.OK)[:, None], a.q, np.nan))
        )
    chosen, check = picked.chosen, picked.check
    if check is not None:
        chosen = _looked_at(chosen, check)
    if gouges is not None:
        chosen = replace(chosen, assignment=chosen.assignment.marked(gouges.deep, InfeasibilityReason.GOUGING))
    default, paper = (chosen if one is picked.chosen else one for one in (default, paper))
    breaks = (
        find_sequence_breaks(path, setup, candidates, found)
        if found and picked.searched
        else find_configuration_jumps(path, chosen)
    )
    if picked.searched:
        chosen = _with_names(path, choice, candidates, chosen)
    grid = _grid_objective(path, choice, candidates, scores, setup, options)
    return Plan(
        setup=setup,
        options=options,
        path=path,
        directions=d,
        candidates=candidates,
        scores=scores,
        choice=choice,
        chosen=chosen,
        chosen_from=picked.source,
        grid=grid,
        cam_default=default,
        jiao2022=paper,
        check=check,
        rounds=found.rounds if found is not None else 0,
        breaks=breaks,
        found=found,
        notes=gouges.sentences() if gouges is not None else {},
        pricing=pricing,
    )


def search_with_worst_price(
    before: Plan, found: CollisionFreeSequence, worst: float, elsewhere: float, clock: StageTimings
) -> Plan:
    """Return the plan searched again with another price of the worst index; exclusions remain.

    Args:
        before: plan without gaps or breaks; its candidates are not changed.
        found: result of its search.
        worst: price of the worst index.
        elsewhere: worst index of the other tools, in units of c₀: below it a lower one gains nothing.
        clock: stage timings.
    """
    options = replace(before.options, weights=replace(before.options.weights, worst=worst))
    scores = replace(before.scores, elsewhere=elsewhere)
    return _with_another_search(before, found, _own(before.candidates), scores, options, clock)


def search_without_branch_changes(
    before: Plan, found: CollisionFreeSequence, shut: Bools, ends: Sequence[tuple[int, int]], clock: StageTimings
) -> Plan:
    """Return the plan searched again without some changes of branch; exclusions remain.

    Args:
        before: plan without gaps or breaks; its candidates are not changed.
        found: result of its search.
        shut: (A, A) branch changes that rapid moves must not make, by the arm's branch numbers.
        ends: stations at the ends of the path, and numbers of branches that cannot be reached there.
        clock: stage timings.
    """
    c = before.candidates
    candidates = replace(_own(c), shut=shut if c.shut is None else shut | c.shut)
    for station, number in ends:
        branch = candidates.branch == number
        candidates.feasible[station, :, branch] = False
        candidates.reason[station, :, branch] = np.where(
            c.reason[station, :, branch] == InfeasibilityReason.OK,
            InfeasibilityReason.NO_PATH,
            c.reason[station, :, branch],
        )
    after = _with_another_search(before, found, candidates, before.scores, before.options, clock)
    bound = min(after.choice.bound, before.choice.bound)  # an unsuccessful search is no proof that no path exists
    return replace(after, choice=replace(after.choice, bound=bound), over_external=None)


def _own(c: CandidateGrid) -> CandidateGrid:
    """Return a copy of candidates that may lose vertices."""
    return replace(c, feasible=c.feasible.copy(), reason=c.reason.copy())


def _with_another_search(
    before: Plan,
    found: CollisionFreeSequence,
    candidates: CandidateGrid,
    scores: CandidateScores,
    options: PlanOptions,
    clock: StageTimings,
) -> Plan:
    path, setup = before.path, before.setup
    scored = _scorer(path, setup, before.directions, scores, options, before.pricing)
    search = _search(path, setup, candidates, scores, options, clock)
    search.resume(found)
    found = _searched(search, scored, clock)
    check = found.check
    chosen = _looked_at(scored(found.assignment), check)
    return replace(
        before,
        options=options,
        candidates=candidates,
        scores=scores,
        choice=found.choice,
        chosen=chosen,
        chosen_from=found.source,
        grid=_grid_objective(path, found.choice, candidates, scores, setup, options),
        check=check,
        rounds=before.rounds + found.rounds,
        breaks=find_sequence_breaks(path, setup, candidates, found),
        found=found,
    )


def _scorer(
    path: PlanningPath,
    setup: PlanningSetup,
    d: LoadDirections,
    scores: CandidateScores,
    options: PlanOptions,
    pricing: PlacePricing | None,
) -> Callable[[JointAssignment], ScoredAssignment]:
    """Return a function that computes cost and objective of an assignment."""

    def scored(assignment: JointAssignment) -> ScoredAssignment:
        cost = np.full(len(path.index), np.nan)
        ok = np.flatnonzero(assignment.reason == InfeasibilityReason.OK)
        cost[ok] = compute_configuration_cost(setup.elasticity, d, ok, assignment.q[ok], scores.index)
        crowded = compute_path_crowding(path, setup.collision, assignment.q, options)
        x, v = setup.in_rad(path, assignment.q), setup.velocity
        price = price_places(pricing, assignment.q)
        rapids = (0.0, 0.0) if scores.rapid is None else scores.rapid.measure(path, x, assignment.branch)
        value = compute_objective(
            path,
            cost,
            x,
            assignment.phi,
            scores.scale,
            v,
            options,
            crowded,
            scores.elsewhere,
            price,
            rapids,
            compute_lost_time(path, setup.arm, setup.robot, setup.cell.limits, options, assignment.q, assignment.phi),
        )
        return ScoredAssignment(assignment, cost, value)

    return scored


def _search(
    path: PlanningPath,
    setup: PlanningSetup,
    candidates: CandidateGrid,
    scores: CandidateScores,
    options: PlanOptions,
    clock: StageTimings,
) -> CollisionFreeSearch:
    """A search over candidates, with nothing struck out yet."""
    return CollisionFreeSearch(
        path=path,
        candidates=candidates,
        scores=scores,
        velocity=setup.cell.limits.velocity[:6],
        options=options,
        checker=PathCollisionChecker.of(path, setup.arm, setup.robot, setup.collision, options),
        progress=clock.switch,
    )


@dataclass(frozen=True)
class _Picked:
    """The selected assignment."""

    chosen: ScoredAssignment
    source: str
    check: PathCollisions | None  # None: not needed, or already done
    searched: bool = False  # it is the result of the search


def _picked(
    found: CollisionFreeSequence,
    scored: Callable[[JointAssignment], ScoredAssignment],
    others: Sequence[ScoredAssignment],
    path: PlanningPath,
    options: PlanOptions,
) -> _Picked:
    """Return the result of a search, or a baseline that is better: the paper's first, then the CAM file's."""
    best = _Picked(scored(found.assignment), found.source, found.check, searched=True)
    for other, name in zip(others, (PAPER, DEFAULT), strict=False):
        is_allowed = is_rotation_allowed(other.assignment.phi, path, options)
        if is_allowed and other.objective.total < best.chosen.objective.total and _whole(other, path):
            best = _Picked(other, name, None)
    return best


def _searched(
    search: CollisionFreeSearch, scored: Callable[[JointAssignment], ScoredAssignment], clock: StageTimings
) -> CollisionFreeSequence:
    """Return the global choice, smoothed and as free of contacts as possible."""

    def prefer_grid(choice: SequenceChoice, curve: JointAssignment, plain: JointAssignment) -> bool:
        return scored(curve).objective.total > scored(plain).objective.total * (1 + 1e-9)

    try:
        return choose_best_nested_grid(search, prefer_grid, lambda a: scored(a).objective.total)
    finally:
        clock.switch(None)


def _looked_at(scored: ScoredAssignment, check: PathCollisions) -> ScoredAssignment:
    """Return the assignment with the contacts of a check."""
    a = scored.assignment
    a = a.marked(check.lost & (a.reason == InfeasibilityReason.OK), InfeasibilityReason.NO_PATH).marked(
        check.hit, InfeasibilityReason.COLLIDING
    )
    return replace(scored, assignment=a)


def _with_names(
    path: PlanningPath, choice: SequenceChoice, candidates: CandidateGrid, scored: ScoredAssignment
) -> ScoredAssignment:
    """Set the reason of points whose station has no configuration: that of the candidate that came furthest."""
    at = np.minimum(np.searchsorted(path.stations, np.arange(len(path.index))), len(path.stations) - 1)
    dropped = choice.dropped[at] & (scored.assignment.reason == InfeasibilityReason.NO_PATH)
    known = np.where(candidates.reason == InfeasibilityReason.BOUNDS, 0, candidates.reason).max(axis=(1, 2))
    if candidates.dropped is not None:
        beyond = np.where(candidates.dropped == InfeasibilityReason.BOUNDS, 0, candidates.dropped)
        known = np.maximum(known, beyond.max(axis=(1, 2)))
    furthest = np.where(
        known == InfeasibilityReason.OK, InfeasibilityReason.BOUNDS, known
    )  # the user's bounds, where they alone are in the way
    return replace(scored, assignment=scored.assignment.marked(dropped, furthest[at].astype(np.uint8)))


def is_rotation_allowed(phi: Array, path: PlanningPath, options: PlanOptions) -> bool:
    """Return whether a rotation keeps the user's range and fixed values, which the baselines do not consider.

    Args:
        phi: (P,) rad, rotation.
        path: planning points.
        options: plan options.
    """
    if options.steer:
        return False
    gamma = np.asarray(wrap_angle(phi + path.offset))
    low, high = options.rotation_range
    inside = (gamma >= low - BOUND_SLACK) & (gamma <= high + BOUND_SLACK)
    if high - low < 2 * np.pi - BOUND_SLACK and not inside[path.counted].all():
        return False
    rows = np.flatnonzero(path.is_point)  # toolpath point k is planning point rows[k]
    return all(abs(float(wrap_angle(gamma[rows[f.point]] - f.gamma))) < BOUND_SLACK for f in options.fixed)


def is_assignment_allowed(a: JointAssignment, path: PlanningPath, options: PlanOptions) -> bool:
    """Return whether rotation and branch keep the user's range, pins, zones and branches at every planning point.

    Args:
        a: rotation and joints.
        path: planning points.
        options: plan options.
    """
    if not is_rotation_allowed(a.phi, path, replace(options, steer=())):
        return False
    if any(
        abs(float(wrap_angle(a.phi[row] - phi))) > PINNED for row, phi in find_fixed_rotations(path, options).items()
    ):
        return False
    gamma = np.asarray(wrap_angle(a.phi + path.offset))
    for wish in options.steer:
        rows = select_steered_rows(wish, path.index)
        if wish.forbid is not None and is_inside_zone(gamma[rows], wish.forbid).any():
            return False
        if wish.branch is not None and (a.branch[rows] != wish.branch).any():
            return False
    return True


def _yardsticks(
    before: Plan | None, path: PlanningPath, d: LoadDirections, setup: PlanningSetup, options: PlanOptions
) -> tuple[JointAssignment, JointAssignment]:
    """Return the CAM baseline and the paper's, with the external joints at home; those of another plan, where there
    is one.
    """
    if before is not None:
        known = (before.cam_default.assignment, before.jiao2022.assignment)
        return known
    by_file = _free(plan_cam_default(path, setup.arm, setup.driven.home), path, setup, options)
    by_paper = plan_jiao2022(path, setup.arm, setup.elasticity, d, setup.collision, setup.driven.home, options)
    return by_file, _free(by_paper, path, setup, options)


def _free(
    assignment: JointAssignment, path: PlanningPath, setup: PlanningSetup, options: PlanOptions
) -> JointAssignment:
    """Return a baseline with its collisions marked, if it is otherwise drivable: only then a gain over it is
    reported.
    """
    if setup.collision is not None and (assignment.reason[path.may_touch] == InfeasibilityReason.OK).all():
        q = np.where((assignment.reason == InfeasibilityReason.OK)[:, None], assignment.q, np.nan)
        found = PathCollisionChecker.of(path, setup.arm, setup.robot, setup.collision, options).whole(assignment.phi, q)
        return assignment.marked(found.lost, InfeasibilityReason.NO_PATH).marked(
            found.hit, InfeasibilityReason.COLLIDING
        )
    return assignment


def _whole(scored: ScoredAssignment, path: PlanningPath) -> bool:
    """Return whether every point is feasible."""
    return bool((scored.assignment.reason == InfeasibilityReason.OK).all()) and not find_configuration_jumps(
        path, scored
    )


def _grid_objective(
    path: PlanningPath,
    choice: SequenceChoice,
    candidates: CandidateGrid,
    scores: CandidateScores,
    setup: PlanningSetup,
    options: PlanOptions,
) -> PlanObjective:
    """Return the objective of the grid optimum; decimated points take the cost of their neighbouring stations."""
    st, rows = path.stations, np.arange(len(path.stations))
    plain = follow_grid_rotation(path, candidates, choice)
    vertex = np.where(choice.dropped, np.nan, scores.cost[rows, choice.rotation, choice.branch])
    # stations behind rapid moves share a path length with the previous point; index by row, not by length
    cost = np.interp(np.arange(len(path.index)), st, vertex)
    crowded = None
    if scores.crowded is not None:
        near = np.where(choice.dropped, np.nan, scores.crowded[rows, choice.rotation, choice.branch])
        crowded = np.interp(np.arange(len(path.index)), st, near)
    x = setup.in_rad(path, plain.seed)
    v = setup.velocity
    price = 0.0, 0.0  # of tolerances, and of stability: the grid has their sum
    if scores.place_price is not None:
        vertices = scores.place_price[rows, choice.rotation, choice.branch]
        total = float(vertices[~choice.dropped].sum())
        price = (total, 0.0) if options.objective == "tolerance" else (0.0, total)
    rapids = 0.0, 0.0
    if scores.rapid is not None:
        at = np.minimum(np.searchsorted(st, np.arange(len(path.index))), len(st) - 1)
        rapids = scores.rapid.measure(path, x, choice.branch[at])
    objective = compute_objective(
        path,
        cost,
        x,
        plain.phi,
        scores.scale,
        v,
        options,
        crowded,
        scores.elsewhere,
        price,
        rapids,
        compute_lost_time(path, setup.arm, setup.robot, setup.cell.limits, options, plain.seed, plain.phi),
    )
    crossed = compute_worst_index(
        scores.raw, path.counted[st], find_hidden_points(path), choice.rotation, choice.branch
    )
    worst, worst_elsewhere = max(objective.worst, crossed), scores.elsewhere
    more = max(worst, worst_elsewhere) - max(objective.worst, worst_elsewhere)
    return replace(objective, worst=worst, total=objective.total + options.weights.worst * more)
