"""Pipeline of the plan of one path; every step's result is stored (:mod:`machopt.planning.pipeline.plan_data_types`).

::

    path ─► candidates ─► score ─► choose ─► smooth ─► realise ─► check ─► timeline
                             ▲        └───────────◄───────────────┘ exclude what collides, choose again (search)
                                            (refine ─► compensate ─► timeline, where requested)
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from machopt.data_types.cell import Cell
from machopt.data_types.infeasibility_reasons import InfeasibilityReason
from machopt.data_types.plan_options import PlanOptions
from machopt.data_types.steering_rules import list_constrained_points, resolve_steering
from machopt.data_types.toolpath import Toolpath
from machopt.numerics.array_types import Array
from machopt.numerics.parallel_map import run_two_in_threads
from machopt.planning.collision_handling.gouge_check import GougeResult, find_gouges
from machopt.planning.collision_handling.path_check import PathCollisionChecker, PathCollisions
from machopt.planning.cost.clearance_cost import compute_path_crowding
from machopt.planning.cost.lost_feed_time import compute_lost_time
from machopt.planning.cost.objective import AssignmentCosts, PlanObjective, compute_objective
from machopt.planning.cost.stiffness_index import (
    CandidateScores,
    LoadDirections,
    compute_configuration_cost,
    compute_load_directions,
    score_candidates,
)
from machopt.planning.pipeline.baseline_comparison import (
    PlannedPaths,
    SelectedAssignment,
    build_baselines,
    select_baseline,
    select_best_assignment,
)
from machopt.planning.pipeline.collision_free_search import CollisionFreeSearch, CollisionFreeSequence
from machopt.planning.pipeline.nested_grids import choose_best_nested_grid
from machopt.planning.pipeline.plan_data_types import Plan
from machopt.planning.pipeline.planning_setup import (
    PlanningSetup,
    ScoredAssignment,
    StageTimings,
    fix_external_axes,
    prepare_planning,
)
from machopt.planning.pipeline.rotation_spreading import spread_rotation_steps
from machopt.planning.pipeline.sequence_breaks import find_configuration_jumps, find_sequence_breaks
from machopt.planning.pipeline.tolerance_and_stability_prices import PlacePricing, price_places
from machopt.planning.pipeline.vertex_prices import add_vertex_prices
from machopt.planning.sampling.candidate_enumeration import enumerate_candidates
from machopt.planning.sampling.candidate_grid import CandidateGrid
from machopt.planning.sampling.joint_path import JointAssignment
from machopt.planning.sequence_search.dynamic_programming import SequenceChoice, choose_sequence
from machopt.planning.sequence_search.worst_index_across_swings import compute_worst_index, find_hidden_points
from machopt.planning.smoothing.rotation_smoothing import follow_grid_rotation
from machopt.planning.stations.planning_path import PlanningPath, build_planning_path
from machopt.planning.stations.tilt_curve import TiltCurve


@dataclass(frozen=True)
class PathVariant:
    """Poses of the path that differ from those of the CAM file at home."""

    external: Array | None = None  # (P, E) m or rad, external joints at the planning points; None: at home
    tilt: TiltCurve | None = None  # tilted tool axes; the baselines keep those of the CAM file. None: the CAM file's
    below: float = np.inf  # J of a plan with the same poses: where the search is far from it, no curve is computed


AS_PROGRAMMED = PathVariant()


def plan_path(
    cell: Cell,
    toolpath: Toolpath,
    options: PlanOptions,
    timings: StageTimings | None = None,
    *,
    setup: PlanningSetup | None = None,
    variant: PathVariant = AS_PROGRAMMED,
    scale: float | None = None,
    before: Plan | None = None,
) -> Plan:
    """Plan one toolpath in one cell; infeasible points are data in the result, never an exception.

    Args:
        cell: robot cell.
        toolpath: toolpath of one tool.
        options: plan options.
        timings: receives the duration of the stages.
        setup: of the same cell and options, prepared before; None: it is prepared here.
        variant: external joints and tilted tool axes at the planning points.
        scale: c₀, where plans are compared that have other candidates; None: of its own.
        before: a plan of the same job with other pins, zones, preferences or branches; unchanged parts are reused.
    """
    clock = timings or StageTimings()
    options = resolve_steering(options, toolpath)
    setup = before.setup if before is not None and setup is None else setup
    with clock.stage("prepare"):
        setup = prepare_planning(cell, options, toolpath) if setup is None else setup
        paths = _build_paths(setup, toolpath, options, variant)
    gouges = None
    if options.gouge is not None:
        with clock.stage("gouges"):
            gouges = find_gouges(paths.path, cell, options.gouge)
    problem = _build_problem(paths, setup, toolpath, options, scale, clock)
    search = problem.build_search(clock) if options.is_searched else None
    with clock.stage("baselines"):  # and, in parallel, the first choice, which needs no contact checks
        default, paper = _score_baselines(problem, paths, before, search)
    if search is not None:
        search.below = variant.below
        found = problem.find_sequence(search, clock)
        with clock.stage("compare"):
            others = (paper, default) if paths.same else ()
            selected = select_best_assignment(found, problem.score, others, problem.path, options, setup.arm)
        return _build_searched_plan(problem, found, _MarkedAssignments.build(selected, default, paper, gouges))
    velocity = setup.cell.limits.velocity[:6]
    choice = choose_sequence(problem.path, problem.candidates, problem.scores, velocity, options)
    selected = select_baseline(default, paper, problem.path, setup, options)
    return _build_plan(problem, choice, _MarkedAssignments.build(selected, default, paper, gouges))


@dataclass(frozen=True, kw_only=True)
class PathProblem:
    """One path with its candidates and their scores, on which the steps of a plan work."""

    path: PlanningPath
    directions: LoadDirections
    setup: PlanningSetup
    options: PlanOptions
    candidates: CandidateGrid
    scores: CandidateScores
    pricing: PlacePricing | None

    def score(self, assignment: JointAssignment) -> ScoredAssignment:
        """Compute cost and objective of an assignment.

        Args:
            assignment: Joint angles at the planning points.
        """
        path, setup, scores, options = self.path, self.setup, self.scores, self.options
        cost = np.full(len(path.index), np.nan)
        ok = np.flatnonzero(assignment.reason == InfeasibilityReason.OK)
        cost[ok] = compute_configuration_cost(setup.elasticity, self.directions, ok, assignment.q[ok], scores.index)
        x = setup.in_rad(path, assignment.q)
        costs = AssignmentCosts(
            cost=cost,
            q=x,
            phi=assignment.phi,
            crowded=compute_path_crowding(path, setup.collision, assignment.q, options),
            places=price_places(self.pricing, assignment.q),
            rapids=(0.0, 0.0) if scores.rapid is None else scores.rapid.measure(path, x, assignment.branch),
            late=compute_lost_time(path, setup.drives, options, assignment.q, assignment.phi),
        )
        value = compute_objective(path, costs, scores.scale, setup.velocity, options, scores.elsewhere)
        return ScoredAssignment(assignment, cost, value)

    def rate_grid_choice(self, choice: SequenceChoice) -> PlanObjective:
        """Compute the objective of the grid optimum; decimated points take the cost of their neighbouring stations.

        Args:
            choice: Sequence over the grid.
        """
        path, setup, candidates, scores, options = self.path, self.setup, self.candidates, self.scores, self.options
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
        price = 0.0, 0.0  # of tolerances, and of stability: the grid has their sum
        if scores.place_price is not None:
            vertices = scores.place_price[rows, choice.rotation, choice.branch]
            total = float(vertices[~choice.dropped].sum())
            price = (total, 0.0) if options.objective == "tolerance" else (0.0, total)
        rapids = 0.0, 0.0
        if scores.rapid is not None:
            at = np.minimum(np.searchsorted(st, np.arange(len(path.index))), len(st) - 1)
            rapids = scores.rapid.measure(path, x, choice.branch[at])
        late = compute_lost_time(path, setup.drives, options, plain.seed, plain.phi)
        costs = AssignmentCosts(cost=cost, q=x, phi=plain.phi, crowded=crowded, places=price, rapids=rapids, late=late)
        objective = compute_objective(path, costs, scores.scale, setup.velocity, options, scores.elsewhere)
        crossed = compute_worst_index(
            scores.raw, path.counted[st], find_hidden_points(path), choice.rotation, choice.branch
        )
        worst, worst_elsewhere = max(objective.worst, crossed), scores.elsewhere
        more = max(worst, worst_elsewhere) - max(objective.worst, worst_elsewhere)
        return replace(objective, worst=worst, total=objective.total + options.weights.worst * more)

    def build_search(self, clock: StageTimings) -> CollisionFreeSearch:
        """Build a search over the candidates, with nothing excluded yet.

        Args:
            clock: Timer of the stages.
        """
        setup = self.setup
        return CollisionFreeSearch(
            path=self.path,
            candidates=self.candidates,
            scores=self.scores,
            velocity=setup.cell.limits.velocity[:6],
            options=self.options,
            checker=PathCollisionChecker.build(self.path, setup.arm, setup.robot, setup.collision, self.options),
            progress=clock.switch,
        )

    def find_sequence(self, search: CollisionFreeSearch, clock: StageTimings) -> CollisionFreeSequence:
        """Find the global choice, smoothed and as free of contacts as possible.

        Args:
            search: Search over the candidates.
            clock: Timer of the stages.
        """

        def prefer_grid(choice: SequenceChoice, curve: JointAssignment, plain: JointAssignment) -> bool:
            return self.score(curve).objective.total > self.score(plain).objective.total * (1 + 1e-9)

        def total(assignment: JointAssignment) -> float:
            return self.score(assignment).objective.total

        try:
            found = choose_best_nested_grid(search, prefer_grid, total)
            return spread_rotation_steps(search, found, self.setup.cell.limits, total)
        finally:
            clock.switch(None)


def _build_paths(setup: PlanningSetup, toolpath: Toolpath, options: PlanOptions, variant: PathVariant) -> PlannedPaths:
    """Return the planning points of a variant, and of the path at home."""
    at_home = fix_external_axes(
        build_planning_path(toolpath, list_constrained_points(options)), setup.cell.external_home
    )
    path = at_home if variant.external is None else fix_external_axes(at_home, variant.external)
    path = path if variant.tilt is None else variant.tilt.tilt_path(path)
    d = compute_load_directions(path, setup.arm, setup.elasticity, options.force)
    is_at_home = path is at_home or np.array_equal(path.external, at_home.external)
    return PlannedPaths(
        path=path,
        directions=d,
        at_home=at_home,
        at_home_d=d if is_at_home else compute_load_directions(at_home, setup.arm, setup.elasticity, options.force),
        same=is_at_home and variant.tilt is None,
    )


def _build_problem(
    paths: PlannedPaths,
    setup: PlanningSetup,
    toolpath: Toolpath,
    options: PlanOptions,
    scale: float | None,
    clock: StageTimings,
) -> PathProblem:
    """Return the candidates of a path with their cost and prices."""
    path, d = paths.path, paths.directions
    with clock.stage("candidates"):
        candidates = enumerate_candidates(path, setup.arm, options)
    with clock.stage("score"):
        scores = score_candidates(path, candidates, setup.elasticity, d, options)
        scores = scores if scale is None else replace(scores, scale=scale)
        scores = add_vertex_prices(scores, path, setup, candidates, options)
        pricing = PlacePricing.build(toolpath, path, setup, d, options)
        if pricing is not None:
            scores = replace(scores, place_price=pricing.price_grid(candidates))
    return PathProblem(
        path=path,
        directions=d,
        setup=setup,
        options=options,
        candidates=candidates,
        scores=scores,
        pricing=pricing,
    )


def _score_baselines(
    problem: PathProblem, paths: PlannedPaths, before: Plan | None, search: CollisionFreeSearch | None
) -> tuple[ScoredAssignment, ScoredAssignment]:
    """Return the CAM baseline and the paper's; in parallel, the search makes its first choice."""
    begin = search.begin if search is not None else lambda: None
    (by_file, by_paper), _ = run_two_in_threads(
        lambda: build_baselines(before, paths, problem.setup, problem.options), begin
    )
    pricing = problem.pricing
    if pricing is not None and not paths.same:
        pricing = pricing.with_path(paths.at_home, paths.at_home_d)
    at_home = replace(problem, path=paths.at_home, directions=paths.at_home_d, pricing=pricing)
    return at_home.score(by_file), at_home.score(by_paper)


@dataclass(frozen=True, kw_only=True)
class _MarkedAssignments:
    """The selected assignment and the baselines, with contacts and gouges of the selected one as reasons."""

    selected: SelectedAssignment
    default: ScoredAssignment
    paper: ScoredAssignment
    gouges: GougeResult | None

    @classmethod
    def build(
        cls,
        selected: SelectedAssignment,
        default: ScoredAssignment,
        paper: ScoredAssignment,
        gouges: GougeResult | None,
    ) -> _MarkedAssignments:
        chosen = selected.chosen if selected.check is None else mark_contacts(selected.chosen, selected.check)
        if gouges is not None:
            marked = chosen.assignment.marked(gouges.deep, InfeasibilityReason.GOUGING)
            chosen = replace(chosen, assignment=marked)
        default, paper = (chosen if one is selected.chosen else one for one in (default, paper))
        return cls(selected=replace(selected, chosen=chosen), default=default, paper=paper, gouges=gouges)


def _build_plan(problem: PathProblem, choice: SequenceChoice, marked: _MarkedAssignments) -> Plan:
    """Return the plan of a selected assignment."""
    chosen = marked.selected.chosen
    return Plan(
        setup=problem.setup,
        options=problem.options,
        path=problem.path,
        directions=problem.directions,
        candidates=problem.candidates,
        scores=problem.scores,
        choice=choice,
        chosen=chosen,
        chosen_from=marked.selected.source,
        grid=problem.rate_grid_choice(choice),
        cam_default=marked.default,
        jiao2022=marked.paper,
        check=marked.selected.check,
        rounds=0,
        breaks=find_configuration_jumps(problem.path, chosen),
        found=None,
        notes={} if marked.gouges is None else marked.gouges.sentences(),
        pricing=problem.pricing,
    )


def _build_searched_plan(problem: PathProblem, sequence: CollisionFreeSequence, marked: _MarkedAssignments) -> Plan:
    """Return the plan after a search, which has selected its result or a baseline."""
    plan = replace(_build_plan(problem, sequence.choice, marked), rounds=sequence.rounds, found=sequence)
    if not marked.selected.searched:
        return plan
    path, candidates = problem.path, problem.candidates
    return replace(
        plan,
        breaks=find_sequence_breaks(path, problem.setup, candidates, sequence),
        chosen=_with_names(path, sequence.choice, candidates, plan.chosen),
    )


def mark_contacts(scored: ScoredAssignment, check: PathCollisions) -> ScoredAssignment:
    """Mark the points of an assignment at which a check found contacts.

    Args:
        scored: Scored assignment.
        check: Contacts along its path.

    Returns:
        The assignment with the reasons of these points.
    """
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
