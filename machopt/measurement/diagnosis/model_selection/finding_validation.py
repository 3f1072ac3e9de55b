"""Validation of the selected effects on held-out readings, and the findings made of them."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np

from machopt.measurement import thresholds
from machopt.measurement.diagnosis.data_types.diagnosis_problem import Quantity
from machopt.measurement.diagnosis.data_types.diagnosis_result import EffectLocation, EstimatedValue, Finding
from machopt.measurement.diagnosis.model_selection.evaluation import fold_fits, repeatable_mismatch
from machopt.measurement.diagnosis.model_selection.evaluation.finding_estimates import (
    estimate_parameters,
    find_rival_explanations,
)
from machopt.measurement.diagnosis.model_selection.evaluation.geometric_stiffness_finding import (
    GeometricStiffnessFinding,
    find_geometric_stiffness,
)
from machopt.measurement.diagnosis.model_selection.search import extended_search
from machopt.measurement.diagnosis.model_selection.search.search_state import SearchState
from machopt.measurement.diagnosis.model_selection.search.selected_effect import BODY, SelectedEffect
from machopt.measurement.diagnosis.statistics import holdout_residuals
from machopt.measurement.diagnosis.statistics.holdout_residuals import FittedModel
from machopt.measurement.diagnosis.statistics.whitened_hypothesis import WhitenedHypothesis, whiten_hypotheses
from machopt.numerics.array_types import Array


@dataclass(frozen=True, kw_only=True)
class ValidatedFindings:
    """Findings validated on held-out readings; residuals (N, D) in SI."""

    findings: tuple[Finding, ...]  # with K_C, where the recording shows it
    withdrawn: tuple[Finding, ...]  # findings that do not improve held-out predictions
    geometric_stiffness: GeometricStiffnessFinding | None
    fitted: tuple[Finding, ...]  # findings with coefficients, without K_C
    written: tuple[SelectedEffect, ...]  # effects of the final model, fitted without forms that no file states
    uncatalogued: tuple[SelectedEffect, ...]  # selected forms that are no effect of the catalogue
    residual_before: Array  # held-out residuals without findings
    residual_after: Array  # held-out residuals with findings
    final: FittedModel  # fit with the remaining findings
    mismatch_before: repeatable_mismatch.RepeatableMismatch  # of ``residual_before``
    mismatch_after: repeatable_mismatch.RepeatableMismatch  # of ``residual_after``
    power: float  # of ``mismatch_before``, at least zero
    is_relevant: bool  # the mismatch is significant and relevant

    @property
    def explained(self) -> float:
        """Share of the repeatable power that the findings explain."""
        if self.withdrawn or not self.power > 0:
            return 0.0
        return float(np.clip(1.0 - max(self.mismatch_after.power, 0.0) / self.power, 0.0, 1.0))


def validate_findings(
    state: SearchState,
    written_state: SearchState,
    unstated: frozenset[EffectLocation] | None,
    rng: np.random.Generator,
) -> ValidatedFindings:
    """Find which effects improve held-out predictions, and how much repeatable mismatch there is with and without them.

    Args:
        state: State of the search, with its names.
        written_state: The same with the unknowns that no file states fixed.
        unstated: Effects and places that stiffness.yaml cannot state; None if no file states the model.
        rng: Random generator of the sign flips.

    Returns:
        The findings with their errors.
    """
    problem, used = state.problem, state.used_rows
    named = [k for k, c in enumerate(state.chosen) if c.whitened.hypothesis.is_in_catalogue]
    nameless = tuple(c for c in state.chosen if not c.whitened.hypothesis.is_in_catalogue)
    stated = [k for k in named if _is_stated(state.chosen[k], unstated)]
    written = tuple(state.chosen[k] for k in stated)
    if written and (len(stated) < len(state.chosen) or written_state is not state):
        written = fold_fits.refit_at_shapes(written_state, written)
    values = [written[stated.index(k)] if k in stated else state.chosen[k] for k in named]
    plain, final = state.fit_effects(()), state.fit_effects(values)
    before, after = plain.heldout(), final.heldout()
    known = find_geometric_stiffness(state)
    if known is not None:  # K_C is part of the model: without it the mismatch would have been larger
        before = known.residual_without
    there = repeatable_mismatch.measure_repeatable_mismatch(
        problem, before, used, state.noise, rng, plain.compute_prediction_noise()
    )
    rest = repeatable_mismatch.measure_repeatable_mismatch(
        problem, after, used, state.noise, rng, final.compute_prediction_noise()
    )
    power = max(there.power, 0.0)
    real = _is_mismatch_relevant(state, there, power)
    forms = _whiten_competing_forms(state) if named else []
    findings = [_build_finding(state, k, effect, forms) for k, effect in zip(named, values, strict=True)]
    withdrawn = list[Finding]()
    beside = (before, after)
    if nameless:
        beside = (state.fit_effects(nameless).heldout(), state.fit_effects(state.chosen).heldout())
    if findings and real and not holdout_residuals.is_better_predicted(problem, *beside, used):
        findings, withdrawn, written = [], findings, ()
        after, final, rest = before, plain, there
    fitted = tuple(findings)
    if known is not None:
        findings.append(known.finding)
    return ValidatedFindings(
        findings=tuple(findings),
        withdrawn=tuple(withdrawn),
        geometric_stiffness=known,
        fitted=fitted,
        written=written,
        uncatalogued=nameless,
        residual_before=before,
        residual_after=after,
        final=final,
        mismatch_before=there,
        mismatch_after=rest,
        power=power,
        is_relevant=real,
    )


def _is_stated(c: SelectedEffect, unstated: frozenset[EffectLocation] | None) -> bool:
    """Return whether the written model contains an effect."""
    if unstated is None:
        return True
    return c.whitened.hypothesis.name not in unstated and fold_fits.is_stated_by_files(c)


def _is_mismatch_relevant(state: SearchState, there: repeatable_mismatch.RepeatableMismatch, power: float) -> bool:
    """Return whether the repeatable mismatch is significant and large compared with the noise."""
    sure = (
        np.isnan(there.p_value)
        or there.p_value <= thresholds.LEVELS.mismatch_significance_level
        or state.base.residual_variance > 1.0 + extended_search.compute_mismatch_threshold(state.base)
    )
    return bool(sure and np.sqrt(power) > thresholds.SHARES.minority * state.noise.total(0))


def _whiten_competing_forms(state: SearchState) -> list[WhitenedHypothesis]:
    """Return the forms outside the catalogue that may explain the displacements of a load test as well as a law."""
    if state.problem.channel != "deflection":
        return []
    tried = [t for t in state.whitened_hypotheses if not t.hypothesis.is_in_catalogue]
    return [*tried, *whiten_hypotheses(state.base, state.catalogue.uncatalogued_hypotheses)]


def _build_finding(state: SearchState, k: int, written: SelectedEffect, forms: Sequence[WhitenedHypothesis]) -> Finding:
    """Build the finding of the k-th effect; its values are those of the written model."""
    c = written
    h, shape = c.whitened.hypothesis, c.whitened.shapes[c.scored.shape]
    x = c.scored.x * c.whitened.unit[c.scored.shape]
    without = state.fit_effects([o for i, o in enumerate(state.chosen) if i != k]).heldout()
    full = state.fit_effects(state.chosen)
    others, names = find_rival_explanations(state.base, state.chosen, k, [*state.catalogue_hypotheses, *forms])
    names = [*names, *(u.name for u in state.catalogue.untestable if u.same_as in names)]
    is_kept = c is state.chosen[k] or h.family == BODY  # sizes of bodies are those that readings determine
    estimates = estimate_parameters(state.base, state.chosen, k, state.catalogue_hypotheses)
    curve = None if h.curve is None else h.curve(x, shape)
    left = None if curve is None else _project_residual(full.residual, h.columns(shape), x, curve.per_reading)
    return Finding(
        effect=h.effect,
        location=h.location,
        law=h.law,
        equation=h.equation,
        note=h.note,
        one_of=tuple(names),
        parameters=estimates if is_kept else _move_estimates(estimates, h.quantities(x, shape)),
        before=holdout_residuals.compute_rmse(state.problem, without, state.used_rows),
        after=holdout_residuals.compute_rmse(state.problem, full.heldout(), state.used_rows),
        p_value=c.p_value,
        rivals=tuple(others),
        correction=h.correction(x, shape),
        curve=curve,
        curve_residual=left,
        record=h.family == "sensor",
    )


def _move_estimates(estimates: dict[str, EstimatedValue], written: Mapping[str, Quantity]) -> dict[str, EstimatedValue]:
    """Return the estimates with the values of the written model; the intervals include them."""
    out = {}
    for name, e in estimates.items():
        value = written[name].value if name in written else e.value
        (a, b), (c, d) = e.ci90, e.ci95
        out[name] = EstimatedValue(value, e.unit, (min(a, value), max(b, value)), (min(c, value), max(d, value)))
    return out


def _project_residual(residual: Array, columns: Array, x: Array, law: Array) -> Array:
    """Return the residuals (N,) along the law's displacement of each reading, in the unit of the law."""
    moved = columns @ x  # (N, D)
    power = np.einsum("nd,nd->n", moved, moved)
    share = np.einsum("nd,nd->n", moved, residual) / np.maximum(power, 1e-300)
    return np.where(power > 1e-4 * np.quantile(power, 0.9), share * law, np.nan)
