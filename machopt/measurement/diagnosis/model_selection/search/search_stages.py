"""Stages of one search for effects, and the engine that executes them.

:data:`SEARCH_STAGES` is the table, in the order of execution. Each stage gets the selection of the stages before it and
returns it changed or as it is. Two further stages, with larger grids and with forms outside the catalogue, follow in
:mod:`extended_search`.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, field
from functools import cached_property

import numpy as np

from machopt.measurement import thresholds
from machopt.measurement.diagnosis.model_selection.screening.hypothesis_screening import score_hypotheses
from machopt.measurement.diagnosis.model_selection.screening.normal_equation_sums import CachedSums
from machopt.measurement.diagnosis.model_selection.search import harmonic_orders, law_deviation
from machopt.measurement.diagnosis.model_selection.search.candidate_checks import has_plausible_sizes
from machopt.measurement.diagnosis.model_selection.search.description_length import (
    exchange_for_weight_laws,
    find_shortest_description,
)
from machopt.measurement.diagnosis.model_selection.search.forward_selection import (
    compute_chances,
    prune_joint_effects,
    select_effects,
)
from machopt.measurement.diagnosis.model_selection.search.law_error import compute_body_error_share, compute_law_error
from machopt.measurement.diagnosis.model_selection.search.predictive_score import (
    compute_set_score,
    drop_unpredictive_effects,
    get_required_gain,
    score_together,
    select_zero_offsets,
)
from machopt.measurement.diagnosis.model_selection.search.selected_effect import (
    BODY,
    SelectedEffect,
    is_law_deviation,
)
from machopt.measurement.diagnosis.model_selection.search.sparse_effect_selection import (
    add_predictive_groups,
    has_frame_laws,
    select_many_effects,
    whiten_picked_groups,
)
from machopt.measurement.diagnosis.model_selection.selection_stage import SelectionStage
from machopt.measurement.diagnosis.statistics.normal_equations_by_fold import WhitenedModel
from machopt.measurement.diagnosis.statistics.whitened_hypothesis import WhitenedHypothesis

DEFAULT_MAX_EFFECTS = 3  # default number of effects of forward selection
MAX_RIVAL_SHAPES = 24  # most shapes of a rival of jointly selected effects


@dataclass(frozen=True)
class EffectSearch:
    """Input of one search."""

    model: WhitenedModel
    laws: Sequence[WhitenedHypothesis]
    most: int  # largest number of effects of forward selection; fewer than three requests few effects
    rng: np.random.Generator = field(repr=False)  # of the sign flips
    noise_variance: float  # whitened residual variance that noise alone would leave; NaN if it was not measured

    @cached_property
    def sums(self) -> CachedSums:
        """Normal equations of all laws."""
        return CachedSums(self.model, self.laws)

    @cached_property
    def has_frames(self) -> bool:
        """Whether the laws are those of measured poses."""
        return has_frame_laws(self.laws)

    @cached_property
    def zero_offsets(self) -> list[tuple[str, str]]:
        """Names of the zero offsets that predict unseen poses together."""
        if not self.has_frames or self.most < DEFAULT_MAX_EFFECTS:
            return []
        return [c.whitened.hypothesis.name for c in select_zero_offsets(self.model, self.laws)]


@dataclass(frozen=True)
class EffectSelection:
    """Selected effects with the hypotheses for rivals, which include them."""

    hypotheses: tuple[WhitenedHypothesis, ...]
    chosen: tuple[SelectedEffect, ...]
    is_joint: bool = False  # selected jointly, as many effects


@dataclass(frozen=True, kw_only=True)
class SearchStage(SelectionStage):
    """Stage of the search: (search, selection so far) to the new selection; None where nothing was selected yet."""

    change: Callable[[EffectSearch, EffectSelection | None], EffectSelection | None]


def search_effects(
    model: WhitenedModel, laws: Sequence[WhitenedHypothesis], most: int, rng: np.random.Generator, noise_variance: float
) -> tuple[tuple[WhitenedHypothesis, ...], tuple[SelectedEffect, ...]]:
    """Search the effects by the stages of the table.

    Args:
        model: Whitened base model.
        laws: All whitened hypotheses.
        most: Largest number of effects of forward selection; fewer than three requests few effects.
        rng: Random generator of the sign flips.
        noise_variance: Whitened residual variance that noise alone would leave; NaN if the noise was not measured.

    Returns:
        Hypotheses for rivals (including the selected ones), and the selected effects.
    """
    search = EffectSearch(model, laws, most, rng, noise_variance)
    selection: EffectSelection | None = None
    for stage in SEARCH_STAGES:
        selection = stage.change(search, selection)
    return (tuple(laws), ()) if selection is None else (selection.hypotheses, selection.chosen)


def _select_many(search: EffectSearch, selection: EffectSelection | None) -> EffectSelection | None:
    """Select jointly, with the zero offsets at first, if there are many effects."""
    if search.most < DEFAULT_MAX_EFFECTS:
        return selection
    model, laws = search.model, search.laws
    found = select_many_effects(model, laws, search.noise_variance, search.sums, search.zero_offsets)
    if not found:
        return selection
    needed = prune_joint_effects(model, found, laws, search.rng)
    is_crowded = len(needed) > thresholds.COUNTS.max_stepwise_effects
    chosen = needed if is_crowded else _drop_law_errors(model, needed, laws)
    return EffectSelection(_list_rivals(laws, found), tuple(chosen), is_joint=True)


def _select_few(search: EffectSearch, selection: EffectSelection | None) -> EffectSelection | None:
    """Select one effect after the other; several orders of one gear are one effect."""
    if selection is not None:
        return selection
    model, laws, rng = search.model, search.laws, search.rng
    if search.has_frames:
        return EffectSelection(tuple(laws), tuple(select_effects(model, laws, search.most, rng)))
    chosen = select_effects(
        model, laws, search.most, rng, lambda so_far: harmonic_orders.add_harmonic_orders(model, so_far, laws, rng)
    )
    return EffectSelection(_add_combined_laws(laws, chosen), tuple(chosen))


def _shorten_description(search: EffectSearch, selection: EffectSelection | None) -> EffectSelection | None:
    if selection is None or selection.is_joint or not search.has_frames:
        return selection
    few = find_shortest_description(search.model, selection.chosen, search.sums, search.most)
    return EffectSelection(selection.hypotheses, tuple(few))


def _exchange_for_weight(search: EffectSearch, selection: EffectSelection | None) -> EffectSelection | None:
    if selection is None or selection.is_joint or not search.has_frames:
        return selection
    chosen = exchange_for_weight_laws(search.model, selection.chosen, search.laws, search.rng)
    return EffectSelection(selection.hypotheses, tuple(chosen))


def _search_beside_deviations(search: EffectSearch, selection: EffectSelection | None) -> EffectSelection | None:
    if selection is None or search.has_frames:
        return selection
    chosen = law_deviation.find_masked_effects(
        search.model, selection.chosen, search.laws, search.most, search.rng, search.noise_variance
    )
    return EffectSelection(_add_combined_laws(search.laws, chosen), tuple(chosen))


def _prefer_zero_offsets(search: EffectSearch, selection: EffectSelection | None) -> EffectSelection | None:
    """Select zero offsets at first and add what predicts; accepted where it predicts clearly better."""
    if selection is None or not search.zero_offsets or len(selection.chosen) > thresholds.COUNTS.max_stepwise_effects:
        return selection  # many effects are already selected jointly, by their cross-validated error
    model, laws = search.model, search.laws
    picked = add_predictive_groups(search.sums.sum_all, search.zero_offsets, search.most)
    joint = [SelectedEffect(s, 1.0) for s in score_hypotheses(model, whiten_picked_groups(model, picked))]
    chosen = compute_chances(model, drop_unpredictive_effects(model, joint), laws, search.rng)
    chosen = [c for c in chosen if c.p_value <= thresholds.LEVELS.significance_level and has_plausible_sizes(c.scored)]
    chosen = _drop_law_errors(model, score_together(model, chosen), laws)
    if compute_set_score(model, chosen) <= compute_set_score(model, selection.chosen) + get_required_gain():
        return selection
    return EffectSelection(_list_rivals(laws, [c.whitened for c in joint]), tuple(chosen))


def _add_combined_laws(
    laws: Sequence[WhitenedHypothesis], chosen: Sequence[SelectedEffect]
) -> tuple[WhitenedHypothesis, ...]:
    """Return all laws, with those of the selection that combine several of them."""
    combined = [c.whitened for c in chosen if not (is_law_deviation(c) or any(c.whitened is t for t in laws))]
    return (*laws, *combined)


def _drop_law_errors(
    model: WhitenedModel, chosen: Sequence[SelectedEffect], laws: Sequence[WhitenedHypothesis]
) -> list[SelectedEffect]:
    """Drop effects that gain no more than the law of a compliant body may leave, the smallest first."""
    out, share = list(chosen), compute_body_error_share(laws)
    while True:
        bodies = [c for c in out if c.whitened.hypothesis.family == BODY]
        weak = [
            c for c in out if c.scored.gain <= compute_law_error(c.scored, [o for o in bodies if o is not c], share)
        ]
        if not bodies or not weak:
            return out
        least = min(weak, key=lambda c: c.scored.gain)
        out = score_together(model, [o for o in out if o is not least])


def _list_rivals(
    laws: Sequence[WhitenedHypothesis], found: Sequence[WhitenedHypothesis]
) -> tuple[WhitenedHypothesis, ...]:
    """Return the rivals of jointly selected effects, and these."""
    names = {t.hypothesis.name for t in found}
    return (
        *(t for t in laws if t.hypothesis.name not in names and len(t.shapes) <= MAX_RIVAL_SHAPES),
        *found,
    )


SEARCH_STAGES: tuple[SearchStage, ...] = (
    SearchStage(
        name="many effects",
        statistic="gain on unseen groups of groups of columns, each refitted with all before it",
        levels=(
            "levels.min_gain",
            "shares.min_transfer",
            "levels.gain_two_sigma",
            "shares.law_error",
            "shares.exact_law_error",
            "counts.min_rows_per_column",
            "counts.max_stepwise_effects",
            "ratios.larger",
        ),
        reference="group orthogonal matching pursuit (Lozano, Swirszcz & Abe 2009)",
        rejects="few large laws in place of many small ones (measured poses)",
        change=_select_many,
    ),
    SearchStage(
        name="few effects",
        statistic="gain on unseen groups, one effect after the other",
        levels=("levels.significance_level", "shares.law_error", "levels.gain_two_sigma", "levels.gain_three_sigma"),
        reference="forward selection with the checks of each candidate",
        rejects="everything that no check supports",
        change=_select_few,
    ),
    SearchStage(
        name="shortest description",
        statistic="−2 log evidence of sets of offsets, waves and frames",
        levels=("levels.min_evidence",),
        reference="MacKay 1992; Kass & Raftery 1995",
        rejects="a frame with six numbers where zero offsets do it (measured poses)",
        change=_shorten_description,
    ),
    SearchStage(
        name="weight laws",
        statistic="−2 log evidence of laws that depend on weight in place of an offset, wave or frame",
        levels=("levels.min_evidence", "levels.significance_level"),
        reference="the same",
        rejects="an offset or wave that is a compensator or a spring (measured poses)",
        change=_exchange_for_weight,
    ),
    SearchStage(
        name="law deviation",
        statistic="gain of effects elsewhere with the deviation of the largest effects from their laws in the model",
        levels=("levels.min_gain", "shares.law_error", "shares.min_gain_per_row", "shares.minority", "shares.majority"),
        reference="model discrepancy (Kennedy & O'Hagan 2001)",
        rejects="that the residual of a large effect hides another one (load tests, motions)",
        change=_search_beside_deviations,
    ),
    SearchStage(
        name="zero offsets",
        statistic="log predictive score of unseen poses, all subsets of zero offsets first",
        levels=("levels.min_evidence", "levels.significance_level"),
        reference="Gneiting & Raftery 2007",
        rejects="frames that imitate several zero offsets (measured poses)",
        change=_prefer_zero_offsets,
    ),
)
