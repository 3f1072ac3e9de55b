"""Steps of a diagnosis, common to all channels.

::

    robust base ─► noise from replicates ─► whiten ─► search ─► repeat about the effects ─► findings, limits, proof
                       ▲                                │
                       └──── outliers, noise, linearisation ────┘
"""

from __future__ import annotations

from collections.abc import Callable, Hashable, Sequence
from dataclasses import dataclass, replace

import numpy as np

from machopt.measurement.diagnosis.data_types.diagnosis_problem import DiagnosisProblem, HypothesisCatalogue
from machopt.measurement.diagnosis.data_types.diagnosis_result import (
    BaseCoefficient,
    DetectionLimit,
    DiagnosisResult,
    Finding,
    HoldoutErrors,
    MismatchShare,
    Verdict,
)
from machopt.measurement.diagnosis.model_selection import unmodelled_slip_and_external_forces
from machopt.measurement.diagnosis.model_selection.attribution import naming_stages
from machopt.measurement.diagnosis.model_selection.evaluation import (
    detection_limits,
    fold_fits,
    repeatable_mismatch,
)
from machopt.measurement.diagnosis.model_selection.evaluation.holdout_validation import validate_on_holdout
from machopt.measurement.diagnosis.model_selection.finding_validation import ValidatedFindings, validate_findings
from machopt.measurement.diagnosis.model_selection.screening.hypothesis_screening import score_hypotheses
from machopt.measurement.diagnosis.model_selection.search.search_cache import SearchCache
from machopt.measurement.diagnosis.model_selection.search.search_iterations import Rebuild, search_iteratively
from machopt.measurement.diagnosis.model_selection.search.search_state import SearchState
from machopt.measurement.diagnosis.model_selection.search.selected_effect import (
    SelectedEffect,
    add_selected_effects,
)
from machopt.measurement.diagnosis.model_selection.verdict_stages import VerdictReason, select_verdict
from machopt.measurement.diagnosis.statistics import holdout_residuals, instrument_uncertainty_check
from machopt.measurement.diagnosis.statistics.normal_equations_by_fold import compute_cluster_robust_fit
from machopt.measurement.diagnosis.verdict import base_model_notes, verdict_text


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
        found = search_iteratively(problem, catalogue, options.max_effects, seed, rebuild, options.progress)
        found = naming_stages.apply_naming_stages(found, np.random.default_rng([seed, 4]))
        if searches is not None:
            searches.store_state(key, found)
        return found

    return _build_diagnosis(search(), options, np.random.default_rng([seed, 1]))


def _build_diagnosis(state: SearchState, options: DiagnosisOptions, rng: np.random.Generator) -> DiagnosisResult:
    """Build the result of a finished search; columns of laws are released before the proof, unless they are cached."""
    options.progress("rivals and intervals")
    written_state = fold_fits.fix_unstated_unknowns(state) if options.is_static else state
    validated = validate_findings(state, written_state, options.unstated if options.is_static else None, rng)
    reason = select_verdict(state, validated, rng)
    shares = _locate_mismatch(state, validated, reason.verdict)
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
    result = _build_diagnosis_result(state, validated, reason, options.predicted)
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
    state: SearchState, validated: ValidatedFindings, reason: VerdictReason, predicted: str
) -> DiagnosisResult:
    """Build findings, verdict and error sizes; locations, limits and validation follow later."""
    problem, used, before, after = state.problem, state.used_rows, validated.residual_before, validated.residual_after
    factor = problem.families[0].factor
    by_group, groups = holdout_residuals.compute_rmse_by_group(problem, (before, after), used)
    return DiagnosisResult(
        channel=problem.channel,
        predicted=predicted,
        verdict=reason.verdict,
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
        + reason.notes
        + verdict_text.describe_session_contradictions(reason.contradicted)
        + unmodelled_slip_and_external_forces.describe_uncatalogued_forms(
            [c.whitened.hypothesis for c in validated.uncatalogued]
        ),
    )


def _locate_mismatch(state: SearchState, validated: ValidatedFindings, verdict: Verdict) -> list[MismatchShare]:
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
    right_side = m.Xy.sum(axis=0)  # with the effects as reported, which bounds may have changed
    for c in chosen:
        right_side = right_side - X.T @ (c.columns @ c.scored.x)
    x = m.inverse @ right_side
    before = state.base.coefficients * state.base_units
    sigma = np.sqrt(np.maximum(np.diag(covariance)[:P], 0.0)) * state.base_units
    return [
        BaseCoefficient(u, float(b), float(v), float(s))
        for u, b, v, s in zip(state.problem.unknowns, before, x[:P] * state.base_units, sigma, strict=True)
    ]
