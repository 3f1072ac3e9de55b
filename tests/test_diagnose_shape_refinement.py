"""Refinement of shapes between grid values, and their intervals."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from machopt.effects.joint.harmonic_functions import HarmonicSeries, compute_harmonics
from machopt.measurement.diagnosis.data_types.diagnosis_problem import (
    BaseUnknown,
    CoordinateFamily,
    DiagnosisProblem,
    EffectHypothesis,
    Quantity,
    Shape,
    ShapeRefinement,
)
from machopt.measurement.diagnosis.data_types.diagnosis_result import EstimatedValue
from machopt.measurement.diagnosis.model_selection.evaluation.finding_estimates import estimate_parameters
from machopt.measurement.diagnosis.model_selection.screening.hypothesis_screening import (
    compute_gain_by_shape,
    score_hypotheses,
)
from machopt.measurement.diagnosis.model_selection.search.selected_effect import SelectedEffect
from machopt.measurement.diagnosis.model_selection.search.shape_refinement import (
    CUT_INTERVAL_NOTE,
    GAIN_ROUNDING,
    _select_middle_shape,
    build_ratio_refinement,
    build_two_number_refinement,
    compute_likelihood_margin,
    refine_law_shape,
)
from machopt.measurement.diagnosis.statistics.normal_equations_by_fold import WhitenedModel, build_base_model
from machopt.measurement.diagnosis.statistics.replicate_noise import ReplicateNoise
from machopt.measurement.diagnosis.statistics.whitened_hypothesis import whiten_hypotheses
from machopt.measurement.diagnosis.statistics.whitening import build_whitening
from machopt.numerics.array_types import Array

GRID: tuple[Shape, ...] = ((0.5,), (0.75,), (1.1,), (1.6,))
SIGMA = 1e-3


def estimate_step(x: Array, true: float, seed: int, size: float = 8.0) -> tuple[float, EstimatedValue]:
    """Return the estimated position of a step of readings (N,) at x = ``true``, and its interval."""
    base, found = fit_step(x, true, seed, size)
    return found.whitened.shapes[found.scored.shape][0], estimate_parameters(base, [found], 0, [found.whitened])["at"]


def fit_step(x: Array, true: float, seed: int, size: float) -> tuple[WhitenedModel, SelectedEffect]:
    """Return the base, and the refined fit of a step with a height of ``size`` times the noise."""
    rng, n = np.random.default_rng(seed), len(x)
    at = np.arange(n)
    problem = DiagnosisProblem(
        channel="position",
        y=((x > true) * size * SIGMA + SIGMA * rng.normal(size=n))[:, None],
        base=np.ones((n, 1, 1)),
        unknowns=(BaseUnknown(name="a", unit="m"),),
        families=(CoordinateFamily(name="translation", columns=(0,), unit="mm", factor=1e3),),
        group=at % 30,
        visit=at % 30,
        cycle=at % 30,
        session=np.zeros(n, np.int64),
        replicate=np.full(n, -1),
        line=at + 2,
        row=at + 1,
    )

    def told(c: Array, shape: Shape) -> dict[str, Quantity]:
        return {"step": Quantity(float(c[0]), "m"), "at": Quantity(float(shape[0]), "1")}

    law = EffectHypothesis(
        effect="made up",
        location="joint:1",
        law="step",
        equation="",
        columns=lambda shape: (x > shape[0]).astype(float)[:, None, None],
        quantities=told,
        shapes=GRID,
        family="joint",
        refinement=build_ratio_refinement(GRID),
        is_exact=True,
    )
    w = build_whitening(
        problem, ReplicateNoise(np.array([SIGMA]), np.zeros(1), np.zeros(1), 0.0, True), np.ones(n, bool)
    )
    base, _ = build_base_model(problem, w, np.random.default_rng(0))
    first = whiten_hypotheses(base, [law])[0]
    assert law.refinement is not None
    return base, refine_law_shape(base, base, SelectedEffect(score_hypotheses(base, [first])[0], 0.0), law.refinement)


@pytest.mark.parametrize("true", [0.83, 0.87, 0.97, 1.03])
def test_interval_of_a_step_reaches_both_neighbouring_readings(true: float) -> None:
    """Readings are 0.05 apart: they contain no information about the position between two of them."""
    x = np.repeat(np.arange(0.0, 2.0, 0.05), 30)
    value, output = estimate_step(x, true, 1)
    low, high = (0.05 * f(true / 0.05) for f in (np.floor, np.ceil))
    assert output.ci95[0] == pytest.approx(low, abs=1e-3)
    assert output.ci95[1] == pytest.approx(high, abs=1e-3)
    assert low + 0.01 < value < high - 0.01


def test_interval_of_a_smooth_shape_is_narrow_and_covers() -> None:
    """Uniformly distributed readings: the interval is one or two readings wide and contains the true value."""
    x = np.random.default_rng(5).uniform(0.0, 2.0, 1200)
    _, output = estimate_step(x, 0.9, 2)
    assert output.ci95[0] <= 0.9 <= output.ci95[1]
    assert output.ci95[1] - output.ci95[0] < 0.02


@pytest.mark.parametrize("true", [0.6, 0.97, 1.4])
def test_interval_ends_by_likelihood_not_by_the_grid(true: float) -> None:
    """A step of 0.4 times the noise cannot be located better than a grid step."""
    x = np.random.default_rng(5).uniform(0.0, 2.0, 400)
    for seed in range(30):
        base, found = fit_step(x, true, seed, 0.4)
        law, h = found.whitened, found.whitened.hypothesis
        assert h.refinement is not None
        if CUT_INTERVAL_NOTE in h.note:
            continue
        ends = min(law.shapes)[0], max(law.shapes)[0]
        fine = [
            (float(e * f),)
            for e, way in zip(ends, (-1.0, 1.0), strict=True)
            for f in 1.5 ** (way * np.arange(21) / 400.0)
        ]
        gain = compute_gain_by_shape(
            base, whiten_hypotheses(base, [replace(h, shapes=((law.shapes[found.scored.shape]), *fine))])[0]
        )
        least = gain[0] - compute_likelihood_margin(h) * max((base.rss - gain[0]) / (len(base.y) - base.count - 1), 1.0)
        assert gain[1:22].min() <= least, seed  # within a twentieth of a grid step
        assert gain[22:].min() <= least, seed


def test_interval_truncated_by_the_law_range_is_marked() -> None:
    """No reading lies below a third of the largest x, so the data contain no information beyond that."""
    x = np.random.default_rng(5).uniform(0.0, 2.0, 1200)
    _, found = fit_step(np.where(x < 0.7, 0.2, x), 0.4, 1, 8.0)
    assert CUT_INTERVAL_NOTE in found.whitened.hypothesis.note
    assert min(found.whitened.shapes)[0] == pytest.approx(0.5 / 1.5)


def test_equivalent_shapes_are_judged_by_absolute_loss() -> None:
    """A relative tolerance of one millionth of a gain of 1e7 exceeds the loss that an equivalent shape may have."""
    observed = {(1.0,): 1e7, (1.1,): 1e7 - 9.0, (1.2,): 1e7 - 9.5}
    assert max(observed.values()) * GAIN_ROUNDING > 9.5
    assert _select_middle_shape(list(observed), observed) == (1.0,)


def test_cached_waves_equal_computed_ones() -> None:
    angle = np.random.default_rng(1).uniform(-6.0, 6.0, 500)
    turning = HarmonicSeries(angle)
    for orders in ((1.0,), (7.0, 14.0), (200.0,), (2.5,), (0.5, 1.0)):
        np.testing.assert_allclose(turning.compute(orders), compute_harmonics(angle, orders), atol=1e-12)


def test_two_parameter_shape_is_refined_and_its_intervals_cover() -> None:
    """A soft sector with a grid of five centres and three widths; intervals had zero width."""
    grid = tuple((float(q), w) for q in np.linspace(-1.0, 1.0, 5) for w in (0.15, 0.3, 0.6))
    finer = build_two_number_refinement(grid)
    assert finer is not None
    fixed, draws = np.zeros(2), 40
    for seed in range(draws):
        rng = np.random.default_rng(seed)
        true = rng.uniform(-0.6, 0.6), rng.uniform(0.2, 0.45)
        x = rng.uniform(-1.2, 1.2, 400)
        y = 3.0 * SIGMA * np.exp(-0.5 * ((x - true[0]) / true[1]) ** 2) + SIGMA * rng.normal(size=len(x))
        base, law = _bump(x, y, grid, finer)
        first = whiten_hypotheses(base, [law])[0]
        found = refine_law_shape(base, base, SelectedEffect(score_hypotheses(base, [first])[0], 0.0), finer)
        parameters = estimate_parameters(base, [found], 0, [found.whitened])
        for n, name in enumerate(("at", "wide")):
            low, high = parameters[name].ci95
            assert 0.0 < high - low < 0.5
            fixed[n] += low <= true[n] <= high
    assert (fixed >= 0.85 * draws).all()  # of 95 %: 34 or fewer of 40 in one of 600 draws


@pytest.mark.parametrize("seed", range(30))
def test_shape_at_the_end_of_the_joint_range_is_valid(seed: int) -> None:
    """The width of a soft sector passed through zero, because width −w gives the same shape; its centre left the
    joint range."""
    rng = np.random.default_rng(seed)
    poses = rng.uniform(-1.2, 1.2, 14)
    low, high = float(poses.min()), float(poses.max())
    grid = tuple((float(q), w * (high - low)) for q in np.linspace(low, high, 6) for w in (0.08, 0.16, 0.3))
    finer = build_two_number_refinement(grid)
    assert finer is not None
    true = rng.choice([low, high, rng.uniform(low, high)]), rng.uniform(0.1, 0.6)
    x = np.repeat(poses, 20)
    y = 2.0 * SIGMA * np.exp(-0.5 * ((x - true[0]) / true[1]) ** 2) + SIGMA * rng.normal(size=len(x))
    base, law = _bump(x, y, grid, finer)
    first = whiten_hypotheses(base, [law])[0]
    found = refine_law_shape(base, base, SelectedEffect(score_hypotheses(base, [first])[0], 0.0), finer)
    parameters = estimate_parameters(base, [found], 0, [found.whitened])
    ends = np.array([parameters["at"].ci95, parameters["wide"].ci95])
    assert low <= ends[0, 0] <= ends[0, 1] <= high
    assert min(s[1] for s in grid) <= ends[1, 0] <= ends[1, 1] <= max(s[1] for s in grid)
    at_end = any(
        value in limits for value, limits in zip(ends.ravel(), np.repeat(finer.search_ranges, 2, axis=0), strict=True)
    )
    assert (CUT_INTERVAL_NOTE in found.whitened.hypothesis.note) or not at_end


def test_nonproduct_grid_is_not_refined() -> None:
    assert build_two_number_refinement(((1.0, 2.0),)) is None
    assert build_two_number_refinement(((1.0, 2.0), (2.0, 3.0), (3.0, 4.0))) is None
    assert build_two_number_refinement(((1.0,), (2.0,))) is None


def _bump(
    x: Array, y: Array, grid: tuple[Shape, ...], finer: ShapeRefinement
) -> tuple[WhitenedModel, EffectHypothesis]:
    """Return the base and the law of a bump."""
    n = len(x)
    at = np.arange(n)
    problem = DiagnosisProblem(
        channel="position",
        y=y[:, None],
        base=np.ones((n, 1, 1)),
        unknowns=(BaseUnknown(name="a", unit="m"),),
        families=(CoordinateFamily(name="translation", columns=(0,), unit="mm", factor=1e3),),
        group=at % 30,
        visit=at % 30,
        cycle=at % 30,
        session=np.zeros(n, np.int64),
        replicate=np.full(n, -1),
        line=at + 2,
        row=at + 1,
    )
    law = EffectHypothesis(
        effect="made up",
        location="joint:1",
        law="bump",
        equation="",
        columns=lambda s: np.exp(-0.5 * ((x - s[0]) / s[1]) ** 2)[:, None, None],
        quantities=lambda c, s: {
            "size": Quantity(float(c[0]), "m"),
            "at": Quantity(float(s[0]), "1"),
            "wide": Quantity(float(s[1]), "1"),
        },
        shapes=grid,
        family="joint",
        refinement=finer,
        is_exact=True,
    )
    w = build_whitening(
        problem, ReplicateNoise(np.array([SIGMA]), np.zeros(1), np.zeros(1), 0.0, True), np.ones(n, bool)
    )
    return build_base_model(problem, w, np.random.default_rng(0))[0], law
