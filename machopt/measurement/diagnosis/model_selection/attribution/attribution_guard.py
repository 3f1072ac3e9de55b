"""A name only for a law that explains more than what nothing explains.

The best of a catalogue is the nearest shape to whatever is there, and takes much of it. Where the noise is known, so is
what the whole sum leaves beyond it; a law that takes little more than that may well be one more side of the very thing
that is not understood. So may a law whose numbers nothing built has, or whose size may be none. Each stays in the fit,
so that no other takes its place, and is said with its place, not named.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from machopt.effects import registry
from machopt.effects.effect_wording import format_effect_in_sentence
from machopt.effects.structure import link_geometry
from machopt.measurement.diagnosis import thresholds
from machopt.measurement.diagnosis.data_types.diagnosis_problem import UNCATALOGUED, EffectHypothesis
from machopt.measurement.diagnosis.model_selection.attribution import time_stability
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
    is_supported_without_session_check,
)
from machopt.measurement.diagnosis.model_selection.search.search_state import SearchState
from machopt.measurement.diagnosis.statistics import holdout_residuals
from machopt.measurement.diagnosis.statistics.normal_equations_by_fold import WhitenedHypothesis, whiten_hypotheses
from machopt.numerics.array_types import Array

SMALL_GAIN_REASON = "explains little more than what is left beside it"
IMPLAUSIBLE_REASON = "would need numbers that nothing built has"
ZERO_SIZE_REASON = "may as well be of no size at all"
UNCATALOGUED_REASON = "is no better than a form without a name"
MIN_COEFFICIENTS = 4  # numbers of a form of measured poses
TIME_VARYING_REASON = "comes and goes with the hours"


def withhold_unsupported_names(state: SearchState, rng: np.random.Generator) -> SearchState:
    """The state, with the laws that what is left outweighs as things without a name.

    Args:
        state: of the search.
        rng: of the sign flips that judge what is left.
    """
    state = replace(
        state, chosen=tuple(c if _is_plausible(c) else _remove_name(c, IMPLAUSIBLE_REASON) for c in state.chosen)
    )
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
    out = list(chosen)
    for k, c in enumerate(chosen):
        if not _is_subject_to_guard(c):
            continue
        without = state.fit_effects([o for o in chosen if o is not c]).heldout()
        taken = _compute_repeatable_power(state, without) - _compute_repeatable_power(state, whole)
        # a frame leaves nothing of itself: what is left is something else, and has to be clearly more
        frame = c.whitened.hypothesis.effect == link_geometry.EFFECT.name
        most = thresholds.PROOF.outweighs_exact if frame else thresholds.PROOF.outweighs
        if left > most * taken:
            out[k] = _remove_name(c, SMALL_GAIN_REASON)
    return replace(state, chosen=tuple(out))


def find_contradicted_effect(state: SearchState) -> ScoredHypothesis | None:
    """The effect that would be named by one session and that another contradicts: the best of them, if any."""
    model = add_selected_effects(state.base, state.chosen)
    taken = {c.whitened.hypothesis.name for c in state.chosen}
    scored = score_hypotheses(model, [t for t in state.catalogue_hypotheses if t.hypothesis.name not in taken])
    for s in sorted(scored, key=lambda s: -s.total):
        if is_supported_without_session_check(model, s) and not is_consistent_between_sessions(model, s):
            return s
    return None


def _withhold_session_dependent(state: SearchState, chosen: tuple[SelectedEffect, ...]) -> tuple[SelectedEffect, ...]:
    """What may be another each day is no name where the days of a load test differ by more of something else.

    Twins then differ by that, too, and what is left hides in what passes for their noise.
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
    """A clock or a lag is what it is, however much else is there; a frame takes in whatever moves with its joint."""
    h = c.whitened.hypothesis
    return h.is_in_catalogue and (not h.is_exact or h.family == "kinematic")


def _has_many_effects(state: SearchState) -> bool:
    """Whether poses show so many waves and frames that each of them is a small part of the whole."""
    return state.problem.channel == "position" and len(state.chosen) > thresholds.RESTING.crowded


def _compute_unexplained_power(state: SearchState, residual: Array, fitted: Array, rng: np.random.Generator) -> float:
    """What comes back of held-out residuals (N, D) and lies above the noise, SI² per coordinate; 0: nothing for sure.

    The one needs no level of noise, the other no repeats of the same thing; a name is kept back where both say so.
    Unseen groups err by as much more than noise, for the coefficients' own error, as ``fitted`` ones (N, D) do by less.
    """
    problem = state.problem
    rest = repeatable_mismatch.measure_repeatable_mismatch(problem, residual, state.used_rows, state.noise, rng)
    if rest.p_value > thresholds.PROOF.certain:  # not a number where nothing was repeated
        return 0.0
    if rest.is_over_time:  # it comes and goes, so that visits differ by it, and hides in what passes for their noise
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


def _withhold_if_size_uncertain(state: SearchState, k: int) -> SelectedEffect:
    """The k-th, without a name where the interval of its size holds zero: one number of a law is sure, not the law."""
    c = state.chosen[k]
    sure = not c.whitened.hypothesis.is_in_catalogue or is_size_significant(state.base, state.chosen, k)
    return c if sure else _remove_name(c, ZERO_SIZE_REASON)


def _list_comparable_uncatalogued(state: SearchState) -> list[tuple[WhitenedHypothesis, ...]]:
    """Forms without a name that have no more numbers than each law: one law of many is any of several things."""
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
    """Forms without a name at the joint of a torque by angle alone, which many things are that pull at a joint."""
    h = state.chosen[k].whitened.hypothesis
    if h.effect not in {e.file_word for e in registry.select_parallel_torque_effects()}:
        return ()
    return tuple(
        whiten_hypotheses(state.base, [n for n in state.catalogue.uncatalogued_hypotheses if n.location == h.location])
    )


def _withhold_if_uncatalogued_fits(
    state: SearchState, k: int, more: Sequence[WhitenedHypothesis] = ()
) -> SelectedEffect:
    """The k-th, without a name where what is only like something without one says as much in no more numbers.

    A hose between column and forearm is nearly a balancer. The true law is beaten by no likeness.
    """
    c = state.chosen[k]
    rough = [*(t for t in state.whitened_hypotheses if t.hypothesis.is_approximate), *more]
    if not c.whitened.hypothesis.is_in_catalogue or not rough:
        return c
    beside = add_selected_effects(state.base, [o for i, o in enumerate(state.chosen) if i != k])
    own = score_hypotheses(beside, [c.whitened])[0]

    def worth(s: ScoredHypothesis) -> float:
        numbers = s.whitened.X.shape[2] + len(s.whitened.shapes[s.shape])
        return float(s.gain / beside.residual_variance - thresholds.DETECTION.per_coefficient * numbers)

    # those that are tried for this alone are dozens, and the best of so many is good by chance
    most = worth(own) + (thresholds.DETECTION.shorter if more else 0.0)
    better = [s for s in score_hypotheses(beside, rough) if worth(s) > most]
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
