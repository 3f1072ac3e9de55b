"""Steps of a diagnosis, common to all channels.

::

    robust base ─► noise from replicates ─► whiten ─► search ─► repeat about the effects ─► findings, limits, proof
                       ▲                                │
                       └──── outliers, noise, linearisation ────┘
"""

from __future__ import annotations

from collections.abc import Callable, Hashable, Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np

from machopt.measurement.diagnosis import thresholds
from machopt.measurement.diagnosis.data_types.diagnosis_problem import DiagnosisProblem, HypothesisCatalogue, Quantity
from machopt.measurement.diagnosis.data_types.diagnosis_result import (
    BaseCoefficient,
    DetectionLimit,
    DiagnosisResult,
    EstimatedValue,
    Finding,
    HoldoutErrors,
    MismatchShare,
    Verdict,
)
from machopt.measurement.diagnosis.model_selection import unmodelled_slip_and_external_forces
from machopt.measurement.diagnosis.model_selection.attribution import (
    attribution_guard,
    compensator_or_harmonics,
    limiting_case_laws,
)
from machopt.measurement.diagnosis.model_selection.evaluation import (
    detection_limits,
    fold_fits,
    repeatable_mismatch,
    uncertain_inputs,
)
from machopt.measurement.diagnosis.model_selection.evaluation.finding_estimates import (
    estimate_parameters,
    find_rival_explanations,
)
from machopt.measurement.diagnosis.model_selection.evaluation.geometric_stiffness_finding import (
    GeometricStiffnessFinding,
    find_geometric_stiffness,
)
from machopt.measurement.diagnosis.model_selection.evaluation.holdout_validation import validate_on_holdout
from machopt.measurement.diagnosis.model_selection.screening.hypothesis_screening import score_hypotheses
from machopt.measurement.diagnosis.model_selection.search import extended_search
from machopt.measurement.diagnosis.model_selection.search.forward_selection import (
    BODY,
    SelectedEffect,
    add_selected_effects,
)
from machopt.measurement.diagnosis.model_selection.search.search_cache import SearchCache
from machopt.measurement.diagnosis.model_selection.search.search_iterations import Rebuild, search_iteratively
from machopt.measurement.diagnosis.model_selection.search.search_state import SearchState
from machopt.measurement.diagnosis.statistics import holdout_residuals, instrument_uncertainty_check
from machopt.measurement.diagnosis.statistics.holdout_residuals import FittedModel
from machopt.measurement.diagnosis.statistics.normal_equations_by_fold import compute_cluster_robust_fit
from machopt.measurement.diagnosis.statistics.whitened_hypothesis import WhitenedHypothesis, whiten_hypotheses
from machopt.measurement.diagnosis.verdict import base_model_notes, verdict_text
from machopt.numerics.array_types import Array


@dataclass(frozen=True, kw_only=True)
class DiagnosisOptions:
    """Options of a diagnosis."""

    max_effects: int = 3  # most effects of forward selection
    predicted: str = ""  # name of the channel in texts
    unstated: frozenset[tuple[str, str]] = frozenset()  # effects and places that stiffness.yaml cannot state
    is_static: bool = False  # readings at rest: stiffness.yaml and kinematics.yaml state the whole model
    progress: Callable[[str], None] = lambda _: None
    searches: SearchCache | None = None  # earlier searches of the same recording; None: each search is run


def diagnose_problem(
    problem: DiagnosisProblem,
    catalogue: HypothesisCatalogue,
    options: DiagnosisOptions,
    rng: np.random.Generator,
    rebuild: Rebuild | None = None,
    key: Hashable = None,
) -> DiagnosisResult:
    """Find the effects that a model lacks.

    Args:
        problem: Regression problem.
        catalogue: Catalogue of hypotheses.
        options: Options of the diagnosis.
        rng: Random generator of sign flips, folds and directions.
        rebuild: Function that rebuilds problem and catalogue about fitted base coefficients (P,) SI and
            load-independent corrections, without implausible unknowns. It makes the iterations Gauss–Newton
            steps. None keeps them.
        key: All that the search depends on, if its state may be stored in ``options.searches``.

    Returns:
        The result.
    """
    seed = int(rng.integers(2**31))
    searches = options.searches if key is not None else None

    # not stored here: the columns of all laws use most of the memory, and the validation does not need them
    def search() -> SearchState:
        known = None if searches is None else searches.find_state(key)
        if known is not None:
            return known
        found = uncertain_inputs.include_uncertain_inputs(
            search_iteratively(problem, catalogue, options.max_effects, seed, rebuild, options.progress)
        )
        found = limiting_case_laws.rename_limiting_cases(
            compensator_or_harmonics.rename_harmonics_as_compensator(found)
        )
        found = attribution_guard.withhold_unsupported_names(found, np.random.default_rng([seed, 4]))
        if searches is not None:
            searches.store_state(key, found)
        return found

    return _build_diagnosis(search(), options, np.random.default_rng([seed, 1]))


@dataclass(frozen=True, kw_only=True)
class _ValidatedFindings:
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


@dataclass(frozen=True)
class _VerdictReason:
    """Verdict with the reasons that weakened it."""

    verdict: Verdict
    excess_noise: instrument_uncertainty_check.ExcessNoise | None  # noise beyond the stated uncertainty
    another_day: tuple[tuple[str, str], ...]  # effects that only one session supports


def _build_diagnosis(state: SearchState, options: DiagnosisOptions, rng: np.random.Generator) -> DiagnosisResult:
    """Build the result of a finished search; columns of laws are released before the proof, unless they are cached."""
    options.progress("rivals and intervals")
    written_state = fold_fits.fix_unstated_unknowns(state) if options.is_static else state
    validated = _validate_findings(state, written_state, options, rng)
    judged = _select_verdict(state, validated, rng)
    shares = _locate_mismatch(state, validated, judged.verdict)
    options.progress("detection limits")
    remaining = validated.uncatalogued if validated.withdrawn else state.chosen
    seen = _compute_limits(state, remaining, rng)
    coefficients, shapes = (
        tuple(_list_base_coefficients(written_state, validated.written)),
        sum(len(t.shapes) for t in state.whitened_hypotheses),
    )
    state, written_state = (replace(one, whitened_hypotheses=()) for one in (state, written_state))
    for one in (state, written_state):
        one.base.extensions.clear()  # they contain columns of laws
    options.progress("proof on readings that no step saw")
    proof = validate_on_holdout(state, options.max_effects, rng) if validated.findings or validated.withdrawn else None
    result = _build_diagnosis_result(state, validated, judged, options.predicted)
    result = replace(
        result,
        mismatch=tuple(shares),
        limits=tuple(seen),
        coefficients=coefficients,
        tried=shapes,
        proof=proof,
        rmse=holdout_residuals.compute_rmse(state.problem, validated.final.residual, state.used_rows),
        record_change=fold_fits.compute_record_change(state, validated.written),
        folds=fold_fits.fit_every_fold(written_state, validated.written),
        fitted_findings=(fitted := tuple(c.whitened.hypothesis.name for c in validated.written)),
        unwritten=tuple(n for f in validated.fitted if (n := (f.effect, f.location)) not in fitted),
    )
    more = base_model_notes.describe_refitted_values(coefficients)
    result = replace(result, notes=(*result.notes, *more))
    return replace(
        result,
        sentence=verdict_text.format_verdict(result),
        next_experiment=verdict_text.suggest_next_experiment(result),
    )


def _build_diagnosis_result(
    state: SearchState, validated: _ValidatedFindings, judged: _VerdictReason, predicted: str
) -> DiagnosisResult:
    """Build findings, verdict and error sizes; locations, limits and validation follow later."""
    problem, used, before, after = state.problem, state.used_rows, validated.residual_before, validated.residual_after
    factor = problem.families[0].factor
    by_group, groups = holdout_residuals.compute_rmse_by_group(problem, (before, after), used)
    return DiagnosisResult(
        channel=problem.channel,
        predicted=predicted,
        verdict=judged.verdict,
        sentence="",
        unit=problem.families[0].unit,
        heldout_before=holdout_residuals.compute_rmse(problem, before, used),
        noise_floor=holdout_residuals.compute_noise_floor(problem, state.noise, used),
        is_ordered=validated.mismatch_before.is_over_time and validated.is_relevant,
        measured_noise=instrument_uncertainty_check.compute_measured_noise(problem, state.noise, used),
        repeatable=factor * float(np.sqrt(validated.power)),
        mismatch_p=validated.mismatch_before.p_value,
        heldout_after=holdout_residuals.compute_rmse(problem, after, used),
        explained=validated.explained,
        repeatable_after=factor * float(np.sqrt(max(validated.mismatch_after.power, 0.0))),
        findings=validated.findings,
        mismatch=(),
        limits=(),
        untestable=state.catalogue.untestable,
        coefficients=(),
        errors=HoldoutErrors(problem.mask_unmeasured(before), problem.mask_unmeasured(after), by_group, groups),
        proof=None,
        used=used,
        outliers=problem.row[~used],
        axes=state.catalogue.axes,
        notes=tuple(verdict_text.describe_withdrawn_findings(validated.withdrawn))
        + verdict_text.describe_noise_source(state.noise, problem, used)
        + holdout_residuals.describe_other_instruments(problem, before, after, state.noise, used)
        + (() if judged.excess_noise is None else (judged.excess_noise.words,))
        + verdict_text.describe_session_contradictions(judged.another_day)
        + unmodelled_slip_and_external_forces.describe_uncatalogued_forms(
            [c.whitened.hypothesis for c in validated.uncatalogued]
        ),
    )


def _validate_findings(
    state: SearchState, written_state: SearchState, options: DiagnosisOptions, rng: np.random.Generator
) -> _ValidatedFindings:
    """Return the findings that improve held-out predictions, those that do not, and the repeatable mismatch."""
    problem, used = state.problem, state.used_rows
    named = [k for k, c in enumerate(state.chosen) if c.whitened.hypothesis.is_in_catalogue]
    nameless = tuple(c for c in state.chosen if not c.whitened.hypothesis.is_in_catalogue)
    stated = [k for k in named if _is_stated(state.chosen[k], options)]
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
    return _ValidatedFindings(
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


def _is_stated(c: SelectedEffect, options: DiagnosisOptions) -> bool:
    """Return whether the written model contains an effect."""
    if not options.is_static:
        return True
    return c.whitened.hypothesis.name not in options.unstated and fold_fits.is_stated_by_files(c)


def _is_mismatch_relevant(state: SearchState, there: repeatable_mismatch.RepeatableMismatch, power: float) -> bool:
    """Return whether the repeatable mismatch is significant and large compared with the noise."""
    sure = (
        np.isnan(there.p_value)
        or there.p_value <= thresholds.PROOF.certain
        or state.base.residual_variance > 1.0 + extended_search.compute_mismatch_threshold(state.base)
    )
    return bool(sure and np.sqrt(power) > thresholds.PROOF.matters * state.noise.total(0))


def _select_verdict(state: SearchState, validated: _ValidatedFindings, rng: np.random.Generator) -> _VerdictReason:
    problem, used, noise = state.problem, state.used_rows, state.noise
    verdict: Verdict
    if validated.findings:
        verdict = (
            "explained"
            if _is_fully_explained(state, validated.mismatch_after, validated.residual_after)
            else "partly_explained"
        )
    else:
        verdict = "unexplained" if validated.is_relevant or validated.withdrawn else "consistent"
    if repeatable_mismatch.has_repeatable_instrument_error(
        problem, validated.residual_after, used, noise, rng, validated.final.compute_prediction_noise()
    ):
        verdict = instrument_uncertainty_check.weaken_verdict(verdict)
    few = len(np.unique(problem.group)) < thresholds.PROOF.fewest_groups  # too few groups for cross-validation
    left = instrument_uncertainty_check.check_stated_uncertainty(
        problem, validated.final.residual if few else validated.residual_after, noise, used
    )
    if left is not None:
        verdict = left.verdict(verdict)
    other_day = attribution_guard.find_contradicted_effect(state)
    apart = () if other_day is None else (other_day.whitened.hypothesis.name,)
    if apart or validated.uncatalogued:
        verdict = instrument_uncertainty_check.weaken_verdict(verdict)
    return _VerdictReason(verdict, left, apart)


def _locate_mismatch(state: SearchState, validated: _ValidatedFindings, verdict: Verdict) -> list[MismatchShare]:
    """Locate the mismatch: findings, further places in the machine, then axes of the data."""
    problem, used = state.problem, state.used_rows
    machine: list[MismatchShare] = []
    data: list[MismatchShare] = []
    if verdict != "consistent":
        beyond = max(state.base.rss - len(state.base.y) + state.base.count, 1.0)
        machine = repeatable_mismatch.locate_in_machine(score_hypotheses(state.base, state.whitened_hypotheses), beyond)
        data = repeatable_mismatch.locate_in_data(
            problem, validated.residual_before, used, state.noise, state.catalogue.axes
        )
    if validated.mismatch_before.is_over_time and validated.is_relevant:
        lasts = MismatchShare(
            "environment", 1.0, "what one visit shows, the next one shows too, at another pose: it lasts"
        )
        machine = [lasts, *(s for s in machine if s.axis != "environment")]
    shares = _list_location_shares(state, validated.findings, machine)
    if validated.geometric_stiffness is not None:
        shares = validated.geometric_stiffness.add_to_shares(
            shares, holdout_residuals.compute_noise_floor(problem, state.noise, used)
        )
    return shares + data[:3]


def _is_fully_explained(state: SearchState, rest: repeatable_mismatch.RepeatableMismatch, after: Array) -> bool:
    """Return whether the findings leave no repeatable mismatch, or no more than noise may cause."""
    noise_floor = holdout_residuals.compute_noise_floor(state.problem, state.noise, state.used_rows)
    if holdout_residuals.compute_rmse(state.problem, after, state.used_rows) <= thresholds.PROOF.as_noise * noise_floor:
        return True
    return rest.p_value > thresholds.PROOF.certain  # NaN without replicates: unknown


def _compute_limits(
    state: SearchState, chosen: Sequence[SelectedEffect], rng: np.random.Generator
) -> list[DetectionLimit]:
    """Return detection limits with all findings included; for a finding with the other findings included."""
    found = {c.whitened.hypothesis.name for c in chosen}
    rest = {t.hypothesis.name for t in state.catalogue_hypotheses} - found
    others = [t for t in state.catalogue_hypotheses if t.hypothesis.name in rest]
    out = detection_limits.compute_detection_limits(add_selected_effects(state.base, chosen), others, rng, rest)
    for c in chosen:
        beside = add_selected_effects(state.base, [o for o in chosen if o is not c])
        out += detection_limits.compute_detection_limits(
            beside, state.catalogue_hypotheses, rng, {c.whitened.hypothesis.name}
        )
    return out


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


def _list_location_shares(
    state: SearchState, findings: Sequence[Finding], machine: list[MismatchShare]
) -> list[MismatchShare]:
    """Return the shares of the findings first, then of other places that explain some of the mismatch alone."""
    total = {c.whitened.hypothesis.location: max(c.scored.total, 0.0) for c in state.chosen}
    whole = sum(total.values())
    beyond = max(state.base.rss - len(state.base.y) + state.base.count, whole, 1e-9)
    out = [
        MismatchShare(f.location, float(np.clip(total.get(f.location, 0.0) / beyond, 0.0, 1.0)), f.note)
        for f in findings
    ]
    for h in (c.whitened.hypothesis for c in state.chosen if not c.whitened.hypothesis.is_in_catalogue):
        out.append(MismatchShare(h.location, float(np.clip(total[h.location] / beyond, 0.0, 1.0)), h.note))
    named = {s.axis for s in out}
    return out + [s for s in machine if s.axis not in named][:6]


def _list_base_coefficients(state: SearchState, chosen: Sequence[SelectedEffect]) -> list[BaseCoefficient]:
    _, covariance, _ = compute_cluster_robust_fit(add_selected_effects(state.base, chosen))
    P = len(state.base_units)
    m, X = state.base, state.base.X
    held = m.Xy.sum(axis=0)  # with the effects as reported, which bounds may have changed
    for c in chosen:
        held = held - X.T @ (c.columns @ c.scored.x)
    x = m.inverse @ held
    before = state.base.coefficients * state.base_units
    sigma = np.sqrt(np.maximum(np.diag(covariance)[:P], 0.0)) * state.base_units
    return [
        BaseCoefficient(u, float(b), float(v), float(s))
        for u, b, v, s in zip(state.problem.unknowns, before, x[:P] * state.base_units, sigma, strict=True)
    ]
