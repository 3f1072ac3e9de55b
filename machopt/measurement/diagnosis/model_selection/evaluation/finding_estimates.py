"""Estimates of a finding: parameters with confidence intervals, rival explanations, and indistinguishable effects."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import replace

import numpy as np
from scipy.special import stdtr, stdtrit

from machopt.effects import registry
from machopt.effects.protocol import DEFAULT_FORM_UNCERTAINTY
from machopt.measurement import thresholds
from machopt.measurement.diagnosis.data_types.diagnosis_problem import EffectHypothesis, Quantity, Shape
from machopt.measurement.diagnosis.data_types.diagnosis_result import (
    EffectLocation,
    EstimatedValue,
    LawFit,
    RivalExplanation,
)
from machopt.measurement.diagnosis.model_selection.screening.hypothesis_screening import (
    ScoredHypothesis,
    score_hypotheses,
)
from machopt.measurement.diagnosis.model_selection.search.selected_effect import SelectedEffect, add_selected_effects
from machopt.measurement.diagnosis.model_selection.search.shape_refinement import compute_likelihood_margin
from machopt.measurement.diagnosis.statistics.normal_equations_by_fold import WhitenedModel, compute_cluster_robust_fit
from machopt.measurement.diagnosis.statistics.whitened_hypothesis import WhitenedHypothesis
from machopt.numerics.array_types import Array

MAX_LISTED = 10
ROUND_OFF = 1e-9  # relative to the largest number of the same unit: what rounding leaves of a zero
COMPONENTS = ("_x", "_y", "_z", " x", " y", " z")  # ends of the names of vector components
MAX_INTERVAL_RATIO = 1000  # ratio of interval end to size from which on the interval of a body counts as unbounded


def find_rival_explanations(
    model: WhitenedModel, chosen: Sequence[SelectedEffect], k: int, tried: Sequence[WhitenedHypothesis]
) -> tuple[list[RivalExplanation], list[EffectLocation]]:
    """Find the effects that could replace the k-th effect, with all other effects present.

    Forms outside the catalogue have no size that a file states: they are rivals without a fit. They are open only
    where they explain as much, and not where a few groups cannot decide.

    Args:
        model: Whitened base model.
        chosen: Selected effects, each fitted together with the others.
        k: Index of the effect in ``chosen``.
        tried: All whitened hypotheses that compete, the selected one included.

    Returns:
        Rivals, the best first, and the effects that are not excluded, the selected one first.
    """
    others = [c for i, c in enumerate(chosen) if i != k]
    model_without = add_selected_effects(model, others)
    taken = {c.whitened.hypothesis.name for c in others}
    mine = chosen[k].whitened.hypothesis
    scored = score_hypotheses(model_without, [t for t in tried if t.hypothesis.name not in taken])
    best: dict[EffectLocation, ScoredHypothesis] = {}
    for s in scored:
        name = s.whitened.hypothesis.name
        if name not in best or s.total > best[name].total:
            best[name] = s
    selected_score = next(s for s in scored if s.whitened is chosen[k].whitened)

    def fit(s: ScoredHypothesis) -> LawFit:
        x, shape = s.x * s.whitened.unit[s.shape], s.whitened.shapes[s.shape]
        return LawFit(tuple(float(v) for v in x), tuple(shape), s.whitened.hypothesis.correction(x, shape))

    named = fit(chosen[k].scored)
    spread = add_selected_effects(model, chosen).residual_variance
    out: list[RivalExplanation] = []
    names: list[EffectLocation] = [mine.name]
    for name, s in sorted(best.items(), key=lambda item: -item[1].total):
        if name == mine.name:
            continue
        h = s.whitened.hypothesis
        d = selected_score.heldout - s.heldout
        p = _compute_paired_p_value(d)
        close = (
            float(d.sum()) / spread < thresholds.LEVELS.gain_three_sigma
            or (selected_score.gain - s.gain) / spread < thresholds.LEVELS.gain_three_sigma
        )
        as_likely = (
            p > thresholds.LEVELS.mismatch_significance_level
            and s.total > thresholds.SHARES.majority * selected_score.total
        )
        is_open = s.total > 0 and (close or (as_likely and h.is_in_catalogue))
        if is_open:
            names.append(name)
        elif not h.is_in_catalogue:
            continue
        out.append(
            RivalExplanation(
                effect=h.effect,
                location=h.location,
                law=h.law,
                closed=float(np.clip(s.total / max(selected_score.total, 1e-12), -1.0, 2.0)),
                standing="not excluded" if is_open else "rejected",
                p_value=p,
                placebo=h.effect == mine.effect,
                fit=fit(s) if h.is_in_catalogue else None,
                named=named,
            )
        )
    return [r for n, r in enumerate(out) if n < MAX_LISTED or r.standing == "not excluded"], names


def estimate_parameters(
    model: WhitenedModel, chosen: Sequence[SelectedEffect], k: int, tried: Sequence[WhitenedHypothesis]
) -> dict[str, EstimatedValue]:
    """Estimate the parameters of the k-th effect with 90 and 95 % intervals over all equally likely shapes and laws.

    Args:
        model: Whitened base model.
        chosen: Selected effects, each fitted together with the others.
        k: Index of the effect in ``chosen``.
        tried: All hypotheses, including other laws of the same effect at the same place.

    Returns:
        Estimates by name; the first one is the size.
    """
    c = chosen[k]
    model_without = add_selected_effects(model, [o for i, o in enumerate(chosen) if i != k])
    h = c.whitened.hypothesis
    value: Mapping[str, Quantity] = h.quantities(
        c.scored.x * c.whitened.unit[c.scored.shape], c.whitened.shapes[c.scored.shape]
    )
    ends: dict[str, list[Array]] = {name: [] for name in value}
    own: dict[str, Array] = {}
    doubt = _compute_model_uncertainty(chosen, k)
    best = _compute_residual_squares(model_without, c)
    most = best + _compute_likelihood_margin(model_without, c, best)
    for t in [o for o in tried if o.hypothesis.name == h.name and o is not c.whitened] + [c.whitened]:
        p = t.X.shape[2]
        for s in range(len(t.shapes)):
            m = model_without.with_law(t, s, with_prior=True)
            more = max(p - c.whitened.X.shape[2], 0)  # coefficients; they have to pay as in the selection
            cost = thresholds.LEVELS.gain_two_sigma * more * m.residual_variance
            if m.rss + cost > most and (t is not c.whitened or s != c.scored.shape):
                continue
            x, covariance, freedom = compute_cluster_robust_fit(m)
            intervals = _compute_quantity_intervals(t, s, x[-p:], covariance[-p:, -p:], freedom, doubt)
            if t is c.whitened and s == c.scored.shape:
                if h.family == "body":
                    value, intervals = _apply_coefficient_prior(
                        t, s, (x[-p:], covariance[-p:, -p:], freedom, doubt), (value, intervals)
                    )
                own = intervals
            for name in ends.keys() & intervals.keys():
                ends[name].append(intervals[name])
    out = {}
    for name in _order_by_significance(own, list(value)):
        q = value[name]
        if name in own and _excludes_zero(own[name]):  # an implausible form does not widen the interval
            ends[name] = [i for i in ends[name] if _excludes_zero(i)]
        both = np.array(ends[name]) if ends[name] else np.full((1, 2, 2), q.value)
        low, high = both[:, :, 0].min(axis=0), both[:, :, 1].max(axis=0)
        if h.family == "body":  # a size: compliances are not negative
            low = np.maximum(low, 0.0)
            high = np.where((high > MAX_INTERVAL_RATIO * q.value) & (q.value > 0.0), np.inf, high)
        out[name] = EstimatedValue(
            q.value,
            q.unit,
            (min(float(low[0]), q.value), max(float(high[0]), q.value)),
            (min(float(low[1]), q.value), max(float(high[1]), q.value)),
        )
    return drop_meaningless_estimates(out)


def drop_meaningless_estimates(estimates: dict[str, EstimatedValue]) -> dict[str, EstimatedValue]:
    """Set numbers of round-off to zero, and leave out numbers that the readings do not determine at all.

    The size, which comes first, and components of vectors are kept.

    Args:
        estimates: Estimates by name.

    Returns:
        The estimates.
    """
    largest: dict[str, float] = {}
    for e in estimates.values():
        largest[e.unit] = max(largest.get(e.unit, 0.0), abs(e.value))
    out = {}
    for n, (name, e) in enumerate(estimates.items()):
        low, high = e.ci95
        around_zero = low <= 0.0 <= high
        if around_zero and abs(e.value) <= ROUND_OFF * max(largest[e.unit], abs(low), abs(high)):
            out[name] = replace(e, value=0.0)
            continue
        is_component = name.endswith(COMPONENTS)
        most = (
            thresholds.RATIOS.implausible * 100.0 if e.unit == "%" else thresholds.RATIOS.impossible * largest[e.unit]
        )
        if n and not is_component and around_zero and high - low > most > 0.0:
            continue
        out[name] = e
    return out


def is_size_significant(model: WhitenedModel, chosen: Sequence[SelectedEffect], k: int) -> bool:
    """Return whether a size of the k-th effect differs from zero at the 95 % level, at its own law and shape.

    A compliance is positive semidefinite: it is of no size only if all its coefficients are zero. So one coefficient of
    it suffices too, at a level that counts them all (Bonferroni). With many coefficients that the readings determine
    only together, every size may have an interval around zero.

    Args:
        model: Whitened base model.
        chosen: Selected effects, each fitted together with the others.
        k: Index of the effect in ``chosen``.

    Returns:
        True if significant.
    """
    c = chosen[k]
    model_without = add_selected_effects(model, [o for i, o in enumerate(chosen) if i != k])
    x, covariance, freedom = compute_cluster_robust_fit(
        model_without.with_columns(c.columns, c.whitened.precision(c.scored.shape))
    )
    p, at, h = len(c.scored.x), c.scored.shape, c.whitened.hypothesis
    x, covariance = x[-p:], covariance[-p:, -p:]
    if h.family == "body" and h.project_to_plausible is not None:
        sigma = np.sqrt(np.maximum(np.diag(covariance), 0.0))
        if (np.abs(x) > float(stdtrit(freedom, 1.0 - 0.025 / p)) * sigma).any():
            return True
    doubt = _compute_model_uncertainty(chosen, k)
    own = _compute_quantity_intervals(c.whitened, at, x, covariance, freedom, doubt)
    if h.family == "body":
        value = h.quantities(x * c.whitened.unit[at], c.whitened.shapes[at])
        own = _apply_coefficient_prior(c.whitened, at, (x, covariance, freedom, doubt), (value, own))[1]
    return bool(_list_significant_sizes(own))


def _order_by_significance(intervals: Mapping[str, Array], names: list[str]) -> list[str]:
    """Return the names with a significant size first if the first one is not significant."""
    sure = _list_significant_sizes(intervals)
    if not sure or names[0] in sure:
        return names
    return [*sure, *(n for n in names if n not in sure)]


def _list_significant_sizes(intervals: Mapping[str, Array]) -> list[str]:
    """Return the significant sizes, without shape parameters."""
    return [n for n, i in intervals.items() if i[1, 0] < i[1, 1] and _excludes_zero(i)]


def _excludes_zero(interval: Array) -> bool:
    """Return whether the 95 % interval excludes zero."""
    return not bool(interval[1, 0] <= 0.0 <= interval[1, 1])


def _apply_coefficient_prior(
    law: WhitenedHypothesis,
    at: int,
    fit: tuple[Array, Array, float, float],
    estimates_and_covariances: tuple[Mapping[str, Quantity], dict[str, Array]],
) -> tuple[Mapping[str, Quantity], dict[str, Array]]:
    """Return sizes of a body and their intervals; insignificant ones are replaced by those of significant
    coefficients.

    Otherwise the largest of several compliances would be the one that no reading determines.
    """
    (x, covariance, freedom, doubt), (value, intervals) = fit, estimates_and_covariances
    sigma = np.sqrt(np.maximum(np.diag(covariance), 0.0))
    significant = np.where(np.abs(x) > float(stdtrit(freedom, 0.975)) * sigma, x, 0.0)
    again = _compute_quantity_intervals(law, at, significant, covariance, freedom, doubt)
    sizes = law.hypothesis.quantities(significant * law.unit[at], law.shapes[at])
    taken = [
        n for n, i in intervals.items() if not _excludes_zero(i) and _excludes_zero(again[n]) and sizes[n].value != 0.0
    ]
    return {**value, **{n: sizes[n] for n in taken}}, {**intervals, **{n: again[n] for n in taken}}


def _compute_likelihood_margin(model_without: WhitenedModel, c: SelectedEffect, best: float) -> float:
    """Return the whitened sum of squares by which another shape may be worse and still be accepted.

    If the noise is measured and the law leaves more than noise, its form is not exact. A shape that is worse by no
    more than this excess may be equally close to the truth.
    """
    m = model_without.with_law(c.whitened, c.scored.shape, with_prior=True)
    freedom = len(m.y) - m.count
    beyond = best - freedom - 2.0 * np.sqrt(2.0 * freedom)  # excess over noise at two standard deviations
    form = 0.0 if c.whitened.hypothesis.is_exact else min(beyond, thresholds.SHARES.law_error * c.scored.gain)
    return max(compute_likelihood_margin(c.whitened.hypothesis) * m.residual_variance, form)


def _get_form_uncertainty(effect: str) -> float:
    known = registry.find_effect(effect)
    return DEFAULT_FORM_UNCERTAINTY if known is None else known.form_uncertainty


def _compute_model_uncertainty(chosen: Sequence[SelectedEffect], k: int) -> float:
    """Return the relative 1σ of the k-th effect caused by the form of the other laws: an exact law absorbs their
    remainder.

    Next to bodies and gears a zero offset and a frame were 11 and 13 % off; their own noise accounted for 3 %.
    """
    others = (o.whitened.hypothesis.effect for i, o in enumerate(chosen) if i != k)
    return (
        DEFAULT_FORM_UNCERTAINTY if any(_get_form_uncertainty(e) >= DEFAULT_FORM_UNCERTAINTY for e in others) else 0.0
    )


def _compute_quantity_intervals(
    law: WhitenedHypothesis, at: int, x: Array, covariance: Array, freedom: float, doubt: float = 0.0
) -> dict[str, Array]:
    """Return the 90 and 95 % intervals (2, 2) of each quantity, by first and second derivatives in the coefficients.

    Args:
        law: Whitened hypothesis.
        at: Index of its shape.
        x: Fitted coefficients.
        covariance: Their covariance.
        freedom: Degrees of freedom.
        doubt: Least relative 1σ of the law's form.
    """
    h, shape, unit = law.hypothesis, law.shapes[at], law.unit[at]
    centre = h.quantities(x * unit, shape)
    slopes: dict[str, list[float]] = {name: [] for name in centre}
    for i in range(len(x)):
        step = np.zeros(len(x))
        step[i] = 1e-3 * max(float(np.sqrt(max(covariance[i, i], 0.0))), abs(float(x[i])), 1e-12)
        up, down = h.quantities((x + step) * unit, shape), h.quantities((x - step) * unit, shape)
        for name in centre:
            slopes[name].append((up[name].value - down[name].value) / (2 * step[i]))
    bends = _compute_noise_bias(h, x, covariance, (unit, shape)) if len(x) > 1 else {}
    out = {}
    form = max(_get_form_uncertainty(h.effect), doubt)
    for name, q in centre.items():
        if not np.isfinite(q.value):  # relative to a compliance that is zero
            out[name] = np.full((2, 2), q.value)
            continue
        g = np.nan_to_num(np.array(slopes[name]), posinf=0.0, neginf=0.0)
        noise = float(np.sqrt(max(g @ covariance @ g, 0.0)))
        more = float(np.clip(bends.get(name, 0.0), -noise, noise))
        sigma = float(np.hypot(noise, form * q.value if g.any() else 0.0))
        t = stdtrit(freedom, np.array([0.95, 0.975]))
        out[name] = np.stack([q.value - more - t * sigma, q.value - more + t * sigma], axis=1)
    return out


def _compute_noise_bias(h: EffectHypothesis, x: Array, covariance: Array, at: tuple[Array, Shape]) -> dict[str, float]:
    """Return the bias of each quantity by noise: the norm of several coefficients is biased upwards."""
    unit, shape = at
    power, axes = np.linalg.eigh(covariance)
    middle = h.quantities(x * unit, shape)
    out = dict.fromkeys(middle, 0.0)
    for step in (axes * np.sqrt(np.maximum(power, 0.0))).T:
        up, down = h.quantities((x + step) * unit, shape), h.quantities((x - step) * unit, shape)
        for name, q in middle.items():
            more = 0.5 * (up[name].value + down[name].value) - q.value
            out[name] += more if np.isfinite(more) else 0.0
    return out


def _compute_residual_squares(model_without: WhitenedModel, c: SelectedEffect) -> float:
    return model_without.with_law(c.whitened, c.scored.shape, with_prior=True).rss


def _compute_paired_p_value(d: Array) -> float:
    """Return the one-sided p-value of a mean difference over folds (Student's t)."""
    n = len(d)
    error = float(d.std(ddof=1)) / np.sqrt(n) if n > 1 else 0.0
    return float(stdtr(n - 1, -float(d.mean()) / error)) if error > 0 else float(d.mean() <= 0)
