"""Model selection on small equations: whitening, noise, gain on unseen groups, significance, intervals."""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import numpy as np
import pytest
from scipy.optimize import nnls

from machopt.measurement import thresholds
from machopt.measurement.diagnosis.data_types.diagnosis_problem import (
    BaseUnknown,
    CoordinateFamily,
    DiagnosisProblem,
    EffectHypothesis,
    HypothesisCatalogue,
    Quantity,
)
from machopt.measurement.diagnosis.data_types.diagnosis_result import DiagnosisResult
from machopt.measurement.diagnosis.model_selection import selection_pipeline
from machopt.measurement.diagnosis.model_selection.evaluation import repeatable_mismatch
from machopt.measurement.diagnosis.model_selection.screening.hypothesis_screening import (
    ScoredHypothesis,
    compute_chance_probability,
    fit_hypotheses,
    minimise_bounded_quadratics,
    score_hypotheses,
)
from machopt.measurement.diagnosis.model_selection.search import candidate_checks, forward_selection, search_cache
from machopt.measurement.diagnosis.model_selection.search.search_cache import SearchCache
from machopt.measurement.diagnosis.model_selection.search.search_state import SearchState
from machopt.measurement.diagnosis.statistics import holdout_residuals, normal_equations_by_fold, replicate_noise
from machopt.measurement.diagnosis.statistics.holdout_residuals import FittedModel
from machopt.measurement.diagnosis.statistics.normal_equations_by_fold import build_base_model
from machopt.measurement.diagnosis.statistics.replicate_noise import ReplicateNoise
from machopt.measurement.diagnosis.statistics.whitened_hypothesis import whiten_hypotheses
from machopt.measurement.diagnosis.statistics.whitening import build_whitening

GROUPS, SESSIONS, EACH = 24, 2, 6
OWN, CYCLE, VISIT, GAIN = 15e-6, 10e-6, 12e-6, 0.005


def build_synthetic_problem(seed: int, extra: float = 0.0, gain: float = GAIN) -> tuple[DiagnosisProblem, np.ndarray]:
    """Build a problem with four base unknowns, three coordinates and clustered noise; ``extra`` m is the size of an
    effect that the base lacks."""
    rng = np.random.default_rng(seed)
    group = np.repeat(np.arange(GROUPS), EACH)
    X = rng.standard_normal((GROUPS * EACH, 3, 5))
    X = np.tile(X, (SESSIONS, 1, 1))
    group, N = np.tile(group, SESSIONS), GROUPS * EACH * SESSIONS
    session = np.repeat(np.arange(SESSIONS), N // SESSIONS)
    visit = session * GROUPS + group
    cycle = visit * 2 + (np.arange(N) % EACH >= EACH // 2)
    known = X[:, :, :4] @ (1e-4 * np.ones(4))
    y = known + extra * X[:, :, 4] + OWN * rng.standard_normal((N, 3))
    y += (CYCLE * rng.standard_normal((cycle.max() + 1, 3)))[cycle]
    y += (VISIT * rng.standard_normal((visit.max() + 1, 3)))[visit]
    y += known * gain * rng.standard_normal(cycle.max() + 1)[cycle][:, None]
    problem = DiagnosisProblem(
        channel="deflection",
        y=y,
        base=X[:, :, :4],
        unknowns=tuple(BaseUnknown(name=f"x{k}", unit="m") for k in range(4)),
        families=(CoordinateFamily(name="translation", columns=(0, 1, 2), unit="mm", factor=1e3),),
        group=group,
        visit=visit,
        cycle=cycle,
        session=session,
        replicate=np.tile(np.arange(N // SESSIONS), SESSIONS),
        line=np.arange(2, N + 2),
        row=np.arange(1, N + 1),
        scale=known,
    )
    return problem, X[:, :, 4:]


def law(columns: np.ndarray, name: str = "wind", where: str = "arm", lower: tuple[float, ...] = ()) -> EffectHypothesis:
    return EffectHypothesis(
        effect=name,
        location=where,
        law="made up",
        equation="y = a x",
        columns=lambda shape: columns,
        quantities=lambda x, shape: {"size": Quantity(1e6 * float(x[0]), "µm")},
        lower=lower,
        family="body",
    )


def catalogue(columns: np.ndarray, rng: np.random.Generator, others: int = 20) -> HypothesisCatalogue:
    rest = [law(rng.standard_normal(columns.shape), f"rival {k}", f"place {k}") for k in range(others)]
    return HypothesisCatalogue((law(columns), *rest))


def test_whitening_makes_shared_errors_independent() -> None:
    problem, _ = build_synthetic_problem(1)
    n = ReplicateNoise(np.array([OWN]), np.array([CYCLE]), np.array([VISIT]), GAIN, True)
    w = build_whitening(problem, n, np.ones(len(problem), bool))
    rows = problem.visit == problem.visit[0]
    pick = np.flatnonzero(rows)
    # explicit covariance matrix of one visit
    same_cycle = problem.cycle[pick][:, None] == problem.cycle[pick][None, :]
    assert problem.scale is not None
    s = problem.scale[pick]
    S = np.einsum("ij,de->idje", VISIT**2 + CYCLE**2 * same_cycle, np.eye(3))
    S = S + np.einsum("ij,id,je->idje", GAIN**2 * same_cycle, s, s)
    S = S.reshape(3 * len(pick), -1) + OWN**2 * np.eye(3 * len(pick))
    probe = np.zeros((len(problem), 3, 3 * len(pick)))
    probe[pick] = np.eye(3 * len(pick)).reshape(len(pick), 3, -1)
    moved = w.whiten(probe)
    W = moved[np.abs(moved).sum(axis=1) > 0]
    assert np.abs(W @ S @ W.T - np.eye(len(S))).max() < 1e-9  # exact except for rounding


def test_noise_components_do_not_depend_on_the_model_error() -> None:
    found = []
    for seed in range(6):
        problem, _column = build_synthetic_problem(10 + seed, extra=60e-6)
        n = replicate_noise.estimate_replicate_noise(
            problem, problem.y - problem.base @ np.full(4, 1e-4), np.ones(len(problem), bool)
        )
        assert n.replicated
        found.append([n.reading[0], n.cycle[0], n.visit[0], n.gain])
    own, cycle, visit, gain = np.mean(found, axis=0)
    # 6 × 864 coordinates: 1 %; the model error of 60 µm cancels between replicates
    assert own == pytest.approx(OWN, rel=0.05)
    # 6 × 96 cycles × 3 coordinates: 3 %, plus the effect of the reading noise
    assert cycle == pytest.approx(CYCLE, rel=0.2)
    assert visit == pytest.approx(VISIT, rel=0.25)
    assert gain == pytest.approx(GAIN, abs=0.5 * GAIN)  # a slope over three readings is poorly determined


def test_repeated_load_in_a_cycle_gives_no_gain_error() -> None:
    """An error of the force changes prediction and residual in opposite directions, which was estimated as a gain
    error of one."""
    problem, _ = build_synthetic_problem(5, gain=0.0)
    rng = np.random.default_rng(5)
    load = 0.02 * rng.standard_normal((problem.cycle.max() + 1, 3))[problem.cycle]  # m, one load per cycle
    misread = 5e-6 * rng.standard_normal(problem.y.shape)
    same = replace(problem, y=problem.y + load, scale=load + misread)
    n = replicate_noise.estimate_replicate_noise(
        same, problem.y - problem.base @ np.full(4, 1e-4) - misread, np.ones(len(problem), bool)
    )
    assert n.gain == 0.0
    assert n.total(0) < 2.0 * np.hypot(np.hypot(OWN, CYCLE), VISIT)


def test_exact_readings_do_not_divide_by_zero() -> None:
    problem, _ = build_synthetic_problem(3)
    problem = replace(problem, y=problem.base @ np.full(4, 1e-4))
    n = replicate_noise.estimate_replicate_noise(problem, np.zeros_like(problem.y), np.ones(len(problem), bool))
    w = build_whitening(problem, n, np.ones(len(problem), bool))
    assert np.isfinite(w.whiten(problem.base)).all()


def test_cross_validated_gain_equals_explicit_refits() -> None:
    problem, column = build_synthetic_problem(4, extra=20e-6)
    used = np.ones(len(problem), bool)
    w = build_whitening(problem, replicate_noise.estimate_replicate_noise(problem, problem.y, used), used)
    base, _ = build_base_model(problem, w, np.random.default_rng(0))
    s = score_hypotheses(base, whiten_hypotheses(base, [law(column)]))[0]
    x = s.whitened.columns_at(0)
    fold = np.repeat(base.fold, np.diff(w.visit_starts))
    for f in range(3):
        out, rest = fold == f, fold != f
        errors = []
        for X in (base.X, np.concatenate([base.X, x], axis=1)):
            beta = np.linalg.lstsq(X[rest], base.y[rest], rcond=None)[0]
            errors.append(float(np.sum((base.y[out] - X[out] @ beta) ** 2)))
        assert s.heldout[f] == pytest.approx(errors[0] - errors[1], rel=1e-5, abs=1e-4)  # includes a ridge of 1e-6


def test_held_out_residuals_equal_explicit_refits() -> None:
    problem, _ = build_synthetic_problem(5)
    used = np.ones(len(problem), bool)
    w = build_whitening(problem, ReplicateNoise(np.array([OWN]), np.zeros(1), np.zeros(1), 0.0, True), used)
    base, unit = build_base_model(problem, w, np.random.default_rng(0))
    got = FittedModel(base, problem.base, unit, problem.y).heldout()
    for g in (0, 7):
        inside = problem.group == g
        A, y = problem.base[~inside].reshape(-1, 4), problem.y[~inside].reshape(-1)
        x = np.linalg.lstsq(A, y, rcond=None)[0]
        want = problem.y[inside] - problem.base[inside] @ x
        assert np.abs(got[inside] - want).max() < 1e-10  # m; a relative ridge of 1e-9 acts on 1e-4


def test_single_group_is_not_held_out() -> None:
    problem, _ = build_synthetic_problem(5)
    problem = replace(problem, group=np.zeros(len(problem), np.int64))
    used = np.ones(len(problem), bool)
    w = build_whitening(problem, replicate_noise.estimate_replicate_noise(problem, problem.y, used), used)
    base, unit = build_base_model(problem, w, np.random.default_rng(0))
    fit = FittedModel(base, problem.base, unit, problem.y)
    assert holdout_residuals.compute_rmse(problem, fit.heldout(), used) < 0.05  # mm; far less than y itself
    assert np.array_equal(fit.heldout(), fit.residual)


def test_bounded_least_squares_agrees_with_another_solver() -> None:
    rng = np.random.default_rng(6)
    for _ in range(30):
        A, b = rng.standard_normal((12, 2)), rng.standard_normal(12)
        x, gain = minimise_bounded_quadratics((A.T @ A)[None], (A.T @ b)[None], (0.0, 0.0))
        want, _ = nnls(A, b)
        left = float(np.sum((b - A @ want) ** 2))
        assert float(b @ b - gain[0]) <= left * (1 + 1e-9) + 1e-12 or np.allclose(x[0], want, atol=1e-9)
        assert (x >= 0).all()


def test_significance_accounts_for_the_whole_search() -> None:
    """Thirty columns without an effect: the best of them has p < 1 % in one of a hundred recordings."""
    least = []
    for seed in range(40):
        rng = np.random.default_rng([7, seed])
        problem, column = build_synthetic_problem(100 + seed)
        used = np.ones(len(problem), bool)
        w = build_whitening(
            problem,
            replicate_noise.estimate_replicate_noise(problem, problem.y - problem.base @ np.full(4, 1e-4), used),
            used,
        )
        base, _ = build_base_model(problem, w, rng)
        laws = whiten_hypotheses(base, catalogue(column, rng, 29).hypotheses)
        least.append(
            compute_chance_probability(base, score_hypotheses(base, laws), base.residual, rng, flips=199).min()
        )
    # 40 uniform numbers: mean 0.5 ± 0.046; more than 7 of them are below 5 % in one of a thousand such tests
    assert 0.36 < np.mean(least) < 0.64
    assert np.sum(np.array(least) < 0.05) <= 7


@pytest.mark.parametrize("gain", [0.0, 0.004])
def test_force_noise_is_no_gain_error_of_a_cycle(gain: float) -> None:
    """Force noise acts along the displacement of each reading; the noise components add up to the variance between
    replicates."""
    made, found = [], []
    for seed in range(4):
        problem, _ = build_synthetic_problem(30 + seed, gain=0.0)
        rng = np.random.default_rng([30, seed])
        way = rng.standard_normal((GROUPS, 3))
        way *= np.sqrt(3.0) / np.linalg.norm(way, axis=1, keepdims=True)
        along = way[problem.group]  # each pose deflects along one direction
        step = np.array([0.5, 1.0, 0.5])[np.arange(len(problem)) % 3]
        scale = 8e-3 * step[:, None] * along
        residual = problem.y - problem.base @ np.full(4, 1e-4) + 10e-6 * rng.standard_normal((len(along), 1)) * along
        residual += gain * rng.standard_normal(problem.cycle.max() + 1)[problem.cycle][:, None] * scale
        n = replicate_noise.estimate_replicate_noise(
            replace(problem, scale=scale), residual, np.ones(len(problem), bool)
        )
        found.append([n.gain, n.total(0) ** 2 + n.gain**2 * np.mean(scale**2)])
        made.append(np.mean(residual**2))
    assert np.sqrt(np.mean([g**2 for g, _ in found])) == pytest.approx(gain, abs=0.0011)
    assert np.mean([p for _, p in found]) == pytest.approx(np.mean(made), rel=0.1)


def test_repeatable_power_is_the_shared_part_of_replicates() -> None:
    problem, column = build_synthetic_problem(8, extra=30e-6)
    used = np.ones(len(problem), bool)
    residual = problem.y - problem.base @ np.full(4, 1e-4)
    n = replicate_noise.estimate_replicate_noise(problem, residual, used)
    there = repeatable_mismatch.measure_repeatable_mismatch(problem, residual, used, n, np.random.default_rng(0))
    share = 30e-6 * float(np.sqrt(np.mean(column**2)))
    # 144 pairs of visits with noise of 18 µm next to a mismatch of 30 µm
    assert np.sqrt(there.power) == pytest.approx(share, rel=0.12)
    assert there.p_value <= 0.002
    gone = repeatable_mismatch.measure_repeatable_mismatch(
        problem, residual - 30e-6 * column[:, :, 0], used, n, np.random.default_rng(0)
    )
    assert gone.p_value > 0.01
    assert gone.power < 0.1 * there.power


def few_poses(seed: int, poses: int = 18, unknowns: int = 20) -> tuple[DiagnosisProblem, FittedModel]:
    """Build a problem without an effect: three coordinates, two visits per pose, and about as many unknowns as
    poses."""
    rng = np.random.default_rng([77, seed])
    X = np.tile(rng.standard_normal((poses, 3, unknowns)), (2, 1, 1))
    y, group = OWN * rng.standard_normal((2 * poses, 3)), np.tile(np.arange(poses), 2)
    visit = np.arange(2 * poses)
    names = tuple(BaseUnknown(name=f"x{k}", unit="m") for k in range(unknowns))
    family, session = (
        (CoordinateFamily(name="translation", columns=(0, 1, 2), unit="mm", factor=1e3),),
        np.repeat([0, 1], poses),
    )
    problem = DiagnosisProblem(
        channel="position",
        y=y,
        base=X,
        unknowns=names,
        families=family,
        group=group,
        visit=visit,
        cycle=visit,
        session=session,
        replicate=group,
        line=visit + 2,
        row=visit + 1,
    )
    w = build_whitening(
        problem, ReplicateNoise(np.array([OWN]), np.zeros(1), np.zeros(1), 0.0, True), np.ones(2 * poses, bool)
    )
    model, unit = build_base_model(problem, w, rng)
    return problem, FittedModel(model, X, unit, y)


def test_replicates_share_the_prediction_error() -> None:
    problem, fit = few_poses(0)
    own = fit.compute_prediction_noise()
    assert own is not None
    of = np.flatnonzero(problem.group == 4)
    X, rest = problem.base, problem.group != 4
    A = X[rest].reshape(-1, X.shape[2])
    S = OWN**2 * np.linalg.inv(A.T @ A)
    one, two = (own.compute_mean_error(np.array([k]), (0, 2)) for k in of)
    assert one @ two == pytest.approx(np.trace(X[of[0]][[0, 2]] @ S @ X[of[1]][[0, 2]].T), rel=1e-6)


def test_prediction_error_is_no_repeatable_mismatch() -> None:
    """Eighteen poses, twenty unknowns: the prediction error repeats in both visits of a pose like a model error."""
    found = []
    for seed in range(20):
        problem, fit = few_poses(seed)
        n, used = ReplicateNoise(np.array([OWN]), np.zeros(1), np.zeros(1), 0.0, True), np.ones(len(problem), bool)
        for own in (None, fit.compute_prediction_noise()):
            rng = np.random.default_rng(seed)
            there = repeatable_mismatch.measure_repeatable_mismatch(problem, fit.heldout(), used, n, rng, own)
            found.append([there.power / OWN**2, there.p_value <= 0.005])
    alone, apart = (np.mean(found[k::2], axis=0) for k in (0, 1))
    assert alone[0] > 0.25  # prediction error of 20 unknowns from 108 coordinates, at poses that the fit has not used
    assert alone[1] >= 0.1  # the nominal false positive rate is one in 200
    assert abs(apart[0]) < 0.1
    assert apart[1] == 0.0


def test_stated_noise_is_the_only_evidence_without_replicates() -> None:
    problem, _ = build_synthetic_problem(9)
    problem = replace(problem, replicate=np.full(len(problem), -1))
    used = np.ones(len(problem), bool)
    residual = problem.y - problem.base @ np.full(4, 1e-4)
    n = replicate_noise.estimate_replicate_noise(problem, residual, used)
    rng = np.random.default_rng(0)
    assert repeatable_mismatch.measure_repeatable_mismatch(problem, residual, used, n, rng).power <= 0
    for stated, beyond in ((15e-6, False), (3e-6, True)):
        message = replace(problem, families=(replace(problem.families[0], stated_uncertainty=stated),))
        assert (repeatable_mismatch.measure_repeatable_mismatch(message, residual, used, n, rng).power > 0) is beyond


def test_effect_is_named_at_its_place_within_its_interval() -> None:
    inside = 0
    for seed in range(8):
        rng = np.random.default_rng([3, seed])
        problem, column = build_synthetic_problem(200 + seed, extra=12e-6)
        d = selection_pipeline.diagnose_problem(
            problem, catalogue(column, rng), selection_pipeline.DiagnosisOptions(), rng
        )
        assert [(f.effect, f.location) for f in d.findings] == [("wind", "arm")]
        assert d.verdict == "explained"
        assert d.findings[0].after < d.findings[0].before
        size = d.findings[0].parameters["size"]
        inside += size.ci90[0] <= 12.0 <= size.ci90[1]
        assert size.ci95[0] <= size.ci90[0] <= size.value <= size.ci90[1] <= size.ci95[1]
    assert inside >= 5  # of eight; at 90 % coverage fewer occur in one of 400 such tests


def test_nothing_is_named_without_an_effect() -> None:
    for seed in range(8):
        rng = np.random.default_rng([4, seed])
        problem, column = build_synthetic_problem(300 + seed)
        d = selection_pipeline.diagnose_problem(
            problem, catalogue(column, rng, 40), selection_pipeline.DiagnosisOptions(), rng
        )
        assert d.findings == ()
        assert d.verdict == "consistent"
        assert d.heldout_after == d.heldout_before


def test_unexplained_mismatch_is_reported() -> None:
    rng = np.random.default_rng(5)
    problem, column = build_synthetic_problem(400, extra=40e-6)
    nothing = HypothesisCatalogue(
        tuple(law(rng.standard_normal(column.shape), f"rival {k}", f"place {k}") for k in range(20))
    )
    d = selection_pipeline.diagnose_problem(problem, nothing, selection_pipeline.DiagnosisOptions(), rng)
    assert d.verdict == "unexplained"
    assert d.findings == ()
    assert d.repeatable > 0.5 * d.heldout_before
    assert d.mismatch_p < 0.005


def test_two_equal_columns_are_reported_as_one_set() -> None:
    rng = np.random.default_rng(6)
    problem, column = build_synthetic_problem(401, extra=20e-6)
    twin = column + 0.02 * rng.standard_normal(column.shape)
    laws = (law(column), law(twin, "draught", "hall"), law(rng.standard_normal(column.shape), "x", "y"))
    d = selection_pipeline.diagnose_problem(
        problem, HypothesisCatalogue(laws), selection_pipeline.DiagnosisOptions(), rng
    )
    assert len(d.findings) == 1
    assert set(d.findings[0].one_of) == {("wind", "arm"), ("draught", "hall")}
    limit = next(x for x in d.limits if x.effect == "wind")
    assert limit.standing == "only as a set"
    assert ("draught", "hall") in limit.one_of


def test_detection_limit_is_where_effects_begin_to_be_named() -> None:
    rng = np.random.default_rng(7)
    problem, column = build_synthetic_problem(500)
    d = selection_pipeline.diagnose_problem(problem, catalogue(column, rng), selection_pipeline.DiagnosisOptions(), rng)
    limit = next(x.value for x in d.limits if x.effect == "wind") * 1e-6
    named = {0.4: 0, 1.3: 0}
    for share in named:
        for seed in range(5):
            problem, column = build_synthetic_problem(510 + seed, extra=share * limit)
            d = selection_pipeline.diagnose_problem(
                problem, catalogue(column, rng), selection_pipeline.DiagnosisOptions(), np.random.default_rng(seed)
            )
            named[share] += any(f.effect == "wind" for f in d.findings)
    assert named[0.4] == 0  # noncentrality 2.7 where 5.5 is required
    assert named[1.3] >= 4  # nine of ten at the detection limit, nearly all above it


def test_detection_limit_is_not_below_the_least_size_with_a_name() -> None:
    for extra, is_named in ((0.0, False), (36e-6, False), (50e-6, True)):
        rng = np.random.default_rng(8)
        problem, column = build_synthetic_problem(501, extra=extra)
        laws = HypothesisCatalogue((replace(law(column), least_size=40.0),))
        d = selection_pipeline.diagnose_problem(problem, laws, selection_pipeline.DiagnosisOptions(), rng)
        assert bool(d.findings) == is_named
        limit = next(x.value for x in d.limits if x.effect == "wind")
        assert 40.0 < limit < 45.0  # 90 % power: 1.28 standard errors above the smallest size


def test_same_seed_gives_the_same_diagnosis() -> None:
    results = []
    for _ in range(2):
        problem, column = build_synthetic_problem(600, extra=12e-6)
        d = selection_pipeline.diagnose_problem(
            problem,
            catalogue(column, np.random.default_rng(1)),
            selection_pipeline.DiagnosisOptions(),
            np.random.default_rng(2),
        )
        results.append((d.sentence, d.heldout_after, d.mismatch_p, [x.value for x in d.limits], d.errors.final))
    assert results[0][:4] == results[1][:4]
    assert np.array_equal(results[0][4], results[1][4])


def test_finding_is_judged_by_readings_with_its_own_effect_only() -> None:
    """K_C is tested on readings to which its effect is added back; with the products of other readings its p-value
    was 1e-307."""
    problem, column = build_synthetic_problem(3, extra=40e-6)
    w = build_whitening(
        problem, ReplicateNoise(np.array([OWN]), np.zeros(1), np.zeros(1), 0.0, True), np.ones(len(problem), bool)
    )
    base, _ = build_base_model(problem, w, np.random.default_rng(0))
    (one,) = whiten_hypotheses(base, [law(column)])
    grown, plain = base.with_law(one, 0), base.with_columns(one.columns_at(0))
    np.testing.assert_allclose(grown.Xy, plain.Xy)
    np.testing.assert_allclose(grown.rss, plain.rss, rtol=1e-9)
    other, _ = build_base_model(replace(problem, y=2.0 * problem.y), w, np.random.default_rng(0))
    with pytest.raises(ValueError, match="with_columns would work"):
        other.with_law(one, 0)


def test_cached_extended_models_equal_those_built_stepwise() -> None:
    problem, column = build_synthetic_problem(7, extra=12e-6)
    rng = np.random.default_rng(7)
    n = ReplicateNoise(np.array([OWN]), np.array([CYCLE]), np.array([VISIT]), GAIN, True)
    base, _ = build_base_model(problem, build_whitening(problem, n, np.ones(len(problem), bool)), rng)
    prior = replace(law(rng.standard_normal(column.shape), "known"), prior_sigma=1e-6)
    laws = [(t, 0) for t in whiten_hypotheses(base, [*catalogue(column, rng).hypotheses, prior])]
    assert base.extend_by_laws([]) is base
    pair = base.extend_by_laws(laws[-2:])
    assert base.extend_by_laws(laws[-2:]) is pair
    step = base.with_law(*laws[-2], with_prior=True).with_law(*laws[-1], with_prior=True)
    for a, b in ((pair.XX, step.XX), (pair.Xy, step.Xy), (pair.prior, step.prior), (pair.X, step.X)):
        np.testing.assert_array_equal(a, b)
    for k in range(len(laws)):
        base.extend_by_laws(laws[: k + 1])
    assert base.extend_by_laws(laws[-2:]) is pair  # small models are all cached, up to a number
    for a in laws:
        for b in laws:
            base.extend_by_laws([a, b])
    assert len(base.extensions) == normal_equations_by_fold.MOST_EXTENSIONS
    assert base.extend_by_laws(laws[-2:]) in base.extensions.values()


@pytest.mark.parametrize("seed", range(4))
def test_selected_law_is_the_best_of_all_significant_ones(seed: int) -> None:
    """Reference: an explicit implementation of the rule, with every law cross-validated and tested."""
    rng = np.random.default_rng(seed)
    problem, column = build_synthetic_problem(seed, extra=8e-6)
    n = ReplicateNoise(np.array([OWN]), np.array([CYCLE]), np.array([VISIT]), GAIN, True)
    base, _ = build_base_model(problem, build_whitening(problem, n, np.ones(len(problem), bool)), rng)
    alike = [law(column + 0.3 * k * rng.standard_normal(column.shape), f"like {k}") for k in range(1, 5)]
    wide = law(np.concatenate([column, rng.standard_normal(column.shape)], axis=2), "wide")
    laws = whiten_hypotheses(base, [*catalogue(column, rng, 8).hypotheses, *alike, wide])
    scored = [s for s in score_hypotheses(base, laws) if candidate_checks.is_supported(base, s)]
    quiet = max(1.0, (base.rss - max(s.gain for s in scored)) / (len(base.y) - base.count))

    def worth(s: ScoredHypothesis) -> float:
        more = s.whitened.X.shape[2] - 1
        return s.total - min(
            thresholds.LEVELS.gain_two_sigma * more * base.residual_variance,
            thresholds.LEVELS.gain_three_sigma * more * quiet,
        )

    best = forward_selection._select_supported_law(base, fit_hypotheses(base, laws))
    assert best is max(scored, key=worth)
    nothing = [f for f in fit_hypotheses(base, laws) if f.whitened.hypothesis.effect.startswith("rival")]
    assert forward_selection._select_supported_law(base, nothing) is None


@pytest.mark.slow
def test_cached_search_equals_a_new_one(monkeypatch: pytest.MonkeyPatch) -> None:
    problem, column = build_synthetic_problem(201, extra=12e-6)
    offered = catalogue(column, np.random.default_rng(1), 4)
    cache, runs = SearchCache(), []
    search = selection_pipeline.search_iteratively

    def count(*given: Any) -> SearchState:
        runs.append(1)
        return search(*given)

    monkeypatch.setattr(selection_pipeline, "search_iteratively", count)

    def run(searches: SearchCache | None, key: str = "same") -> DiagnosisResult:
        options = selection_pipeline.DiagnosisOptions(max_effects=3, searches=searches)
        return selection_pipeline.diagnose_problem(problem, offered, options, np.random.default_rng(5), key=key)

    first, again = run(cache), run(cache)
    assert len(runs) == 1
    new = run(None)
    assert len(runs) == 2
    for other in (again, new):
        assert (other.verdict, other.heldout_after) == (first.verdict, first.heldout_after)
        assert [(f.effect, f.p_value, f.parameters) for f in other.findings] == [
            (f.effect, f.p_value, f.parameters) for f in first.findings
        ]
        assert repr(other.proof) == repr(first.proof)
    state = cache.find_state("same")
    assert state is not None
    assert cache.find_state("other") is None
    size = search_cache._measure_bytes(state.whitened_hypotheses[0])
    assert size > state.whitened_hypotheses[0].X.nbytes  # the size includes the products
    total = sum(search_cache._measure_bytes(t) for t in state.whitened_hypotheses)
    monkeypatch.setattr(search_cache, "MAX_CACHED_BYTES", int(1.5 * total))  # space for one state
    cache.store_state("second", state)
    assert cache.find_state("same") is None
    assert cache.find_state("second") is state
    monkeypatch.setattr(search_cache, "MAX_CACHED_BYTES", total - 1)  # space for none
    cache.store_state("third", state)
    assert cache.find_state("third") is None
    cache.clear()
    assert cache.find_state("second") is None
