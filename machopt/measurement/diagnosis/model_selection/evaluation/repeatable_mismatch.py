"""Is there a mismatch that comes back, and where does it live.

Repeatable power S = mean of r⁽¹⁾·r⁽²⁾ over pairs of readings of the same thing on two visits: independent noise
cancels, what the model misses stays. Its chance is judged by flipping the signs of whole visits.

Both visits of a pose are held out together, and predicted by the same coefficients: the prediction's own error comes
back in both. Of few poses and many unknowns it is as large as noise, so what is expected of it is taken off.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from itertools import pairwise

import numpy as np
from numpy.typing import NDArray
from scipy.sparse import coo_array

from machopt.measurement.diagnosis import thresholds
from machopt.measurement.diagnosis.data_types.diagnosis_problem import DiagnosisProblem
from machopt.measurement.diagnosis.data_types.diagnosis_result import AxisInterval, MismatchShare
from machopt.measurement.diagnosis.model_selection.screening.hypothesis_screening import ScoredHypothesis
from machopt.measurement.diagnosis.statistics.holdout_residuals import PredictionNoise
from machopt.measurement.diagnosis.statistics.replicate_noise import ReplicateNoise
from machopt.numerics.array_types import Array

Flags = NDArray[np.bool_]
FLIPS = 999
BINS = 3


@dataclass(frozen=True)
class RepeatableMismatch:
    """What comes back in repeats."""

    power: float  # SI², per coordinate of the first family; may be slightly negative by chance
    p_value: float
    is_over_time: bool = False  # what comes back does so over time, not over poses


def measure_repeatable_mismatch(
    problem: DiagnosisProblem,
    residual: Array,
    used: Flags,
    noise: ReplicateNoise,
    rng: np.random.Generator,
    own: PredictionNoise | None = None,
) -> RepeatableMismatch:
    """Measure it.

    Where time matters, what visits share with the next one (of another pose) comes back, too: heat, a tracker that
    moved. Where nothing was measured twice, power is what exceeds the noise, and chance is not judged (NaN).

    Args:
        problem: what was measured twice, and when.
        residual: (N, D) SI.
        used: (N,) readings that took part.
        noise: as found.
        rng: draws signs.
        own: of held-out residuals, what noise alone makes their predictions err by.
    """
    e = residual[:, list(problem.families[0].columns)]
    again = _compute_replicate_product(problem, residual, used, noise, rng, own)
    if problem.time is None:
        return again
    lasting = _compute_visit_correlation(problem, e, used, problem.time, rng)
    return lasting if lasting.power > again.power and lasting.p_value <= thresholds.PROOF.permitted else again


def _compute_visit_correlation(
    problem: DiagnosisProblem, e: Array, used: Flags, time: Array, rng: np.random.Generator
) -> RepeatableMismatch:
    """Mean product of the mean residuals of visits that follow each other; chance by shuffling their order."""
    rows = np.flatnonzero(used)
    visits, label = np.unique(problem.visit[rows], return_inverse=True)
    count = np.bincount(label).astype(float)
    mean = np.stack([np.bincount(label, e[rows, d]) for d in range(e.shape[1])], axis=1) / count[:, None]
    when = np.bincount(label, time[rows]) / count
    session = np.zeros(len(visits))
    session[label] = problem.session[rows]
    order = np.lexsort((when, session))
    if len(order) < thresholds.PROOF.least_visits:
        return RepeatableMismatch(0.0, 1.0)
    mean, session = mean[order], session[order]
    spans = np.split(np.arange(len(order)), np.flatnonzero(np.diff(session)) + 1)
    # a shift of a whole session is noise of the set-up
    own = np.concatenate([mean[s] - mean[s].mean(axis=0) for s in spans])
    inside = np.diff(session) == 0

    def product(x: Array) -> float:
        return float(np.mean(np.sum(x[1:] * x[:-1], axis=1)[inside]) / e.shape[1]) if inside.any() else 0.0

    power = product(own)
    drawn = np.empty(FLIPS)
    for n in range(FLIPS):
        drawn[n] = product(own[np.concatenate([rng.permutation(s) for s in spans])])
    return RepeatableMismatch(power, float((1 + np.sum(drawn >= power)) / (FLIPS + 1)), True)


def _compute_replicate_product(
    problem: DiagnosisProblem,
    residual: Array,
    used: Flags,
    noise: ReplicateNoise,
    rng: np.random.Generator,
    own: PredictionNoise | None,
) -> RepeatableMismatch:
    """What twins on different visits share in the first family."""
    columns = problem.families[0].columns
    sums, weight = _sum_products_by_visit_pair(problem, residual, columns, used, own)
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
    own: PredictionNoise | None,
) -> bool:
    """Whether an instrument of its own shows something that comes back, beyond its noise; as in
    :func:`measure_repeatable_mismatch`."""
    for n, family in enumerate(problem.families):
        if not family.is_separate_instrument:
            continue
        rows = used & problem.has_family(family)
        sums, weight = _sum_products_by_visit_pair(problem, residual, family.columns, rows, own)
        if weight <= 0:
            continue
        found = _compute_sign_flip_chance(*sums, weight, rng)
        least = thresholds.PROOF.matters * noise.total(n)
        if found.p_value <= thresholds.PROOF.certain and np.sqrt(max(found.power, 0.0)) > least:
            return True
    return False


def _compute_sign_flip_chance(
    pairs: Array, products: Array, weight: float, rng: np.random.Generator
) -> RepeatableMismatch:
    """Mean product, and its chance by flipping the signs of whole visits."""
    power = float(products.sum() / weight)
    visits, label = np.unique(pairs, return_inverse=True)
    label = label.reshape(pairs.shape)
    signs = rng.choice([-1.0, 1.0], (FLIPS, len(visits)))
    # a long motion repeats so often that pairs × flips would fill the memory
    of_pairs = coo_array((products, (label[0], label[1])), shape=(len(visits), len(visits))).tocsr()
    drawn = np.sum(signs * (of_pairs @ signs.T).T, axis=1) / weight
    return RepeatableMismatch(power, float((1 + np.sum(drawn >= power)) / (FLIPS + 1)))


def _compute_allowed_power(problem: DiagnosisProblem, used: Flags, noise: ReplicateNoise) -> float:
    """SI², what unseen readings may err by where nothing was measured twice.

    Noise is then what the fit leaves, and says nothing against the model; unseen groups err by more, as there are few
    of them for so many unknowns. Only what the recording itself states its readings to be good for speaks against it.
    """
    family = problem.families[0]
    if family.stated_uncertainty is not None:
        return (thresholds.PROOF.trusted * family.stated_uncertainty) ** 2
    groups = len(np.unique(problem.group[used])) * len(family.columns)
    free = max(groups - problem.base.shape[2], 1)
    gain = 0.0 if problem.scale is None else noise.gain**2 * float(np.mean(problem.scale[used][:, family.columns] ** 2))
    return float(thresholds.PROOF.unsure * (noise.total(0) ** 2 + gain) * (groups / free) ** 2)


def _sum_products_by_visit_pair(
    problem: DiagnosisProblem, residual: Array, columns: Sequence[int], used: Flags, own: PredictionNoise | None
) -> tuple[tuple[Array, Array], float]:
    """Sums of products by pair of visits ((2, K), (K,)), and the number of coordinates behind them.

    Args:
        problem: which readings repeat each other.
        residual: (N, D) SI.
        columns: coordinates that count.
        used: (N,) readings that took part.
        own: what twins of one group share by it is taken off.
    """
    e = residual[:, list(columns)]
    rows = np.flatnonzero(used & (problem.replicate >= 0))
    order = rows[np.argsort(problem.replicate[rows], kind="stable")]
    found: dict[tuple[int, int], float] = {}
    weight = 0.0
    starts = np.flatnonzero(np.diff(problem.replicate[order], prepend=-2)) if len(order) else np.zeros(0, int)
    for block in np.split(order, starts[1:]) if len(order) else []:
        visits = problem.visit[block]
        names = np.unique(visits).tolist()
        if len(names) < 2:
            continue
        among = [block[visits == v] for v in names]
        means = np.stack([e[k].mean(axis=0) for k in among])
        product = means @ means.T
        if own is not None:
            group = problem.group[[k[0] for k in among]]
            shared = np.stack([own.compute_mean_error(k, columns) for k in among])
            product = product - np.where(group[:, None] == group, shared @ shared.T, 0.0)
        share = 1.0 / (len(names) - 1)  # each kind counts with its number of visits
        for a, one in enumerate(names):
            for b, two in enumerate(names[a + 1 :], a + 1):
                found[one, two] = found.get((one, two), 0.0) + share * float(product[a, b])
                weight += share * e.shape[1]
    pairs = np.array(list(found), dtype=float).reshape(-1, 2).T
    return (pairs, np.array(list(found.values()))), weight


def locate_in_machine(scored: Sequence[ScoredHypothesis], power: float) -> list[MismatchShare]:
    """Share of the whitened mismatch that each place can explain by itself, best law, on unseen groups.

    Args:
        scored: every hypothesis beside the base.
        power: whitened sum of squares beyond the noise.
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
    """Where along load, branch, time, joints … the power beyond the noise is higher than on average."""
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
        if share > thresholds.PROOF.concentrated * there.readings:
            out.append(MismatchShare(name, float(np.clip(share, 0.0, 1.0)), there.words, "data", there))
    return sorted(out, key=lambda s: -s.share)
