"""Several harmonic orders of one gear: a joint's harmonics as one law, each order refined together with the others.

Forward selection reports one law per place. A gear has errors in the orders of its input, cam and output at once.
Once a harmonic is selected, further ones at the same place are added while they are supported (orthogonal matching
pursuit). Orders that become unnecessary are dropped again.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from machopt.measurement import thresholds
from machopt.measurement.diagnosis.data_types.diagnosis_problem import EffectHypothesis, Shape, ShapeRefinement
from machopt.measurement.diagnosis.model_selection.screening.hypothesis_screening import (
    compute_chance_probability,
    compute_gain_by_shape,
    fit_hypotheses,
    score_hypotheses,
)
from machopt.measurement.diagnosis.model_selection.search.candidate_checks import compute_least_gain, is_supported
from machopt.measurement.diagnosis.model_selection.search.selected_effect import SelectedEffect, add_selected_effects
from machopt.measurement.diagnosis.statistics.normal_equations_by_fold import WhitenedModel
from machopt.measurement.diagnosis.statistics.whitened_hypothesis import WhitenedHypothesis, whiten_hypotheses
from machopt.numerics.array_types import Array

MOST = 6  # most orders of a joint, as a safeguard
NARROWER = (1.0, 0.2, 0.04)  # successive search widths relative to the grid spacing


def add_harmonic_orders(
    model: WhitenedModel, chosen: Sequence[SelectedEffect], laws: Sequence[WhitenedHypothesis], rng: np.random.Generator
) -> list[SelectedEffect]:
    """Extend each harmonic law of the selection by all supported orders of its joint.

    Args:
        model: Whitened base model.
        chosen: Selected effects, one law per place.
        laws: All hypotheses; single harmonics among them have a name for their sum and a refinement.
        rng: Random generator of the sign flips.

    Returns:
        The effects.
    """
    out = list(chosen)
    for k, c in enumerate(chosen):
        single = [t for t in laws if t.hypothesis.name == c.whitened.hypothesis.name and _is_single_wave(t.hypothesis)]
        if single and _is_wave_series(c):
            out[k] = _fit_joint_orders(model, out, k, single, rng)
    return out


def count_parts(chosen: Sequence[SelectedEffect]) -> int:
    """Count the parts of an explanation; each harmonic order of a motion counts as one.

    Args:
        chosen: Selected effects, each fitted together with the others.

    Returns:
        Number of parts.
    """
    return sum(
        len(c.whitened.shapes[c.scored.shape]) if c.whitened.hypothesis.refinement and _is_wave_series(c) else 1
        for c in chosen
    )


def _is_wave_series(c: SelectedEffect) -> bool:
    """Return whether a law has a cosine and a sine for each of its orders."""
    return bool(2 * len(c.whitened.shapes[c.scored.shape]) == c.whitened.X.shape[2])


def _is_single_wave(h: EffectHypothesis) -> bool:
    """Return whether a law is a single harmonic with a refinable order."""
    return bool(h.sum_name) and h.refinement is not None


def _fit_joint_orders(
    model: WhitenedModel,
    chosen: list[SelectedEffect],
    k: int,
    single: Sequence[WhitenedHypothesis],
    rng: np.random.Generator,
) -> SelectedEffect:
    """Return the k-th effect with all its orders."""
    first = chosen[k]
    model_without = add_selected_effects(model, [c for n, c in enumerate(chosen) if n != k])
    law = single[0].hypothesis
    assert law.refinement is not None  # of a wave
    orders = tuple(first.whitened.shapes[first.scored.shape])
    added = False
    while len(orders) < MOST:
        refined = _refine_orders(model, model_without, law, orders)
        one = _find_next_order(
            model_without.with_columns(_build_order_columns(model, law, refined).columns_at(0)), single, rng
        )
        if one is None:
            break
        orders, added = (*refined, one), True
    if not added:
        return first
    orders = _drop_unneeded_orders(
        model,
        model_without,
        law,
        _merge_unresolved_orders(model, model_without, law, _refine_orders(model, model_without, law, orders)),
    )
    own = score_hypotheses(model_without, [_build_order_columns(model, _combine_waves(law, orders), orders)])[0]
    return replace(first, scored=own)


def _find_next_order(
    model: WhitenedModel, single: Sequence[WhitenedHypothesis], rng: np.random.Generator
) -> float | None:
    """Return the order of one more supported harmonic; None if there is none."""
    ranked = sorted(
        score_hypotheses(model, single),
        key=lambda s: s.whitened.hypothesis.penalty * model.residual_variance - s.total,
    )
    best = next((s for s in ranked if is_supported(model, s)), None)
    if best is None:
        return None
    left = model.with_law(best.whitened, best.shape).residual
    each = [best, *(f for f in fit_hypotheses(model, single) if f.whitened is not best.whitened)]
    if float(compute_chance_probability(model, each, left, rng)[0]) > thresholds.LEVELS.significance_level:
        return None
    return float(best.whitened.shapes[best.shape][0])


def _refine_orders(model: WhitenedModel, model_without: WhitenedModel, law: EffectHypothesis, orders: Shape) -> Shape:
    """Refine each order with the others fixed; integer orders are preferred if they are no worse."""
    assert law.refinement is not None  # of a wave
    out = list(orders)
    for share in NARROWER:
        for n, order in enumerate(out):
            m = model_without
            if len(out) > 1:
                m = model_without.with_columns(
                    _build_order_columns(model, law, tuple(v for i, v in enumerate(out) if i != n)).columns_at(0)
                )
            about = tuple(dict.fromkeys(((order,), *law.refinement.shapes_around((order,), share))))
            gain = compute_gain_by_shape(m, whiten_hypotheses(model, [replace(law, shapes=about)])[0])
            near = np.flatnonzero(gain.max() - gain < thresholds.LEVELS.gain_two_sigma * m.residual_variance)
            plain = [i for i in near.tolist() if law.refinement.is_preferred(about[i])]
            out[n] = about[max(plain or near.tolist(), key=lambda i: float(gain[i]))][0]
    return tuple(dict.fromkeys(out))


def _merge_unresolved_orders(
    model: WhitenedModel, model_without: WhitenedModel, law: EffectHypothesis, orders: Shape
) -> Shape:
    """Merge orders that the range of the joint cannot resolve, and refine the rest.

    Two orders with less than a fraction of a beat in the range are one harmonic to these data. Fitted separately they
    get large cancelling amplitudes.
    """
    assert law.refinement is not None  # of a wave
    while len(orders) > 1:
        row = np.argsort(orders)
        k = int(np.argmin(np.diff(np.array(orders)[row])))
        pair = row[k : k + 2].tolist()
        if orders[pair[1]] - orders[pair[0]] >= law.refinement.minimum_separation:
            break
        ways = [orders[:n] + orders[n + 1 :] for n in pair]
        merged = min(
            ways, key=lambda way: model_without.with_columns(_build_order_columns(model, law, way).columns_at(0)).rss
        )
        orders = _refine_orders(model, model_without, law, merged)
    return orders


def _drop_unneeded_orders(
    model: WhitenedModel, model_without: WhitenedModel, law: EffectHypothesis, orders: Shape
) -> Shape:
    """Drop orders that the others make unnecessary, and refine the rest."""
    while len(orders) > 1:
        need = []
        for n in range(len(orders)):
            rest = model_without.with_columns(
                _build_order_columns(model, law, orders[:n] + orders[n + 1 :]).columns_at(0)
            )
            s = score_hypotheses(rest, [_build_order_columns(model, law, (orders[n],))])[0]
            need.append(s.gain / rest.residual_variance - compute_least_gain(rest, s.whitened))
        worst = int(np.argmin(need))
        if need[worst] >= 0.0:
            break
        orders = _refine_orders(model, model_without, law, orders[:worst] + orders[worst + 1 :])
    return orders


def _build_order_columns(model: WhitenedModel, law: EffectHypothesis, orders: Shape) -> WhitenedHypothesis:
    return whiten_hypotheses(model, [replace(law, shapes=(orders,))])[0]


def _combine_waves(law: EffectHypothesis, orders: Shape) -> EffectHypothesis:
    """Combine several harmonics into one law with individually refined orders."""
    assert law.refinement is not None  # of a wave
    if len(orders) == 1:
        return law
    return replace(
        law, law=f"{len(orders)} {law.sum_name}", refinement=_build_order_refinement(law.refinement), penalty=0.0
    )


def _build_order_refinement(one: ShapeRefinement) -> ShapeRefinement:
    """Build the refinement of several orders: one after the other, with the others fixed."""

    def about(shape: Shape, share: float) -> tuple[Shape, ...]:
        out = []
        for n, order in enumerate(shape):
            out += [(*shape[:n], *v, *shape[n + 1 :]) for v in one.shapes_around((order,), share)]
        return tuple(out)

    def describe_shapes(shapes: Sequence[Shape]) -> str:
        best: Array = np.array(shapes)
        return "; ".join(filter(None, (one.describe_ambiguity([(float(v),) for v in own]) for own in best.T)))

    return ShapeRefinement(
        shapes_around=about,
        is_preferred=lambda s: all(one.is_preferred((v,)) for v in s),
        describe_ambiguity=describe_shapes,
        minimum_separation=one.minimum_separation,
    )
