"""The arrows of the plan: every step's result is kept, so that reports and tests can look at each.

::

    path ─► candidates ─► score ─► choose ─► smooth ─► realise ─► check ─► timeline
                             ▲        └───────────◄───────────────┘ strike out what collides, choose again (search)
                                            (refine ─► compensate ─► timeline, where that is asked for)
"""

from __future__ import annotations

import time
from collections.abc import Callable, Iterator
from contextlib import AbstractContextManager, contextmanager
from dataclasses import dataclass, field, replace

import numpy as np
from numpy.typing import NDArray

from machopt.arrays import Array
from machopt.domain.cell import Cell
from machopt.domain.options import PlanOptions
from machopt.domain.reason import Reason
from machopt.domain.steering import kept, steered
from machopt.domain.toolpath import Toolpath
from machopt.errors import InputError
from machopt.model.collision import CollisionModel
from machopt.model.correction import Correction, correction_of
from machopt.model.elastic import ArmElasticity
from machopt.model.ik import solver_for
from machopt.model.machine import Machine, load_machine
from machopt.model.robot import Robot, load_chain, load_masses
from machopt.plan.baseline import cam_default, jiao2022
from machopt.plan.breaks import Break, breaks_of_choice, jumps
from machopt.plan.candidates import Arm, Candidates, enumerate_candidates
from machopt.plan.check import Checker, PathCheck
from machopt.plan.choose import Choice, choose
from machopt.plan.compensate import Compensation, rescored
from machopt.plan.gouge import gouges_of
from machopt.plan.nearness import along, over_grid
from machopt.plan.nested import best_of_nested
from machopt.plan.objective import Objective, objective
from machopt.plan.path import Path, build_path
from machopt.plan.realise import Assignment, realise
from machopt.plan.score import Directions, Scores, configuration_cost, directions, score_candidates
from machopt.plan.search import Found, Search
from machopt.plan.smooth import follow_grid
from machopt.se3 import wrap

LENGTH = 0.5  # m of a sliding joint that count as a rad of travel: about an arm's link
UPRIGHT = np.cos(np.radians(0.1))  # of a joint's axis against the vertical
BOUND_SLACK = np.radians(0.05)  # of the user's rotation bounds, where a yardstick is asked whether it keeps them
Progress = Callable[[str], None]


@dataclass(frozen=True)
class Setup:
    """The cell made ready for planning.

    All configurations of a plan are true angles: where the arm stands. The encoders say others where the cell has
    kinematic corrections; :mod:`machopt.plan.timeline` turns to them, and what is exported is theirs.
    """

    cell: Cell  # as written: home and limits are encoder angles
    robot: Robot
    arm: Arm
    elasticity: ArmElasticity
    collision: CollisionModel | None
    correction: Correction | None = None  # from encoder to true angles; None: they are the same

    @property
    def per_rad(self) -> Array:
        """(6 + E,) how much of each joint counts as a rad of travel: a length as :data:`LENGTH` of it."""
        lengths = np.array(self.cell.external_prismatic, bool)
        return np.concatenate([np.ones(6), np.where(lengths, 1.0 / LENGTH, 1.0)])

    @property
    def velocity(self) -> Array:
        """(6 + E,) velocity limits of the machine, lengths as they count (:attr:`per_rad`) in rad/s."""
        return np.asarray(self.cell.limits.velocity * self.per_rad)

    def in_rad(self, path: Path, q: Array) -> Array:
        """(P, 6 + E) joints of the machine along a path, lengths as they count."""
        return np.asarray(path.whole(q) * self.per_rad)

    @property
    def driven(self) -> Cell:
        """The cell with home and position limits as true angles."""
        return in_true_angles(self.cell, self.correction)


@dataclass(frozen=True)
class Scored:
    """An assignment with its cost at every planning point and its objective."""

    assignment: Assignment
    cost: Array  # (P,) in the unit of the index, NaN where infeasible
    objective: Objective


@dataclass
class Timings:
    """Seconds per stage, in the order of first use."""

    seconds: dict[str, float] = field(default_factory=dict)
    progress: Progress = lambda _: None
    _current: str | None = None
    _since: float = 0.0

    @contextmanager
    def stage(self, name: str) -> Iterator[None]:
        self.progress(name)
        start = time.perf_counter()
        try:
            yield
        finally:
            self.seconds[name] = self.seconds.get(name, 0.0) + time.perf_counter() - start

    def switch(self, name: str | None) -> None:
        """Begin the next of several stages that follow one another; None ends the last."""
        now = time.perf_counter()
        if self._current is not None:
            self.seconds[self._current] = self.seconds.get(self._current, 0.0) + now - self._since
        if name is not None and name != self._current:
            self.progress(name)
        self._current, self._since = name, now


@dataclass(frozen=True)
class Plan:
    """Everything the plan found out, step by step."""

    setup: Setup
    options: PlanOptions
    path: Path
    directions: Directions
    candidates: Candidates
    scores: Scores
    choice: Choice
    chosen: Scored
    chosen_from: str  # "smooth", "jiao2022" or "cam default": the assignment with the least objective
    grid: Objective  # of the grid optimum at the stations, for comparison
    cam_default: Scored
    jiao2022: Scored
    check: PathCheck | None
    rounds: int
    breaks: tuple[Break, ...] = ()  # where no continuous way leads on inside a run
    found: Found | None = None  # the search, where that was the method
    notes: dict[int, str] = field(default_factory=dict)  # planning point: why it was given up after the choice
    compensation: Compensation | None = None  # then ``path`` is the shifted one
    conflict: str = ""  # which of the user's wishes cannot be kept together, where without them there is a plan
    begin: Array | None = None  # (6 + E,) rad or m by encoder, where the motion begins; None: at home
    end: Array | None = None  # likewise, where it ends
    parts: tuple[Part, ...] = ()  # one a tool that is on, of a job that changes tools; empty: it has one tool

    def at(self, point: int) -> tuple[Plan, int]:
        """The plan that planning point ``point`` was planned in, and which of its points it is."""
        part = next((part for part in reversed(self.parts) if part.row <= point), None)
        return (self, point) if part is None else (part.plan, point - part.row)

    def among(self, points: NDArray[np.intp] | NDArray[np.int32]) -> Iterator[tuple[Plan, NDArray[np.intp]]]:
        """Each plan that some of the planning points (n,) were planned in, and which of the n these are."""
        if not self.parts:
            yield self, np.arange(len(points))
        part = self.part_of(points)
        for k, one in enumerate(self.parts):
            mine = np.flatnonzero(part == k)
            if len(mine):
                yield one.plan, mine

    def part_of(self, points: NDArray[np.intp] | NDArray[np.int32]) -> NDArray[np.intp]:
        """(n,) which of the parts planning points (n,) belong to."""
        return np.searchsorted([one.row for one in self.parts], points, side="right") - 1

    @property
    def missing(self) -> NDArray[np.intp]:
        """Planning points without a feasible configuration."""
        return np.flatnonzero(self.chosen.assignment.reason != Reason.OK)


@dataclass(frozen=True)
class Part:
    """A stretch of a job with one tool on, planned by itself (:mod:`machopt.plan.joined`)."""

    plan: Plan  # its toolpath indices are those of the whole job
    row: int  # its first planning point in the whole
    share: float  # of the length cut


def prepare(cell: Cell, options: PlanOptions) -> Setup:
    """Robot, inverse kinematics, stiffness and collision model of a cell.

    Raises:
        InputError: the cell lacks what planning needs (a stiffness), or uses what is not supported.
    """
    if cell.stiffness is None:
        raise InputError(
            "the cell names no stiffness file; optimise needs joint stiffness "
            "(cell key 'stiffness', e.g. from machopt identify)",
            file=cell.folder / "cell.yaml",
            where="stiffness",
        )
    robot, shapes = load_chain(cell)
    correction = correction_of(cell.kinematics)
    driven = in_true_angles(cell, correction)
    machine = load_machine(cell, robot)
    _refuse_tilting(cell, machine)
    arm = Arm.of(driven, solver_for(robot), machine, options)
    elasticity = ArmElasticity(
        robot, cell.tool.T_flange_tcp, cell.stiffness, (cell.limits.lower[:6], cell.limits.upper[:6]), load_masses(cell)
    )
    collision = CollisionModel(driven, robot, shapes, options.clearance) if options.collision else None
    return Setup(cell, robot, arm, elasticity, collision, correction)


def _refuse_tilting(cell: Cell, machine: Machine) -> None:
    """Weight is reckoned with in one attitude of the base."""
    up = cell.T_world_base[2, :3]  # in base_link
    for k in range(machine.positioner, machine.external):
        if not machine.slides[k] and abs(machine.axis[k] @ up) < UPRIGHT:
            raise InputError(
                f"joint {cell.external_joints[machine.column[k] - 6]!r} tilts the robot's base, and its weight is "
                "reckoned with in one attitude; a joint that slides or turns about the vertical would work",
                file=cell.folder / "cell.yaml",
                where="robot.external_joints",
            )


def standing(path: Path, external: Array) -> Path:
    """The path with the external joints at (E,) everywhere, or at (P, E)."""
    return replace(path, external=np.array(np.broadcast_to(external, (len(path.index), np.shape(external)[-1]))))


def in_true_angles(cell: Cell, correction: Correction | None) -> Cell:
    """The cell with home and position limits as true angles."""
    if correction is None:
        return cell
    return replace(cell, home=correction.true_angles(cell.home), limits=correction.true_limits(cell.limits))


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
) -> Plan:
    """Plan one toolpath in one cell; infeasible points are data in the result, never an exception.

    Args:
        setup: of the same cell and options, made before.
        external: (P, E) m or rad, where the external joints stand at the planning points; None: at home.
        scale: c₀, where plans are compared that have other candidates; None: of its own.
        before: a plan of the same with other pins, zones, preferences or branches; what these do not change is taken
            from it.
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

    def scored(assignment: Assignment, path: Path = path, d: Directions = d) -> Scored:
        cost = np.full(len(path.index), np.nan)
        ok = np.flatnonzero(assignment.reason == Reason.OK)
        cost[ok] = configuration_cost(setup.elasticity, d, ok, assignment.q[ok], scores.index)
        crowded = along(path, setup.collision, assignment.q, options)
        x = setup.in_rad(path, assignment.q)
        value = objective(path, cost, x, assignment.phi, scores.scale, setup.velocity, options, crowded)
        return Scored(assignment, cost, value)

    with stage("baselines"):
        by_file, by_paper = _yardsticks(before, at_home, d_home, setup, options)
        default, paper = scored(by_file, at_home, d_home), scored(by_paper, at_home, d_home)

    checker = Checker.of(path, setup.arm, setup.robot, setup.collision, options)
    found: Found | None = None
    check: PathCheck | None
    from_search = False
    if options.method == "global":
        found = _searched(path, setup, candidates, scores, scored, options, clock, checker)
        choice, check, rounds = found.choice, found.check, found.rounds
        chosen, source, from_search = scored(found.assignment), found.source, True
        with stage("compare"):
            for other, name in ((paper, "jiao2022"), (default, "cam default")) if same else ():
                wanted = _as_asked(other.assignment.phi, path, options)
                if wanted and other.objective.total < chosen.objective.total and _whole(other, path):
                    chosen, source, check, from_search = other, name, None, False
    else:
        chosen, source = (paper, "jiao2022") if options.method == "jiao2022" else (default, "cam default")
        rounds, choice = 0, choose(path, candidates, scores, setup.cell.limits.velocity[:6], options)
        a = chosen.assignment
        check = checker.whole(a.phi, np.where((a.reason == Reason.OK)[:, None], a.q, np.nan))
    if check is not None:
        chosen.assignment.reason[check.lost & (chosen.assignment.reason == Reason.OK)] = Reason.NO_PATH
        chosen.assignment.reason[check.hit] = Reason.COLLIDING
    if gouges is not None:
        chosen.assignment.reason[gouges.deep] = Reason.GOUGING
    breaks = breaks_of_choice(path, setup, candidates, found) if found and from_search else jumps(path, chosen)
    if from_search:
        _name_dropped(path, choice, candidates, chosen.assignment)
    grid = _grid_objective(path, choice, candidates, scores, setup, options)
    return Plan(
        setup,
        options,
        path,
        d,
        candidates,
        scores,
        choice,
        chosen,
        source,
        grid,
        default,
        paper,
        check,
        rounds,
        breaks=breaks,
        found=found,
        notes=gouges.sentences() if gouges is not None else {},
    )


def _searched(
    path: Path,
    setup: Setup,
    candidates: Candidates,
    scores: Scores,
    scored: Callable[[Assignment], Scored],
    options: PlanOptions,
    clock: Timings,
    checker: Checker,
) -> Found:
    """The global choice, smoothed and free of contacts as far as that can be had."""

    def prefer_grid(choice: Choice, curve: Assignment, plain: Assignment) -> bool:
        grid = _grid_objective(path, choice, candidates, scores, setup, options)
        return scored(curve).objective.total > grid.total * (1 + 1e-9)

    search = Search(path, candidates, scores, setup.cell.limits.velocity[:6], options, checker, clock.switch)
    try:
        return best_of_nested(search, search.run(prefer_grid), lambda a: scored(a).objective.total)
    finally:
        clock.switch(None)


def _name_dropped(path: Path, choice: Choice, candidates: Candidates, assignment: Assignment) -> None:
    """Points whose station has no configuration take its reason: of the candidate that came furthest."""
    at = np.minimum(np.searchsorted(path.stations, np.arange(len(path.index))), len(path.stations) - 1)
    dropped = choice.dropped[at] & (assignment.reason == Reason.NO_PATH)
    known = np.where(candidates.reason == Reason.BOUNDS, 0, candidates.reason).max(axis=(1, 2))
    furthest = np.where(known == Reason.OK, Reason.BOUNDS, known)  # the user's bounds, where they alone are in the way
    assignment.reason[dropped] = furthest[at[dropped]]


def as_driven(plan: Plan, phi: Array) -> Plan:
    """The plan with the rotation the retimed motion really takes at the planning points, (P,) rad."""
    before = plan.chosen.assignment
    after = realise(plan.path, plan.setup.arm, plan.setup.robot, phi, before.q)
    keep = before.reason != Reason.OK  # what was ruled out stays so
    after.reason[keep] = before.reason[keep]
    return rescored(plan, after)


def _as_asked(phi: Array, path: Path, options: PlanOptions) -> bool:
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


def _yardsticks(
    before: Plan | None, path: Path, d: Directions, setup: Setup, options: PlanOptions
) -> tuple[Assignment, Assignment]:
    """The CAM's own rotation and the paper's, the external joints at home; of another plan, where there is one."""
    if before is not None:
        known = (before.cam_default.assignment, before.jiao2022.assignment)
        return tuple(replace(a, reason=a.reason.copy()) for a in known)  # type: ignore[return-value]
    by_file = _free(cam_default(path, setup.arm, setup.driven.home), path, setup, options)
    by_paper = jiao2022(path, setup.arm, setup.elasticity, d, setup.collision, setup.driven.home, options)
    return by_file, _free(by_paper, path, setup, options)


def _free(assignment: Assignment, path: Path, setup: Setup, options: PlanOptions) -> Assignment:
    """A yardstick with its collisions marked, where it can be driven otherwise: a gain over it is stated only then."""
    if setup.collision is not None and (assignment.reason[path.may_touch] == Reason.OK).all():
        q = np.where((assignment.reason == Reason.OK)[:, None], assignment.q, np.nan)
        found = Checker.of(path, setup.arm, setup.robot, setup.collision, options).whole(assignment.phi, q)
        assignment.reason[found.lost] = Reason.NO_PATH
        assignment.reason[found.hit] = Reason.COLLIDING
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
    return objective(path, cost, x, plain.phi, scores.scale, setup.velocity, options, crowded)
