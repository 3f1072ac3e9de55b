"""Variance components from replicates: how much of the error a reading, a load cycle and a visit to a pose has.

Restricted maximum likelihood (Patterson & Thompson 1971) of random shifts; the scale s² is profiled out, so two numbers
are sought at most, on sums per cycle instead of readings.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from scipy.optimize import minimize

from machopt.measurement.estimation import thresholds
from machopt.measurement.estimation.error_clusters import (
    ClusterSums,
    ErrorClusters,
    VarianceComponents,
    build_normal_equations,
)
from machopt.numerics.array_types import Array

LEAST, MOST = 1e-4, 1e4  # variance of a shift per variance of a reading; at the least end it counts as none
ZERO_WEIGHT = 1e-20  # weight of a coefficient per the largest one; below it the readings say nothing of it
STARTS = (1e-1, 10.0)
CONVERGENCE_TOLERANCE = 1e-7  # relative change of the likelihood (thousands) at which the search ends


@dataclass(frozen=True)
class NoiseScatter:
    """1 sigma of one coordinate of a channel, m or rad; None where replicates cannot tell it."""

    reading: float
    cycle: float | None
    visit: float | None

    @property
    def total(self) -> float:
        return float(np.sqrt(self.reading**2 + (self.cycle or 0.0) ** 2 + (self.visit or 0.0) ** 2))


def estimate_variance_components(
    clusters: ErrorClusters, sums: ClusterSums, unit: float, *, stated: bool, before: VarianceComponents | None = None
) -> VarianceComponents:
    """Estimate a channel's components.

    Args:
        clusters: who shares what.
        sums: of the channel's equations with s² = 1, at outlier weights.
        unit: m² or rad², typical variance of a reading's coordinate at s² = 1; makes the ratios dimensionless.
        stated: the readings' uncertainty is stated, so that s² is held near 1 where the residuals are few.
        before: found earlier on almost the same sums, a good start.

    Returns:
        scale and ratios; where nothing is left over to judge by, a scale of 1.
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
    held = thresholds.ESTIMATED.trust_in_stated if stated else 0.0
    cycle, visit = ratios(best)
    return VarianceComponents((held + rss) / (held + free), cycle, visit)


def _compute_column_scale(H: Array) -> Array:
    """Root of each diagonal element; 1 where the readings say nothing of a coefficient."""
    d = np.diag(H)
    return np.asarray(np.sqrt(np.where(d > ZERO_WEIGHT * d.max(), d, 1.0)))


def _compute_residual_sum(H: Array, h: Array, yy: float) -> tuple[float, float, int]:
    """Residual sum of squares at the best coefficients, log det H and rank; directions without data left out."""
    d = _compute_column_scale(H)
    values, vectors = np.linalg.eigh(H / np.outer(d, d))
    seen = values > 1e-9 * values[-1]
    along = vectors[:, seen].T @ (h / d)
    rss = yy - float(np.sum(along**2 / values[seen]))
    logdet = float(np.log(values[seen]).sum() + 2 * np.log(d).sum())
    return max(rss, 1e-12 * yy, float(np.finfo(float).tiny)), logdet, int(seen.sum())
