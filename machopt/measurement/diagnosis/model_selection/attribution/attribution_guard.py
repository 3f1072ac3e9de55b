"""Attribution guard: an effect is reported only if it explains more than remains unexplained.

The best law of a catalogue approximates any mismatch and takes much of it. If the noise is known, the remainder
beyond the noise is known too. A law that explains little more than this remainder may be another projection of the
same unmodelled cause. The same holds for a law with implausible parameters or a size that may be zero. Such a law
stays in the fit, so that no other takes its place, but it is reported by its location only.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from machopt.effects import registry
from machopt.effects.effect_wording import format_effect_in_sentence
from machopt.effects.structure import as_built_joint_frames
from machopt.measurement.diagnosis import thresholds
from machopt.measurement.diagnosis.data_types.diagnosis_problem import UNCATALOGUED, EffectHypothesis
from machopt.measurement.diagnosis.model_selection.attribution import place_certainty, time_stability
from machopt.measurement.diagnosis.model_selection.evaluation import repeatable_mismatch
from machopt.measurement.diagnosis.model_selection.evaluation.finding_estimates import is_size_significant
from machopt.measurement.diagnosis.model_selection.screening.hypothesis_screening import (
    ScoredHypothesis,
    score_hypotheses,
)
from machopt.measurement.diagnosis.model_selection.screening.session_transfer import (
    SESSION_DEPENDENT_FAMILIES,
    is_consistent_between_sessions,
)
from machopt.measurement.diagnosis.model_selection.search.forward_selection import (
    SelectedEffect,
    add_selected_effects,
    has_plausible_sizes,
    is_supported_without_session_check,
)
from machopt.measurement.diagnosis.model_selection.search.search_state import SearchState
from machopt.measurement.diagnosis.statistics import holdout_residuals
from machopt.measurement.diagnosis.statistics.whitened_hypothesis import WhitenedHypothesis, whiten_hypotheses
from machopt.numerics.array_types import Array

SMALL_GAIN_REASON = "explains little more than what is left beside it"
IMPLAUSIBLE_REASON = "would need numbers that nothing built has"
BETTER_LAW_REASON = "fits worse than another law of this place, which would need a size that nothing built has"
ZERO_SIZE_REASON = "may as well be of no size at all"
UNCATALOGUED_REASON = "is no better than a form without a name"
MIN_COEFFICIENTS = 4  # least number of coefficients of an uncatalogued form in measured poses
TIME_VARYING_REASON = "comes and goes with the hours"


def withhold_unsupported_names(state: SearchState, rng: np.random.Generator) -> SearchState:
    """Replace unsupported effects by uncatalogued ones with the same columns.

    Args:
        state: State of the search.
        rng: Random generator of the sign flips.

    Returns:
        The state with the remaining effects.
    """
    state = replace(
        state, chosen=tuple(c if _is_plausible(c) else _remove_name(c, IMPLAUSIBLE_REASON) for c in state.chosen)
    )
    state = replace(state, chosen=tuple(_withhold_if_implausible_law_fits(state, k) for k in range(len(state.chosen))))
    if state.problem.channel == "deflection":
        state = replace(state, chosen=tuple(_withhold_if_size_uncertain(state, k) for k in range(len(state.chosen))))
        state = replace(state, chosen=tuple(_withhold_if_uncatalogued_fits(state, k) for k in range(len(state.chosen))))
        if any(c.whitened.hypothesis.is_in_catalogue for c in state.chosen):
            forms = whiten_hypotheses(state.base, state.catalogue.uncatalogued_hypotheses)
            state = replace(
                state, chosen=tuple(_withhold_if_uncatalogued_fits(state, k, forms) for k in range(len(state.chosen)))
            )
    if state.problem.channel == "position" and not _has_many_effects(state):
        state = replace(
            state,
            chosen=tuple(
                _withhold_if_uncatalogued_fits(state, k, few)
                for k, few in enumerate(_list_comparable_uncatalogued(state))
            ),
        )
    if state.problem.channel == "torque":
        state = replace(
            state,
            chosen=tuple(
                _withhold_if_uncatalogued_fits(state, k, _list_uncatalogued_at_joint(state, k))
                for k in range(len(state.chosen))
            ),
        )
    if not any(_is_subject_to_guard(c) for c in state.chosen) or _has_many_effects(state):
        return state
    unsteady = [
        c.whitened.hypothesis.is_in_catalogue and time_stability.is_time_varying(state, c) for c in state.chosen
    ]
    steadily = (_remove_name(c, TIME_VARYING_REASON) if u else c for c, u in zip(state.chosen, unsteady, strict=True))
    chosen = _withhold_session_dependent(state, tuple(steadily))
    fit = state.fit_effects(chosen)
    whole = fit.heldout()
    left = _compute_unexplained_power(state, whole, fit.residual, rng)
    if left <= 0.0:
        return replace(state, chosen=chosen)
    return replace(state, chosen=_withhold_small_gains(state, chosen, whole, left))


def _withhold_small_gains(
    state: SearchState, chosen: tuple[SelectedEffect, ...], whole: Array, left: float
) -> tuple[SelectedEffect, ...]:
    """Remove the names of effects that take less power than what is left, unless their place is certain."""
    out = list(chosen)
    for k, c in enumerate(chosen):
        if not _is_subject_to_guard(c):
            continue
        without = state.fit_effects([o for o in chosen if o is not c]).heldout()
        taken = _compute_repeatable_power(state, without) - _compute_repeatable_power(state, whole)
        # a frame law is exact: the remainder has another cause and must be clearly larger
        frame = c.whitened.hypothesis.effect == as_built_joint_frames.EFFECT.name
        most = thresholds.PROOF.outweighs_exact if frame else thresholds.PROOF.outweighs
        if left > most * taken and not place_certainty.is_place_certain(state, chosen, k):
            out[k] = _remove_name(c, SMALL_GAIN_REASON)
    return tuple(out)


def find_contradicted_effect(state: SearchState) -> ScoredHypothesis | None:
    """Find the best effect that one session supports and another session contradicts.

    Args:
        state: State of the search.

    Returns:
        The effect, or None.
    """
    model = add_selected_effects(state.base, state.chosen)
    taken = {c.whitened.hypothesis.name for c in state.chosen}
    scored = score_hypotheses(model, [t for t in state.catalogue_hypotheses if t.hypothesis.name not in taken])
    for s in sorted(scored, key=lambda s: -s.total):
        if is_supported_without_session_check(model, s) and not is_consistent_between_sessions(model, s):
            return s
    return None


def _withhold_session_dependent(state: SearchState, chosen: tuple[SelectedEffect, ...]) -> tuple[SelectedEffect, ...]:
    """Withhold session-dependent effects if the sessions of a load test differ more by another cause.

    Replicates then differ by that cause too, and the remainder is hidden in the noise estimate.
    """
    if state.problem.channel != "deflection" or not any(
        c.whitened.hypothesis.family in SESSION_DEPENDENT_FAMILIES for c in chosen
    ):
        return chosen
    other = find_contradicted_effect(state)
    if other is None:
        return chosen
    return tuple(
        _remove_name(c, SMALL_GAIN_REASON)
        if c.whitened.hypothesis.family in SESSION_DEPENDENT_FAMILIES
        and other.gain > thresholds.PROOF.outweighs * c.scored.gain
        else c
        for c in chosen
    )


def _is_subject_to_guard(c: SelectedEffect) -> bool:
    """Return whether the guard applies: clock errors and lags are exact, frames absorb any motion of their joint."""
    h = c.whitened.hypothesis
    return h.is_in_catalogue and (not h.is_exact or h.family == "kinematic")


def _has_many_effects(state: SearchState) -> bool:
    """Return whether the poses show so many harmonics and frames that each is a small part of the mismatch."""
    return state.problem.channel == "position" and len(state.chosen) > thresholds.RESTING.crowded


def _compute_unexplained_power(state: SearchState, residual: Array, fitted: Array, rng: np.random.Generator) -> float:
    """Return the repeatable power of held-out residuals (N, D) above the noise, SI² per coordinate; 0 if
    insignificant.

    One estimate needs no noise level, the other no replicates; both must agree. Held-out residuals exceed the noise
    by the coefficient errors by as much as fitted residuals (N, D) fall below it.
    """
    problem = state.problem
    rest = repeatable_mismatch.measure_repeatable_mismatch(problem, residual, state.used_rows, state.noise, rng)
    if rest.p_value > thresholds.PROOF.certain:  # NaN without replicates
        return 0.0
    if rest.is_over_time:  # it varies with time, so that visits differ by it and it enters the noise estimate
        return rest.power
    floor = holdout_residuals.compute_noise_floor(problem, state.noise, state.used_rows) / problem.families[0].factor
    power = 0.5 * (_compute_repeatable_power(state, residual) + _compute_repeatable_power(state, fitted))
    return max(min(rest.power, power - floor**2), 0.0)


def _compute_repeatable_power(state: SearchState, residual: Array) -> float:
    problem = state.problem
    return (holdout_residuals.compute_rmse(problem, residual, state.used_rows) / problem.families[0].factor) ** 2


def _is_plausible(c: SelectedEffect) -> bool:
    h, s = c.whitened.hypothesis, c.scored
    return not h.is_in_catalogue or h.is_plausible(s.x * c.whitened.unit[s.shape], c.whitened.shapes[s.shape])


def _withhold_if_implausible_law_fits(state: SearchState, k: int) -> SelectedEffect:
    """Return the k-th effect, withheld if another effect of its place fits clearly better at an implausible size."""
    c = state.chosen[k]
    h = c.whitened.hypothesis
    rivals = [
        t
        for t in state.whitened_hypotheses
        if t.hypothesis.location == h.location and t.hypothesis.effect != h.effect and t.hypothesis.is_in_catalogue
    ]
    if not h.is_in_catalogue or not rivals:
        return c
    beside = add_selected_effects(state.base, [o for i, o in enumerate(state.chosen) if i != k])
    own = score_hypotheses(beside, [c.whitened])[0].total
    better = [s for s in score_hypotheses(beside, rivals) if not has_plausible_sizes(s)]
    least = (1.0 + thresholds.DETECTION.beside) * own
    return _remove_name(c, BETTER_LAW_REASON) if any(s.total > least for s in better) else c


def _withhold_if_size_uncertain(state: SearchState, k: int) -> SelectedEffect:
    """Return the k-th effect, withheld if the confidence interval of its size contains zero."""
    c = state.chosen[k]
    sure = not c.whitened.hypothesis.is_in_catalogue or is_size_significant(state.base, state.chosen, k)
    return c if sure else _remove_name(c, ZERO_SIZE_REASON)


def _list_comparable_uncatalogued(state: SearchState) -> list[tuple[WhitenedHypothesis, ...]]:
    """Return for each law the uncatalogued forms with at most as many coefficients."""
    laws = [c.whitened for c in state.chosen]
    most = [t.X.shape[2] + len(t.shapes[0]) if t.hypothesis.is_in_catalogue else 0 for t in laws]
    most = [m if m >= MIN_COEFFICIENTS else 0 for m in most]
    if not any(most):
        return [()] * len(laws)
    few = [
        n
        for n in state.catalogue.uncatalogued_hypotheses
        if n.columns(n.shapes[0]).shape[2] + len(n.shapes[0]) <= max(most)
    ]
    forms = whiten_hypotheses(state.base, few)
    return [tuple(t for t in forms if t.X.shape[2] + len(t.shapes[0]) <= m) for m in most]


def _list_uncatalogued_at_joint(state: SearchState, k: int) -> tuple[WhitenedHypothesis, ...]:
    """Return the uncatalogued forms at the joint of an angle-dependent torque law."""
    h = state.chosen[k].whitened.hypothesis
    if h.effect not in {e.file_word for e in registry.select_parallel_torque_effects()}:
        return ()
    return tuple(
        whiten_hypotheses(state.base, [n for n in state.catalogue.uncatalogued_hypotheses if n.location == h.location])
    )


def _withhold_if_uncatalogued_fits(
    state: SearchState, k: int, more: Sequence[WhitenedHypothesis] = ()
) -> SelectedEffect:
    """Return the k-th effect, withheld if an uncatalogued form with no more coefficients fits as well.

    A hose between column and forearm resembles a gravity compensator. The true law is not outperformed by an
    approximation.
    """
    c = state.chosen[k]
    rough = [*(t for t in state.whitened_hypotheses if t.hypothesis.is_approximate), *more]
    if not c.whitened.hypothesis.is_in_catalogue or not rough:
        return c
    model_without = add_selected_effects(state.base, [o for i, o in enumerate(state.chosen) if i != k])
    own = score_hypotheses(model_without, [c.whitened])[0]

    def worth(s: ScoredHypothesis) -> float:
        numbers = s.whitened.X.shape[2] + len(s.whitened.shapes[s.shape])
        return float(s.gain / model_without.residual_variance - thresholds.DETECTION.per_coefficient * numbers)

    # dozens of forms are tried for this purpose only: the best of many is good by chance
    most = worth(own) + (thresholds.DETECTION.shorter if more else 0.0)
    better = [s for s in score_hypotheses(model_without, rough) if worth(s) > most]
    return (
        c
        if not better
        else _remove_name(c, f"{UNCATALOGUED_REASON}, of something {_format_effect(max(better, key=worth))}")
    )


def _format_effect(s: ScoredHypothesis) -> str:
    return f"at {s.whitened.hypothesis.location} that {s.whitened.hypothesis.law}"


def _remove_name(c: SelectedEffect, why: str) -> SelectedEffect:
    h = c.whitened.hypothesis
    note = f"looks like {format_effect_in_sentence(*h.name)} ({h.law}) and {why}"
    unnamed: EffectHypothesis = replace(h, family=UNCATALOGUED, note=note)
    return replace(c, scored=replace(c.scored, whitened=replace(c.whitened, hypothesis=unnamed)))
