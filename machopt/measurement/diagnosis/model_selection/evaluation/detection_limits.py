"""Detection limits: the smallest size of each effect that this recording would have shown, and its confounded
effects.

An effect is reported from a gain of ``compute_least_gain`` and a size of ``least_size`` on. A noncentrality that is
larger by 1.28 reaches both with 90 % probability. The required size follows from the design: the effect's columns
after projection by the base.
"""

from __future__ import annotations

from collections.abc import Collection, Sequence

import numpy as np

from machopt.measurement import thresholds
from machopt.measurement.diagnosis.data_types.diagnosis_problem import Quantity
from machopt.measurement.diagnosis.data_types.diagnosis_result import DetectionLimit, EffectLocation, Testability
from machopt.measurement.diagnosis.model_selection.screening.hypothesis_screening import minimise_bounded_quadratics
from machopt.measurement.diagnosis.model_selection.search.candidate_checks import compute_least_gain
from machopt.measurement.diagnosis.statistics.normal_equations_by_fold import (
    MIN_COLUMN_SQUARE,
    WhitenedModel,
    invert_with_ridge,
)
from machopt.measurement.diagnosis.statistics.whitened_hypothesis import WhitenedHypothesis
from machopt.numerics.array_types import Array

DIRECTIONS = 8
MOST_SHAPES = 6


def compute_detection_limits(
    model: WhitenedModel, tried: Sequence[WhitenedHypothesis], rng: np.random.Generator, of: Collection[EffectLocation]
) -> list[DetectionLimit]:
    """Compute one detection limit per effect and place, for its first law.

    Args:
        model: Base model, including the findings.
        tried: All whitened hypotheses.
        rng: Random generator of coefficient directions.
        of: Effects and places with a limit; the others are only candidates for confusion.

    Returns:
        The limits.
    """
    M = invert_with_ridge(model.normal)
    first: dict[EffectLocation, tuple[WhitenedHypothesis, int]] = {}
    values: dict[EffectLocation, float] = {}
    units: dict[EffectLocation, str] = {}
    signals: dict[EffectLocation, Array] = {}
    out: list[DetectionLimit] = []
    for t in tried:
        name = t.hypothesis.name
        if name in first or name not in of:
            continue
        first[name] = (t, 0)
        needed = np.sqrt(compute_least_gain(model, t) * model.residual_variance)
        power = thresholds.LEVELS.power_quantile * np.sqrt(model.residual_variance)
        sizes: list[float] = []
        for s in _select_spread_indices(len(t.shapes)):
            C = t.products_with(model)[s]
            rest = t.columns_at(s) - model.X @ (M @ C.T)
            own = t.XX[:, s].sum(axis=0)
            S, whole = own - C @ M @ C.T, np.diag(own)  # as in the search: unknowns with a prior absorb less
            if np.all(np.diag(S) < thresholds.SHARES.absorbed_power * whole):
                continue
            for x in _draw_coefficient_directions(t, s, rng):
                n = float(np.sqrt(max(x @ S @ x, 0.0)))
                if n <= 1e-9 * float(np.sqrt(whole.max())):
                    continue
                least = x * (needed + power) / n
                if t.hypothesis.least_size:  # a size that is linear in the coefficients
                    named = t.hypothesis.least_size * n / abs(_compute_size(t, s, x).value)
                    least = x * (max(needed, named) + power) / n
                quantity = _compute_size(t, s, least)
                sizes.append(abs(quantity.value))
                units[name] = quantity.unit
                if name not in signals or len(sizes) == 1:
                    signals[name] = rest @ least
                    first[name] = (t, s)
        if sizes and np.isfinite(np.median(sizes)):
            values[name] = float(np.median(sizes))
        else:
            unit = _compute_size(t, 0, np.ones(t.X.shape[2])).unit
            effect, location = name
            out.append(
                DetectionLimit(effect=effect, location=location, value=float("nan"), unit=unit, standing="not testable")
            )
    if signals:
        sets = _find_confounded_effects(model, M, tried, signals)
        for name, value in values.items():
            (effect, location), one_of = name, tuple(sets[name])
            standing: Testability = "only as a set" if one_of else "testable"
            out.append(
                DetectionLimit(
                    effect=effect, location=location, value=value, unit=units[name], standing=standing, one_of=one_of
                )
            )
    return out


def _find_confounded_effects(
    model: WhitenedModel, M: Array, tried: Sequence[WhitenedHypothesis], signals: dict[EffectLocation, Array]
) -> dict[EffectLocation, list[EffectLocation]]:
    """Return for each effect at twice its limit the other effects that absorb it."""
    names = list(signals)
    V = 2.0 * np.stack([signals[n] for n in names], axis=1)  # (M, K), orthogonal to the base
    whole = np.einsum("mk,mk->k", V, V)
    best: dict[EffectLocation, Array] = {}
    for t in tried:
        taken = np.zeros(len(names))
        for s in _select_spread_indices(len(t.shapes)):
            XX, C = t.XX[:, s].sum(axis=0), t.products_with(model)[s]
            S = XX - C @ M @ C.T + np.diag(1e-6 * np.diag(XX) + MIN_COLUMN_SQUARE)
            U = t.columns_at(s).T @ V
            _, gain = minimise_bounded_quadratics(np.broadcast_to(S, (len(names), *S.shape)), U.T, t.hypothesis.lower)
            if t.hypothesis.lower:  # else both signs gain the same
                _, other = minimise_bounded_quadratics(
                    np.broadcast_to(S, (len(names), *S.shape)), -U.T, t.hypothesis.lower
                )
                gain = np.maximum(gain, other)
            taken = np.maximum(taken, gain)
        name = t.hypothesis.name
        best[name] = np.maximum(best.get(name, np.zeros(len(names))), taken)
    return {
        n: [
            o
            for o in best
            if o != n and whole[k] - best[o][k] < thresholds.LEVELS.gain_three_sigma * model.residual_variance
        ]
        for k, n in enumerate(names)
    }


def _compute_size(t: WhitenedHypothesis, shape: int, x: Array) -> Quantity:
    """Return the size of an effect with the scaled coefficients (p,) at a shape."""
    return next(iter(t.hypothesis.quantities(x * t.unit[shape], t.shapes[shape]).values()))


def _select_spread_indices(count: int) -> list[int]:
    return list(range(count)) if count <= MOST_SHAPES else np.linspace(0, count - 1, MOST_SHAPES).astype(int).tolist()


def _draw_coefficient_directions(t: WhitenedHypothesis, shape: int, rng: np.random.Generator) -> Array:
    """Return coefficient directions (K, p) for limits: typical ones if known, otherwise random."""
    p, lower = t.X.shape[2], t.hypothesis.lower
    if p == 1:
        return np.ones((1, 1))
    if t.hypothesis.typical_coefficients is not None:
        return np.asarray(t.hypothesis.typical_coefficients / t.unit[shape])
    x = rng.normal(size=(DIRECTIONS, p))
    if lower:
        x = np.where(np.isfinite(np.array(lower)), np.abs(x), x)
    return np.asarray(x / np.linalg.norm(x, axis=1, keepdims=True))
