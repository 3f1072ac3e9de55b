"""Warnings and notes of an identification in words."""

from __future__ import annotations

import numpy as np

from machopt.data_types.documents.identification_document import describe_unidentified_joint
from machopt.data_types.stiffness import format_joint_stiffness
from machopt.measurement import thresholds
from machopt.measurement.identification.assessment.coefficient_uncertainty import CoefficientUncertainty
from machopt.measurement.identification.assessment.holdout_errors import HoldoutErrorSummary
from machopt.measurement.identification.assessment.identifiability import SettledCoefficients
from machopt.measurement.identification.assessment.leverage_and_outliers import ReadingOutlier
from machopt.measurement.identification.fitting.weighted_fit import StiffnessFit

MAX_LISTED_ROWS = 5


def build_warnings(
    fit: StiffnessFit,
    uncertainty: CoefficientUncertainty,
    settled: SettledCoefficients,
    fitted_errors: HoldoutErrorSummary,
    holdout_errors: HoldoutErrorSummary,
    outliers: tuple[ReadingOutlier, ...],
) -> list[str]:
    """Build the warnings about a result.

    Args:
        fit: Weighted fit of the stiffness.
        uncertainty: Uncertainty of the coefficients.
        settled: Final coefficients with their identifiability.
        fitted_errors: Errors on the fitted readings.
        holdout_errors: Cross-validated errors.
        outliers: Rejected outliers.

    Returns:
        Warnings.
    """
    return [
        *_list_identifiability_warnings(fit, uncertainty, settled),
        *_list_coefficient_warnings(fit, uncertainty, settled),
        *_list_error_warnings(fitted_errors, holdout_errors),
        *_list_scatter_warnings(fit),
        *_list_outlier_warnings(outliers),
    ]


def _list_identifiability_warnings(
    fit: StiffnessFit, uncertainty: CoefficientUncertainty, settled: SettledCoefficients
) -> list[str]:
    """Return warnings of unknowns that the readings do not determine."""
    out = []
    if uncertainty.unobserved_directions.shape[1]:
        names = [
            u.name
            for u, row in zip(fit.unknowns, uncertainty.unobserved_directions, strict=True)
            if np.abs(row).max() > thresholds.SHARES.small
        ]
        out.append(
            f"singular design: no reading separates {', '.join(names)}, or shows them at all; other poses and loads "
            "are needed"
        )
    out += [
        describe_unidentified_joint(j + 1, s.reason) for j, s in enumerate(settled.joint_status) if not s.identified
    ]
    for t, term in enumerate(fit.terms):
        term_statuses = [s for u, s in zip(fit.unknowns, settled.status, strict=True) if u.term == t]
        if not any(s.identified for s in term_statuses):
            reasons = dict.fromkeys(s.reason for s in term_statuses)
            out.append(f"{term.effect} at {term.location} is not found and left out: {'; '.join(reasons)}")
    return out


def _list_coefficient_warnings(
    fit: StiffnessFit, uncertainty: CoefficientUncertainty, settled: SettledCoefficients
) -> list[str]:
    """Return warnings of negative compliances, of single coefficients and of whole matrices."""
    out = []
    for p, u in enumerate(fit.unknowns):
        if np.isfinite(u.lower) and fit.free[p] + thresholds.LEVELS.three_sigma * uncertainty.sigma[p] < u.lower:
            out.append(
                f"without its bound, the compliance of {u.name} would be negative by "
                f"{abs(fit.free[p]) / uncertainty.sigma[p]:.1f} standard errors: the model lacks something, "
                "or the record is wrong"
            )
    for t in settled.has_projected_matrices:
        term = fit.terms[t]
        out.append(
            f"{term.effect} at {term.location}: as fitted it would move against a load in some direction, which no "
            "structure does; the best fit that does not is given instead, fewer coefficients (form: diagonal) would be "
            "surer"
        )
    return out


def _list_error_warnings(fitted_errors: HoldoutErrorSummary, holdout_errors: HoldoutErrorSummary) -> list[str]:
    """Return warnings of a model that explains little, or that predicts unseen poses worse."""
    out = []
    if fitted_errors.explained < thresholds.SHARES.majority:
        out.append(
            f"the model explains only {100 * fitted_errors.explained:.0f} % of the squared displacements"
            if fitted_errors.explained > 0
            else "the model explains none of the displacements"
        )
    if holdout_errors.rmse > thresholds.RATIOS.larger * fitted_errors.rmse:
        out.append(
            f"poses that the fit has not seen err by {1e3 * holdout_errors.rmse:.3g} mm, seen ones by "
            f"{1e3 * fitted_errors.rmse:.3g} mm: "
            "too few poses for the unknowns, or stiffness that changes with the pose"
        )
    return out


def _list_scatter_warnings(fit: StiffnessFit) -> list[str]:
    """Return warnings of readings that scatter more than their stated uncertainty."""
    out = []
    stated = fit.experiment.uncertainty
    for value, scatter, unit, factor in zip(
        (stated.displacement, stated.rotation),
        fit.weighting.scatter(fit.clusters),
        ("mm", "mrad"),
        (1e3, 1e3),
        strict=False,
    ):
        if value is not None and fit.weighted and scatter.reading > thresholds.LEVELS.two_sigma * value:
            out.append(
                f"readings scatter by {factor * scatter.reading:.3g} {unit} about the model, {factor * value:.3g} "
                f"{unit} are stated: physics that the model lacks, or a measurement that is worse than stated"
            )
    return out


def _list_outlier_warnings(outliers: tuple[ReadingOutlier, ...]) -> list[str]:
    if not outliers:
        return []
    places = list(dict.fromkeys(o.place for o in outliers))
    more = f" and {len(places) - MAX_LISTED_ROWS} more" if len(places) > MAX_LISTED_ROWS else ""
    return [f"put aside as outliers: {', '.join(places[:MAX_LISTED_ROWS])}{more}"]


def build_notes(
    fit: StiffnessFit, uncertainty: CoefficientUncertainty, settled: SettledCoefficients
) -> tuple[str, ...]:
    """Build the notes on noise and values.

    Args:
        fit: Weighted fit of the stiffness.
        uncertainty: Uncertainty of the coefficients.
        settled: Final coefficients with their identifiability.

    Returns:
        Notes.
    """
    stated = fit.experiment.uncertainty
    out = []
    if fit.weighted:
        for name, scatter, factor, unit, own in zip(
            ("displacement", "rotation"),
            fit.weighting.scatter(fit.clusters),
            (1e6, 1e6),
            ("µm", "µrad"),
            (stated.displacement, stated.rotation),
            strict=False,
        ):
            shared = [
                f"{factor * v:.3g} {unit} shared by a {level}"
                for v, level in ((scatter.cycle, "load cycle"), (scatter.visit, "visit to a pose"))
                if v is not None
            ]
            origin = (
                "stated and checked against the residuals"
                if own is not None
                else "not stated, taken from the residuals"
            )
            out.append(
                f"{name} errors, 1 sigma of a coordinate: {factor * scatter.reading:.3g} {unit} a reading"
                + "".join(f", {s}" for s in shared)
                + ("" if shared else " (no replicates: errors shared by readings of a pose cannot be separated)")
                + f"; {origin}"
            )
    else:
        out.append("unweighted: every coordinate counts alike")
    out.append(
        f"{100 * uncertainty.level:.0f} % intervals: cluster-robust, errors within a pose taken as dependent "
        f"({fit.clusters.poses} pose{'s' if fit.clusters.poses > 1 else ''})"
    )
    for j, s in enumerate(settled.joint_status):
        if not s.identified:
            treatment = "at a bound" if settled.replaced[j] else "drawn to the cell's value or to a bound"
            stiffness = 1 / settled.x[j] if settled.x[j] else np.inf
            out.append(
                f"joint {j + 1} is set to {format_joint_stiffness(stiffness)}, {treatment}; that is not a measurement"
            )
    return tuple(out)
