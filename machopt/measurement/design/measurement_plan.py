"""Measurement plan from candidate poses: admissible loads, D-optimal design, comparison with heuristics, order of
work.

::

    sample_poses ─► load cases ─► design problem ─► D-optimal search ─► expected accuracy
                        └─► published heuristics ─► comparison with the same loads and number of readings
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace

import numpy as np

from machopt.measurement.design.d_optimal_search import (
    compute_information_matrix,
    find_d_optimal_design,
    select_promising_poses,
)
from machopt.measurement.design.design_problem import DesignProblem, ModelBelief, ReadingDesign
from machopt.measurement.design.efficiency_bound import compute_efficiency_bound
from machopt.measurement.design.expected_accuracy import (
    ExpectedAccuracy,
    compute_design_efficiency,
    compute_expected_accuracy,
    find_smallest_number,
)
from machopt.measurement.design.load_cases import LoadCases, LoadCriteria, build_load_cases
from machopt.measurement.design.load_methods import LoadMethod
from machopt.measurement.design.measurement_schedule import ScheduledLoadTest, build_schedule, order_poses_by_travel
from machopt.measurement.design.pose_candidates import PosePool, PoseScreen
from machopt.measurement.design.published_heuristics import (
    HeuristicPosePool,
    build_dumas2011_heuristic,
    build_jiao2022_poses,
    build_random_heuristic,
    build_zhang2025_heuristic,
    draw_heuristic_design,
)
from machopt.measurement.design.reading_noise import ReadingNoise
from machopt.measurement.design.torque_reversal_loads import (
    JointLoadComparison,
    ProcessLoads,
    TorqueReversalCases,
    compare_joint_loads,
    compute_load_steps,
    exchange_loads_for_reversal,
)
from machopt.numerics.array_types import Array, Bools
from machopt.stiffness.arm_stiffness import ArmElasticity
from machopt.stiffness.terms import LinearTerm

DRAWS = 40  # random designs per heuristic
CURVE_DRAWS = 16  # random designs per heuristic and number of poses of the curve
BELIEFS = 5  # stiffnesses that a Bayesian design averages over, including the prior
CURVE_POSES = 300  # candidate poses for designs of other sizes
MOST_POSES = 120  # most poses for a target accuracy
CURVE_PASSES = 2  # exchange passes for designs of other sizes


@dataclass(frozen=True, kw_only=True)
class MeasurementPlanSize:
    """Size of a plan."""

    poses: int
    loads: int  # different loads at each pose
    candidates: int  # poses to choose from
    target: float | None = None  # required relative 1 sigma of the worst unknown
    belief: float = 1.0  # factor by which the prior stiffness may be wrong in either direction
    starts: int = 2
    seed: int = 0


@dataclass(frozen=True)
class IdentifiedUnknowns:
    """The P unknowns: six joint compliances, then the coefficients of the terms."""

    names: tuple[str, ...]
    units: tuple[str, ...]
    scale: Array  # (P,) SI; the prior value if there is one
    relative: Bools  # (P,) True: scale is the prior value, so sigmas are relative


@dataclass(frozen=True, kw_only=True)
class HeuristicComparison:
    """Comparison of a heuristic with the design: same loads, same number of readings, median over random draws."""

    name: str
    poses: int  # number of poses it selects from
    rms: tuple[float, float, float]  # 10, 50, 90 % quantiles of the draws; relative
    sigma: Array  # (P,) median
    efficiency: tuple[float, float, float]  # D, A, E relative to the design, median
    readings: float  # factor of readings needed for the design's rms accuracy
    curve: tuple[float, ...]  # rms at the numbers of poses of the plan's curve


@dataclass(frozen=True, kw_only=True)
class MeasurementPlan:
    """Measurement plan with its expected accuracy."""

    unknowns: IdentifiedUnknowns
    cases: LoadCases
    design: ReadingDesign
    accuracy: ExpectedAccuracy  # with full loads only
    accuracy_by_belief: Bools  # (P,) identified relative unknowns: rms and worst refer to these
    believed_values: tuple[ExpectedAccuracy, ...]  # accuracy under each other prior stiffness, relative to it
    bound: float  # lower bound of the D-efficiency against any design of the same size
    comparisons: tuple[HeuristicComparison, ...]
    curve_poses: tuple[int, ...]
    curve: tuple[float, ...]  # rms of the best design for each number of poses
    needed_poses: int | None  # poses for the target; None: no target, or more than MOST_POSES
    visits: tuple[ScheduledLoadTest, ...]
    steps: tuple[float, ...] = (1.0,)  # shares of the full load at which a cycle is read
    joints: tuple[JointLoadComparison, ...] = ()  # for a plan with a job


def build_unknowns(prior: ArmElasticity, terms: Sequence[LinearTerm], cases: LoadCases) -> IdentifiedUnknowns:
    """Build names and scales of the unknowns.

    A coefficient without a prior value is scaled so that it deflects the arm as much as a joint does (rms).

    Args:
        prior: Prior model of the arm.
        terms: Linear terms to identify together with the joints.
        cases: Admissible load cases.

    Returns:
        The unknowns.
    """
    known = {(t.effect, t.location): t for t in prior.terms}
    names = [f"joint {j}" for j in range(1, 7)]
    units = ["rad/(N·m)"] * 6
    scale = list(1.0 / prior.stiffness.joints)
    size = np.sqrt(np.mean(np.sum(cases.response**2, axis=1), axis=0))
    typical = float(np.sqrt(np.mean((size[:6] * np.array(scale)) ** 2)))
    relative = [True] * 6
    for term in terms:
        before = known.get((term.effect, term.location))
        same = before is not None and [c.name for c in before.coefficients] == [c.name for c in term.coefficients]
        for n, c in enumerate(term.coefficients):
            value = abs(float(before.values[n])) if before is not None and same else 0.0
            p = len(names)
            names.append(f"{term.effect} {term.location} {c.name}")
            units.append(c.unit)
            relative.append(value > 0.0)
            scale.append(value if value > 0.0 else typical / size[p] if size[p] > 0.0 else 1.0)
    return IdentifiedUnknowns(tuple(names), tuple(units), np.array(scale), np.array(relative))


def build_design_problem(
    cases: LoadCases, unknowns: IdentifiedUnknowns, noise: ReadingNoise, belief: float, rng: np.random.Generator
) -> tuple[DesignProblem, Array]:
    """Build the design problem of the load cases.

    Scaling an unknown adds a constant to log det, so for constant noise the D-optimal design does not depend on the
    prior. A relative load error makes the noise grow with the deflection; only then prior stiffnesses matter.

    Args:
        cases: Admissible load cases.
        unknowns: Names and scales of the unknowns.
        noise: Noise of a reading.
        belief: Factor by which the prior stiffness may be wrong.
        rng: Random generator.

    Returns:
        The problem, and the assumed values relative to the prior (K, P), the prior first.
    """
    A = cases.response * unknowns.scale
    expected = cases.twist[:, : noise.dimensions]
    shares = np.ones((1, len(unknowns.scale)))
    if belief > 1.0 and noise.force > 0.0:
        drawn = np.exp(np.log(belief) * rng.uniform(-1.0, 1.0, (BELIEFS - 1, len(unknowns.scale))))
        shares = np.concatenate([shares, np.where(unknowns.relative, drawn, 1.0)])
    part = np.where(unknowns.relative, shares - 1.0, 0.0)
    models = tuple(ModelBelief(A, noise.covariance(expected + A @ change), 1.0 / len(shares)) for change in part)
    return DesignProblem(models, cases.pose, noise.shared()), shares


@dataclass(frozen=True, kw_only=True)
class MeasurementTask:
    """What a plan selects readings from, and the models that it uses."""

    pool: PosePool  # candidate poses
    cases: LoadCases  # admissible load cases, at least one
    screen: PoseScreen
    limits: tuple[Array, Array]  # lower and upper joint limits, each (6,) rad
    home: Array  # (6,) rad
    velocity: Array  # (6,) rad/s, joint speed limits
    prior: ArmElasticity
    terms: Sequence[LinearTerm]  # to identify together with the joints
    ways: tuple[LoadMethod, ...]  # methods of load application
    criteria: LoadCriteria  # limits of each load
    noise: ReadingNoise


@dataclass(frozen=True, kw_only=True)
class _ReferenceDesign:
    """The design that others are compared with."""

    accuracy: ExpectedAccuracy
    assessed: Bools  # (P,) unknowns to which rms and worst refer
    poses: int
    loads: int  # different loads at each pose
    curve_poses: tuple[int, ...]


def build_measurement_plan(
    task: MeasurementTask,
    size: MeasurementPlanSize,
    progress: Callable[[str], None] = lambda _: None,
    job: ProcessLoads | None = None,
) -> MeasurementPlan:
    """Select, evaluate, compare and order the readings.

    Args:
        task: Candidate poses, load cases and models.
        size: Size of the plan.
        progress: Called with progress messages.
        job: Process loads; the loads are then read at two sizes and reverse joint torques.

    Returns:
        The plan.
    """
    rng = np.random.default_rng(size.seed)
    cases, noise = task.cases, task.noise
    unknowns = build_unknowns(task.prior, task.terms, cases)
    problem, shares = build_design_problem(cases, unknowns, noise, size.belief, rng)
    progress("choosing readings")
    design = find_d_optimal_design(problem, size.poses, size.loads, rng=rng, starts=size.starts)
    design, steps, joints = _fit_to_job(task, job, design, problem, unknowns.scale)
    found = compute_expected_accuracy(compute_information_matrix(problem, design.blocks))
    nominal = replace(problem, models=(replace(problem.models[0], weight=1.0),))
    progress("designs of other sizes")
    smaller, _ = nominal.select_poses(select_promising_poses(nominal, design, size.loads, CURVE_POSES))
    sigmas = _AccuracyByPoseCount(smaller, size.loads, rng, {len(design.blocks): found})
    reference = _ReferenceDesign(
        accuracy=found,
        assessed=unknowns.relative & found.is_identified,
        poses=len(design.blocks),
        loads=size.loads,
        curve_poses=_list_curve_pose_counts(len(design.blocks), size.loads * noise.dimensions, len(unknowns.scale)),
    )
    curve = tuple(sigmas(n).rms(reference.assessed) for n in reference.curve_poses)
    needed = _find_needed_poses(sigmas, reference, size.target)
    progress("the papers' ways of choosing")
    comparisons = _compare_with_heuristics(task, reference, nominal, unknowns, rng)
    return MeasurementPlan(
        unknowns=unknowns,
        cases=cases,
        design=design,
        accuracy=found,
        accuracy_by_belief=reference.assessed,
        believed_values=_compute_believed_accuracy(problem, design, shares),
        bound=compute_efficiency_bound(nominal, design, size.loads),
        comparisons=comparisons,
        curve_poses=reference.curve_poses,
        curve=curve,
        needed_poses=needed,
        visits=build_schedule(design.blocks, noise.cycles, rng),
        steps=steps,
        joints=joints,
    )


def _fit_to_job(
    task: MeasurementTask, job: ProcessLoads | None, design: ReadingDesign, problem: DesignProblem, scale: Array
) -> tuple[ReadingDesign, tuple[float, ...], tuple[JointLoadComparison, ...]]:
    """Return the design in the order of least travel, its load steps, and the loads of its joints.

    With a job, loads are exchanged so that joint torques reverse as in the job.
    """
    pool, cases = task.pool, task.cases
    steps: tuple[float, ...] = (1.0,)
    turning: TorqueReversalCases | None = None
    if job is not None:
        steps = compute_load_steps(job, cases)
        turning = TorqueReversalCases.from_cases(
            cases, pool, task.screen.robot, task.prior.masses, scale, task.noise, steps
        )
        design = exchange_loads_for_reversal(design, cases, turning, problem)
    way = order_poses_by_travel(pool.q[cases.pose[[b[0] for b in design.blocks]]], task.home, task.velocity)
    design = replace(design, blocks=tuple(design.blocks[i] for i in way))
    joints = () if job is None or turning is None else compare_joint_loads(job, design, turning, steps)
    return design, steps, joints


def _compute_believed_accuracy(
    problem: DesignProblem, design: ReadingDesign, shares: Array
) -> tuple[ExpectedAccuracy, ...]:
    """Return the accuracy under each other prior stiffness, shares (K, P) of the prior, relative to it."""
    return tuple(
        compute_expected_accuracy(
            compute_information_matrix(problem, design.blocks, k) * np.outer(shares[k], shares[k])
        )
        for k in range(len(shares))
    )[1:]


def _find_needed_poses(sigmas: _AccuracyByPoseCount, reference: _ReferenceDesign, target: float | None) -> int | None:
    """Return the number of poses for the target accuracy; None without one, or for more than MOST_POSES."""
    assessed = reference.assessed
    if target is None or not assessed.any():
        return None
    return find_smallest_number(lambda n: sigmas(n).worst(assessed), target, reference.poses, MOST_POSES)


def _compare_with_heuristics(
    task: MeasurementTask,
    reference: _ReferenceDesign,
    problem: DesignProblem,
    unknowns: IdentifiedUnknowns,
    rng: np.random.Generator,
) -> tuple[HeuristicComparison, ...]:
    """Return the comparisons with the published heuristics that have enough poses."""
    pool, cases, screen, limits = task.pool, task.cases, task.screen, task.limits
    chosen = [
        build_random_heuristic(pool),
        build_zhang2025_heuristic(pool),
        build_dumas2011_heuristic(pool, cases, screen, limits),
    ]
    compared = [_compare_with_heuristic(c, problem, cases, reference, rng) for c in chosen]
    cube = build_jiao2022_poses(screen, pool, limits, rng)
    if len(cube):
        cube_cases = build_load_cases(cube, task.ways, task.prior, task.terms, task.criteria, task.noise)
        if len(cube_cases):
            own = build_design_problem(cube_cases, unknowns, task.noise, 1.0, rng)[0]
            chooser = HeuristicPosePool("jiao2022", np.arange(len(cube)))
            compared.append(_compare_with_heuristic(chooser, own, cube_cases, reference, rng))
    return tuple(c for c in compared if c is not None)


@dataclass
class _AccuracyByPoseCount:
    """Accuracy of the best design for any number of poses, cached."""

    problem: DesignProblem
    loads: int
    rng: np.random.Generator
    cache: dict[int, ExpectedAccuracy]

    def __call__(self, n: int) -> ExpectedAccuracy:
        if n not in self.cache:
            design = find_d_optimal_design(self.problem, n, self.loads, rng=self.rng, starts=1, passes=CURVE_PASSES)
            self.cache[n] = compute_expected_accuracy(compute_information_matrix(self.problem, design.blocks))
        return self.cache[n]


def _list_curve_pose_counts(poses: int, numbers_a_pose: int, unknowns: int) -> tuple[int, ...]:
    """Return numbers of poses of the curve: a quarter to twice the plan's, enough to determine the unknowns."""
    least = -(-unknowns // numbers_a_pose)
    wanted = {max(least + 1, round(poses * f)) for f in (0.25, 0.35, 0.5, 0.7, 1.0, 1.4, 2.0)}
    return tuple(sorted(wanted | {poses}))


def _compare_with_heuristic(
    chooser: HeuristicPosePool,
    problem: DesignProblem,
    cases: LoadCases,
    reference: _ReferenceDesign,
    rng: np.random.Generator,
) -> HeuristicComparison | None:
    """Return the typical accuracy of a heuristic; None if it has fewer poses than the plan."""
    n, assessed, best = reference.poses, reference.assessed, reference.accuracy
    available = int(np.isin(chooser.poses, cases.pose).sum())
    if available < n or not assessed.any():
        return None

    def drawn(count: int, times: int) -> list[ExpectedAccuracy]:
        return [
            compute_expected_accuracy(
                compute_information_matrix(
                    problem, draw_heuristic_design(chooser, problem, cases, count, reference.loads, rng)
                )
            )
            for _ in range(times)
        ]

    at = drawn(n, DRAWS)
    rms = np.array([a.rms(assessed) for a in at])
    low, middle, high = (float(np.quantile(rms, p, method="nearest")) for p in (0.1, 0.5, 0.9))
    curve = tuple(
        float(np.median([a.rms(assessed) for a in drawn(m, CURVE_DRAWS)])) if m <= available else float("nan")
        for m in reference.curve_poses
    )
    efficiencies = np.array([compute_design_efficiency(a, best) for a in at])
    sigma = np.quantile(np.array([a.sigma for a in at]), 0.5, axis=0, method="nearest")
    return HeuristicComparison(
        name=chooser.name,
        poses=available,
        rms=(low, middle, high),
        sigma=sigma,
        efficiency=tuple(float(e) for e in np.median(efficiencies, axis=0)),  # type: ignore[arg-type]
        readings=(middle / best.rms(assessed)) ** 2,
        curve=curve,
    )
