"""Assembly of the result from the intermediate results: final values, tables, texts."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from machopt.data_types.stiffness import ArmStiffness, StiffnessTerm
from machopt.measurement.estimation.load_test_equations import LoadTestExperiment
from machopt.measurement.identification.assessment.coefficient_uncertainty import CoefficientUncertainty
from machopt.measurement.identification.assessment.holdout_errors import summarise_residuals
from machopt.measurement.identification.assessment.identifiability import SettledCoefficients
from machopt.measurement.identification.assessment.leverage_and_outliers import compute_influence, list_outliers
from machopt.measurement.identification.assessment.subset_and_monte_carlo_studies import (
    MonteCarloResult,
    SubsetStudyResult,
)
from machopt.measurement.identification.data_quality.record_fault_type import RecordFault
from machopt.measurement.identification.fitting.reading_weights import set_term_coefficients
from machopt.measurement.identification.fitting.weighted_fit import StiffnessFit
from machopt.measurement.identification.grid_stiffness.grid_fit import GridFit
from machopt.measurement.identification.identification_result import (
    IdentificationResult,
    JointResult,
    ResidualTable,
    TermResult,
)
from machopt.measurement.identification.warnings_and_notes import build_notes, build_warnings
from machopt.numerics.array_types import Array
from machopt.stiffness.joint_stiffness import compute_joint_stiffness
from machopt.stiffness.terms import LinearTerm


@dataclass(frozen=True, kw_only=True)
class IdentificationStages:
    """Intermediate results of all steps of an identification."""

    experiment: LoadTestExperiment
    fit: StiffnessFit
    uncertainty: CoefficientUncertainty
    settled: SettledCoefficients
    known_terms: tuple[LinearTerm, ...]  # terms that are not fitted
    geometric: bool
    heldout: Array  # (N, D) residuals of the constant model
    grid: GridFit | None
    why_model: str
    findings: tuple[RecordFault, ...]
    messages: tuple[str, ...]  # findings in words
    subsets: SubsetStudyResult | None
    monte_carlo: MonteCarloResult | None
    equilibrium_influence: Array | None
    notes: tuple[str, ...] = ()  # on the origin of the equations


def assemble_identification(parts: IdentificationStages) -> IdentificationResult:
    """Assemble the result.

    Args:
        parts: Intermediate results.

    Returns:
        The result.
    """
    fit, sure, settled, grid = parts.fit, parts.uncertainty, parts.settled, parts.grid
    x = settled.x.copy()
    if grid is not None:
        x[settled.joint_count :] = grid.terms
    residual, holdout_residual, sigma = _compute_residuals(parts, x)
    fitted_errors, holdout_errors = summarise_residuals(fit, residual), summarise_residuals(fit, holdout_residual)
    outliers = list_outliers(fit)
    measured = parts.experiment.measured
    return IdentificationResult(
        model="constant" if grid is None else "grid",
        why_model=parts.why_model,
        readings=len(parts.experiment),
        poses=fit.clusters.poses,
        stiffness=_build_stiffness(parts, x),
        joints=_build_joint_results(fit, sure, settled),
        terms=_build_term_results(fit, sure, settled, x),
        combinations=tuple(c.text for c in settled.combinations),
        errors=fitted_errors,
        heldout=holdout_errors if fit.clusters.poses > 1 else None,
        condition_number=sure.condition,
        condition_plain=sure.condition_plain,
        scatter=fit.weighting.scatter(fit.clusters),
        findings=parts.findings,
        warnings=(*parts.messages, *build_warnings(fit, sure, settled, fitted_errors, holdout_errors, outliers)),
        notes=(*parts.notes, *build_notes(fit, sure, settled)),
        table=ResidualTable(measured, measured - residual, sigma, holdout_residual, fit.weighting.robust),
        influence=compute_influence(fit, settled),
        outliers=outliers,
        subsets=parts.subsets,
        monte_carlo=parts.monte_carlo,
        fit=fit,
        uncertainty=sure,
        settled=settled,
        grid=grid,
        equilibrium_influence=parts.equilibrium_influence,
    )


def _compute_residuals(parts: IdentificationStages, x: Array) -> tuple[Array, Array, Array]:
    """Return residuals (N, D), cross-validated residuals (N, D), and the prediction's 1σ of the selected model."""
    fit, grid = parts.fit, parts.grid
    A = fit.A
    C = parts.uncertainty.covariance
    sigma = np.sqrt(np.maximum(np.einsum("ndp,pq,ndq->nd", A, C, A, optimize=True), 0.0))
    if grid is None:
        return fit.y - A @ x, parts.heldout, sigma
    at = parts.experiment.T_base_tcp[:, :3, 3]
    k = compute_joint_stiffness(ArmStiffness(joints=1.0 / parts.settled.compliance, grid=grid.grid), at).k
    n = parts.settled.joint_count
    residual = fit.y - np.einsum("ndj,nj->nd", A[..., :n], 1.0 / k) - A[..., n:] @ x[n:]
    left_out = parts.heldout.copy()
    left_out[grid.inside] = grid.heldout.grid
    shape = np.array(grid.grid.shape)
    index = np.clip(np.floor((at - grid.grid.origin) / grid.grid.cell).astype(int), 0, shape - 1)
    cell = index @ np.array([1, shape[0], shape[0] * shape[1]])
    rows, joints = grid.inside, A[..., :n]
    variance = np.einsum("ndj,njk,ndk->nd", joints[rows], grid.covariance[cell[rows]], joints[rows], optimize=True)
    sigma[rows] = np.sqrt(np.maximum(variance, 0.0))
    return residual, left_out, sigma


def _build_stiffness(parts: IdentificationStages, x: Array) -> ArmStiffness:
    """Return the stiffness to be written: joints, grid, and known or found terms."""
    settled = parts.settled
    identified = [
        any(s.identified for s, u in zip(settled.status, parts.fit.unknowns, strict=True) if u.term == t)
        for t in range(len(parts.fit.terms))
    ]
    found = [t.to_file() for t, good in zip(set_term_coefficients(parts.fit.terms, x), identified, strict=True) if good]
    geometric = [StiffnessTerm("geometric_stiffness", "arm")] if parts.geometric else []
    return ArmStiffness(
        joints=1.0 / settled.compliance,
        covariance=settled.covariance,
        grid=None if parts.grid is None else parts.grid.grid,
        terms=(*(t.to_file() for t in parts.known_terms), *found, *geometric),
    )


def _build_joint_results(
    fit: StiffnessFit, sure: CoefficientUncertainty, settled: SettledCoefficients
) -> tuple[JointResult, ...]:
    k, interval = 1.0 / settled.compliance, sure.stiffness_interval()
    # unidentified joints at the cell's values can shift an identified joint; its interval must contain its value
    low = np.where([s.identified for s in settled.joint_status], np.minimum(interval[:, 0], k), interval[:, 0])
    high = np.where([s.identified for s in settled.joint_status], np.maximum(interval[:, 1], k), interval[:, 1])
    return tuple(
        JointResult(
            joint=j + 1,
            k=float(k[j]),
            interval=(float(low[j]), float(high[j])),
            sigma=float(sure.sigma[j]),
            freedom=float(sure.freedom[j]),
            identified=s.identified,
            reason=s.reason,
            torque=s.torque,
            expected=s.expected,
            inflation=s.inflation,
        )
        for j, s in enumerate(settled.joint_status)
    )


def _build_term_results(
    fit: StiffnessFit, sure: CoefficientUncertainty, settled: SettledCoefficients, x: Array
) -> tuple[TermResult, ...]:
    out = []
    for p, (u, s) in enumerate(zip(fit.unknowns, settled.status, strict=True)):
        if u.term is not None:
            term = fit.terms[u.term]
            low, high = sure.interval[p]
            out.append(
                TermResult(
                    effect=term.effect,
                    location=term.location,
                    name=term.coefficients[u.coefficient].name,
                    unit=u.unit,
                    value=float(x[p]),
                    interval=(float(low), float(high)),
                    sigma=float(sure.sigma[p]),
                    identified=s.identified,
                    reason=s.reason,
                )
            )
    return tuple(out)
