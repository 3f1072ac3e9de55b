"""Extended search if the selected effects leave more than noise, or if they need more coefficients than one other
law.

It tries first the laws with larger shape grids, then forms that are no effect of the catalogue. The selection stays
if none of these is accepted.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass

import numpy as np

from machopt.effects.joint import joint_angle_errors
from machopt.measurement import thresholds
from machopt.measurement.diagnosis.data_types.diagnosis_problem import EffectHypothesis, HypothesisCatalogue
from machopt.measurement.diagnosis.model_selection.search import harmonic_orders, search_stages
from machopt.measurement.diagnosis.model_selection.search.predictive_score import compute_set_score, get_required_gain
from machopt.measurement.diagnosis.model_selection.search.selected_effect import SelectedEffect, add_selected_effects
from machopt.measurement.diagnosis.model_selection.selection_stage import SelectionStage
from machopt.measurement.diagnosis.statistics.normal_equations_by_fold import WhitenedModel
from machopt.measurement.diagnosis.statistics.whitened_hypothesis import WhitenedHypothesis, whiten_hypotheses

SearchOutcome = tuple[
    tuple[WhitenedHypothesis, ...], tuple[SelectedEffect, ...]
]  # hypotheses for rivals, selected effects


@dataclass(frozen=True, kw_only=True)
class ExtensionProblem:
    """Input of the extension stages."""

    base: WhitenedModel
    catalogue: HypothesisCatalogue
    most: int
    seed: int
    noise_variance: float


@dataclass(frozen=True, kw_only=True)
class ExtensionStage(SelectionStage):
    """Repeated search with more hypotheses: (problem, outcome so far) to the new outcome."""

    change: Callable[[ExtensionProblem, SearchOutcome], SearchOutcome]


def search_extended_hypotheses(
    base: WhitenedModel,
    catalogue: HypothesisCatalogue,
    search_outcome: SearchOutcome,
    most: int,
    seed: int,
    fits: float,
) -> SearchOutcome:
    """Repeat the search with the extended hypotheses, by the stages of the table.

    Args:
        base: Whitened base model.
        catalogue: Catalogue of hypotheses.
        search_outcome: Outcome of the regular search.
        most: Largest number of effects.
        seed: Seed of the sign flips.
        fits: Whitened residual variance that noise alone would leave; NaN if the noise was not measured.

    Returns:
        The new outcome, or the regular one.
    """
    problem = ExtensionProblem(base=base, catalogue=catalogue, most=most, seed=seed, noise_variance=fits)
    for stage in EXTENSION_STAGES:
        search_outcome = stage.change(problem, search_outcome)
    return search_outcome


def _search_larger_grids(problem: ExtensionProblem, search_outcome: SearchOutcome) -> SearchOutcome:
    if not _has_remaining_mismatch(problem.base, search_outcome[1], problem.noise_variance):
        return search_outcome
    return _search_again(
        problem, problem.catalogue.extended_hypotheses, search_outcome, np.random.default_rng([problem.seed, 5])
    )


def _search_uncatalogued_forms(problem: ExtensionProblem, search_outcome: SearchOutcome) -> SearchOutcome:
    several = (
        harmonic_orders.count_parts(search_outcome[1]) > 1
        and len(search_outcome[1]) <= thresholds.COUNTS.max_stepwise_effects
    )
    if not several and not _has_remaining_mismatch(problem.base, search_outcome[1], problem.noise_variance):
        return search_outcome
    rng = np.random.default_rng([problem.seed, 6])
    again = _search_again(problem, problem.catalogue.uncatalogued_hypotheses, search_outcome, rng)
    return again if _is_shorter_description(problem.base, again[1], search_outcome[1]) else search_outcome


def compute_mismatch_threshold(base: WhitenedModel) -> float:
    """Compute the excess variance of whitened residuals that counts as a mismatch; larger for few visits.

    Args:
        base: Whitened base model.

    Returns:
        Excess variance over 1.
    """
    error = float(np.sqrt(2.0 / len(base.w.group_of_visit)))
    return max(thresholds.SHARES.minority, thresholds.RATIOS.larger * error)


def _has_remaining_mismatch(base: WhitenedModel, chosen: Sequence[SelectedEffect], fits: float) -> bool:
    """Return whether the selected effects leave more than noise. Zero offsets do not count as many effects."""
    others = [c for c in chosen if c.whitened.hypothesis.effect != joint_angle_errors.ZERO.file_word]
    few = len(others) <= thresholds.COUNTS.max_stepwise_effects
    return (
        few
        and np.isfinite(fits)
        and add_selected_effects(base, chosen).residual_variance > fits + compute_mismatch_threshold(base)
    )


def _search_again(
    problem: ExtensionProblem, laws: Sequence[EffectHypothesis], search_outcome: SearchOutcome, rng: np.random.Generator
) -> SearchOutcome:
    """Return the outcome of a search with further laws; ``search_outcome`` if none of them is accepted.

    A joint selection combines the further waves of a joint with others, so that its law is none of the list. Then the
    predictive score decides.
    """
    base = problem.base
    more = whiten_hypotheses(base, laws)
    if not more:
        return search_outcome
    again = search_stages.search_effects(base, (*search_outcome[0], *more), problem.most, rng, problem.noise_variance)
    if any(any(c.whitened is t for t in more) for c in again[1]):
        return again
    least = compute_set_score(base, search_outcome[1]) + get_required_gain()
    return again if compute_set_score(base, again[1]) > least else search_outcome


def _is_shorter_description(base: WhitenedModel, new: Sequence[SelectedEffect], old: Sequence[SelectedEffect]) -> bool:
    """Return whether the new set explains as much with clearly fewer coefficients, or clearly more, by the BIC."""
    models = [add_selected_effects(base, c) for c in (new, old)]
    spread = min(m.residual_variance for m in models)
    numbers = [sum(len(c.scored.x) + len(c.whitened.shapes[c.scored.shape]) for c in some) for some in (new, old)]
    lengths = [m.rss / spread + n * float(np.log(len(m.y))) for m, n in zip(models, numbers, strict=True)]
    return lengths[0] < lengths[1] - thresholds.LEVELS.min_evidence


EXTENSION_STAGES: tuple[ExtensionStage, ...] = (
    ExtensionStage(
        name="larger grids",
        statistic="the search again, with finer and wider grids of shapes, while more than noise is left",
        levels=("shares.minority", "ratios.larger", "counts.max_stepwise_effects"),
        reference="χ² of whitened residuals; log predictive score",
        rejects="a law whose shape the regular grid misses",
        change=_search_larger_grids,
    ),
    ExtensionStage(
        name="forms without a name",
        statistic="the search again, with forms outside the catalogue; BIC of both results",
        levels=("levels.min_evidence", "shares.minority", "ratios.larger"),
        reference="BIC difference of 10 (Kass & Raftery 1995)",
        rejects="several effects that together imitate one that the catalogue lacks",
        change=_search_uncatalogued_forms,
    ),
)
