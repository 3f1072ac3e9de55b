"""Zero offsets over all joint subsets, compared by the log predictive score on held-out folds."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from scipy.stats import multivariate_normal
from test_diagnose_multiple_effects import MANY, SIGMA, N, build_hypothesis, model

from machopt.measurement.diagnosis.data_types.diagnosis_problem import Quantity
from machopt.measurement.diagnosis.model_selection.search import predictive_score, search_stages
from machopt.measurement.diagnosis.statistics.normal_equations_by_fold import WhitenedModel, build_whitened_model
from machopt.measurement.diagnosis.statistics.whitened_hypothesis import WhitenedHypothesis, whiten_hypotheses
from machopt.numerics.array_types import Array

ZEROS = [f"joint:{j}" for j in range(1, 7)]


def with_zeros(planted: dict[str, float], seed: int) -> tuple[WhitenedModel, list[WhitenedHypothesis]]:
    """Build a base of noise with six zero offsets; each joint frame contains its zero offset and five other
    directions."""
    base, _ = model({}, seed)
    rng = np.random.default_rng([seed, 7])
    zero = {place: rng.normal(size=(N, 3, 1)) for place in ZEROS}

    frame = {p: np.concatenate([zero[p], 0.5 * rng.normal(size=(N, 3, 5))], axis=2) for p in ZEROS}

    def deg(x: Array, _: object) -> dict[str, Quantity]:
        return {"offset": Quantity(1e-3 * float(x[0]), "deg")}

    offsets = [
        replace(
            build_hypothesis("joint_zero_offset", p, lambda s, c=zero[p]: c, ((),), "kinematic"),
            quantities=deg,
            law="constant angle",
        )
        for p in ZEROS
    ]
    frames = [build_hypothesis("geometry", p, lambda s, c=frame[p]: c, ((),), "kinematic") for p in ZEROS]
    signal = np.zeros((N, 3))
    for place, size in planted.items():
        signal += size * SIGMA * zero[place][:, :, 0]
    y = base.y + base.w.whiten(signal)
    changed = build_whitened_model(base.w, base.X, y, base.fold, base.prior, base.rows)
    return changed, whiten_hypotheses(changed, [*offsets, *frames])


def test_score_is_the_log_density_of_each_fold_given_the_others() -> None:
    base, laws = model(MANY, 5)
    whole = base.with_law(laws[0], 0, with_prior=True)
    X, y = whole.X, whole.y
    N_all = X.T @ X + np.diag(whole.prior)
    variance = (y @ y - (X.T @ y) @ np.linalg.solve(N_all, X.T @ y)) / (len(y) - whole.count)
    expected = 0.0
    for rows in whole.rows:
        rest = np.setdiff1d(np.arange(len(y)), rows)
        N_rest = X[rest].T @ X[rest] + np.diag(whole.prior)
        mean = X[rows] @ np.linalg.solve(N_rest, X[rest].T @ y[rest])
        S = variance * (np.eye(len(rows)) + X[rows] @ np.linalg.solve(N_rest, X[rows].T))
        expected += multivariate_normal(mean, S).logpdf(y[rows]) + 0.5 * len(rows) * np.log(2.0 * np.pi)
    one = [search_stages.SelectedEffect(s, 1.0) for s in search_stages.score_hypotheses(base, [laws[0]])]
    found = predictive_score.compute_set_score(base, [replace(one[0], scored=replace(one[0].scored, shape=0))])
    shapes = 0.5 * len(laws[0].shapes[0]) * np.log(len(y)) + 0.5 * whole.prior @ whole.coefficients**2
    assert found == pytest.approx(expected - shapes, rel=1e-6)


@pytest.mark.parametrize(
    ("planted", "seed"),
    [
        ({"joint:2": 1.0, "joint:3": -0.8, "joint:4": 1.2, "joint:5": 0.9}, 11),
        ({"joint:1": 0.7, "joint:6": 0.7}, 12),
        ({"joint:3": -2.0, "joint:4": 3.0, "joint:5": 0.5}, 13),
    ],
)
def test_exactly_the_planted_offsets_are_selected(planted: dict[str, float], seed: int) -> None:
    base, laws = with_zeros(planted, seed)
    found = predictive_score.select_zero_offsets(base, laws)
    assert {c.whitened.hypothesis.location for c in found} == set(planted)
    _, chosen = search_stages.search_effects(base, laws, 3, np.random.default_rng(0), 1.0)
    assert {c.whitened.hypothesis.name for c in chosen} == {("joint_zero_offset", p) for p in planted}


@pytest.mark.parametrize("seed", range(5))
def test_no_offset_is_selected_in_noise(seed: int) -> None:
    base, laws = with_zeros({}, 20 + seed)
    assert predictive_score.select_zero_offsets(base, laws) == []


def test_unnecessary_effect_is_removed() -> None:
    base, laws = with_zeros({"joint:2": 1.0, "joint:5": 1.0}, 31)
    three = [t for t in laws if t.hypothesis.effect == "joint_zero_offset" and t.hypothesis.location[-1] in "256"]
    found = [search_stages.SelectedEffect(s, 1.0) for s in search_stages.score_hypotheses(base, three)]
    left = predictive_score.drop_unpredictive_effects(base, predictive_score.score_together(base, found))
    assert {c.whitened.hypothesis.location for c in left} == {"joint:2", "joint:5"}
