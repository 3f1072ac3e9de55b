"""Forward selection of effects by cross-validated gain; each step is tested against the chance level of the whole
search.

:data:`STEP_CHECKS` are the tests of a further effect. After every step :data:`GROWTH_STAGES` may exchange earlier
effects, and at the end effects are dropped that the others make unnecessary.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from itertools import combinations

import numpy as np
from numpy.typing import NDArray

from machopt.measurement import thresholds
from machopt.measurement.diagnosis.model_selection.screening.hypothesis_screening import (
    FittedHypothesis,
    ScoredHypothesis,
    compute_chance_probability,
    fit_hypotheses,
    score_hypotheses,
)
from machopt.measurement.diagnosis.model_selection.screening.significance_check import (
    find_insignificant_laws,
    project_to_plausible_coefficients,
)
from machopt.measurement.diagnosis.model_selection.search.candidate_checks import (
    compute_least_gain,
    is_large_enough,
    is_supported,
)
from machopt.measurement.diagnosis.model_selection.search.law_error import (
    compute_body_error_share,
    compute_law_error,
    has_law_deviation,
)
from machopt.measurement.diagnosis.model_selection.search.selected_effect import (
    SelectedEffect,
    add_selected_effects,
    is_law_deviation,
)
from machopt.measurement.diagnosis.model_selection.selection_stage import SelectionStage
from machopt.measurement.diagnosis.statistics.normal_equations_by_fold import WhitenedModel
from machopt.measurement.diagnosis.statistics.whitened_hypothesis import WhitenedHypothesis
from machopt.numerics.array_types import Array

Flags = NDArray[np.bool_]
PAIR_CANDIDATES = 6


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
        if len(chosen) > 1:
            for stage in GROWTH_STAGES:
                chosen = stage.regroup(search, model, chosen, start)
        chosen = grown(chosen)
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
    known = add_selected_effects(model, chosen).rss > thresholds.SHARES.majority * len(model.y)
    while True:
        model_without = [add_selected_effects(model, [o for o in chosen if o is not c]) for c in chosen]
        chosen = [
            replace(c, scored=score_hypotheses(m, [c.whitened])[0]) for m, c in zip(model_without, chosen, strict=True)
        ]
        needed = [
            s.gain / m.residual_variance - compute_least_gain(m, s.whitened)
            for m, s in zip(model_without, [c.scored for c in chosen], strict=True)
        ]
        if known and chosen and min(needed) < 0.0:
            del chosen[int(np.argmin(needed))]
            continue
        chosen = compute_chances(model, chosen, tried, rng)
        weak = [k for k, c in enumerate(chosen) if c.p_value > thresholds.LEVELS.significance_level]
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
        passed = np.ones(len(fitted), bool)
        for check in STEP_CHECKS:
            at = np.flatnonzero(passed)
            passed[at] = check.find_passing([fitted[k] for k in at], chance[at], chosen, self.body_error_share)
        good = [s for s, is_passed in zip(fitted, passed, strict=True) if is_passed]
        best = _select_supported_law(model, good)
        if best is None:
            return None
        return SelectedEffect(best, float(chance[[s.whitened is best.whitened for s in fitted].index(True)]))


def _has_gain_beyond_chance(
    fitted: Sequence[FittedHypothesis], chance: Array, chosen: Sequence[SelectedEffect], body_error_share: float
) -> Flags:
    return chance <= thresholds.LEVELS.significance_level


def _has_gain_beyond_law_errors(
    fitted: Sequence[FittedHypothesis], chance: Array, chosen: Sequence[SelectedEffect], body_error_share: float
) -> Flags:
    return np.array([s.gain > compute_law_error(s, chosen, body_error_share) for s in fitted], bool)


@dataclass(frozen=True, kw_only=True)
class StepCheck(SelectionStage):
    """Check of all further effects of a step: (fitted, chance, chosen, share of body errors) to flags (K,)."""

    find_passing: Callable[[Sequence[FittedHypothesis], Array, Sequence[SelectedEffect], float], Flags]


@dataclass(frozen=True, kw_only=True)
class GrowthStage(SelectionStage):
    """Exchange of selected effects after a step: (search, model, chosen, start) to the effects."""

    regroup: Callable[
        [_SelectionStep, WhitenedModel, list[SelectedEffect], Sequence[SelectedEffect]], list[SelectedEffect]
    ]


STEP_CHECKS: tuple[StepCheck, ...] = (
    StepCheck(
        name="chance",
        statistic="share of 499 sign flips of whole groups whose largest gain of any law and shape is as large",
        levels=("levels.significance_level",),
        reference="wild cluster bootstrap, max-T (Westfall & Young 1993)",
        rejects="the best of many laws where nothing is concealed",
        find_passing=_has_gain_beyond_chance,
    ),
    StepCheck(
        name="law error",
        statistic="gain per gain that the laws selected so far may leave because their form is not exact",
        levels=("shares.law_error", "shares.minority", "shares.body_law_error", "shares.exact_law_error"),
        reference="model discrepancy as a share of the effect (Kennedy & O'Hagan 2001)",
        rejects="an effect that is the residual of a larger one",
        find_passing=_has_gain_beyond_law_errors,
    ),
)


def _exchange_effects(
    search: _SelectionStep, model: WhitenedModel, chosen: list[SelectedEffect], start: Sequence[SelectedEffect]
) -> list[SelectedEffect]:
    """Re-select each effect with the others fixed."""
    out = list(chosen)
    for k in range(len(out)):
        if not any(t is out[k].whitened for t in search.whitened_hypotheses) or has_law_deviation(out[k], out):
            continue  # a sum of several laws, each of which would replace it, or a law with its deviation
        others = out[:k] + out[k + 1 :]
        again = search.find_next_effect(add_selected_effects(model, others), others)
        if again is not None:
            out[k] = again
    return out


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
    scored = score_hypotheses(model, [f.whitened for f in fitted if is_large_enough(model, f)])
    largest = next((s for s in sorted(scored, key=lambda s: -s.gain) if is_supported(model, s)), None)
    if largest is None:
        return None
    quiet = max(1.0, (model.rss - largest.gain) / max(len(model.y) - model.count, 1))

    def worth(s: ScoredHypothesis) -> float:
        more = s.whitened.X.shape[2] - 1
        own = s.whitened.hypothesis.penalty
        cost = min(
            (own + thresholds.LEVELS.gain_two_sigma * more) * model.residual_variance,
            (own + thresholds.LEVELS.gain_three_sigma * more) * quiet,
        )
        return float(s.total - cost)

    return next(s for s in sorted(scored, key=lambda s: -worth(s)) if s is largest or is_supported(model, s))


def _search_pairs(
    search: _SelectionStep, model: WhitenedModel, chosen: list[SelectedEffect], start: Sequence[SelectedEffect]
) -> list[SelectedEffect]:
    """Try all pairs among the best hypotheses in place of the first two; accept one that clearly outperforms them."""
    if len(chosen) != 2 or start:
        return chosen
    tried = search.whitened_hypotheses
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
            if one.total + second.total <= best + thresholds.LEVELS.gain_three_sigma * model.residual_variance:
                continue
            first = score_hypotheses(model.with_law(second.whitened, second.shape), [one.whitened])[0]
            both = [SelectedEffect(first, chosen[0].p_value), SelectedEffect(second, chosen[1].p_value)]
            if (
                is_supported(m, second)
                and _compute_joint_gain(model, both)
                > best + thresholds.LEVELS.gain_three_sigma * model.residual_variance
            ):
                best, pair = _compute_joint_gain(model, both), both
    return pair


GROWTH_STAGES: tuple[GrowthStage, ...] = (
    GrowthStage(
        name="pairs",
        statistic="cross-validated gain of each pair of the six best laws",
        levels=("levels.gain_three_sigma",),
        reference="best subsets of two (Furnival & Wilson 1974)",
        rejects="one effect that imitates two",
        regroup=_search_pairs,
    ),
    GrowthStage(
        name="exchange",
        statistic="gain of every law in place of each selected one",
        levels=("levels.significance_level", "shares.law_error"),
        reference="stepwise regression with exchanges (Efroymson 1960)",
        rejects="an early choice that later ones make wrong",
        regroup=_exchange_effects,
    ),
)


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
            remaining = [
                replace(c, scored=replace(s, x=project_to_plausible_coefficients(m, s.whitened, s.shape, s.x)[0]))
                for c, (m, s) in zip(out, again, strict=True)
            ]
            return sorted(remaining, key=lambda c: -c.scored.total)
        worst = min(weak, key=lambda k: again[k][1].total)
        out = out[:worst] + out[worst + 1 :]
