"""Attribution guard: a form without a name that fits as well as an effect removes its name.

A hose between column and forearm resembles a gravity compensator. The true law is not outperformed by an approximation
with no more coefficients.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

from machopt.effects import registry
from machopt.measurement import thresholds
from machopt.measurement.diagnosis.model_selection.attribution.attribution_guard import has_many_effects, remove_name
from machopt.measurement.diagnosis.model_selection.screening.hypothesis_screening import (
    ScoredHypothesis,
    score_hypotheses,
)
from machopt.measurement.diagnosis.model_selection.search.search_state import SearchState
from machopt.measurement.diagnosis.model_selection.search.selected_effect import SelectedEffect, add_selected_effects
from machopt.measurement.diagnosis.statistics.whitened_hypothesis import WhitenedHypothesis, whiten_hypotheses

UNCATALOGUED_REASON = "is no better than a form without a name"
MIN_COEFFICIENTS = 4  # least number of coefficients of an uncatalogued form in measured poses


def remove_names_if_form_fits_displacements(state: SearchState) -> SearchState:
    """Remove the names of effects in load tests that an approximate law or an uncatalogued form explains as well.

    Args:
        state: State of the search.

    Returns:
        The state with the remaining names.
    """
    state = _remove_names(state, [()] * len(state.chosen))
    if not any(c.whitened.hypothesis.is_in_catalogue for c in state.chosen):
        return state
    forms = whiten_hypotheses(state.base, state.catalogue.uncatalogued_hypotheses)
    return _remove_names(state, [forms] * len(state.chosen))


def remove_names_if_form_fits_positions(state: SearchState) -> SearchState:
    """Remove the names of effects of measured poses that a form with no more coefficients explains as well.

    Args:
        state: State of the search.

    Returns:
        The state with the remaining names.
    """
    return state if has_many_effects(state) else _remove_names(state, _list_comparable_forms(state))


def remove_names_if_form_fits_torques(state: SearchState) -> SearchState:
    """Remove the names of torque laws over the joint angle that a form at their joint explains as well.

    Args:
        state: State of the search.

    Returns:
        The state with the remaining names.
    """
    return _remove_names(state, [_list_forms_at_joint(state, k) for k in range(len(state.chosen))])


def _remove_names(state: SearchState, forms: Sequence[Sequence[WhitenedHypothesis]]) -> SearchState:
    """Return the state without the names of effects that one of their forms explains as well."""
    return replace(state, chosen=tuple(_remove_name_if_form_fits(state, k, more) for k, more in enumerate(forms)))


def _list_comparable_forms(state: SearchState) -> list[tuple[WhitenedHypothesis, ...]]:
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


def _list_forms_at_joint(state: SearchState, k: int) -> tuple[WhitenedHypothesis, ...]:
    """Return the uncatalogued forms at the joint of an angle-dependent torque law."""
    h = state.chosen[k].whitened.hypothesis
    if h.effect not in {e.file_word for e in registry.select_parallel_torque_effects()}:
        return ()
    return tuple(
        whiten_hypotheses(state.base, [n for n in state.catalogue.uncatalogued_hypotheses if n.location == h.location])
    )


def _remove_name_if_form_fits(state: SearchState, k: int, more: Sequence[WhitenedHypothesis] = ()) -> SelectedEffect:
    """Return the k-th effect, without its name if an uncatalogued form with no more coefficients fits as well."""
    c = state.chosen[k]
    rough = [*(t for t in state.whitened_hypotheses if t.hypothesis.is_approximate), *more]
    if not c.whitened.hypothesis.is_in_catalogue or not rough:
        return c
    model_without = add_selected_effects(state.base, [o for i, o in enumerate(state.chosen) if i != k])
    own = score_hypotheses(model_without, [c.whitened])[0]

    def worth(s: ScoredHypothesis) -> float:
        numbers = s.whitened.X.shape[2] + len(s.whitened.shapes[s.shape])
        return float(s.gain / model_without.residual_variance - thresholds.LEVELS.gain_two_sigma * numbers)

    # dozens of forms are tried for this purpose only: the best of many is good by chance
    most = worth(own) + (thresholds.LEVELS.min_evidence if more else 0.0)
    better = [s for s in score_hypotheses(model_without, rough) if worth(s) > most]
    return (
        c
        if not better
        else remove_name(c, f"{UNCATALOGUED_REASON}, of something {_format_effect(max(better, key=worth))}")
    )


def _format_effect(s: ScoredHypothesis) -> str:
    return f"at {s.whitened.hypothesis.location} that {s.whitened.hypothesis.law}"
