"""Weights of the readings: covariance, outlier weights and variance components, found together by iteration."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property

import numpy as np

from machopt.data_types.measurements.recording import StandardUncertainty
from machopt.measurement.estimation.bounded_least_squares import minimise_bounded_quadratic
from machopt.measurement.estimation.error_clusters import (
    ClusterSums,
    ErrorClusters,
    NormalEquations,
    VarianceComponents,
    build_normal_equations,
    predict_cluster_shifts,
    sum_channel_equations,
)
from machopt.measurement.estimation.load_test_equations import LoadTestExperiment
from machopt.measurement.estimation.reading_covariance import compute_reading_covariance
from machopt.measurement.estimation.robust_weights import (
    compute_robust_weights,
    estimate_robust_scale,
    fit_least_absolute_deviations,
)
from machopt.measurement.estimation.variance_components import NoiseScatter, estimate_variance_components
from machopt.numerics.array_types import Array
from machopt.stiffness.terms import LinearTerm

ROUNDS = 8

CONVERGENCE_TOLERANCE = 1e-3  # change of a coefficient between rounds, in standard errors


@dataclass(frozen=True)
class ReadingWeights:
    """Weights of the readings in a fit."""

    covariance: Array  # (C, N, 3, 3) of a single reading's error for s² = 1; C channels: translation, rotation
    components: tuple[VarianceComponents, ...]  # one per channel
    robust: Array  # (N, D) in [0, 1]

    @cached_property
    def precision(self) -> Array:
        """Inverse covariance (C, N, 3, 3) for s² = 1; the variance of a suspect coordinate is divided by its weight."""
        V = self.covariance.copy()
        for c in range(len(V)):
            w = np.maximum(self.robust[:, 3 * c : 3 * c + 3], 1e-9)
            for i in range(3):
                V[c, :, i, i] /= w[:, i]
        return np.asarray(np.linalg.inv(V))

    def scatter(self, clusters: ErrorClusters) -> tuple[NoiseScatter, ...]:
        """Return the standard deviations of each channel's variance components.

        Args:
            clusters: Clusters with shared errors.

        Returns:
            One entry per channel.
        """
        out = []
        for V, c in zip(self.covariance, self.components, strict=True):
            s = float(np.sqrt(c.scale))
            own = s * float(np.sqrt(np.median(V[:, [0, 1, 2], [0, 1, 2]])))
            cycle = s * float(np.sqrt(c.cycle)) if clusters.has_cycle else None
            out.append(NoiseScatter(own, cycle, s * float(np.sqrt(c.visit)) if clusters.has_visit else None))
        return tuple(out)


def set_term_coefficients(terms: Sequence[LinearTerm], x: Array) -> tuple[LinearTerm, ...]:
    """Set the coefficients of terms from a vector of all coefficients.

    Args:
        terms: Linear terms.
        x: (n + P,) coefficients; those of the terms follow the n joints.

    Returns:
        The terms.
    """
    out: list[LinearTerm] = []
    at = len(x) - sum(len(term.coefficients) for term in terms)
    for term in terms:
        n = len(term.coefficients)
        out.append(term.with_values(x[at : at + n]))
        at += n
    return tuple(out)


@dataclass(frozen=True, kw_only=True)
class WeightIteration:
    """State of the iteration: scaled equations and the computation of weights."""

    experiment: LoadTestExperiment
    terms: tuple[LinearTerm, ...]
    A: Array  # (N, D, P) scaled
    y: Array
    column: Array
    lower: Array
    clusters: ErrorClusters
    uncertainty: StandardUncertainty | None
    robust: bool

    @property
    def load(self) -> Array:
        """Magnitude (N,) of each load; moments divided by a lever arm of 1 m."""
        w = self.experiment.wrench
        return np.asarray(np.linalg.norm(w[:, :3], axis=1) + np.linalg.norm(w[:, 3:], axis=1))

    @property
    def stated(self) -> tuple[bool, bool]:
        """Whether the uncertainties of translations and rotations are stated."""
        given = self.experiment.uncertainty if self.uncertainty is None else self.uncertainty
        return given.displacement is not None, given.rotation is not None

    def equal_weights(self) -> ReadingWeights:
        """Return equal variances for all coordinates, estimated from the residuals."""
        N, D = self.y.shape
        V = np.broadcast_to(np.eye(3), (D // 3, N, 3, 3))
        doubt = np.ones((N, D))
        if self.robust:
            residual = self.y - self.A @ fit_least_absolute_deviations(self.A, self.y, self.load)
            for c in range(0, D, 3):
                part = residual[:, c : c + 3]
                doubt[:, c : c + 3] = compute_robust_weights(
                    part, np.full(part.shape, max(estimate_robust_scale(part, self.A.shape[2]), 1e-12))
                )
        draft = ReadingWeights(V, (VarianceComponents(),) * (D // 3), doubt)
        H, h = self.equations(draft).total()
        residual = self.y - self.A @ minimise_bounded_quadratic(H, h, self.lower / self.column)
        left = max(float(doubt.sum()) - self.A.shape[2], 1.0)
        common = max(float(np.sum(doubt * residual**2)) / left, float(np.finfo(float).tiny))
        return ReadingWeights(V, (VarianceComponents(common),) * (D // 3), doubt)

    def update_weights(self) -> ReadingWeights:
        """Update covariance, outlier weights, components and coefficients until convergence."""
        stated = self.experiment.uncertainty if self.uncertainty is None else self.uncertainty
        N, D = self.y.shape
        x = fit_least_absolute_deviations(self.A, self.y, self.load)
        residual = self.y - self.A @ x
        typical = np.array([estimate_robust_scale(residual[:, c : c + 3], len(x)) for c in range(0, D, 3)])
        weighting: ReadingWeights | None = None
        found: tuple[VarianceComponents, ...] = ()
        joints = self.experiment.joint_count
        for _ in range(ROUNDS):
            known = set_term_coefficients(self.terms, x * self.column)
            V = compute_reading_covariance(self.experiment, (x * self.column)[:joints], known, stated, typical)
            doubt = self._compute_covariance(residual, V, weighting) if self.robust else np.ones((N, D))
            weighting = ReadingWeights(V, (), doubt)
            parts = self.sums(weighting)
            found = tuple(
                estimate_variance_components(
                    self.clusters,
                    s,
                    float(np.median(V[c][:, [0, 1, 2], [0, 1, 2]])),
                    stated=self.stated[c],
                    before=found[c] if found else None,
                )
                for c, s in enumerate(parts)
            )
            weighting = ReadingWeights(V, found, doubt)
            H, h = self._build_normal(parts, found).total()
            new = minimise_bounded_quadratic(H, h, self.lower / self.column)
            error = np.sqrt(np.maximum(np.diag(np.linalg.pinv(H, hermitian=True)), 1e-300))
            moved, x = np.abs(new - x) / error, new
            residual = self.y - self.A @ x
            if moved.max() < CONVERGENCE_TOLERANCE:
                break
        assert weighting is not None  # ROUNDS > 0
        return weighting

    def _compute_covariance(self, residual: Array, V: Array, before: ReadingWeights | None) -> Array:
        """Return outlier weights, first of the residuals, later of residuals without shared shifts."""
        out = np.empty_like(residual)
        for c in range(len(V)):
            part = residual[:, 3 * c : 3 * c + 3]
            own = np.sqrt(V[c][:, [0, 1, 2], [0, 1, 2]])
            if before is None:
                least = 1.0 if self.stated[c] else 1e-12  # not below the stated uncertainty
                typical = max(estimate_robust_scale(part / own, self.A.shape[2]), least)
                out[:, 3 * c : 3 * c + 3] = compute_robust_weights(part / own, np.full(part.shape, typical))
                continue
            share = before.components[c]
            rest = part - predict_cluster_shifts(self.clusters, before.precision[c], part, share)
            out[:, 3 * c : 3 * c + 3] = compute_robust_weights(rest, np.sqrt(share.scale) * own)
        return out

    def sums(self, weighting: ReadingWeights) -> list[ClusterSums]:
        """Return the equations of each channel, summed by cluster.

        Args:
            weighting: Weights of the readings.

        Returns:
            One entry per channel.
        """
        Q = weighting.precision
        out = []
        for c in range(len(Q)):
            rows = slice(3 * c, 3 * c + 3)
            count = float(weighting.robust[:, rows].sum())
            out.append(sum_channel_equations(self.clusters, Q[c], self.A[:, rows], self.y[:, rows], count))
        return out

    def equations(self, weighting: ReadingWeights) -> NormalEquations:
        """Return the normal equations by pose.

        Args:
            weighting: Weights of the readings.

        Returns:
            The equations.
        """
        return self._build_normal(self.sums(weighting), weighting.components)

    def _build_normal(self, parts: Sequence[ClusterSums], found: Sequence[VarianceComponents]) -> NormalEquations:
        each = [build_normal_equations(self.clusters, s, c) for s, c in zip(parts, found, strict=True)]
        return each[0] if len(each) == 1 else each[0].add(each[1])
