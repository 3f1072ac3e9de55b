"""Inputs of the model that are stated with an uncertainty: fitted with their prior beside the selected effects.

A search with them in the base would use them for every mismatch. They are therefore added to its result. An effect
that they explain within their uncertainty is dropped, and the intervals of the others contain them. Where a fit needs
more than three standard deviations of an input, the input is not what the readings show, and the result stays.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from machopt.measurement import thresholds
from machopt.measurement.diagnosis.model_selection.search.candidate_checks import compute_least_gain
from machopt.measurement.diagnosis.model_selection.search.predictive_score import (
    drop_unpredictive_effects,
    score_together,
)
from machopt.measurement.diagnosis.model_selection.search.search_state import SearchState
from machopt.measurement.diagnosis.model_selection.search.selected_effect import SelectedEffect, add_selected_effects
from machopt.measurement.diagnosis.statistics.normal_equations_by_fold import WhitenedModel


def include_uncertain_inputs(state: SearchState) -> SearchState:
    """Return the state with the uncertain inputs in its base, and with the effects that they do not explain.

    Args:
        state: State of the finished search.

    Returns:
        The new state; the given one without such inputs, or if they would have to be implausible.
    """
    inputs = state.catalogue.uncertain_inputs
    if inputs is None or len(state.chosen) > thresholds.COUNTS.max_stepwise_effects:
        return state
    problem = replace(
        state.problem,
        base=np.concatenate([state.problem.base, inputs.columns], axis=2),
        unknowns=(*state.problem.unknowns, *inputs.unknowns),
    )
    columns = state.whitening.whiten(inputs.columns)
    unit = 1.0 / np.maximum(np.sqrt(np.mean(columns**2, axis=0)), np.finfo(float).tiny)
    base = state.base.with_columns(columns * unit, (unit / np.array([u.prior for u in inputs.unknowns], float)) ** 2)
    whole = replace(state, problem=problem, base=base, base_units=np.concatenate([state.base_units, unit]))
    for findings in (_drop_explained(base, state.chosen), tuple(score_together(base, state.chosen))):
        if _are_plausible(whole, findings):
            return replace(whole, chosen=findings)
    return state


def _drop_explained(base: WhitenedModel, chosen: tuple[SelectedEffect, ...]) -> tuple[SelectedEffect, ...]:
    """Return the effects that predict unseen readings, and that keep half of their gain or enough of it."""
    before = {c.whitened.hypothesis.name: c.scored.gain for c in chosen}
    out = drop_unpredictive_effects(base, chosen)
    while True:
        weak = []
        for c in out:
            beside = add_selected_effects(base, [o for o in out if o is not c])
            least = compute_least_gain(beside, c.whitened) * beside.residual_variance
            half = thresholds.SHARES.min_transfer * before[c.whitened.hypothesis.name]
            if c.scored.gain < min(least, half):
                weak.append(c)
        if not weak:
            return tuple(out)
        worst = min(weak, key=lambda c: c.scored.gain)
        out = score_together(base, [o for o in out if o is not worst])


def _are_plausible(state: SearchState, chosen: tuple[SelectedEffect, ...]) -> bool:
    """Return whether all uncertain inputs stay within three standard deviations of what is stated."""
    assert state.catalogue.uncertain_inputs is not None  # checked by the caller
    unknowns = state.catalogue.uncertain_inputs.unknowns
    P = len(state.base_units)
    values = (add_selected_effects(state.base, chosen).coefficients[:P] * state.base_units)[P - len(unknowns) :]
    scales = np.array([u.prior for u in unknowns], float)
    return bool(np.all(np.abs(values) ** 2 <= thresholds.LEVELS.gain_three_sigma * scales**2))
