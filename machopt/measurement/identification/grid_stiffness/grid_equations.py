"""Equations of a grid: relative compliances of the varying joints, then the terms, from the readings of the constant
fit.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from machopt.measurement.estimation.error_clusters import (
    ErrorClusters,
    VarianceComponents,
    build_error_clusters,
    predict_cluster_shifts,
    sum_channel_equations,
)
from machopt.measurement.estimation.robust_weights import compute_robust_weights, estimate_robust_scale
from machopt.measurement.identification.fitting.reading_weights import ReadingWeights
from machopt.measurement.identification.fitting.weighted_fit import StiffnessFit
from machopt.measurement.identification.grid_stiffness.grid_cells import MeasuredCells
from machopt.measurement.identification.grid_stiffness.grid_marginal_likelihood import GridLikelihood
from machopt.measurement.identification.grid_stiffness.grid_prior import GridPosterior, GridPrior, LinearisedResponse
from machopt.numerics.array_types import Array, Bools

SHIFT_START = 0.3  # start value of the relative shift variance: away from zero, where the likelihood is flat


@dataclass(frozen=True, kw_only=True)
class GridEquations:
    """M readings inside the grid: y = A r of their place + error, with r = (relative compliances, scaled terms)."""

    constant: StiffnessFit
    rows: Bools  # (N,) readings inside the grid
    places: MeasuredCells
    varying_joints: Bools  # (6,)
    reference: Array  # (6,) rad/(N·m), reference of relative compliances; for fixed joints their value
    A: Array  # (M, D, R) response of the readings inside
    y: Array  # (M, D)
    kept_columns: Bools  # (T,) coefficients of terms that are fitted; the others stay at their bound
    groups: ErrorClusters
    smooth: bool

    @classmethod
    def from_fit(
        cls,
        constant: StiffnessFit,
        rows: Bools,
        places: MeasuredCells,
        vary: Bools,
        reference: Array,
        smooth: bool,
        fitted: Bools,
    ) -> GridEquations:
        """Build the grid equations from the constant fit.

        Args:
            constant: Fit of the constant model.
            rows: (N,) True for readings inside the grid.
            places: Cells, sites and places of these readings.
            vary: (6,) True for joints that vary by cell.
            reference: (6,) reference compliance, rad/(N·m).
            smooth: Whether neighbouring cells may be correlated.
            fitted: (T,) True for coefficients of terms that are fitted; the others stay at their lower bound.

        Returns:
            The equations.
        """
        A = constant.A[rows]
        n = constant.joint_count
        joints = A[..., :n] * reference
        fixed = np.where(fitted, 0.0, constant.lower[n:])
        y = constant.y[rows] - joints[..., ~vary].sum(axis=-1) - A[..., n:] @ fixed
        scaled = (A[..., n:] * constant.column[n:])[..., fitted]
        groups = constant.clusters if rows.all() else build_error_clusters(constant.experiment.select_readings(rows))
        A = np.concatenate([joints[..., vary], scaled], axis=-1)
        return cls(
            constant=constant,
            rows=rows,
            places=places,
            varying_joints=vary,
            reference=reference,
            A=A,
            y=y,
            kept_columns=fitted,
            groups=groups,
            smooth=smooth,
        )

    @property
    def terms(self) -> int:
        return int(self.kept_columns.sum())

    def start(self) -> ReadingWeights:
        """Return the weights of the constant fit; without weights, variances from its residuals."""
        w = self.constant.weighting
        V, robust = w.covariance[:, self.rows], w.robust[self.rows]
        if self.constant.weighted:
            return ReadingWeights(V, w.components, robust)
        residual = self.constant.residual[self.rows]
        size = [
            max(estimate_robust_scale(residual[:, 3 * c : 3 * c + 3]), np.finfo(float).tiny) ** 2 for c in range(len(V))
        ]
        return ReadingWeights(V * np.array(size)[:, None, None, None], w.components, robust)

    def prior(self, weighting: ReadingWeights) -> GridPrior:
        """Return the start values of the prior.

        Args:
            weighting: Weights of the readings.

        Returns:
            The prior.
        """
        start = GridPrior.start(int(self.varying_joints.sum()), self.smooth)
        noise = tuple(
            VarianceComponents(c.scale, max(c.cycle, SHIFT_START * unit), max(c.visit, SHIFT_START * unit))
            for c, unit in zip(weighting.components, map(_compute_scalar_variance, weighting.covariance), strict=True)
        )
        return replace(start, noise=noise)

    def evidence(self, weighting: ReadingWeights) -> GridLikelihood:
        """Sum the readings by cluster for the marginal likelihood.

        Args:
            weighting: Weights of the readings.

        Returns:
            The likelihood.
        """
        Q, V = weighting.precision, weighting.covariance
        parts = []
        for c in range(len(Q)):
            rows = slice(3 * c, 3 * c + 3)
            parts.append(
                sum_channel_equations(
                    self.groups, Q[c], self.A[:, rows], self.y[:, rows], float(weighting.robust[:, rows].sum())
                )
            )
        stated = self.constant.experiment.uncertainty
        return GridLikelihood(
            clusters=self.groups,
            channel_sums=parts,
            unit=[_compute_scalar_variance(v) for v in V],
            stated=[s is not None for s in (stated.displacement, stated.rotation)][: len(V)],
            site=self.places.site,
            place=self.places.place,
            cells=len(self.places.cells),
            joints=int(self.varying_joints.sum()),
            distance=self.places.distance,
            smooth=self.smooth,
        )

    def first_unknowns(self) -> Array:
        """Return the unknowns (n,) of the constant model: log relative compliances by cell, then scaled terms."""
        n = self.constant.joint_count
        terms = (self.constant.x[n:] / self.constant.column[n:])[self.kept_columns]
        return np.concatenate([np.zeros(len(self.places.cells) * int(self.varying_joints.sum())), terms])

    def linear(self, beta: Array) -> LinearisedResponse:
        """Linearise the responses of the places about given unknowns.

        Args:
            beta: (n,) unknowns.

        Returns:
            The linearised responses.
        """
        C = len(self.places.cells)
        return LinearisedResponse(
            *self.places.linear(beta[: C * int(self.varying_joints.sum())].reshape(C, -1), self.terms)
        )

    def residual(self, response: Array) -> Array:
        """Return the residuals for given responses.

        Args:
            response: (G, R) responses by pose.

        Returns:
            (M, D) m, rad.
        """
        return np.asarray(self.y - np.einsum("ndr,nr->nd", self.A, response[self.groups.pose]))

    def compute_reading_covariance(
        self, before: ReadingWeights, prior: GridPrior, posterior: GridPosterior
    ) -> ReadingWeights:
        """Update the outlier weights from residuals without shared shifts.

        Args:
            before: Current weights.
            prior: Prior of the cells.
            posterior: Posterior of the cells.

        Returns:
            The updated weights.
        """
        found = ReadingWeights(before.covariance, prior.noise, before.robust)
        residual = self.residual(posterior.site_response[self.places.site])
        out = np.empty_like(residual)
        for c, (V, share) in enumerate(zip(found.covariance, prior.noise, strict=True)):
            part = residual[:, 3 * c : 3 * c + 3]
            rest = part - predict_cluster_shifts(self.groups, found.precision[c], part, share)
            out[:, 3 * c : 3 * c + 3] = compute_robust_weights(rest, np.sqrt(share.scale * V[:, [0, 1, 2], [0, 1, 2]]))
        return ReadingWeights(before.covariance, prior.noise, out)


def _compute_scalar_variance(V: Array) -> float:
    return float(np.median(V[:, [0, 1, 2], [0, 1, 2]]))
