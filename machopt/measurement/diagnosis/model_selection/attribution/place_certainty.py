"""Certainty of the place of an effect beside a large remainder.

The law of a large effect is approximate. What it leaves is far above the noise, and other effects beside it then seem
small. An effect is certain nevertheless where two conditions hold on readings that no fit saw: the selected effects
together close most of the mismatch, and no law or form at another place closes half as much in its place.
"""

from __future__ import annotations

from collections.abc import Sequence

from machopt.measurement import thresholds
from machopt.measurement.diagnosis.model_selection.screening.hypothesis_screening import score_hypotheses
from machopt.measurement.diagnosis.model_selection.search.search_state import SearchState
from machopt.measurement.diagnosis.model_selection.search.selected_effect import SelectedEffect, add_selected_effects
from machopt.measurement.diagnosis.statistics.whitened_hypothesis import whiten_hypotheses


def compute_closed_share(state: SearchState, chosen: Sequence[SelectedEffect]) -> float:
    """Compute the share of the whitened mismatch beyond the noise that effects close together.

    Args:
        state: State of the search.
        chosen: Effects, each fitted together with the others.

    Returns:
        Share, 0 to 1; 0 where the base leaves nothing beyond the noise.
    """
    beyond = state.base.rss - len(state.base.y)
    if beyond <= 0.0:
        return 0.0
    left = add_selected_effects(state.base, chosen).rss - len(state.base.y)
    return 1.0 - max(left, 0.0) / beyond


def is_place_certain(state: SearchState, chosen: Sequence[SelectedEffect], k: int) -> bool:
    """Return whether the k-th effect is beyond doubt at its place.

    Args:
        state: State of the search.
        chosen: Effects, each fitted together with the others.
        k: Index of the effect.

    Returns:
        True if all effects close most of the mismatch, and no other place explains half as much as the effect.
    """
    if not state.noise.replicated or compute_closed_share(state, chosen) < thresholds.SHARES.half_power_amplitude:
        return False
    c = chosen[k]
    beside = add_selected_effects(state.base, [o for o in chosen if o is not c])
    names = {o.whitened.hypothesis.name for o in chosen}
    forms = whiten_hypotheses(state.base, state.catalogue.uncatalogued_hypotheses)
    elsewhere = [
        t
        for t in (*state.whitened_hypotheses, *forms)
        if t.hypothesis.location != c.whitened.hypothesis.location and t.hypothesis.name not in names
    ]
    own = score_hypotheses(beside, [c.whitened])[0].total
    return own > 0.0 and all(s.total < thresholds.SHARES.majority * own for s in score_hypotheses(beside, elsewhere))
