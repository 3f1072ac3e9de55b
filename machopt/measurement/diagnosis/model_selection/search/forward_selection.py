"""Forward selection of effects by cross-validated gain; each step is tested against the chance level of the whole
search.

After every step earlier effects may be exchanged or dropped. Pairs among the best hypotheses are tried exhaustively,
because one effect can imitate two.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from itertools import combinations

import numpy as np

from machopt.data_types.effect_locations import BASE, LINK, TOOL, parse_location
from machopt.effects import registry
from machopt.effects.structure import as_built_joint_frames
from machopt.measurement.diagnosis import thresholds
from machopt.measurement.diagnosis.data_types.diagnosis_problem import EffectHypothesis
from machopt.measurement.diagnosis.model_selection.screening.hypothesis_screening import (
    FittedHypothesis,
    ScoredHypothesis,
    compute_chance_probability,
    fit_hypotheses,
    score_hypotheses,
)
from machopt.measurement.diagnosis.model_selection.screening.session_transfer import is_consistent_between_sessions
from machopt.measurement.diagnosis.model_selection.screening.significance_check import (
    find_insignificant_laws,
    project_to_plausible_coefficients,
)
from machopt.measurement.diagnosis.statistics.normal_equations_by_fold import WhitenedModel
from machopt.measurement.diagnosis.statistics.whitened_hypothesis import WhitenedHypothesis
from machopt.numerics.array_types import Array

PAIR_CANDIDATES = 6
BODY = "body"  # family of compliant bodies
SENSOR = "sensor"  # family of recording errors
LAW_DEVIATION = "deviation from a law"  # name of the form in :mod:`law_deviation`
RELATIVE_UNITS = {"%": 0.01, "deg": np.pi / 180.0}  # relative size of a gain, of an angle
JOINTS_BEFORE_WRIST = 3  # number of joints before the wrist
LAST_LINK_OF_SIX = 5  # from this link on, links count as next to the tool


@dataclass(frozen=True)
class SelectedEffect:
    """One effect of the selected model."""

    scored: ScoredHypothesis  # scored together with the other effects
    p_value: float
    law_error: float | None = None  # gain that the law may leave; None: a share of its own gain

    @property
    def whitened(self) -> WhitenedHypothesis:
        return self.scored.whitened

    @property
    def columns(self) -> Array:
        return self.scored.whitened.columns_at(self.scored.shape)


def compute_least_gain(model: WhitenedModel, s: FittedHypothesis) -> float:
    """Compute the gain that a hypothesis must reach, relative to the residual variance.

    Args:
        model: Whitened base model.
        s: Hypothesis fitted to all readings.

    Returns:
        Required gain.
    """
    h = s.whitened.hypothesis
    p = s.whitened.X.shape[2]
    least: float = thresholds.DETECTION.gain + thresholds.DETECTION.per_coefficient * (p - 1) + h.penalty
    return max(least, thresholds.DETECTION.share * len(model.y))


def is_supported(model: WhitenedModel, s: ScoredHypothesis) -> bool:
    """Return whether a hypothesis is large enough, cross-validated, and not limited to one group or session.

    Args:
        model: Whitened base model.
        s: Scored hypothesis.

    Returns:
        True if supported.
    """
    return is_supported_without_session_check(model, s) and is_consistent_between_sessions(model, s)


def is_supported_without_session_check(model: WhitenedModel, s: ScoredHypothesis) -> bool:
    """Return whether a hypothesis is supported, without the comparison between sessions.

    Args:
        model: Whitened base model.
        s: Scored hypothesis.

    Returns:
        True if supported.
    """
    return (
        _is_large_enough(model, s)
        and s.total > thresholds.DETECTION.generalises * s.gain
        and project_to_plausible_coefficients(model, s.whitened, s.shape, s.x)[1]
        <= (1.0 - thresholds.DETECTION.possible) * s.gain
        and _is_supported_by_several_groups(model, s)
        and not find_insignificant_laws(model.with_law(s.whitened, s.shape), [(s.whitened, s.shape)])
    )


def _is_large_enough(model: WhitenedModel, s: FittedHypothesis) -> bool:
    """Return whether a law gains enough with sizes that its effect can have."""
    return s.gain / model.residual_variance >= compute_least_gain(model, s) and has_plausible_sizes(s)


def _is_supported_by_several_groups(model: WhitenedModel, s: ScoredHypothesis) -> bool:
    """Return whether a law does not depend on a single group: the others contribute their share or suffice alone."""
    others = s.total - float(s.heldout.max())
    return (
        others > thresholds.DETECTION.without_best * s.total
        or others / model.residual_variance >= compute_least_gain(model, s)
    )


def has_plausible_sizes(s: FittedHypothesis) -> bool:
    """Return whether the size of a fitted law is one that its effect can have.

    Args:
        s: Hypothesis fitted to all readings.

    Returns:
        True if it can.
    """
    h = s.whitened.hypothesis
    size = next(iter(h.quantities(s.x * s.whitened.unit[s.shape], s.whitened.shapes[s.shape]).values()))
    known = registry.find_effect(h.effect)
    if abs(size.value) < h.least_size:
        return False
    return known is None or abs(size.value) <= known.plausible_sizes.get(size.unit, np.inf)


def select_effects(
    model: WhitenedModel,
    tried: Sequence[WhitenedHypothesis],
    most: int,
    rng: np.random.Generator,
    grown: Callable[[list[SelectedEffect]], list[SelectedEffect]] = lambda chosen: chosen,
    start: Sequence[SelectedEffect] = (),
) -> list[SelectedEffect]:
    """Select up to ``most`` effects.

    Args:
        model: Whitened base model.
        tried: All whitened hypotheses.
        most: Largest number of effects.
        rng: Random generator of the sign flips.
        grown: Function that extends the selection after every step, for example by further harmonic orders.
        start: Effects that are selected already, with deviations from their laws; deviations do not count.

    Returns:
        The selected effects.
    """
    search = _SelectionStep(
        tuple(tried), _select_greedily(model, start, tried, most).residual, rng, compute_body_error_share(tried)
    )
    chosen = list(start)
    first: list[SelectedEffect] = []
    while sum(not is_law_deviation(c) for c in chosen) < most:
        step = search.find_next_effect(add_selected_effects(model, chosen), chosen)
        if step is None:
            break
        chosen.append(step)
        if len(chosen) == 2 and not start:
            chosen = _search_pairs(model, tried, chosen)
        chosen = grown(search.exchange(model, chosen))
        first = first or list(chosen)
    # two effects that explain the same may both fail together: then the one selected alone is kept
    return _eliminate_backward(model, chosen) or _eliminate_backward(model, first)


def _select_greedily(
    model: WhitenedModel, start: Sequence[SelectedEffect], tried: Sequence[WhitenedHypothesis], most: int
) -> WhitenedModel:
    """Return the model with effects and the best supported hypotheses, without a chance level."""
    laws = [(c.whitened, c.scored.shape) for c in start]
    extended, added = model.extend_by_laws(laws), list[WhitenedHypothesis]()
    for _ in range(most):
        taken = {t.hypothesis.name for t in added}
        fitted = fit_hypotheses(extended, [t for t in tried if t.hypothesis.name not in taken])
        best = _select_supported_law(extended, fitted)
        if best is None:
            break
        laws.append((best.whitened, best.shape))
        added.append(best.whitened)
        is_free = all(t.hypothesis.prior_sigma is None for t in added)  # else the prior would be applied
        extended = model.extend_by_laws(laws) if is_free else extended.with_law(best.whitened, best.shape)
    return extended


def prune_joint_effects(
    model: WhitenedModel,
    laws: Sequence[WhitenedHypothesis],
    tried: Sequence[WhitenedHypothesis],
    rng: np.random.Generator,
) -> list[SelectedEffect]:
    """Refit jointly selected effects and drop those that the others make unnecessary.

    If the noise was estimated from residuals of a poorer model, it does not tell which effects are needed. Then all
    effects stay whose gain exceeds the chance level of a search with the whole sum.

    Args:
        model: Whitened base model.
        laws: Selected laws with one shape each.
        tried: All laws of the search.
        rng: Random generator of the sign flips.

    Returns:
        The remaining effects.
    """
    chosen = [SelectedEffect(score_hypotheses(model, [t])[0], 1.0) for t in laws]
    known = add_selected_effects(model, chosen).rss > thresholds.RESTING.noise_known * len(model.y)
    while True:
        model_without = [add_selected_effects(model, [o for o in chosen if o is not c]) for c in chosen]
        chosen = [
            replace(c, scored=score_hypotheses(m, [c.whitened])[0]) for m, c in zip(model_without, chosen, strict=True)
        ]
        needed = [
            s.gain / m.residual_variance - compute_least_gain(m, s)
            for m, s in zip(model_without, [c.scored for c in chosen], strict=True)
        ]
        if known and chosen and min(needed) < 0.0:
            del chosen[int(np.argmin(needed))]
            continue
        chosen = compute_chances(model, chosen, tried, rng)
        weak = [k for k, c in enumerate(chosen) if c.p_value > thresholds.DETECTION.chance]
        if not weak:
            return sorted(_refit_together(model, chosen), key=lambda c: -c.scored.total)
        del chosen[min(weak, key=lambda k: chosen[k].scored.gain)]


def _refit_together(model: WhitenedModel, chosen: Sequence[SelectedEffect]) -> list[SelectedEffect]:
    """Return each effect with its coefficients from the joint fit, to which the cross-validated error refers.

    Scored individually, a direction shared by two effects counts as absorbed in both and would vanish. Bounded laws
    keep coefficients within their bounds.
    """
    x, at, out = add_selected_effects(model, chosen).coefficients, model.count, []
    for c in chosen:
        p = len(c.scored.x)
        own = c.scored.x if c.whitened.hypothesis.lower else x[at : at + p]
        out.append(replace(c, scored=replace(c.scored, x=own)))
        at += p
    return out


def compute_chances(
    model: WhitenedModel,
    chosen: Sequence[SelectedEffect],
    tried: Sequence[WhitenedHypothesis],
    rng: np.random.Generator,
) -> list[SelectedEffect]:
    """Compute for each effect the probability that the largest gain of the search reaches its own by chance.

    Args:
        model: Whitened base model.
        chosen: Selected effects, each fitted together with the others.
        tried: All laws of the search.
        rng: Random generator of the sign flips.

    Returns:
        The effects with their p-value.
    """
    whole = add_selected_effects(model, chosen)
    chance = compute_chance_probability(
        whole, [*(c.scored for c in chosen), *fit_hypotheses(whole, tried)], whole.residual, rng
    )
    return [replace(c, p_value=float(p)) for c, p in zip(chosen, chance, strict=False)]


def add_selected_effects(model: WhitenedModel, chosen: Sequence[SelectedEffect]) -> WhitenedModel:
    """Return the model with the columns of selected effects.

    Args:
        model: Whitened base model.
        chosen: Selected effects, each fitted together with the others.

    Returns:
        The extended model.
    """
    return model.extend_by_laws([(c.whitened, c.scored.shape) for c in chosen])


@dataclass(frozen=True)
class _SelectionStep:
    """Data common to all steps of the search."""

    whitened_hypotheses: tuple[WhitenedHypothesis, ...]
    residual: Array  # (M,) whitened residuals of a model with all possible effects
    rng: np.random.Generator
    body_error_share: float  # see compute_law_error

    def find_next_effect(self, model: WhitenedModel, chosen: Sequence[SelectedEffect]) -> SelectedEffect | None:
        """Find the best further effect.

        Args:
            model: Whitened base model.
            chosen: Selected effects, each fitted together with the others.

        Returns:
            The effect; None if none is supported.
        """
        taken = {c.whitened.hypothesis.name for c in chosen}
        fitted = fit_hypotheses(model, [t for t in self.whitened_hypotheses if t.hypothesis.name not in taken])
        chance = compute_chance_probability(model, fitted, self.residual, self.rng)
        good = [
            s
            for p_value, s in zip(chance, fitted, strict=True)
            if p_value <= thresholds.DETECTION.chance and s.gain > compute_law_error(s, chosen, self.body_error_share)
        ]
        best = _select_supported_law(model, good)
        if best is None:
            return None
        return SelectedEffect(best, float(chance[[s.whitened is best.whitened for s in fitted].index(True)]))

    def exchange(self, model: WhitenedModel, chosen: list[SelectedEffect]) -> list[SelectedEffect]:
        """Re-select each effect with the others fixed.

        Args:
            model: Whitened base model.
            chosen: Selected effects, each fitted together with the others.

        Returns:
            The effects.
        """
        out = list(chosen)
        for k in range(len(out) if len(out) > 1 else 0):
            if not any(t is out[k].whitened for t in self.whitened_hypotheses) or _has_law_deviation(out[k], out):
                continue  # a sum of several laws, each of which would replace it, or a law with its deviation
            others = out[:k] + out[k + 1 :]
            again = self.find_next_effect(add_selected_effects(model, others), others)
            if again is not None:
                out[k] = again
        return out


def is_law_deviation(c: SelectedEffect) -> bool:
    """Return whether a selected form is the fitted deviation of another effect from its law.

    Args:
        c: Selected effect.

    Returns:
        True if so.
    """
    return c.whitened.hypothesis.law == LAW_DEVIATION


def compute_law_error(s: FittedHypothesis, chosen: Sequence[SelectedEffect], of_body: float = 0.0) -> float:
    """Compute the gain that the selected laws may leave because their form is not exact.

    Args:
        s: Further law.
        chosen: Selected effects, each fitted together with the others.
        of_body: Least relative model error of compliant bodies under weight.

    Returns:
        Gain that is not evidence for the further law.
    """

    def share(c: SelectedEffect) -> float:
        h = c.whitened.hypothesis
        if h.is_exact:
            return thresholds.DETECTION.beside_exact
        if h.is_approximate or _is_neighbour(h, s.whitened.hypothesis):
            return thresholds.DETECTION.beside_here
        if h.family == SENSOR:
            return min(thresholds.DETECTION.beside, _compute_second_order_share(c))
        bends = h.family == BODY and not _is_behind_body(s.whitened.hypothesis, h)
        return max(thresholds.DETECTION.beside, of_body if bends else 0.0)

    def error(c: SelectedEffect) -> float:
        if not _is_neighbour(c.whitened.hypothesis, s.whitened.hypothesis):
            if c.law_error is not None:
                return c.law_error
            if _has_law_deviation(c, chosen):
                return 0.0
        return c.scored.gain * share(c)

    return max((error(c) for c in chosen), default=0.0)


def _has_law_deviation(c: SelectedEffect, chosen: Sequence[SelectedEffect]) -> bool:
    """Return whether the deviation of an effect from its law is among the selected forms."""
    place = c.whitened.hypothesis.location
    return not is_law_deviation(c) and any(
        is_law_deviation(o) and o.whitened.hypothesis.location == place for o in chosen
    )


def _compute_second_order_share(c: SelectedEffect) -> float:
    """Return the remainder of a gain or axis-rotation column as a share of its power: the square of its size.

    A load cell with a gain error of 7 % has a large effect, but its linear law leaves only 0.5 %, less than laws of
    gears.
    """
    h, s = c.whitened.hypothesis, c.scored
    size = next(iter(h.quantities(s.x * c.whitened.unit[s.shape], c.whitened.shapes[s.shape]).values()))
    return float((size.value * RELATIVE_UNITS[size.unit]) ** 2) if size.unit in RELATIVE_UNITS else 1.0


def compute_body_error_share(tried: Sequence[WhitenedHypothesis]) -> float:
    """Return the least relative model error of compliant bodies in this channel.

    Args:
        tried: All whitened hypotheses.

    Returns:
        Share of the gain.
    """
    poses = any(t.hypothesis.effect == as_built_joint_frames.EFFECT.name for t in tried)
    return thresholds.DETECTION.beside_body if poses else 0.0


def _is_behind_body(a: EffectHypothesis, body: EffectHypothesis) -> bool:
    """Return whether a law acts at one of the first three joints behind a body, which rotate with the body's weight."""
    place, of = parse_location(a.location), parse_location(body.location)
    return place.is_joint_location and min(place.numbers, default=0) > max(
        n + 1 for n in (JOINTS_BEFORE_WRIST - 1, *of.numbers)
    )


def _is_neighbour(a: EffectHypothesis, b: EffectHypothesis) -> bool:
    """Return whether the remainder of one law resembles the other: the same place or an adjacent body."""
    if a.location == b.location:
        return True
    places = [parse_location(h.location) for h in (a, b)]
    links = [p.numbers[0] for p in places if p.kind == LINK]
    if len(links) == 2:
        return abs(links[0] - links[1]) <= 1
    kinds = {p.kind for p in places}
    return len(links) == 1 and (
        (kinds == {LINK, BASE} and links[0] == 1) or (kinds == {LINK, TOOL} and links[0] >= LAST_LINK_OF_SIX)
    )


def _select_supported_law(model: WhitenedModel, fitted: Sequence[FittedHypothesis]) -> ScoredHypothesis | None:
    """Select the best supported law by cross-validation, or one with fewer coefficients that is hardly worse.

    A strong effect dominates the residual variance; relative to it, a significant coefficient seems worthless. The
    cost of a coefficient is therefore limited by the threshold that rejects a rival. Only laws that gain enough are
    cross-validated, and they are tested for support in the order of their rank.

    Args:
        model: Whitened base model.
        fitted: Hypotheses to select from.

    Returns:
        The selected hypothesis; None if none is supported.
    """
    scored = score_hypotheses(model, [f.whitened for f in fitted if _is_large_enough(model, f)])
    largest = next((s for s in sorted(scored, key=lambda s: -s.gain) if is_supported(model, s)), None)
    if largest is None:
        return None
    quiet = max(1.0, (model.rss - largest.gain) / max(len(model.y) - model.count, 1))

    def worth(s: ScoredHypothesis) -> float:
        more, d = s.whitened.X.shape[2] - 1, thresholds.DETECTION
        own = s.whitened.hypothesis.penalty
        cost = min((own + d.simpler * more) * model.residual_variance, (own + d.as_good * more) * quiet)
        return float(s.total - cost)

    return next(s for s in sorted(scored, key=lambda s: -worth(s)) if s is largest or is_supported(model, s))


def _search_pairs(
    model: WhitenedModel, tried: Sequence[WhitenedHypothesis], chosen: list[SelectedEffect]
) -> list[SelectedEffect]:
    """Try all pairs among the best hypotheses; accept a pair that outperforms the selection."""
    scored = sorted(score_hypotheses(model, tried), key=lambda s: -s.total)
    leading: list[ScoredHypothesis] = []
    for s in scored:
        if s.whitened.hypothesis.name not in {o.whitened.hypothesis.name for o in leading}:
            leading.append(s)
        if len(leading) == PAIR_CANDIDATES:
            break
    best, pair = _compute_joint_gain(model, chosen), chosen
    for a, b in combinations(leading, 2):
        for one, two in ((a, b), (b, a)):
            m = model.with_law(one.whitened, one.shape)
            second = score_hypotheses(m, [two.whitened])[0]
            if one.total + second.total <= best + thresholds.DETECTION.pair_must_win * model.residual_variance:
                continue
            first = score_hypotheses(model.with_law(second.whitened, second.shape), [one.whitened])[0]
            both = [SelectedEffect(first, chosen[0].p_value), SelectedEffect(second, chosen[1].p_value)]
            if (
                is_supported(m, second)
                and _compute_joint_gain(model, both)
                > best + thresholds.DETECTION.pair_must_win * model.residual_variance
            ):
                best, pair = _compute_joint_gain(model, both), both
    return pair


def _compute_joint_gain(model: WhitenedModel, chosen: Sequence[SelectedEffect]) -> float:
    """Return the cross-validated gain of several effects together."""
    total = 0.0
    for c in chosen:
        total += score_hypotheses(model, [c.whitened])[0].total
        model = model.with_law(c.whitened, c.scored.shape)
    return total


def _eliminate_backward(model: WhitenedModel, chosen: list[SelectedEffect]) -> list[SelectedEffect]:
    """Drop unnecessary effects and score the rest together."""
    out = list(chosen)
    while True:
        again = []
        for k, c in enumerate(out):
            model_without = add_selected_effects(model, out[:k] + out[k + 1 :])
            again.append((model_without, score_hypotheses(model_without, [c.whitened])[0]))
        weak = [k for k, (m, s) in enumerate(again) if not is_supported(m, s)] or find_insignificant_laws(
            add_selected_effects(model, out), [(c.whitened, c.scored.shape) for c in out]
        )
        if not weak:
            kept = [
                replace(c, scored=replace(s, x=project_to_plausible_coefficients(m, s.whitened, s.shape, s.x)[0]))
                for c, (m, s) in zip(out, again, strict=True)
            ]
            return sorted(kept, key=lambda c: -c.scored.total)
        worst = min(weak, key=lambda k: again[k][1].total)
        out = out[:worst] + out[worst + 1 :]
