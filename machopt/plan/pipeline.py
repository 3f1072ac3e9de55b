"""The arrows of the plan: every step's result is kept, so that reports and tests can look at each.

::

    path ─► candidates ─► score ─► choose ─► smooth ─► realise ─► check ─► timeline
                             ▲        └───────────◄───────────────┘ forbid what collides, choose again
                                            (refine ─► compensate ─► timeline, where that is asked for)
"""

from __future__ import annotations

import time
from collections.abc import Callable, Iterator
from contextlib import AbstractContextManager, contextmanager
from dataclasses import dataclass, field, replace

import numpy as np
from numpy.typing import NDArray

from machopt.domain.cell import Cell
from machopt.domain.options import PlanOptions
from machopt.domain.reason import Reason
from machopt.domain.toolpath import Toolpath
from machopt.errors import InputError
from machopt.model.collision import CollisionModel
from machopt.model.correction import Correction, correction_of
from machopt.model.elastic import ArmElasticity
from machopt.model.ik import solver_for
from machopt.model.robot import Robot, load_chain, load_masses
from machopt.plan.baseline import cam_default, jiao2022
from machopt.plan.candidates import Arm, Candidates, enumerate_candidates
from machopt.plan.check import PathCheck, check_path, forbid
from machopt.plan.choose import Choice, choose
from machopt.plan.compensate import Compensation, rescored
from machopt.plan.path import Path, build_path
from machopt.plan.realise import Assignment, realise
from machopt.plan.score import (
    Directions,
    Objective,
    Scores,
    configuration_cost,
    directions,
    objective,
    score_candidates,
)
from machopt.plan.smooth import follow_grid, smooth
from machopt.se3 import wrap

Array = NDArray[np.float64]
ROUNDS_IN_VAIN = 8
ROUNDS = 40  # of choosing again after collisions
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

    @contextmanager
    def stage(self, name: str) -> Iterator[None]:
        self.progress(name)
        start = time.perf_counter()
        try:
            yield
        finally:
            self.seconds[name] = self.seconds.get(name, 0.0) + time.perf_counter() - start


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
    compensation: Compensation | None = None  # then ``path`` is the shifted one

    @property
    def missing(self) -> NDArray[np.intp]:
        """Planning points without a feasible configuration."""
        return np.flatnonzero(self.chosen.assignment.reason != Reason.OK)


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
    if cell.workpiece.link != "world":
        raise InputError(
            f"the workpiece is carried by link {cell.workpiece.link!r}; positioners are not supported yet, "
            "'world' would work",
            file=cell.folder / "cell.yaml",
            where="workpiece.link",
        )
    if cell.external_joints:
        raise InputError(
            f"external joints {', '.join(cell.external_joints)} are not planned yet; a cell without them would work",
            file=cell.folder / "cell.yaml",
            where="robot.external_joints",
        )
    robot, shapes = load_chain(cell)
    correction = correction_of(cell.kinematics)
    driven = in_true_angles(cell, correction)
    arm = Arm.of(driven, solver_for(robot), options)
    elasticity = ArmElasticity(
        robot, cell.tool.T_flange_tcp, cell.stiffness, (cell.limits.lower[:6], cell.limits.upper[:6]), load_masses(cell)
    )
    collision = CollisionModel(driven, robot, shapes, options.clearance) if options.collision else None
    return Setup(cell, robot, arm, elasticity, collision, correction)


def in_true_angles(cell: Cell, correction: Correction | None) -> Cell:
    """The cell with home and position limits as true angles."""
    if correction is None:
        return cell
    return replace(cell, home=correction.true_angles(cell.home), limits=correction.true_limits(cell.limits))


def plan(cell: Cell, toolpath: Toolpath, options: PlanOptions, timings: Timings | None = None) -> Plan:
    """Plan one toolpath in one cell; infeasible points are data in the result, never an exception."""
    clock = timings or Timings()

    def stage(name: str) -> AbstractContextManager[None]:
        return clock.stage(name)

    with stage("prepare"):
        setup = prepare(cell, options)
        path = build_path(toolpath, tuple(f.point for f in options.fixed))
        d = directions(path, setup.arm.T_base_workpiece, setup.elasticity, options.force)
    with stage("candidates"):
        candidates = enumerate_candidates(path, setup.arm, options)
    with stage("score"):
        scores = score_candidates(path, candidates, setup.elasticity, d, options)

    velocity = cell.limits.velocity[:6]

    def scored(assignment: Assignment) -> Scored:
        cost = np.full(len(path.index), np.nan)
        ok = np.flatnonzero(assignment.reason == Reason.OK)
        cost[ok] = configuration_cost(setup.elasticity, d, ok, assignment.q[ok], scores.index)
        return Scored(
            assignment, cost, objective(path, cost, assignment.q, assignment.phi, scores.scale, velocity, options)
        )

    with stage("baselines"):
        default = scored(_free(cam_default(path, setup.arm, setup.driven.home), path, setup, options))
        by_paper = jiao2022(path, setup.arm, setup.elasticity, d, setup.collision, setup.driven.home, options)
        paper = scored(_free(by_paper, path, setup, options))

    if options.method == "global":
        chosen, source, choice, check, rounds = _global(path, setup, candidates, scores, scored, options, clock)
        with stage("compare"):
            for other, name in ((paper, "jiao2022"), (default, "cam default")):
                wanted = _as_asked(other.assignment.phi, path, options)
                if wanted and other.objective.total < chosen.objective.total and _whole(other):
                    chosen, source, check = other, name, None
    else:
        chosen, source = (paper, "jiao2022") if options.method == "jiao2022" else (default, "cam default")
        rounds, choice = 0, choose(path, candidates, scores, setup.cell.limits.velocity[:6], options)
        check = None if setup.collision is None else check_path(path, chosen.assignment.q, setup.collision, options)
    if check is not None and not check.free:
        chosen.assignment.reason[check.hit] = Reason.COLLIDING
    _name_dropped(path, choice, candidates, chosen.assignment)
    grid = _grid_objective(path, choice, candidates, scores, setup, options)
    return Plan(
        setup, options, path, d, candidates, scores, choice, chosen, source, grid, default, paper, check, rounds
    )


def _global(
    path: Path, setup: Setup, candidates: Candidates, scores: Scores, scored: Callable[[Assignment], Scored],
    options: PlanOptions, clock: Timings,
) -> tuple[Scored, str, Choice, PathCheck | None, int]:  # fmt: skip
    """Choose, smooth, check; strike out what collides or cannot be joined, and choose again."""
    for rounds in range(1, ROUNDS + 1):
        with clock.stage("choose"):
            choice = choose(path, candidates, scores, setup.cell.limits.velocity[:6], options)
        with clock.stage("smooth"):
            smoothed = smooth(path, candidates, scores, choice, setup.cell.limits.velocity[:6], options)
            best, source = scored(realise(path, setup.arm, setup.robot, smoothed.phi, smoothed.seed)), "smooth"
            grid = _grid_objective(path, choice, candidates, scores, setup, options)
            lost = _lost(path, choice, best)
            worse = best.objective.total > grid.total * (1 + 1e-9) and not options.fixed  # the grid misses fixed values
            if lost.any() or worse:
                plain = follow_grid(path, candidates, choice)
                other = scored(realise(path, setup.arm, setup.robot, plain.phi, plain.seed))
                if _lost(path, choice, other).sum() < lost.sum() or (
                    not lost.any() and not _lost(path, choice, other).any()
                ):
                    best, source, lost = other, "grid", _lost(path, choice, other)
        check = None
        if setup.collision is not None and not lost.any():
            with clock.stage("check"):
                check = check_path(path, best.assignment.q, setup.collision, options)
        if lost.any():
            struck = forbid(path, candidates, choice, PathCheck(lost, np.full(len(lost), -1, np.int32)), None)
        elif check is not None and not check.free and setup.collision is not None:
            with clock.stage("check"):
                struck = forbid(path, candidates, choice, check, setup.collision)
        else:
            break
        if struck == 0:
            break
        # some points have no answer any more: a few rounds more tell which, the whole search would be in vain
        hopeless = ~candidates.feasible.any(axis=(1, 2, 3)) & path.may_touch[path.stations]
        if hopeless.any() and not options.allow_gaps and rounds >= ROUNDS_IN_VAIN:
            break
    if check is None and setup.collision is not None:  # points were lost to the end; the rest is not taken unchecked
        check = check_path(path, best.assignment.q, setup.collision, options)
    return best, source, choice, check, rounds


def _lost(path: Path, choice: Choice, scored: Scored) -> NDArray[np.bool_]:
    """(P,) points that the choice covers but the curve does not."""
    covered = np.zeros(len(path.index), bool)
    st = path.stations
    for first, last in path.runs:
        kept = st[(st >= first) & (st <= last) & ~choice.dropped]
        if len(kept) == ((st >= first) & (st <= last)).sum():
            covered[first : last + 1] = True
        covered[kept] = True
    return np.asarray(covered & (scored.assignment.reason != Reason.OK))


def _name_dropped(path: Path, choice: Choice, candidates: Candidates, assignment: Assignment) -> None:
    """Points whose station has no configuration take its reason: of the candidate that came furthest."""
    at = np.minimum(np.searchsorted(path.stations, np.arange(len(path.index))), len(path.stations) - 1)
    dropped = choice.dropped[at] & (assignment.reason == Reason.NO_PATH)
    assignment.reason[dropped] = candidates.reason.max(axis=(1, 2))[at[dropped]]


def as_driven(plan: Plan, phi: Array) -> Plan:
    """The plan with the rotation the retimed motion really takes at the planning points, (P,) rad."""
    before = plan.chosen.assignment
    after = realise(plan.path, plan.setup.arm, plan.setup.robot, phi, before.q)
    keep = before.reason != Reason.OK  # what was ruled out stays so
    after.reason[keep] = before.reason[keep]
    return rescored(plan, after)


def _as_asked(phi: Array, path: Path, options: PlanOptions) -> bool:
    """The rotation keeps the user's range and fixed values, which the yardsticks know nothing of."""
    gamma = np.asarray(wrap(phi + path.offset))
    low, high = options.rotation_range
    inside = (gamma >= low - BOUND_SLACK) & (gamma <= high + BOUND_SLACK)
    if high - low < 2 * np.pi - BOUND_SLACK and not inside[path.counted].all():
        return False
    at = {round(float(k)): n for n, k in enumerate(path.index) if path.is_point[n]}
    return all(abs(float(wrap(gamma[at[f.point]] - f.gamma))) < BOUND_SLACK for f in options.fixed if f.point in at)


def _free(assignment: Assignment, path: Path, setup: Setup, options: PlanOptions) -> Assignment:
    """A yardstick with its collisions marked, where it can be driven otherwise: a gain over it is stated only then."""
    if setup.collision is not None and (assignment.reason[path.may_touch] == Reason.OK).all():
        hit = check_path(path, assignment.q, setup.collision, options).hit
        assignment.reason[hit] = Reason.COLLIDING
    return assignment


def _whole(scored: Scored) -> bool:
    """Executable as it stands."""
    return bool((scored.assignment.reason == Reason.OK).all())


def _grid_objective(
    path: Path, choice: Choice, candidates: Candidates, scores: Scores, setup: Setup, options: PlanOptions
) -> Objective:  # fmt: skip
    """The objective of the grid optimum; decimated points take the cost of their neighbouring stations."""
    st, rows = path.stations, np.arange(len(path.stations))
    plain = follow_grid(path, candidates, choice)
    vertex = np.where(choice.dropped, np.nan, scores.cost[rows, choice.rotation, choice.branch])
    # stations behind rapid moves share a path length with the point before; index by row, not by length
    cost = np.interp(np.arange(len(path.index)), st, vertex)
    return objective(path, cost, plain.seed, plain.phi, scores.scale, setup.cell.limits.velocity[:6], options)
