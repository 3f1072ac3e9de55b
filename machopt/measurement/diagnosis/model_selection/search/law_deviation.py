"""Search of further effects with the deviation of a large effect from its law in the model.

The law of an effect is approximate. For a backlash of 100 standard deviations its residual is larger than the effect of
a compliant tool. Forward selection therefore accepts nothing below a fixed share of the largest gain
(:func:`compute_law_error`). Here the deviation is fitted: the other laws and shapes at the same place describe any
smooth function of torque, angle and history. With them in the model, the law error is that of an expansion, about the
gain of its last term, and effects at other places are searched again. The deviation stays in the model without a name,
so that it does not count against the other effects. If no further effect is found, it is dropped.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from machopt.measurement import thresholds
from machopt.measurement.diagnosis.data_types.diagnosis_problem import EffectHypothesis
from machopt.measurement.diagnosis.model_selection.screening.hypothesis_screening import (
    ScoredHypothesis,
    score_hypotheses,
)
from machopt.measurement.diagnosis.model_selection.search.candidate_checks import is_supported
from machopt.measurement.diagnosis.model_selection.search.forward_selection import select_effects
from machopt.measurement.diagnosis.model_selection.search.law_error import compute_law_error
from machopt.measurement.diagnosis.model_selection.search.selected_effect import (
    LAW_DEVIATION,
    SelectedEffect,
    add_selected_effects,
    is_law_deviation,
)
from machopt.measurement.diagnosis.model_selection.unmodelled_slip_and_external_forces import (
    build_uncatalogued_hypothesis,
)
from machopt.measurement.diagnosis.statistics.normal_equations_by_fold import WhitenedModel
from machopt.measurement.diagnosis.statistics.whitened_hypothesis import WhitenedHypothesis, whiten_hypotheses
from machopt.numerics.array_types import Array

MOST_LAWS = 6  # most laws and shapes that describe one deviation
NOTE = "differs from the law of the effect named there"


def find_masked_effects(
    model: WhitenedModel,
    chosen: Sequence[SelectedEffect],
    tried: Sequence[WhitenedHypothesis],
    most: int,
    rng: np.random.Generator,
    noise_variance: float,
) -> list[SelectedEffect]:
    """Search further effects with the deviations of the largest effects from their laws in the model.

    Args:
        model: Whitened base model.
        chosen: Selected effects, each fitted together with the others.
        tried: All whitened hypotheses.
        most: Largest number of effects.
        rng: Random generator of the sign flips.
        noise_variance: Whitened residual variance that noise alone would leave; NaN if the noise was not measured.

    Returns:
        The effects with further ones and with the fitted deviations; else ``chosen``.
    """
    out = list(chosen)
    while True:
        found = _search_with_deviations(model, _list_named(out), tried, most, rng, noise_variance)
        if len(_list_named(found)) <= len(_list_named(out)):
            return out
        out = found


def _search_with_deviations(
    model: WhitenedModel,
    chosen: Sequence[SelectedEffect],
    tried: Sequence[WhitenedHypothesis],
    most: int,
    rng: np.random.Generator,
    noise_variance: float,
) -> list[SelectedEffect]:
    """Return the effects with further ones that explain most of what the deviations leave; else none."""
    if len(chosen) >= most:
        return []
    start = list(chosen)
    for c in sorted(chosen, key=lambda c: -c.scored.gain):
        if not _is_left_beyond_noise(model, start, noise_variance, c):
            break
        start = _add_law_deviation(model, start, c, tried)
    names = {c.whitened.hypothesis.name for c in chosen}
    places = {c.whitened.hypothesis.location for c in chosen}
    elsewhere = [t for t in tried if t.hypothesis.location not in places or t.hypothesis.name in names]
    whole = add_selected_effects(model, start)
    beyond = whole.rss - noise_variance * len(model.y)
    if all(c.law_error is None for c in start) or not _may_close_most(
        whole, start, elsewhere, beyond / (most - len(chosen))
    ):
        return []
    found = select_effects(model, elsewhere, most, rng, start=start)
    left = add_selected_effects(model, found).rss - noise_variance * len(model.y)
    is_larger = len(_list_named(found)) > len(chosen)
    return found if is_larger and left <= thresholds.SHARES.majority * (beyond - left) else []


def _may_close_most(
    whitened_model: WhitenedModel, start: Sequence[SelectedEffect], elsewhere: Sequence[WhitenedHypothesis], each: float
) -> bool:
    """Return whether a supported effect elsewhere closes enough of ``each``, an equal part of what is left."""
    share = 1.0 / (1.0 + thresholds.SHARES.majority)
    places = {c.whitened.hypothesis.location for c in start}
    other = [t for t in elsewhere if t.hypothesis.location not in places]
    return any(
        s.gain >= share * each and s.gain > compute_law_error(s, start) and is_supported(whitened_model, s)
        for s in score_hypotheses(whitened_model, other)
    )


def _list_named(chosen: Sequence[SelectedEffect]) -> list[SelectedEffect]:
    return [c for c in chosen if not is_law_deviation(c)]


def _is_left_beyond_noise(
    model: WhitenedModel, chosen: Sequence[SelectedEffect], noise_variance: float, c: SelectedEffect
) -> bool:
    """Return whether more than noise is left, by less than the law error of an effect of the catalogue."""
    if not np.isfinite(noise_variance) or not c.whitened.hypothesis.is_in_catalogue:
        return False
    whole = add_selected_effects(model, chosen)
    hidden = thresholds.SHARES.law_error * c.scored.gain
    return (
        hidden > thresholds.SHARES.min_gain_per_row * whole.rss
        and whole.residual_variance > noise_variance + thresholds.SHARES.minority
    )


def _add_law_deviation(
    model: WhitenedModel, chosen: Sequence[SelectedEffect], c: SelectedEffect, tried: Sequence[WhitenedHypothesis]
) -> list[SelectedEffect]:
    """Return the effects with the deviation of one of them from its law: other laws and shapes of its place."""
    place = c.whitened.hypothesis.location
    others = {o.whitened.hypothesis.name for o in chosen if o is not c}
    here = [t for t in tried if t.hypothesis.location == place and t.hypothesis.name not in others]
    whole = add_selected_effects(model, chosen)
    parts: list[ScoredHypothesis] = []
    while len(parts) < MOST_LAWS:
        best = max(score_hypotheses(whole, here), key=lambda s: s.total, default=None)
        if best is None or best.total < thresholds.LEVELS.min_gain * whole.residual_variance:
            break
        parts.append(best)
        whole = whole.with_law(best.whitened, best.shape)
    least = thresholds.LEVELS.min_gain * whole.residual_variance
    law = whiten_hypotheses(model, [_build_deviation(model, chosen, c, parts)]) if parts else []
    if not law:
        return [replace(o, law_error=least) if o is c else o for o in chosen]
    deviation = score_hypotheses(add_selected_effects(model, chosen), law)[0]
    # the error of an expansion is about its last term; of one term it is a share, as of any law
    error = max(least, min(parts[-1].gain, thresholds.SHARES.law_error * deviation.gain))
    return [*chosen, SelectedEffect(deviation, 0.0, error)]


def _build_deviation(
    model: WhitenedModel, chosen: Sequence[SelectedEffect], c: SelectedEffect, parts: Sequence[ScoredHypothesis]
) -> EffectHypothesis:
    """Build the form with the columns of all parts, from which those of the effect itself are eliminated.

    The effect therefore keeps its coefficients and its gain.
    """
    place = c.whitened.hypothesis.location
    laws = [(c.whitened, c.scored.shape), *((s.whitened, s.shape) for s in parts)]
    raw: list[Array] = [t.hypothesis.columns(t.shapes[shape]) * t.unit[shape] for t, shape in laws]
    extended = add_selected_effects(model, [o for o in chosen if o is not c])
    count, own = extended.count, c.whitened.X.shape[2]
    for t, shape in laws:
        extended = extended.with_law(t, shape)
    to, at = slice(0, count + own), slice(count + own, extended.count)
    normal = extended.normal
    x = np.linalg.lstsq(normal[to, to], normal[to, at], rcond=1e-12)[0][count:]
    columns = np.concatenate(raw[1:], axis=2) - raw[0] @ x
    return build_uncatalogued_hypothesis(place, LAW_DEVIATION, NOTE, lambda shape: columns, ((),))
