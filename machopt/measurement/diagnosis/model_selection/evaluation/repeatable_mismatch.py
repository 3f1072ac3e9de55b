"""Repeatable mismatch: is there one, and where in the machine or the data.

Repeatable power S = mean of r⁽¹⁾·r⁽²⁾ over pairs of replicates on two visits. Independent noise cancels, and model
errors remain. Its p-value comes from flipping the signs of whole visits. Both visits of a pose are held out together
and predicted by the same coefficients. The prediction error is common to both, and for few poses and many unknowns as
large as noise. Its expectation is therefore subtracted.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from itertools import pairwise

import numpy as np
from numpy.typing import NDArray
from scipy.sparse import coo_array

from machopt.measurement import thresholds
from machopt.measurement.diagnosis.data_types.diagnosis_problem import DiagnosisProblem
from machopt.measurement.diagnosis.data_types.diagnosis_result import AxisInterval, MismatchShare
from machopt.measurement.diagnosis.model_selection.screening.hypothesis_screening import ScoredHypothesis
from machopt.measurement.diagnosis.statistics.holdout_residuals import PredictionNoise
from machopt.measurement.diagnosis.statistics.permutation_probability import compute_permutation_probability
from machopt.measurement.diagnosis.statistics.replicate_noise import ReplicateNoise
from machopt.numerics.array_types import Array

Flags = NDArray[np.bool_]
MISMATCH_FLIPS = 999
BINS = 3


@dataclass(frozen=True)
class RepeatableMismatch:
    """Repeatable power of residuals."""

    power: float  # SI², per coordinate of the first family; may be slightly negative by chance
    p_value: float
    is_over_time: bool = False  # the mismatch is correlated over time, not over poses


def measure_repeatable_mismatch(
    problem: DiagnosisProblem,
    residual: Array,
    used: Flags,
    noise: ReplicateNoise,
    rng: np.random.Generator,
    prediction_noise: PredictionNoise | None = None,
) -> RepeatableMismatch:
    """Measure the repeatable power and its p-value.

    Errors shared by successive visits (of other poses) count too: heat, a moved tracker. Without a stated time the rows
    tell the order. Without
    replicates the power is the excess over the noise, without a p-value (NaN).

    Args:
        problem: Regression problem.
        residual: (N, D) residuals, SI.
        used: (N,) True for readings that are used.
        noise: Estimated noise.
        rng: Random generator of the sign flips.
        prediction_noise: Covariance of the held-out predictions; None for fitted residuals.

    Returns:
        The repeatable mismatch.
    """
    e = residual[:, list(problem.families[0].columns)]
    again = _compute_replicate_product(problem, residual, used, noise, rng, prediction_noise)
    if problem.order is None:
        return again
    lasting = _compute_visit_correlation(problem, e, used, problem.order, rng)
    return (
        lasting
        if lasting.power > again.power and lasting.p_value <= thresholds.LEVELS.mismatch_significance_level
        else again
    )


def _compute_visit_correlation(
    problem: DiagnosisProblem, e: Array, used: Flags, time: Array, rng: np.random.Generator
) -> RepeatableMismatch:
    """Return the mean product of successive visits' mean residuals; p-value by permutation of their order."""
    rows = np.flatnonzero(used)
    visits, label = np.unique(problem.visit[rows], return_inverse=True)
    count = np.bincount(label).astype(float)
    mean = np.stack([np.bincount(label, e[rows, d]) for d in range(e.shape[1])], axis=1) / count[:, None]
    when = np.bincount(label, time[rows]) / count
    session = np.zeros(len(visits))
    session[label] = problem.session[rows]
    order = np.lexsort((when, session))
    if len(order) < thresholds.COUNTS.min_degrees_of_freedom:
        return RepeatableMismatch(0.0, 1.0)
    mean, session = mean[order], session[order]
    spans = np.split(np.arange(len(order)), np.flatnonzero(np.diff(session)) + 1)
    # a shift of a whole session is set-up noise
    own = np.concatenate([mean[s] - mean[s].mean(axis=0) for s in spans])
    inside = np.diff(session) == 0

    def product(x: Array) -> float:
        return float(np.mean(np.sum(x[1:] * x[:-1], axis=1)[inside]) / e.shape[1]) if inside.any() else 0.0

    power = product(own)
    drawn = np.empty(MISMATCH_FLIPS)
    for n in range(MISMATCH_FLIPS):
        drawn[n] = product(own[np.concatenate([rng.permutation(s) for s in spans])])
    size = float(np.mean(np.sum(own**2, axis=1)))
    return RepeatableMismatch(power, compute_permutation_probability(drawn, power, size), True)


def _compute_replicate_product(
    problem: DiagnosisProblem,
    residual: Array,
    used: Flags,
    noise: ReplicateNoise,
    rng: np.random.Generator,
    prediction_noise: PredictionNoise | None,
) -> RepeatableMismatch:
    """Return the power that replicates on different visits share in the first family."""
    columns = problem.families[0].columns
    sums, weight = _sum_products_by_visit_pair(problem, residual, columns, used, prediction_noise)
    if weight <= 0:
        return RepeatableMismatch(
            float(np.mean(residual[used][:, list(columns)] ** 2)) - _compute_allowed_power(problem, used, noise),
            float("nan"),
        )
    return _compute_sign_flip_chance(*sums, weight, rng)


def has_repeatable_instrument_error(
    problem: DiagnosisProblem,
    residual: Array,
    used: Flags,
    noise: ReplicateNoise,
    rng: np.random.Generator,
    prediction_noise: PredictionNoise | None,
) -> bool:
    """Return whether an independent instrument shows a repeatable error beyond its noise.

    The test is that of :func:`measure_repeatable_mismatch`.

    Args:
        problem: Regression problem.
        residual: (N, D) residuals, SI.
        used: (N,) True for readings that are used.
        noise: Estimated noise.
        rng: Random generator of the sign flips.
        prediction_noise: Covariance of the held-out predictions; None for fitted residuals.

    Returns:
        True if significant and relevant.
    """
    for n, family in enumerate(problem.families):
        if not family.is_separate_instrument:
            continue
        rows = used & problem.has_family(family)
        sums, weight = _sum_products_by_visit_pair(problem, residual, family.columns, rows, prediction_noise)
        if weight <= 0:
            continue
        found = _compute_sign_flip_chance(*sums, weight, rng)
        least = thresholds.SHARES.minority * noise.total(n)
        if found.p_value <= thresholds.LEVELS.mismatch_significance_level and np.sqrt(max(found.power, 0.0)) > least:
            return True
    return False


def _compute_sign_flip_chance(
    pairs: Array, products: Array, weight: float, rng: np.random.Generator
) -> RepeatableMismatch:
    """Return the mean product and its p-value by flipping the signs of whole visits."""
    power = float(products.sum() / weight)
    visits, label = np.unique(pairs, return_inverse=True)
    label = label.reshape(pairs.shape)
    signs = rng.choice([-1.0, 1.0], (MISMATCH_FLIPS, len(visits)))
    # limits memory: a long motion has many pairs
    of_pairs = coo_array((products, (label[0], label[1])), shape=(len(visits), len(visits))).tocsr()
    drawn = np.sum(signs * (of_pairs @ signs.T).T, axis=1) / weight
    size = float(np.abs(products).sum() / weight)
    return RepeatableMismatch(power, compute_permutation_probability(drawn, power, size))


def _compute_allowed_power(problem: DiagnosisProblem, used: Flags, noise: ReplicateNoise) -> float:
    """Return the power (SI²) that held-out residuals may have without replicates.

    The noise is then estimated from the residuals and is no evidence against the model. Held-out groups have larger
    errors because of few groups and many unknowns. Only a stated uncertainty is evidence.
    """
    family = problem.families[0]
    if family.stated_uncertainty is not None:
        return (thresholds.LEVELS.three_sigma * family.stated_uncertainty) ** 2
    groups = len(np.unique(problem.group[used])) * len(family.columns)
    free = max(groups - problem.base.shape[2], 1)
    gain = 0.0 if problem.scale is None else noise.gain**2 * float(np.mean(problem.scale[used][:, family.columns] ** 2))
    return float(thresholds.RATIOS.larger * (noise.total(0) ** 2 + gain) * (groups / free) ** 2)


def _sum_products_by_visit_pair(
    problem: DiagnosisProblem,
    residual: Array,
    columns: Sequence[int],
    used: Flags,
    prediction_noise: PredictionNoise | None,
) -> tuple[tuple[Array, Array], float]:
    """Return sums of products by pair of visits ((2, K), (K,)), and the number of coordinates.

    Args:
        problem: Problem with replicate labels.
        residual: (N, D) residuals, SI.
        columns: Coordinates that count.
        used: (N,) True for readings that are used.
        prediction_noise: Its expected product within a group is subtracted.
    """
    e = residual[:, list(columns)]
    rows = np.flatnonzero(used & (problem.replicate >= 0))
    order = rows[np.argsort(problem.replicate[rows], kind="stable")]
    found: dict[tuple[int, int], float] = {}
    weight = 0.0
    starts = np.flatnonzero(np.diff(problem.replicate[order], prepend=-2)) if len(order) else np.zeros(0, int)
    for block in np.split(order, starts[1:]) if len(order) else []:
        visits = problem.replicate_visit[block]
        names = np.unique(visits).tolist()
        if len(names) < 2:
            continue
        among = [block[visits == v] for v in names]
        means = np.stack([e[k].mean(axis=0) for k in among])
        product = means @ means.T
        if prediction_noise is not None:
            group = problem.group[[k[0] for k in among]]
            shared = np.stack([prediction_noise.compute_mean_error(k, columns) for k in among])
            product = product - np.where(group[:, None] == group, shared @ shared.T, 0.0)
        share = 1.0 / (len(names) - 1)  # each replicate label is weighted by its number of visits
        for a, one in enumerate(names):
            for b, two in enumerate(names[a + 1 :], a + 1):
                found[one, two] = found.get((one, two), 0.0) + share * float(product[a, b])
                weight += share * e.shape[1]
    pairs = np.array(list(found), dtype=float).reshape(-1, 2).T
    return (pairs, np.array(list(found.values()))), weight


def locate_in_machine(scored: Sequence[ScoredHypothesis], power: float) -> list[MismatchShare]:
    """Compute the share of the whitened mismatch that each place can explain alone, by its best law, cross-validated.

    Args:
        scored: All hypotheses, scored with the base.
        power: Whitened sum of squares beyond the noise.

    Returns:
        Shares by place, descending.
    """
    best: dict[str, ScoredHypothesis] = {}
    for s in scored:
        place = s.whitened.hypothesis.location
        if place not in best or s.total > best[place].total:
            best[place] = s
    out = [
        MismatchShare(place, float(np.clip(s.total / max(power, 1e-12), 0.0, 1.0)), s.whitened.hypothesis.note)
        for place, s in best.items()
        if s.total > 0
    ]
    return sorted(out, key=lambda s: -s.share)


def locate_in_data(
    problem: DiagnosisProblem, residual: Array, used: Flags, noise: ReplicateNoise, axes: Mapping[str, Array]
) -> list[MismatchShare]:
    """Find intervals of load, branch, time or joint angles with more than average power beyond the noise.

    Args:
        problem: Regression problem.
        residual: (N, D) residuals, SI.
        used: (N,) True for readings that are used.
        noise: Estimated noise.
        axes: Name → (N,) values.

    Returns:
        Shares by axis, descending.
    """
    columns = list(problem.families[0].columns)
    power = np.mean(residual[:, columns] ** 2, axis=1) - noise.total(0) ** 2
    total = float(power[used].sum())
    if total <= 0:
        return []
    out = []
    for name, given in axes.items():
        values = np.asarray(given, float)
        levels = np.unique(values[used])
        if len(levels) < 2:
            continue
        if len(levels) <= BINS:
            parts = [(float(v), float(v), values == v) for v in levels]
        else:
            edges = np.quantile(values[used], np.linspace(0, 1, BINS + 1))
            parts = [
                (float(a), float(b), (values >= a) & (values <= b if k == BINS - 1 else values < b))
                for k, (a, b) in enumerate(pairwise(edges))
            ]
        found = [
            (float(power[used & m].sum()) / total, AxisInterval(low, high, float((used & m).sum()) / used.sum()))
            for low, high, m in parts
        ]
        share, there = max(found, key=lambda f: f[0] - f[1].readings)
        if share > thresholds.RATIOS.equal_fit * there.readings:
            out.append(MismatchShare(name, float(np.clip(share, 0.0, 1.0)), there.words, "data", there))
    return sorted(out, key=lambda s: -s.share)
