"""Poses and loads at which the explanations that a diagnosis left differ most.

::

    diagnosis.json ─► disputes ─► laws at candidate poses × loads ─► contests ─► least separation, maximised ─► PosePlan
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from machopt.data_types.cell import Cell
from machopt.kinematics.robot import Robot, RobotMasses
from machopt.measurement.design.d_optimal_search import ReadingDesign, compute_information_matrix
from machopt.measurement.design.expected_accuracy import compute_expected_accuracy
from machopt.measurement.design.load_cases import LoadCases
from machopt.measurement.design.load_methods import LoadMethod
from machopt.measurement.design.maximin_discrimination import (
    ModelContest,
    compute_required_noncentrality,
    compute_total_noncentrality,
    draw_random_readings,
)
from machopt.measurement.design.measurement_plan import (
    MeasurementPlan,
    MeasurementPlanSize,
    build_design_problem,
    build_unknowns,
)
from machopt.measurement.design.measurement_schedule import build_schedule, order_poses_by_travel
from machopt.measurement.design.pose_candidates import PosePool
from machopt.measurement.design.reading_noise import UNLOADED_TWICE, ReadingNoise
from machopt.measurement.diagnosis import thresholds
from machopt.measurement.diagnosis.discrimination.open_hypotheses import (
    MAX_HIDDEN_EFFECTS,
    MAX_LOCATIONS,
    MAX_RIVALS,
    NO_EFFECT,
    CandidateLaw,
    OpenDiagnosis,
    RivalLawSet,
)
from machopt.measurement.diagnosis.discrimination.predicted_signals import (
    PredictedCases,
    PredictedLaw,
    compute_case_noise,
    list_law_columns,
    predict_law,
    predict_load_tests,
    predict_measured_poses,
    select_load_steps,
)
from machopt.measurement.diagnosis.discrimination.required_measurements import (
    ContestSide,
    combine_required_rounds,
    compute_required_rounds,
    compute_rounds_to_exclude,
    compute_separation,
    select_hardest_rivals,
    select_poses_for_exclusion,
)
from machopt.measurement.diagnosis.discrimination.separation_advice import advise_on_separation, format_hypothesis_name
from machopt.numerics.array_types import Array
from machopt.stiffness.arm_stiffness import ArmElasticity

Ints = NDArray[np.int64]

ROWS = 60_000  # numbers × cases looked at: more take minutes and change nothing
FEWEST = 200  # poses looked at; rather fewer loads at each
DRAWS = 30  # random designs beside
TURNS = 3  # of choosing readings and of looking for forms of the rivals that these tell worse


@dataclass(frozen=True)
class DiscriminationOptions:
    """What the user says of the measurement."""

    noise: ReadingNoise  # of a reading, with the rounds that are wanted at least
    has_stated_noise: bool  # the user typed the noise: it counts even where the diagnosis saw another
    targets: float  # m, between the targets on the tool


@dataclass(frozen=True, kw_only=True)
class RivalPair:
    """Two laws and how well the plan tells them apart."""

    first: CandidateLaw
    second: CandidateLaw
    reason: str  # which finding
    per_cycle: float  # noncentrality of one round over all poses, the worse way round
    planned: float  # of all rounds
    cycles: int | None  # for 90 % at the 1 % level; None: not within 50
    required_cycles: (
        int | None
    )  # until diagnose, given these readings alone, excludes the wrong one; None: rounds do not do it
    random: float  # median noncentrality of one round at random poses and loads
    advice: str  # what would split them where this cannot
    is_separated: bool = False  # by all rounds, in nine of ten cases, by diagnose's own test

    @property
    def is_separable(self) -> bool:
        return not self.advice


@dataclass(frozen=True, kw_only=True)
class DiscriminationPlan:
    """A plan that tells explanations apart."""

    plan: MeasurementPlan
    noise: ReadingNoise  # with the plan's cycles
    steps: tuple[float, ...]
    pairs: tuple[RivalPair, ...]
    least_separation: float  # noncentrality per round of the worst pair that can be split
    random_separation: float
    notes: tuple[str, ...]


def compute_planning_noise(asked: DiscriminationOptions, found: OpenDiagnosis, cycles: int) -> ReadingNoise:
    """Noise of ``cycles`` rounds: what the diagnosis saw, or what was typed."""
    stated = asked.noise
    if found.scatter is None or asked.has_stated_noise:
        return replace(stated, cycles=cycles, targets=stated.targets if found.coordinates == 6 else None)
    own, visit = found.scatter
    targets = None
    if found.coordinates == 6:
        targets = own / found.turn if found.turn else asked.targets
    # each round arrives anew, so what a visit shares is new in each
    return ReadingNoise(
        displacement=own / np.sqrt(UNLOADED_TWICE),
        cycle=0.0,
        pose=visit / np.sqrt(cycles),
        force=stated.force,
        targets=targets,
        cycles=cycles,
    )


def select_planning_compliance(found: OpenDiagnosis, stiffness: Array) -> Array:
    """(6,) rad/(N·m) of the diagnosis; the cell's where it has none."""
    return np.array([found.compliance.get(j, 0.0) or 1.0 / stiffness[j - 1] for j in range(1, 7)])


def build_discrimination_plan(
    asked: DiscriminationOptions,
    found: OpenDiagnosis,
    cell: Cell,
    robot: Robot,
    masses: RobotMasses | None,
    pool: PosePool,
    cases: LoadCases,
    ways: Sequence[LoadMethod],
    prior: ArmElasticity,
    size: MeasurementPlanSize,
    progress: Callable[[str], None] = lambda _: None,
) -> DiscriminationPlan:
    """Choose poses, loads and rounds.

    Args:
        asked: what is believed of the instrument, and rounds.
        found: the diagnosis.
        cell, robot, masses: the arm.
        pool, cases, ways: what may be measured; at least one case.
        prior: stiffness of the arm as diagnosed.
        size: poses, loads, seed.
    """
    rng = np.random.default_rng(size.seed)
    noise = compute_planning_noise(asked, found, 1)
    compliance = select_planning_compliance(found, prior.stiffness.joints)
    stands = [s for d in found.rival_sets for s in (*d.candidate_laws, *d.other_laws)]
    steps = select_load_steps(stands) if found.channel == "deflection" else (1.0,)
    few = _thin_cases(cases, ROWS // (len(steps) * noise.dimensions), rng)
    progress("what each explanation predicts")
    q = pool.q[few.pose]
    if found.channel == "deflection":
        T = cell.tool.T_flange_tcp
        at = predict_load_tests(found, few, q, robot, T, masses, compliance, steps, noise.dimensions)
    else:
        at = predict_measured_poses(found, few, q, cell, robot, masses, compliance, noise.dimensions, rng)
    covariance, shared = compute_case_noise(few, noise, steps)
    open_, closed, notes = _build_contests(found, at, covariance + shared, noise.dimensions)
    progress("choosing poses and loads")
    contests = [both for _, both, _ in open_]
    for turn in range(TURNS):
        blocks = select_poses_for_exclusion(contests, at.base, covariance, shared, few.pose, size, rng, grow=turn > 0)
        known = [len(both) for both in contests]
        pool_of = zip(contests, open_, strict=True)
        contests = [select_hardest_rivals(both, sides, covariance + shared, blocks) for both, (_, _, sides) in pool_of]
        if turn > 0 and known == [len(both) for both in contests]:
            break
    home, velocity = cell.home[:6], cell.limits.velocity[:6]
    blocks = tuple(blocks[i] for i in order_poses_by_travel(pool.q[few.pose[[b[0] for b in blocks]]], home, velocity))
    draws = [draw_random_readings(few.pose, len(blocks), size.loads, rng) for _ in range(DRAWS)]
    progress("how well they tell apart")
    enough = compute_required_noncentrality()
    each = [compute_separation(both, covariance, shared, few.pose, blocks) for both in contests]
    chance = np.array([[compute_separation(both, covariance, shared, few.pose, b) for b in draws] for both in contests])
    excluded = [compute_rounds_to_exclude(both, covariance + shared, blocks, at.base) for both in contests]
    wanted = []
    for both, first in zip(contests, each, strict=True):

        def planned(n: int, both: Sequence[ModelContest] = both) -> float:
            own, together = compute_case_noise(few, compute_planning_noise(asked, found, n), steps)
            return compute_separation(both, own, together, few.pose, blocks)

        wanted.append(compute_required_rounds(planned, first, enough))
    cycles = max(asked.noise.cycles, combine_required_rounds(wanted, excluded))
    final = compute_planning_noise(asked, found, cycles)
    own, together = compute_case_noise(few, final, steps)
    pairs = []
    for k, ((pair, _, _), both) in enumerate(zip(open_, contests, strict=True)):
        whole, until = compute_separation(both, own, together, few.pose, blocks), excluded[k]
        pairs.append(
            replace(
                pair,
                per_cycle=each[k],
                planned=whole,
                cycles=wanted[k],
                required_cycles=until,
                random=float(np.median(chance[k])),
                is_separated=whole >= enough and until is not None and until <= cycles,
                advice="" if wanted[k] is not None else advise_on_separation(pair.first, pair.second),
            )
        )
    plan = _build_pose_plan(prior, few, ReadingDesign(blocks, min(each, default=0.0)), final, rng)
    least = min(each, default=0.0)
    worst = float(np.median(chance.min(axis=0))) if len(open_) else 0.0
    return DiscriminationPlan(
        plan=plan,
        noise=final,
        steps=steps,
        pairs=(*pairs, *closed),
        least_separation=least,
        random_separation=worst,
        notes=(*found.notes, *notes),
    )


def _build_contests(
    found: OpenDiagnosis, at: PredictedCases, covariance: Array, dimensions: int
) -> tuple[list[tuple[RivalPair, list[ModelContest], list[ContestSide]]], list[RivalPair], list[str]]:
    """Pairs that can be split with their contests and what else their rivals may be, pairs that nothing here can split,
    and what was left out."""
    share = 3.0 / dimensions
    open_: list[tuple[RivalPair, list[ModelContest], list[ContestSide]]] = []
    forms: dict[tuple[str, str], tuple[Array, ...]] = {}
    closed: list[RivalPair] = []
    notes: list[str] = []
    made: dict[tuple[int, int], Array] = {}
    for number, d in enumerate(found.rival_sets):
        laws, pairs = _select_rival_laws(d, at, covariance, share, notes)
        beside = [predict_law(s, at, share) for s in d.other_laws]
        base = np.concatenate([at.base, *(b.columns[0] for b in beside if b is not None)], axis=2)
        for i, j in pairs:
            one, two = laws[i], laws[j]
            pair = RivalPair(
                first=one.candidate_law,
                second=two.candidate_law,
                reason=d.reason,
                per_cycle=0.0,
                planned=0.0,
                cycles=None,
                required_cycles=None,
                random=0.0,
                advice="",
            )
            contests: list[ModelContest] = []
            sides: list[ContestSide] = []
            for t, r in ((i, j), (j, i)):
                if laws[t].candidate_law is NO_EFFECT:
                    continue
                for n, columns in enumerate(laws[r].columns):
                    key = (number * 1000 + r, n)
                    if key not in made:
                        made[key] = np.concatenate([base, columns], axis=2)
                    contests.append(ModelContest(t, r, made[key], laws[t].signal))
                rival = laws[r].candidate_law
                if rival.name not in forms:
                    forms[rival.name] = list_law_columns(rival, at)
                sides.append(ContestSide(t, r, laws[t].signal, base, forms[rival.name]))
            left = [compute_total_noncentrality(c, covariance) for c in contests]
            if min(rest / max(whole, 1e-300) for rest, whole in left) < thresholds.DETECTION.left_apart:
                closed.append(replace(pair, advice=advise_on_separation(one.candidate_law, two.candidate_law)))
            else:
                open_.append((pair, contests, sides))
    return open_, closed, notes


def _select_rival_laws(
    d: RivalLawSet, at: PredictedCases, covariance: Array, share: float, notes: list[str]
) -> tuple[list[PredictedLaw], list[tuple[int, int]]]:
    """The laws of a dispute at these poses, as many as can be told apart in time."""
    found = {k: predict_law(s, at, share) for k, s in enumerate(d.candidate_laws)}
    for k, law in found.items():
        if law is None and d.candidate_laws[k].coefficients:
            s = d.candidate_laws[k]
            notes.append(f"{format_hypothesis_name(s)} ({s.law}) cannot be predicted at these poses and is left out")
    kept = [k for k, law in found.items() if law is not None]
    sized = [k for k in kept if d.candidate_laws[k].size is not None]
    if sized:  # detection limits: what could hide most
        moves = {k: float(np.mean(_compute_signal(found, k) ** 2)) for k in sized}
        kept = [k for k in kept if k not in sized] + sorted(sized, key=lambda k: -moves[k])[:MAX_HIDDEN_EFFECTS]
    elif any(d.candidate_laws[k].rms is not None for k in kept):
        kept = kept[:MAX_LOCATIONS]
    else:
        most = kept if NO_EFFECT in d.candidate_laws else kept[:MAX_RIVALS]
        notes += [
            f"{format_hypothesis_name(d.candidate_laws[k])} stands too, but the nearest {MAX_RIVALS} are enough at once"
            for k in kept[MAX_RIVALS:]
            if k not in most
        ]
        kept = most
    place = {k: n for n, k in enumerate(kept)}
    laws = [law for k in kept if (law := found[k]) is not None]
    return laws, [(place[i], place[j]) for i, j in d.pairs if i in place and j in place]


def _compute_signal(found: dict[int, PredictedLaw | None], k: int) -> Array:
    law = found[k]
    assert law is not None  # kept are those that were found
    return law.signal


def _thin_cases(cases: LoadCases, most: int, rng: np.random.Generator) -> LoadCases:
    """At most so many cases, of poses that come first in the quasi-random sequence: they fill the space evenly."""
    if len(cases) <= most:
        return cases
    poses = np.unique(cases.pose)
    enough = max(FEWEST, most * len(poses) // len(cases))
    keep = np.flatnonzero(np.isin(cases.pose, poses[:enough]))
    keep = np.sort(rng.permutation(keep)[:most])
    return LoadCases(
        pose=cases.pose[keep],
        way=cases.way[keep],
        magnitude=cases.magnitude[keep],
        wrench=cases.wrench[keep],
        point=cases.point[keep],
        twist=cases.twist[keep],
        response=cases.response[keep],
        nu_p=cases.nu_p[keep],
        nu_r=cases.nu_r[keep],
        rejected=cases.rejected,
    )


def _build_pose_plan(
    prior: ArmElasticity, cases: LoadCases, design: ReadingDesign, noise: ReadingNoise, rng: np.random.Generator
) -> MeasurementPlan:
    """The design as plan-poses writes it out; joints are identified on the way."""
    unknowns = build_unknowns(prior, (), cases)
    problem, _ = build_design_problem(cases, unknowns, noise, 1.0, rng)
    seen = compute_expected_accuracy(compute_information_matrix(problem, design.blocks))
    judged = unknowns.relative & seen.is_identified
    visits = build_schedule(design.blocks, noise.cycles, rng)
    poses = len(design.blocks)
    return MeasurementPlan(
        unknowns=unknowns,
        cases=cases,
        design=design,
        accuracy=seen,
        accuracy_by_belief=judged,
        believed_values=(),
        bound=float("nan"),
        comparisons=(),
        curve_poses=(poses,),
        curve=(seen.rms(judged),),
        needed_poses=None,
        visits=visits,
    )


def format_pair(pair: RivalPair) -> str:
    """``link compliance of link 3 | link compliance of link 4``."""
    return f"{format_hypothesis_name(pair.first)} | {format_hypothesis_name(pair.second)}"
