"""Weighted, robust, bounded least squares of compliances; dumas2011 eq. 26 is the special case without these.

::

    start (bounded leverage, L1) ─► reading covariance ─► outlier weights ─► variance components ─► bounded coefficients
                                      ▲────────────────────── repeated until convergence ─────────────────────┘
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from machopt.data_types.measurements.recording import StandardUncertainty
from machopt.errors import RecordingError
from machopt.measurement import thresholds
from machopt.measurement.estimation.bounded_least_squares import minimise_bounded_quadratic
from machopt.measurement.estimation.error_clusters import ErrorClusters, NormalEquations, build_error_clusters
from machopt.measurement.estimation.load_test_equations import LoadTestExperiment
from machopt.measurement.estimation.robust_weights import estimate_robust_scale
from machopt.measurement.identification.fitting.reading_weights import ReadingWeights, WeightIteration
from machopt.numerics.array_types import Array
from machopt.stiffness.terms import LinearTerm

MIN_COLUMN_EFFECT = 1e-7  # relative effect of a coefficient below which it counts as rounding


@dataclass(frozen=True, kw_only=True)
class FitCoefficient:
    """One coefficient of the fit."""

    name: str  # "joint 3", or "link_compliance at link:4 1/EI"
    unit: str
    lower: float = 0.0
    joint: int | None = None  # 1 … n
    term: int | None = None  # index of its term
    coefficient: int = 0  # index in its term


def list_fit_coefficients(joints: int, terms: Sequence[LinearTerm] = ()) -> tuple[FitCoefficient, ...]:
    """List the joint compliances and then the coefficients of the terms.

    Args:
        joints: Number of joints of the arm.
        terms: Linear terms.

    Returns:
        The coefficients.
    """
    out = [FitCoefficient(name=f"joint {j}", unit="rad/(N·m)", lower=0.0, joint=j) for j in range(1, joints + 1)]
    for t, term in enumerate(terms):
        for k, c in enumerate(term.coefficients):
            out.append(
                FitCoefficient(
                    name=f"{term.effect} at {term.location} {c.name}", unit=c.unit, lower=c.lower, term=t, coefficient=k
                )
            )
    return tuple(out)


@dataclass(frozen=True, kw_only=True)
class StiffnessFit:
    """Fitted coefficients with all data for uncertainty, cross-validation and influence.

    ``normal`` and ``column`` refer to scaled coefficients x / column. Displacements are A · x.
    """

    experiment: LoadTestExperiment
    terms: tuple[LinearTerm, ...]
    unknowns: tuple[FitCoefficient, ...]
    A: Array  # (N, D, P) m, rad per unit of each coefficient
    y: Array  # (N, D) m, rad: measured minus fixed terms and corrections
    x: Array  # (P,) coefficients within their bounds
    free: Array  # (P,) unbounded solution; unobservable directions at zero
    column: Array  # (P,) unit of each scaled coefficient
    lower: Array  # (P,) bounds
    clusters: ErrorClusters
    weighting: ReadingWeights
    normal: NormalEquations  # by pose, in scaled coefficients
    weighted: bool = True

    @property
    def compliance(self) -> Array:
        """Joint compliances (n,) rad/(N·m)."""
        return self.x[: self.joint_count]

    @property
    def joint_count(self) -> int:
        """Number of joints of the arm, n; their compliances are the first coefficients."""
        return self.experiment.joint_count

    @property
    def residual(self) -> Array:
        """Residuals (N, D) m, rad."""
        return np.asarray(self.y - self.A @ self.x)

    @property
    def outlier(self) -> NDArray[np.bool_]:
        """Readings (N,) with a rejected coordinate."""
        return np.asarray((self.weighting.robust < thresholds.SHARES.majority).any(axis=1))


def _check_determined(experiment: LoadTestExperiment, unknowns: int) -> None:
    """Raise RecordingError where there are too few equations for the unknowns, or no load."""
    count = experiment.measured.size
    if count <= unknowns:
        raise RecordingError(
            f"{len(experiment)} reading{'s' if len(experiment) > 1 else ''} of {experiment.dimensions} coordinates: "
            f"{count} equations for {unknowns} unknowns; at least "
            f"{unknowns // experiment.dimensions + 1} readings, better three times as many, would work",
            file=experiment.source,
        )
    if not experiment.wrench.any():
        raise RecordingError("no reading carries a load; every force and moment is zero", file=experiment.source)


def fit_stiffness(
    experiment: LoadTestExperiment,
    terms: Sequence[LinearTerm] = (),
    fixed: Sequence[LinearTerm] = (),
    *,
    uncertainty: StandardUncertainty | None = None,
    robust: bool = True,
    weighted: bool = True,
    bounded: bool = True,
    groups: ErrorClusters | None = None,
    weighting: ReadingWeights | None = None,
) -> StiffnessFit:
    """Identify joint compliances and the coefficients of further terms.

    Minimises Σ over poses of (y − A x)ᵀ W (y − A x) subject to lower bounds. W is the inverse covariance of the
    readings (error of a single reading, and shifts shared by a load cycle or a visit to a pose). The variance of each
    coordinate is divided by its outlier weight. Not valid if the displacement is not proportional to the load.

    Args:
        experiment: N readings.
        terms: Terms to fit together with the joints; their values are not used.
        fixed: Terms with known values; their contribution is subtracted.
        uncertainty: Standard uncertainty of the readings; None: as stated in the recording.
        robust: Whether to reject gross outliers, if there are enough equations.
        weighted: Whether to weight by the noise. False weights all coordinates equally, metres and radians
            alike; with ``robust=False, bounded=False`` this is dumas2011 eq. 26.
        bounded: Whether to keep compliances ≥ 0 and every coefficient above its bound.
        groups: Precomputed clusters, for repeated fits.
        weighting: Weights of an earlier fit to the same readings, used unchanged.

    Returns:
        The fit.

    Raises:
        InputError: No more coordinates than unknowns, or no load.

    Source:
        Dumas et al. 2011, eqs. 16–26.
    """
    unknowns = list_fit_coefficients(experiment.joint_count, terms)
    _check_determined(experiment, len(unknowns))
    A = experiment.response(terms)
    y = _subtract_fixed_terms(experiment, fixed)
    column, seen = _scale_columns(A, y)
    problem = WeightIteration(
        experiment=experiment,
        terms=tuple(terms),
        A=A * np.where(seen, column, 0.0),  # columns with rounding only are excluded
        y=y,
        column=column,
        lower=np.array([u.lower for u in unknowns]) if bounded else np.full(len(unknowns), -np.inf),
        clusters=build_error_clusters(experiment) if groups is None else groups,
        uncertainty=uncertainty,
        robust=robust and y.size >= thresholds.COUNTS.min_equations_per_unknown * len(unknowns),
    )
    if weighting is None:
        weighting = problem.update_weights() if weighted else problem.equal_weights()
    return _solve_fit(problem, A, unknowns, weighting, bounded=bounded, weighted=weighted)


def _subtract_fixed_terms(experiment: LoadTestExperiment, fixed: Sequence[LinearTerm]) -> Array:
    """Return the measured displacements (N, D) m, rad, less the contribution of terms with known values."""
    y = experiment.measured
    for term in fixed:
        y = y - (term.compute_response(experiment.state, experiment.wrench) @ term.values)[:, : experiment.dimensions]
    return y


def _solve_fit(
    problem: WeightIteration,
    A: Array,
    unknowns: tuple[FitCoefficient, ...],
    weighting: ReadingWeights,
    *,
    bounded: bool,
    weighted: bool,
) -> StiffnessFit:
    """Solve the weighted equations without bounds and within them; ``A`` (N, D, P) per unit of each coefficient."""
    normal = problem.equations(weighting)
    H, h = normal.total()
    free = minimise_bounded_quadratic(H, h, np.full(len(h), -np.inf)) * problem.column
    x = minimise_bounded_quadratic(H, h, problem.lower / problem.column) * problem.column if bounded else free
    return StiffnessFit(
        experiment=problem.experiment,
        terms=problem.terms,
        unknowns=unknowns,
        A=A,
        y=problem.y,
        x=x,
        free=free,
        column=problem.column,
        lower=problem.lower,
        clusters=problem.clusters,
        weighting=weighting,
        normal=normal,
        weighted=weighted,
    )


def _scale_columns(A: Array, y: Array) -> tuple[Array, NDArray[np.bool_]]:
    """Return the unit of each coefficient, which causes a typical displacement, and whether any reading shows it."""
    channels = range(0, A.shape[1], 3)
    size = np.repeat([max(estimate_robust_scale(y[:, c : c + 3]), 1e-12) for c in channels], 3)
    rms = np.sqrt(np.mean((A / size[:, None]) ** 2, axis=(0, 1)))
    least = max(MIN_COLUMN_EFFECT * float(rms.max()), float(np.finfo(float).tiny))
    return np.asarray(1.0 / np.maximum(rms, least)), np.asarray(rms > least)
