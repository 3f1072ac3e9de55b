"""Attribution guard: an effect is reported only if it explains more than remains unexplained.

The best law of a catalogue approximates any mismatch and takes much of it. If the noise is known, the remainder
beyond the noise is known too. A law that explains little more than this remainder may be another projection of the
same unmodelled cause. The same holds for a law with implausible parameters or a size that may be zero. Such a law
stays in the fit, so that no other takes its place, but it is reported by its location only.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from machopt.effects.effect_wording import format_effect_in_sentence
from machopt.effects.structure import as_built_joint_frames
from machopt.measurement import thresholds
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
from machopt.measurement.diagnosis.model_selection.search.candidate_checks import (
    has_plausible_sizes,
    is_supported_without_session_check,
)
from machopt.measurement.diagnosis.model_selection.search.search_state import SearchState
from machopt.measurement.diagnosis.model_selection.search.selected_effect import SelectedEffect, add_selected_effects
from machopt.measurement.diagnosis.statistics import holdout_residuals
from machopt.numerics.array_types import Array

SMALL_GAIN_REASON = "explains little more than what is left beside it"
IMPLAUSIBLE_REASON = "would need numbers that nothing built has"
BETTER_LAW_REASON = "fits worse than another law of this place, which would need a size that nothing built has"
ZERO_SIZE_REASON = "may as well be of no size at all"
TIME_VARYING_REASON = "comes and goes with the hours"


def remove_names_with_implausible_coefficients(state: SearchState) -> SearchState:
    """Remove the names of effects whose coefficients nothing built has.

    Args:
        state: State of the search.

    Returns:
        The state with the remaining names.
    """
    return replace(
        state, chosen=tuple(c if _is_plausible(c) else remove_name(c, IMPLAUSIBLE_REASON) for c in state.chosen)
    )


def remove_names_if_implausible_law_fits(state: SearchState) -> SearchState:
    """Remove the names of effects where another effect of their place fits clearly better, at an implausible size.

    Args:
        state: State of the search.

    Returns:
        The state with the remaining names.
    """
    return replace(
        state, chosen=tuple(_remove_name_if_implausible_law_fits(state, k) for k in range(len(state.chosen)))
    )


def remove_names_of_uncertain_size(state: SearchState) -> SearchState:
    """Remove the names of effects whose size may be zero.

    Args:
        state: State of the search.

    Returns:
        The state with the remaining names.
    """
    return replace(state, chosen=tuple(_remove_name_if_size_uncertain(state, k) for k in range(len(state.chosen))))


def remove_names_of_time_varying_effects(state: SearchState) -> SearchState:
    """Remove the names of frames and offsets of measured poses whose size varies with the hours.

    Args:
        state: State of the search.

    Returns:
        The state with the remaining names.
    """
    if not is_guarded(state):
        return state
    varies = [c.whitened.hypothesis.is_in_catalogue and time_stability.is_time_varying(state, c) for c in state.chosen]
    chosen = (remove_name(c, TIME_VARYING_REASON) if v else c for c, v in zip(state.chosen, varies, strict=True))
    return replace(state, chosen=tuple(chosen))


def remove_names_of_small_gain(state: SearchState, rng: np.random.Generator) -> SearchState:
    """Remove the names of effects that take less power than what is left, unless their place is certain.

    Args:
        state: State of the search.
        rng: Random generator of the sign flips.

    Returns:
        The state with the remaining names.
    """
    if not is_guarded(state):
        return state
    chosen = state.chosen
    fit = state.fit_effects(chosen)
    whole = fit.heldout()
    left = _compute_unexplained_power(state, whole, fit.residual, rng)
    if left <= 0.0:
        return state
    out = list(chosen)
    for k, c in enumerate(chosen):
        if not _is_subject_to_guard(c):
            continue
        without = state.fit_effects([o for o in chosen if o is not c]).heldout()
        taken = _compute_repeatable_power(state, without) - _compute_repeatable_power(state, whole)
        # a frame law is exact: the remainder has another cause and must be clearly larger
        frame = c.whitened.hypothesis.effect == as_built_joint_frames.EFFECT.name
        most = thresholds.RATIOS.larger if frame else thresholds.SHARES.majority
        if left > most * taken and not place_certainty.is_place_certain(state, chosen, k):
            out[k] = remove_name(c, SMALL_GAIN_REASON)
    return replace(state, chosen=tuple(out))


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


def remove_names_of_session_dependent_effects(state: SearchState) -> SearchState:
    """Remove the names of session-dependent effects if the sessions of a load test differ more by another cause.

    Replicates then differ by that cause too, and the remainder is hidden in the noise estimate.

    Args:
        state: State of the search.

    Returns:
        The state with the remaining names.
    """
    if not is_guarded(state) or not any(
        c.whitened.hypothesis.family in SESSION_DEPENDENT_FAMILIES for c in state.chosen
    ):
        return state
    other = find_contradicted_effect(state)
    if other is None:
        return state
    chosen = (
        remove_name(c, SMALL_GAIN_REASON)
        if c.whitened.hypothesis.family in SESSION_DEPENDENT_FAMILIES
        and other.gain > thresholds.SHARES.majority * c.scored.gain
        else c
        for c in state.chosen
    )
    return replace(state, chosen=tuple(chosen))


def is_guarded(state: SearchState) -> bool:
    """Return whether effects are compared with what is left: one of them is not exact, and they are few.

    Args:
        state: State of the search.

    Returns:
        True if so.
    """
    return any(_is_subject_to_guard(c) for c in state.chosen) and not has_many_effects(state)


def _is_subject_to_guard(c: SelectedEffect) -> bool:
    """Return whether the guard applies: clock errors and lags are exact, frames absorb any motion of their joint."""
    h = c.whitened.hypothesis
    return h.is_in_catalogue and (not h.is_exact or h.family == "kinematic")


def has_many_effects(state: SearchState) -> bool:
    """Return whether the poses show so many harmonics and frames that each is a small part of the mismatch.

    Args:
        state: State of the search.

    Returns:
        True if so.
    """
    return state.problem.channel == "position" and len(state.chosen) > thresholds.COUNTS.max_stepwise_effects


def _compute_unexplained_power(state: SearchState, residual: Array, fitted: Array, rng: np.random.Generator) -> float:
    """Return the repeatable power of held-out residuals (N, D) above the noise, SI² per coordinate; 0 if
    insignificant.

    One estimate needs no noise level, the other no replicates; both must agree. Held-out residuals exceed the noise
    by the coefficient errors by as much as fitted residuals (N, D) fall below it.
    """
    problem = state.problem
    rest = repeatable_mismatch.measure_repeatable_mismatch(problem, residual, state.used_rows, state.noise, rng)
    if rest.p_value > thresholds.LEVELS.mismatch_significance_level:  # NaN without replicates
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


def _remove_name_if_implausible_law_fits(state: SearchState, k: int) -> SelectedEffect:
    """Return the k-th effect, without its name if another one here fits clearly better at an implausible size."""
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
    least = (1.0 + thresholds.SHARES.law_error) * own
    return remove_name(c, BETTER_LAW_REASON) if any(s.total > least for s in better) else c


def _remove_name_if_size_uncertain(state: SearchState, k: int) -> SelectedEffect:
    """Return the k-th effect, without its name if the confidence interval of its size contains zero."""
    c = state.chosen[k]
    sure = not c.whitened.hypothesis.is_in_catalogue or is_size_significant(state.base, state.chosen, k)
    return c if sure else remove_name(c, ZERO_SIZE_REASON)


def remove_name(c: SelectedEffect, why: str) -> SelectedEffect:
    """Return an effect of the same columns that is reported by its location only.

    Args:
        c: Selected effect.
        why: Reason, as the end of a sentence.

    Returns:
        The form without a name.
    """
    h = c.whitened.hypothesis
    note = f"looks like {format_effect_in_sentence(*h.name)} ({h.law}) and {why}"
    unnamed: EffectHypothesis = replace(h, family=UNCATALOGUED, note=note)
    return replace(c, scored=replace(c.scored, whitened=replace(c.whitened, hypothesis=unnamed)))
