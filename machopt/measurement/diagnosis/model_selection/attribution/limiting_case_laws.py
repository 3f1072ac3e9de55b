"""Laws at the end of their grid where they become another law. The limiting law is reported unless the data exclude
it.

A gear that is softer below a knee smaller than every load is a gear with backlash. Creep with a time constant beyond
the observed time is a permanent twist, that is hysteresis. The simpler name is reported, and the other stays in
``one_of``. Smaller loads or longer rests separate them. The limiting law must reach nearly the same gain.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import replace

from machopt.effects.joint import backlash, creep, hysteresis, nonlinear_stiffness
from machopt.measurement import thresholds
from machopt.measurement.diagnosis.model_selection.evaluation.finding_estimates import find_rival_explanations
from machopt.measurement.diagnosis.model_selection.screening.hypothesis_screening import (
    ScoredHypothesis,
    score_hypotheses,
)
from machopt.measurement.diagnosis.model_selection.search.candidate_checks import is_supported
from machopt.measurement.diagnosis.model_selection.search.search_state import SearchState
from machopt.measurement.diagnosis.model_selection.search.selected_effect import SelectedEffect, add_selected_effects


def rename_limiting_cases(state: SearchState) -> SearchState:
    """Replace laws at such an end by their limiting law.

    Args:
        state: State of the search.

    Returns:
        The state with the replaced effects.
    """
    out = list(state.chosen)
    for k, c in enumerate(out):
        other = _find_limiting_effect(c)
        if other is None:
            continue
        _, open_ = find_rival_explanations(state.base, out, k, state.catalogue_hypotheses)
        if (other, c.whitened.hypothesis.location) in open_:
            there = _find_best_replacement(state, out, k, other)
            out[k] = c if there is None else replace(c, scored=there)
    return replace(state, chosen=tuple(out))


def _find_limiting_effect(c: SelectedEffect) -> str | None:
    end = LIMITING_CASES.get(c.whitened.hypothesis.effect)
    return end[0] if end is not None and end[1](c) else None


def _find_best_replacement(
    state: SearchState, chosen: list[SelectedEffect], k: int, effect: str
) -> ScoredHypothesis | None:
    """Return the best law of an effect in place of the k-th; None if none is supported and equally good."""
    model_without = add_selected_effects(state.base, chosen[:k] + chosen[k + 1 :])
    place = chosen[k].whitened.hypothesis.location
    least = (1.0 - thresholds.SHARES.law_error) * score_hypotheses(model_without, [chosen[k].whitened])[0].gain
    laws = [t for t in state.catalogue_hypotheses if t.hypothesis.name == (effect, place)]
    found = [s for s in score_hypotheses(model_without, laws) if is_supported(model_without, s) and s.gain >= least]
    return max(found, key=lambda s: s.total) if found else None


def _is_knee_below_loads(c: SelectedEffect) -> bool:
    """Return whether the gear is softer below the smallest knee of the grid."""
    shapes, shape = c.whitened.shapes, c.whitened.shapes[c.scored.shape]
    return bool(shape and c.scored.x[0] > 0.0 and shape[0] <= min(s[0] for s in shapes))


def _is_time_constant_at_limit(c: SelectedEffect) -> bool:
    """Return whether a single time constant is the largest of the grid."""
    shapes, shape = c.whitened.shapes, c.whitened.shapes[c.scored.shape]
    return len(c.scored.x) == 1 and shape[0] >= max(s[0] for s in shapes)


LIMITING_CASES: Mapping[str, tuple[str, Callable[[SelectedEffect], bool]]] = {
    nonlinear_stiffness.EFFECT.name: (backlash.EFFECT.name, _is_knee_below_loads),
    creep.EFFECT.name: (hysteresis.EFFECT.name, _is_time_constant_at_limit),
}
