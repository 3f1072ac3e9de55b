"""Poses and loads at which the competing explanations of a diagnosis differ most (maximin discrimination design).

::

    diagnosis.json ─► open hypotheses ─► laws at candidate poses × loads ─► pairwise contests
                                                              │
                         MeasurementPlan ◄─ maximise the least noncentrality
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from functools import partial

import numpy as np
from numpy.typing import NDArray

from machopt.measurement import thresholds
from machopt.measurement.design.d_optimal_search import compute_information_matrix
from machopt.measurement.design.design_problem import ReadingDesign
from machopt.measurement.design.expected_accuracy import compute_expected_accuracy
from machopt.measurement.design.load_cases import LoadCases
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
from machopt.measurement.design.reading_noise import ReadingNoise
from machopt.measurement.diagnosis.discrimination.open_hypotheses import (
    MAX_HIDDEN_EFFECTS,
    MAX_LOCATIONS,
    MAX_RIVALS,
    NO_EFFECT,
    OpenDiagnosis,
    RivalLawSet,
)
from machopt.measurement.diagnosis.discrimination.planning_noise import DiscriminationOptions, compute_planning_noise
from machopt.measurement.diagnosis.discrimination.predicted_signals import (
    DiagnosedArm,
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
from machopt.measurement.diagnosis.discrimination.rival_pairs import DiscriminationPlan, RivalPair
from machopt.measurement.diagnosis.discrimination.separation_advice import advise_on_separation, format_hypothesis_name
from machopt.numerics.array_types import Array
from machopt.stiffness.arm_stiffness import ArmElasticity

Ints = NDArray[np.int64]

ROWS = 60_000  # limit on values × cases: more cost minutes and change nothing
FEWEST = 200  # least number of candidate poses; loads per pose are reduced first
DRAWS = 30  # random designs for comparison
TURNS = 3  # iterations: select readings, then find the rival shapes that these readings separate worst


def build_discrimination_plan(
    user_options: DiscriminationOptions,
    arm: DiagnosedArm,
    pool: PosePool,
    cases: LoadCases,
    prior: ArmElasticity,
    size: MeasurementPlanSize,
    progress: Callable[[str], None] = lambda _: None,
) -> DiscriminationPlan:
    """Select poses, loads and number of rounds.

    Args:
        user_options: User input on noise and rounds.
        arm: Arm with its open diagnosis.
        pool: Candidate poses.
        cases: Candidate load cases, at least one.
        prior: Elasticity of the arm as diagnosed.
        size: Number of poses, loads and the seed.
        progress: Called with a text for each step.

    Returns:
        The plan.
    """
    rng, found = np.random.default_rng(size.seed), arm.found
    noise = compute_planning_noise(user_options, found, 1)
    candidate_laws = [s for d in found.rival_sets for s in (*d.candidate_laws, *d.other_laws)]
    steps = select_load_steps(candidate_laws) if found.channel == "deflection" else (1.0,)
    few = _thin_cases(cases, ROWS // (len(steps) * noise.dimensions), rng)
    progress("what each explanation predicts")
    q = pool.q[few.pose]
    if found.channel == "deflection":
        at = predict_load_tests(arm, few, q, steps, noise.dimensions)
    else:
        at = predict_measured_poses(arm, few, q, noise.dimensions, rng)
    covariance, shared = compute_case_noise(few, noise, steps)
    open_, closed, notes = _build_contests(found, at, covariance + shared, noise.dimensions)
    progress("choosing poses and loads")
    problem = _SelectionProblem(cases=few, steps=steps, base=at.base, covariance=covariance, shared=shared)
    contests, blocks = _select_readings(problem, open_, size, rng)
    home, velocity = arm.cell.home[:6], arm.cell.limits.velocity[:6]
    blocks = tuple(blocks[i] for i in order_poses_by_travel(pool.q[few.pose[[b[0] for b in blocks]]], home, velocity))
    draws = [draw_random_readings(few.pose, len(blocks), size.loads, rng) for _ in range(DRAWS)]
    progress("how well they tell apart")
    chance = np.array([[problem.compute_separation(both, b) for b in draws] for both in contests])
    rounds = _compute_rounds(problem, contests, blocks, partial(compute_planning_noise, user_options, found))
    cycles = max(user_options.noise.cycles, combine_required_rounds(rounds.wanted, rounds.excluded))
    final = compute_planning_noise(user_options, found, cycles)
    least = min(rounds.separations, default=0.0)
    pairs = _rate_pairs(problem.with_noise(final), open_, contests, blocks, rounds, chance, cycles)
    return DiscriminationPlan(
        plan=_build_pose_plan(prior, few, ReadingDesign(blocks, least), final, rng),
        noise=final,
        steps=steps,
        pairs=(*pairs, *closed),
        least_separation=least,
        random_separation=float(np.median(chance.min(axis=0))) if len(open_) else 0.0,
        notes=(*found.notes, *notes),
    )


OpenPair = tuple[RivalPair, list[ModelContest], list[ContestSide]]
Blocks = tuple[tuple[int, ...], ...]


@dataclass(frozen=True, kw_only=True)
class _SelectionProblem:
    """N cases of K steps with D coordinates, from which readings are selected."""

    cases: LoadCases
    steps: tuple[float, ...]
    base: Array  # (N, K·D, P) columns that are always refitted
    covariance: Array  # (N, K·D, K·D) noise of each case
    shared: Array  # (K·D, K·D) covariance shared by the readings of a pose

    def with_noise(self, noise: ReadingNoise) -> _SelectionProblem:
        """Return the same cases with another noise of a reading."""
        covariance, shared = compute_case_noise(self.cases, noise, self.steps)
        return replace(self, covariance=covariance, shared=shared)

    def compute_separation(self, contests: Sequence[ModelContest], blocks: Blocks) -> float:
        """Return the least noncentrality of the contests over selected readings."""
        return compute_separation(contests, self.covariance, self.shared, self.cases.pose, blocks)


@dataclass(frozen=True)
class _RequiredRounds:
    """What the selected readings need to separate each open pair."""

    separations: list[float]  # noncentrality of one round
    wanted: list[int | None]  # rounds for the noncentrality that separates; None: no number is enough
    excluded: list[int | None]  # rounds until the wrong law is excluded; None: no number is enough


def _select_readings(
    problem: _SelectionProblem, open_: list[OpenPair], size: MeasurementPlanSize, rng: np.random.Generator
) -> tuple[list[list[ModelContest]], Blocks]:
    """Return the hardest rivals of each pair and the readings that separate them, selected in turn."""
    covariance, shared = problem.covariance, problem.shared
    contests = [both for _, both, _ in open_]
    for turn in range(TURNS):
        blocks = select_poses_for_exclusion(
            contests, problem.base, covariance, shared, problem.cases.pose, size, rng, grow=turn > 0
        )
        known = [len(both) for both in contests]
        pool_of = zip(contests, open_, strict=True)
        contests = [select_hardest_rivals(both, sides, covariance + shared, blocks) for both, (_, _, sides) in pool_of]
        if turn > 0 and known == [len(both) for both in contests]:
            break
    return contests, blocks


def _compute_rounds(
    problem: _SelectionProblem,
    contests: list[list[ModelContest]],
    blocks: Blocks,
    compute_noise: Callable[[int], ReadingNoise],
) -> _RequiredRounds:
    """Return the rounds that each pair needs; ``compute_noise`` returns the noise of a number of rounds."""
    covariance, enough = problem.covariance + problem.shared, compute_required_noncentrality()
    separations = [problem.compute_separation(both, blocks) for both in contests]
    excluded = [compute_rounds_to_exclude(both, covariance, blocks, problem.base) for both in contests]

    def compute_planned_separation(both: Sequence[ModelContest], n: int) -> float:
        return problem.with_noise(compute_noise(n)).compute_separation(both, blocks)

    wanted = [
        compute_required_rounds(partial(compute_planned_separation, both), first, enough)
        for both, first in zip(contests, separations, strict=True)
    ]
    return _RequiredRounds(separations, wanted, excluded)


def _rate_pairs(
    problem: _SelectionProblem,
    open_: list[OpenPair],
    contests: list[list[ModelContest]],
    blocks: Blocks,
    rounds: _RequiredRounds,
    chance: Array,
    cycles: int,
) -> list[RivalPair]:
    """Return the open pairs with their separation; ``chance`` (pairs, draws): that of random readings."""
    enough = compute_required_noncentrality()
    pairs = []
    for k, ((pair, _, _), both) in enumerate(zip(open_, contests, strict=True)):
        whole, until = problem.compute_separation(both, blocks), rounds.excluded[k]
        pairs.append(
            replace(
                pair,
                per_cycle=rounds.separations[k],
                planned=whole,
                cycles=rounds.wanted[k],
                required_cycles=until,
                random=float(np.median(chance[k])),
                is_separated=whole >= enough and until is not None and until <= cycles,
                advice="" if rounds.wanted[k] is not None else advise_on_separation(pair.first, pair.second),
            )
        )
    return pairs


def _build_contests(
    open_diagnosis: OpenDiagnosis, at: PredictedCases, covariance: Array, dimensions: int
) -> tuple[list[tuple[RivalPair, list[ModelContest], list[ContestSide]]], list[RivalPair], list[str]]:
    """Return separable pairs with their contests and rival shapes, pairs that no reading here separates, and notes."""
    share = 3.0 / dimensions
    open_: list[tuple[RivalPair, list[ModelContest], list[ContestSide]]] = []
    forms: dict[tuple[str, str], tuple[Array, ...]] = {}
    closed: list[RivalPair] = []
    notes: list[str] = []
    made: dict[tuple[int, int], Array] = {}
    for number, d in enumerate(open_diagnosis.rival_sets):
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
            if min(rest / max(whole, 1e-300) for rest, whole in left) < thresholds.SHARES.rank:
                closed.append(replace(pair, advice=advise_on_separation(one.candidate_law, two.candidate_law)))
            else:
                open_.append((pair, contests, sides))
    return open_, closed, notes


def _select_rival_laws(
    d: RivalLawSet, at: PredictedCases, covariance: Array, share: float, notes: list[str]
) -> tuple[list[PredictedLaw], list[tuple[int, int]]]:
    """Return the laws of a set at these poses, limited to a number that can be compared in time."""
    found = {k: predict_law(s, at, share) for k, s in enumerate(d.candidate_laws)}
    for k, law in found.items():
        if law is None and d.candidate_laws[k].coefficients:
            s = d.candidate_laws[k]
            notes.append(f"{format_hypothesis_name(s)} ({s.law}) cannot be predicted at these poses and is left out")
    rivals = [k for k, law in found.items() if law is not None]
    sized = [k for k in rivals if d.candidate_laws[k].size is not None]
    if sized:  # effects below their detection limits: the largest possible ones
        moves = {k: float(np.mean(_compute_signal(found, k) ** 2)) for k in sized}
        rivals = [k for k in rivals if k not in sized] + sorted(sized, key=lambda k: -moves[k])[:MAX_HIDDEN_EFFECTS]
    elif any(d.candidate_laws[k].rms is not None for k in rivals):
        rivals = rivals[:MAX_LOCATIONS]
    else:
        most = rivals if NO_EFFECT in d.candidate_laws else rivals[:MAX_RIVALS]
        notes += [
            f"{format_hypothesis_name(d.candidate_laws[k])} is possible too; a plan separates {MAX_RIVALS} at most"
            for k in rivals[MAX_RIVALS:]
            if k not in most
        ]
        rivals = most
    place = {k: n for n, k in enumerate(rivals)}
    laws = [law for k in rivals if (law := found[k]) is not None]
    return laws, [(place[i], place[j]) for i, j in d.pairs if i in place and j in place]


def _compute_signal(found: dict[int, PredictedLaw | None], k: int) -> Array:
    law = found[k]
    assert law is not None  # only predictable laws were selected
    return law.signal


def _thin_cases(cases: LoadCases, most: int, rng: np.random.Generator) -> LoadCases:
    """Limit the number of cases, keeping the poses that come first in the quasi-random sequence, which fills space
    evenly.
    """
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
    """Return the design as a measurement plan; joint stiffness is identified as well."""
    unknowns = build_unknowns(prior, (), cases)
    problem, _ = build_design_problem(cases, unknowns, noise, 1.0, rng)
    seen = compute_expected_accuracy(compute_information_matrix(problem, design.blocks))
    assessed = unknowns.relative & seen.is_identified
    visits = build_schedule(design.blocks, noise.cycles, rng)
    poses = len(design.blocks)
    return MeasurementPlan(
        unknowns=unknowns,
        cases=cases,
        design=design,
        accuracy=seen,
        accuracy_by_belief=assessed,
        believed_values=(),
        bound=float("nan"),
        comparisons=(),
        curve_poses=(poses,),
        curve=(seen.rms(assessed),),
        needed_poses=None,
        visits=visits,
    )
