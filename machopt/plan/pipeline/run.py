"""The arrows of the plan: every step's result is kept (:mod:`machopt.plan.pipeline.planned`), for all to look at.

::

    path ─► candidates ─► score ─► choose ─► smooth ─► realise ─► check ─► timeline
                             ▲        └───────────◄───────────────┘ strike out what collides, choose again (search)
                                            (refine ─► compensate ─► timeline, where that is asked for)
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from contextlib import AbstractContextManager
from dataclasses import dataclass, replace

import numpy as np

from machopt.arrays import Array, Bools
from machopt.domain.cell import Cell
from machopt.domain.options import PlanOptions
from machopt.domain.reason import Reason
from machopt.domain.steering import among, inside, kept, steered
from machopt.domain.toolpath import Toolpath
from machopt.model.threads import both
from machopt.plan.choice.baseline import cam_default, jiao2022
from machopt.plan.choice.between import hiding, worst_index
from machopt.plan.choice.choose import Choice, choose
from machopt.plan.configurations.candidates import Candidates, enumerate_candidates
from machopt.plan.configurations.realise import Assignment
from machopt.plan.contacts.check import Checker, PathCheck
from machopt.plan.contacts.gouge import gouges_of
from machopt.plan.cost.nearness import along, over_grid
from machopt.plan.cost.objective import Objective, objective
from machopt.plan.cost.score import Directions, Scores, configuration_cost, directions, score_candidates
from machopt.plan.pipeline.breaks import breaks_of_choice, jumps
from machopt.plan.pipeline.coarser_grids import best_of_nested
from machopt.plan.pipeline.planned import Plan
from machopt.plan.pipeline.search import Found, Search
from machopt.plan.pipeline.setup import Scored, Setup, Timings, prepare, standing
from machopt.plan.smoothing.smooth import follow_grid
from machopt.plan.stations.path import Path, build_path
from machopt.plan.stations.pinned import pinned
from machopt.se3 import wrap

PAPER, DEFAULT = "jiao2022", "cam default"  # where an assignment comes from that no search found
PINNED = 1e-6  # rad, by how much a pin may be missed
BOUND_SLACK = np.radians(0.05)  # of the user's rotation bounds, where a yardstick is asked whether it keeps them


def plan(
    cell: Cell,
    toolpath: Toolpath,
    options: PlanOptions,
    timings: Timings | None = None,
    *,
    setup: Setup | None = None,
    external: Array | None = None,
    scale: float | None = None,
    before: Plan | None = None,
    below: float = np.inf,
) -> Plan:
    """Plan one toolpath in one cell; infeasible points are data in the result, never an exception.

    Args:
        setup: of the same cell and options, made before.
        external: (P, E) m or rad, where the external joints stand at the planning points; None: at home.
        scale: c₀, where plans are compared that have other candidates; None: of its own.
        before: a plan of the same with other pins, zones, preferences or branches; what these do not change is taken
            from it.
        below: J of a plan with the same external joints: where the search is far from it no curve is looked for.
    """
    clock = timings or Timings()
    options = steered(options, toolpath)
    setup = before.setup if before is not None and setup is None else setup

    def stage(name: str) -> AbstractContextManager[None]:
        return clock.stage(name)

    with stage("prepare"):
        setup = prepare(cell, options) if setup is None else setup
        at_home = standing(build_path(toolpath, kept(options)), cell.external_home)
        path = at_home if external is None else standing(at_home, external)
        d = directions(path, setup.arm, setup.elasticity, options.force)
        same = path is at_home or np.array_equal(path.external, at_home.external)
        d_home = d if same else directions(at_home, setup.arm, setup.elasticity, options.force)
    gouges = None
    if options.gouge is not None:
        with stage("gouges"):
            gouges = gouges_of(path, cell, options.gouge)
    with stage("candidates"):
        candidates = enumerate_candidates(path, setup.arm, options)
    with stage("score"):
        scores = score_candidates(path, candidates, setup.elasticity, d, options)
        scores = replace(scores, crowded=over_grid(path, setup.collision, candidates, options))
        scores = scores if scale is None else replace(scores, scale=scale)

    scored = _scorer(path, setup, d, scores, options)
    search = _search(path, setup, candidates, scores, options, clock) if options.method == "global" else None
    if search is not None:
        search.below = below
    with stage("baselines"):  # and the first choice, which looks at no contacts, beside them
        begin = search.begin if search is not None else lambda: None
        (by_file, by_paper), _ = both(lambda: _yardsticks(before, at_home, d_home, setup, options), begin)
        default, paper = map(_scorer(at_home, setup, d_home, scores, options), (by_file, by_paper))

    found: Found | None = None
    if search is not None:
        found = _searched(search, scored, clock)
        choice = found.choice
        with stage("compare"):
            picked = _picked(found, scored, (paper, default) if same else (), path, options)
    else:
        choice = choose(path, candidates, scores, setup.cell.limits.velocity[:6], options)
        chosen, source = (paper, PAPER) if options.method == "jiao2022" else (default, DEFAULT)
        a = chosen.assignment
        checker = Checker.of(path, setup.arm, setup.robot, setup.collision, options)
        picked = _Picked(chosen, source, checker.whole(a.phi, np.where((a.reason == Reason.OK)[:, None], a.q, np.nan)))
    chosen, check = picked.chosen, picked.check
    if check is not None:
        chosen = _looked_at(chosen, check)
    if gouges is not None:
        chosen = replace(chosen, assignment=chosen.assignment.marked(gouges.deep, Reason.GOUGING))
    default, paper = (chosen if one is picked.chosen else one for one in (default, paper))
    breaks = breaks_of_choice(path, setup, candidates, found) if found and picked.searched else jumps(path, chosen)
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
    )


def searched_again(before: Plan, found: Found, worst: float, elsewhere: float, clock: Timings) -> Plan:
    """The plan searched once more with another price of the worst index; what was struck out stays so.

    Args:
        before: without gaps or breaks; keeps its candidates.
        found: of its search.
        worst: price of the worst index.
        elsewhere: worst index of what is planned beside it, in units of c₀: below it a lower one gains nothing.
    """
    options = replace(before.options, weights=replace(before.options.weights, worst=worst))
    scores = replace(before.scores, elsewhere=elsewhere)
    return _with_another_search(before, found, _own(before.candidates), scores, options, clock)


def searched_past(before: Plan, found: Found, shut: Bools, ends: Sequence[tuple[int, int]], clock: Timings) -> Plan:
    """The plan searched once more without some changes of branch; what was struck out stays so.

    Args:
        before: without gaps or breaks; keeps its candidates.
        found: of its search.
        shut: (B, B) rapid moves do not lead from the one branch to the other.
        ends: stations at the ends of the path, and branches that are not come by there.
    """
    c = before.candidates
    candidates = replace(_own(c), shut=shut if c.shut is None else shut | c.shut)
    for station, branch in ends:
        candidates.feasible[station, :, branch] = False
        candidates.reason[station, :, branch] = np.where(
            c.reason[station, :, branch] == Reason.OK, Reason.NO_PATH, c.reason[station, :, branch]
        )
    after = _with_another_search(before, found, candidates, before.scores, before.options, clock)
    bound = min(after.choice.bound, before.choice.bound)  # that no way was found is no proof that there is none
    return replace(after, choice=replace(after.choice, bound=bound), over_external=None)


def _own(c: Candidates) -> Candidates:
    """Candidates that may lose vertices without those of a plan losing them."""
    return replace(c, feasible=c.feasible.copy(), reason=c.reason.copy())


def _with_another_search(
    before: Plan, found: Found, candidates: Candidates, scores: Scores, options: PlanOptions, clock: Timings
) -> Plan:
    path, setup = before.path, before.setup
    scored = _scorer(path, setup, before.directions, scores, options)
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
        breaks=breaks_of_choice(path, setup, candidates, found),
        found=found,
    )


def _scorer(
    path: Path, setup: Setup, d: Directions, scores: Scores, options: PlanOptions
) -> Callable[[Assignment], Scored]:
    """What gives an assignment its cost at every planning point, and its objective."""

    def scored(assignment: Assignment) -> Scored:
        cost = np.full(len(path.index), np.nan)
        ok = np.flatnonzero(assignment.reason == Reason.OK)
        cost[ok] = configuration_cost(setup.elasticity, d, ok, assignment.q[ok], scores.index)
        crowded = along(path, setup.collision, assignment.q, options)
        x, v = setup.in_rad(path, assignment.q), setup.velocity
        value = objective(path, cost, x, assignment.phi, scores.scale, v, options, crowded, scores.elsewhere)
        return Scored(assignment, cost, value)

    return scored


def _search(
    path: Path, setup: Setup, candidates: Candidates, scores: Scores, options: PlanOptions, clock: Timings
) -> Search:
    """A search over candidates, with nothing struck out yet."""
    return Search(
        path=path,
        candidates=candidates,
        scores=scores,
        velocity=setup.cell.limits.velocity[:6],
        options=options,
        checker=Checker.of(path, setup.arm, setup.robot, setup.collision, options),
        progress=clock.switch,
    )


@dataclass(frozen=True)
class _Picked:
    """The assignment that is taken."""

    chosen: Scored
    source: str
    check: PathCheck | None  # None: it needs none, or has had it
    searched: bool = False  # it is the search's own


def _picked(
    found: Found, scored: Callable[[Assignment], Scored], others: Sequence[Scored], path: Path, options: PlanOptions
) -> _Picked:
    """What a search found, or a yardstick that is better still: the paper's first, then the CAM file's."""
    best = _Picked(scored(found.assignment), found.source, found.check, searched=True)
    for other, name in zip(others, (PAPER, DEFAULT), strict=False):
        wanted = as_asked(other.assignment.phi, path, options)
        if wanted and other.objective.total < best.chosen.objective.total and _whole(other, path):
            best = _Picked(other, name, None)
    return best


def _searched(search: Search, scored: Callable[[Assignment], Scored], clock: Timings) -> Found:
    """The global choice, smoothed and free of contacts as far as that can be had."""

    def prefer_grid(choice: Choice, curve: Assignment, plain: Assignment) -> bool:
        return scored(curve).objective.total > scored(plain).objective.total * (1 + 1e-9)

    try:
        return best_of_nested(search, prefer_grid, lambda a: scored(a).objective.total)
    finally:
        clock.switch(None)


def _looked_at(scored: Scored, check: PathCheck) -> Scored:
    """With what a check found of its points."""
    a = scored.assignment
    a = a.marked(check.lost & (a.reason == Reason.OK), Reason.NO_PATH).marked(check.hit, Reason.COLLIDING)
    return replace(scored, assignment=a)


def _with_names(path: Path, choice: Choice, candidates: Candidates, scored: Scored) -> Scored:
    """Points whose station has no configuration take its reason: of the candidate that came furthest."""
    at = np.minimum(np.searchsorted(path.stations, np.arange(len(path.index))), len(path.stations) - 1)
    dropped = choice.dropped[at] & (scored.assignment.reason == Reason.NO_PATH)
    known = np.where(candidates.reason == Reason.BOUNDS, 0, candidates.reason).max(axis=(1, 2))
    furthest = np.where(known == Reason.OK, Reason.BOUNDS, known)  # the user's bounds, where they alone are in the way
    return replace(scored, assignment=scored.assignment.marked(dropped, furthest[at].astype(np.uint8)))


def as_asked(phi: Array, path: Path, options: PlanOptions) -> bool:
    """The rotation keeps the user's range and fixed values, which the yardsticks know nothing of."""
    if options.steer:
        return False
    gamma = np.asarray(wrap(phi + path.offset))
    low, high = options.rotation_range
    inside = (gamma >= low - BOUND_SLACK) & (gamma <= high + BOUND_SLACK)
    if high - low < 2 * np.pi - BOUND_SLACK and not inside[path.counted].all():
        return False
    rows = np.flatnonzero(path.is_point)  # toolpath point k is planning point rows[k]
    return all(abs(float(wrap(gamma[rows[f.point]] - f.gamma))) < BOUND_SLACK for f in options.fixed)


def obeys(a: Assignment, path: Path, options: PlanOptions) -> bool:
    """The rotation and branch keep the user's range, pins, zones and branches at every planning point."""
    if not as_asked(a.phi, path, replace(options, steer=())):
        return False
    if any(abs(float(wrap(a.phi[row] - phi))) > PINNED for row, phi in pinned(path, options).items()):
        return False
    gamma = np.asarray(wrap(a.phi + path.offset))
    for wish in options.steer:
        rows = among(wish, path.index)
        if wish.forbid is not None and inside(gamma[rows], wish.forbid).any():
            return False
        if wish.branch is not None and (a.branch[rows] != wish.branch).any():
            return False
    return True


def _yardsticks(
    before: Plan | None, path: Path, d: Directions, setup: Setup, options: PlanOptions
) -> tuple[Assignment, Assignment]:
    """The CAM's own rotation and the paper's, the external joints at home; of another plan, where there is one."""
    if before is not None:
        known = (before.cam_default.assignment, before.jiao2022.assignment)
        return known
    by_file = _free(cam_default(path, setup.arm, setup.driven.home), path, setup, options)
    by_paper = jiao2022(path, setup.arm, setup.elasticity, d, setup.collision, setup.driven.home, options)
    return by_file, _free(by_paper, path, setup, options)


def _free(assignment: Assignment, path: Path, setup: Setup, options: PlanOptions) -> Assignment:
    """A yardstick with its collisions marked, where it can be driven otherwise: a gain over it is stated only then."""
    if setup.collision is not None and (assignment.reason[path.may_touch] == Reason.OK).all():
        q = np.where((assignment.reason == Reason.OK)[:, None], assignment.q, np.nan)
        found = Checker.of(path, setup.arm, setup.robot, setup.collision, options).whole(assignment.phi, q)
        return assignment.marked(found.lost, Reason.NO_PATH).marked(found.hit, Reason.COLLIDING)
    return assignment


def _whole(scored: Scored, path: Path) -> bool:
    """Executable as it stands."""
    return bool((scored.assignment.reason == Reason.OK).all()) and not jumps(path, scored)


def _grid_objective(
    path: Path, choice: Choice, candidates: Candidates, scores: Scores, setup: Setup, options: PlanOptions
) -> Objective:
    """The objective of the grid optimum; decimated points take the cost of their neighbouring stations."""
    st, rows = path.stations, np.arange(len(path.stations))
    plain = follow_grid(path, candidates, choice)
    vertex = np.where(choice.dropped, np.nan, scores.cost[rows, choice.rotation, choice.branch])
    # stations behind rapid moves share a path length with the point before; index by row, not by length
    cost = np.interp(np.arange(len(path.index)), st, vertex)
    crowded = None
    if scores.crowded is not None:
        near = np.where(choice.dropped, np.nan, scores.crowded[rows, choice.rotation, choice.branch])
        crowded = np.interp(np.arange(len(path.index)), st, near)
    x = setup.in_rad(path, plain.seed)
    v = setup.velocity
    told = objective(path, cost, x, plain.phi, scores.scale, v, options, crowded, scores.elsewhere)
    crossed = worst_index(scores.raw, path.counted[st], hiding(path), choice.rotation, choice.branch)
    worst, beside = max(told.worst, crossed), scores.elsewhere
    more = max(worst, beside) - max(told.worst, beside)
    return replace(told, worst=worst, total=told.total + options.weights.worst * more)
