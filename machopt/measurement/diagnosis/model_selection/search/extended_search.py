"""A second look where what was found leaves more than noise, or says in several parts what one law says in few numbers.

First among laws of more shapes than noise lets be tried, then among forms that have no name. What was found stands
where none of these is taken.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from machopt.measurement.diagnosis import thresholds
from machopt.measurement.diagnosis.data_types.diagnosis_problem import EffectHypothesis, HypothesisCatalogue
from machopt.measurement.diagnosis.model_selection.search import harmonic_orders, joint_selection
from machopt.measurement.diagnosis.model_selection.search.forward_selection import SelectedEffect, add_selected_effects
from machopt.measurement.diagnosis.statistics.normal_equations_by_fold import (
    WhitenedHypothesis,
    WhitenedModel,
    whiten_hypotheses,
)

SearchOutcome = tuple[
    tuple[WhitenedHypothesis, ...], tuple[SelectedEffect, ...]
]  # laws that rivals are taken from, what was found


def search_extended_hypotheses(
    base: WhitenedModel, catalogue: HypothesisCatalogue, found: SearchOutcome, most: int, seed: int, fits: float
) -> SearchOutcome:
    """What was found, or what the same search finds among further laws, too.

    Args:
        base: the base.
        catalogue: with further laws, and forms without a name.
        found: what a search among the others found.
        most: effects at most.
        seed: of the sign flips.
        fits: whitened variance of what noise alone would leave; NaN: nobody measured it.
    """
    if _has_remaining_mismatch(base, found[1], fits):
        found = _search_again(base, catalogue.extended_hypotheses, found, most, np.random.default_rng([seed, 5]), fits)
    several = harmonic_orders.count_parts(found[1]) > 1 and len(found[1]) <= thresholds.RESTING.crowded
    if several or _has_remaining_mismatch(base, found[1], fits):
        again = _search_again(
            base, catalogue.uncatalogued_hypotheses, found, most, np.random.default_rng([seed, 6]), fits
        )
        if _is_shorter_description(base, again[1], found[1]):
            found = again
    return found


def compute_mismatch_threshold(base: WhitenedModel) -> float:
    """Variance of whitened residuals beyond 1 from which on there is a mismatch; more where visits are few."""
    error = float(np.sqrt(2.0 / len(base.w.group_of_visit)))
    return max(thresholds.PROOF.restless, thresholds.PROOF.restless_errors * error)


def _has_remaining_mismatch(base: WhitenedModel, chosen: Sequence[SelectedEffect], fits: float) -> bool:
    """Whether what was found one by one leaves more than noise."""
    few = len(chosen) <= thresholds.RESTING.crowded
    return (
        few
        and np.isfinite(fits)
        and add_selected_effects(base, chosen).residual_variance > fits + compute_mismatch_threshold(base)
    )


def _search_again(
    base: WhitenedModel,
    laws: Sequence[EffectHypothesis],
    found: SearchOutcome,
    most: int,
    rng: np.random.Generator,
    fits: float,
) -> SearchOutcome:
    """What the search finds once more among further laws, too; ``found`` where none of these is taken."""
    more = whiten_hypotheses(base, laws)
    if not more:
        return found
    again = joint_selection.search_effects(base, (*found[0], *more), most, rng, fits)
    return again if any(any(c.whitened is t for t in more) for c in again[1]) else found


def _is_shorter_description(base: WhitenedModel, new: Sequence[SelectedEffect], old: Sequence[SelectedEffect]) -> bool:
    """Whether what was found anew says as much in clearly fewer numbers, or clearly more: by the BIC of both."""
    models = [add_selected_effects(base, c) for c in (new, old)]
    spread = min(m.residual_variance for m in models)
    numbers = [sum(len(c.scored.x) + len(c.whitened.shapes[c.scored.shape]) for c in some) for some in (new, old)]
    lengths = [m.rss / spread + n * float(np.log(len(m.y))) for m, n in zip(models, numbers, strict=True)]
    return lengths[0] < lengths[1] - thresholds.DETECTION.shorter
