"""Variance components from replicates: error of a single reading, of a load cycle and of a visit to a pose.

Restricted maximum likelihood (Patterson & Thompson 1971) of random shifts. The scale s² is profiled out, so that at
most two numbers are optimised, on sums per cycle.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from scipy.optimize import minimize

from machopt.measurement import thresholds
from machopt.measurement.estimation.error_clusters import (
    ClusterSums,
    ErrorClusters,
    VarianceComponents,
    build_normal_equations,
)
from machopt.numerics.array_types import Array

LEAST, MOST = 1e-4, 1e4  # bounds of a shift's variance relative to a reading's; the lower bound counts as zero
ZERO_WEIGHT = 1e-20  # relative weight below which a coefficient is unobserved
STARTS = (1e-1, 10.0)
CONVERGENCE_TOLERANCE = 1e-7  # relative change of the likelihood at which the search ends


@dataclass(frozen=True)
class NoiseScatter:
    """Standard deviations of one coordinate of a channel, m or rad; None if replicates do not determine it."""

    reading: float
    cycle: float | None
    visit: float | None

    @property
    def total(self) -> float:
        return float(np.sqrt(self.reading**2 + (self.cycle or 0.0) ** 2 + (self.visit or 0.0) ** 2))


def estimate_variance_components(
    clusters: ErrorClusters, sums: ClusterSums, unit: float, *, stated: bool, before: VarianceComponents | None = None
) -> VarianceComponents:
    """Estimate the variance components of a channel.

    Args:
        clusters: Clusters of readings with shared errors.
        sums: Sums of the channel's equations for s² = 1, with outlier weights.
        unit: Typical variance of a reading's coordinate at s² = 1, m² or rad²; makes the ratios dimensionless.
        stated: Whether the uncertainty of the readings is stated; then s² is kept near 1 if there are few
            residuals.
        before: Components estimated from similar sums, as start values.

    Returns:
        Scale and ratios; a scale of 1 without degrees of freedom.
    """
    rank = _compute_residual_sum(sums.AQA.sum(axis=0), sums.AQy.sum(axis=0), sums.quadratic)[2]
    free = sums.count - rank
    use = [clusters.has_cycle, clusters.has_visit]

    def ratios(x: Array) -> tuple[float, float]:
        full = np.zeros(2)
        full[use] = np.exp(x) * unit
        full[full <= 1.01 * LEAST * unit] = 0.0
        return float(full[0]), float(full[1])

    def misfit(x: Array) -> tuple[float, float]:
        cycle, visit = ratios(x)
        n = build_normal_equations(clusters, sums, VarianceComponents(1.0, cycle, visit))
        H, h = n.total()
        rss, logdet, _ = _compute_residual_sum(H, h, n.yy)
        return free * np.log(rss) + n.logdet + logdet, rss

    if free < 1:
        return VarianceComponents()
    best = np.full(sum(use), np.log(LEAST))
    if any(use):
        bounds = [(np.log(LEAST), np.log(MOST))] * len(best)
        starts = [best, *(np.full(len(best), np.log(s)) for s in STARTS)]
        if before is not None:
            known = np.array([before.cycle, before.visit])[use] / unit
            starts = [np.log(np.clip(known, LEAST, MOST))]
        first = min(starts, key=lambda x: misfit(x)[0])
        found = minimize(
            lambda x: misfit(x)[0], first, method="L-BFGS-B", bounds=bounds, options={"ftol": CONVERGENCE_TOLERANCE}
        )
        best = np.asarray(found.x, float)
    rss = misfit(best)[1]
    stated_freedom = thresholds.COUNTS.min_degrees_of_freedom if stated else 0.0
    cycle, visit = ratios(best)
    return VarianceComponents((stated_freedom + rss) / (stated_freedom + free), cycle, visit)


def _compute_column_scale(H: Array) -> Array:
    """Return the square root of each diagonal element; 1 for unobserved coefficients."""
    d = np.diag(H)
    return np.asarray(np.sqrt(np.where(d > ZERO_WEIGHT * d.max(), d, 1.0)))


def _compute_residual_sum(H: Array, h: Array, yy: float) -> tuple[float, float, int]:
    """Return the residual sum of squares at the optimum, log det H and the rank; directions without data are left
    out.
    """
    d = _compute_column_scale(H)
    values, vectors = np.linalg.eigh(H / np.outer(d, d))
    seen = values > 1e-9 * values[-1]
    along = vectors[:, seen].T @ (h / d)
    rss = yy - float(np.sum(along**2 / values[seen]))
    logdet = float(np.log(values[seen]).sum() + 2 * np.log(d).sum())
    return max(rss, 1e-12 * yy, float(np.finfo(float).tiny)), logdet, int(seen.sum())
