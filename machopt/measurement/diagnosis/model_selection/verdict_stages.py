"""Verdict of a diagnosis: what the findings close, weakened by every doubt of the table :data:`VERDICT_STAGES`."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

from machopt.measurement import thresholds
from machopt.measurement.diagnosis.data_types.diagnosis_result import Verdict
from machopt.measurement.diagnosis.model_selection.attribution import attribution_guard
from machopt.measurement.diagnosis.model_selection.evaluation import repeatable_mismatch
from machopt.measurement.diagnosis.model_selection.finding_validation import ValidatedFindings
from machopt.measurement.diagnosis.model_selection.search.search_state import SearchState
from machopt.measurement.diagnosis.model_selection.selection_stage import SelectionStage
from machopt.measurement.diagnosis.statistics import holdout_residuals, instrument_uncertainty_check
from machopt.numerics.array_types import Array


@dataclass(frozen=True)
class VerdictDoubt:
    """Doubt that weakens a verdict."""

    note: str = ""  # for the notes of the result; empty for none
    contradicted: tuple[tuple[str, str], ...] = ()  # effects that only one session supports


@dataclass(frozen=True, kw_only=True)
class VerdictStage(SelectionStage):
    """Stage of the verdict: (state, findings, random generator of the sign flips) to a doubt, or None."""

    find_doubt: Callable[[SearchState, ValidatedFindings, np.random.Generator], VerdictDoubt | None]


@dataclass(frozen=True)
class VerdictReason:
    """Verdict with the doubts that weakened it."""

    verdict: Verdict
    doubts: tuple[VerdictDoubt, ...]

    @property
    def notes(self) -> tuple[str, ...]:
        """Notes of the doubts."""
        return tuple(d.note for d in self.doubts if d.note)

    @property
    def contradicted(self) -> tuple[tuple[str, str], ...]:
        """Effects that only one session supports."""
        return tuple(name for d in self.doubts for name in d.contradicted)


def select_verdict(state: SearchState, validated: ValidatedFindings, rng: np.random.Generator) -> VerdictReason:
    """Select the strongest verdict that no doubt weakens.

    Args:
        state: State of the search.
        validated: Findings with their errors on held-out readings.
        rng: Random generator of the sign flips.

    Returns:
        The verdict with its doubts.
    """
    verdict: Verdict
    if validated.findings:
        explained = _is_fully_explained(state, validated.mismatch_after, validated.residual_after)
        verdict = "explained" if explained else "partly_explained"
    else:
        verdict = "unexplained" if validated.is_relevant or validated.withdrawn else "consistent"
    doubts = []
    for stage in VERDICT_STAGES:
        doubt = stage.find_doubt(state, validated, rng)
        if doubt is not None:
            doubts.append(doubt)
            verdict = instrument_uncertainty_check.weaken_verdict(verdict)
    return VerdictReason(verdict, tuple(doubts))


def _is_fully_explained(state: SearchState, rest: repeatable_mismatch.RepeatableMismatch, after: Array) -> bool:
    """Return whether the findings leave no repeatable mismatch, or no more than noise may cause."""
    noise_floor = holdout_residuals.compute_noise_floor(state.problem, state.noise, state.used_rows)
    if (
        holdout_residuals.compute_rmse(state.problem, after, state.used_rows)
        <= thresholds.RATIOS.equal_fit * noise_floor
    ):
        return True
    return rest.p_value > thresholds.LEVELS.mismatch_significance_level  # NaN without replicates: unknown


def _doubt_repeating_instrument(
    state: SearchState, validated: ValidatedFindings, rng: np.random.Generator
) -> VerdictDoubt | None:
    noise = validated.final.compute_prediction_noise()
    repeats = repeatable_mismatch.has_repeatable_instrument_error(
        state.problem, validated.residual_after, state.used_rows, state.noise, rng, noise
    )
    return VerdictDoubt() if repeats else None


def _doubt_stated_uncertainty(
    state: SearchState, validated: ValidatedFindings, rng: np.random.Generator
) -> VerdictDoubt | None:
    few = len(np.unique(state.problem.group)) < thresholds.COUNTS.min_groups  # too few groups for cross-validation
    residual = validated.final.residual if few else validated.residual_after
    left = instrument_uncertainty_check.check_stated_uncertainty(state.problem, residual, state.noise, state.used_rows)
    return None if left is None else VerdictDoubt(note=left)


def _doubt_contradicting_session(
    state: SearchState, validated: ValidatedFindings, rng: np.random.Generator
) -> VerdictDoubt | None:
    other = attribution_guard.find_contradicted_effect(state)
    return None if other is None else VerdictDoubt(contradicted=(other.whitened.hypothesis.name,))


def _doubt_form_without_name(
    state: SearchState, validated: ValidatedFindings, rng: np.random.Generator
) -> VerdictDoubt | None:
    return VerdictDoubt() if validated.uncatalogued else None


VERDICT_STAGES: tuple[VerdictStage, ...] = (
    VerdictStage(
        name="repeating instrument",
        statistic="repeatable power of the other instruments of the recording that is left",
        levels=("levels.mismatch_significance_level",),
        reference="components of variance of replicates",
        rejects="consistent or explained where an inclinometer or an encoder disagrees",
        find_doubt=_doubt_repeating_instrument,
    ),
    VerdictStage(
        name="stated uncertainty",
        statistic="noise and misfit per stated uncertainty of the instrument",
        levels=("ratios.implausible", "shares.negligible", "counts.min_groups"),
        reference="data sheet of the instrument",
        rejects="consistent or explained where ten times the stated uncertainty is left",
        find_doubt=_doubt_stated_uncertainty,
    ),
    VerdictStage(
        name="session that contradicts",
        statistic="gain of the best effect that one session supports and another contradicts",
        levels=("shares.min_transfer",),
        reference="cross-validation by sessions",
        rejects="consistent or explained where the sessions differ",
        find_doubt=_doubt_contradicting_session,
    ),
    VerdictStage(
        name="form in the model",
        statistic="whether the fit holds a form outside the catalogue",
        levels=(),
        reference="a place without a name is no explanation",
        rejects="explained where a part of it has no name",
        find_doubt=_doubt_form_without_name,
    ),
)
