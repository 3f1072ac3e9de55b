"""Leverage, influence and outliers: which readings and poses determine the result, and which contradict the others."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from machopt.measurement import thresholds
from machopt.measurement.estimation.error_clusters import predict_cluster_shifts
from machopt.measurement.identification.assessment.identifiability import SettledCoefficients
from machopt.measurement.identification.fitting.weighted_fit import StiffnessFit
from machopt.numerics.array_types import Array, Ints


@dataclass(frozen=True)
class ReadingInfluence:
    """Leverage and influence. The leverages sum to the number of unknowns."""

    leverage: Array  # (N,) leverage of each reading
    cook: Array  # (N,) Cook's distance of each reading (first order), per unknown
    pose: Ints  # (G,) label of each pose
    pose_leverage: Array  # (G,)
    pose_cook: Array  # (G,) Cook's distance of each pose, exact


@dataclass(frozen=True)
class ReadingOutlier:
    """Coordinate that the fit rejected as an outlier."""

    reading: int  # 0-based
    place: str  # file and line
    axis: int  # 0 … D − 1
    residual: float  # m or rad
    sigmas: float  # per standard deviation of a reading


def compute_influence(fit: StiffnessFit, settled: SettledCoefficients) -> ReadingInfluence:
    """Compute leverage h = tr(A M Aᵀ W) and Cook's distance of readings and poses.

    Args:
        fit: Weighted fit of the stiffness.
        settled: Final coefficients with their identifiability.

    Returns:
        The influence.
    """
    H, h = fit.normal.total()
    M = np.linalg.pinv(H + np.diag(settled.pull), hermitian=True)
    leverage, moved = np.zeros(len(fit.y)), np.zeros((len(fit.y), len(fit.x)))
    for c, share in enumerate(fit.weighting.components):
        rows = slice(3 * c, 3 * c + 3)
        A = fit.A[:, rows] * fit.column
        Q = fit.weighting.precision[c]
        WA = Q @ (A - predict_cluster_shifts(fit.clusters, Q, A, share)) / share.scale
        leverage += np.einsum("nip,pq,niq->n", A, M, WA, optimize=True)
        moved += np.einsum("nip,ni->np", WA, fit.residual[:, rows]) @ M
    cook = np.einsum("np,pq,nq->n", moved, H, moved, optimize=True) / len(fit.x)
    G = fit.clusters.poses
    pose_leverage = np.einsum("gpq,qp->g", fit.normal.H, M)
    pose_cook = np.empty(G)
    for g in range(G):
        apart = (settled.solve(fit, H - fit.normal.H[g], h - fit.normal.h[g]) - settled.x) / fit.column
        pose_cook[g] = apart @ H @ apart / len(fit.x)
    first = fit.clusters.order[fit.clusters.starts[:-1]]
    return ReadingInfluence(leverage, cook, fit.experiment.pose[first], pose_leverage, pose_cook)


def list_outliers(fit: StiffnessFit) -> tuple[ReadingOutlier, ...]:
    """List the rejected coordinates, the worst first.

    Args:
        fit: Weighted fit of the stiffness.

    Returns:
        The outliers.
    """
    found = []
    residual = fit.residual
    for c, (V, share) in enumerate(zip(fit.weighting.covariance, fit.weighting.components, strict=True)):
        together = np.sqrt(share.scale * (V[:, [0, 1, 2], [0, 1, 2]] + share.cycle + share.visit))
        for n, i in np.argwhere(fit.weighting.robust[:, 3 * c : 3 * c + 3] < thresholds.SHARES.majority):
            e = float(residual[n, 3 * c + i])
            found.append(
                ReadingOutlier(
                    int(n), fit.experiment.format_reading_location(int(n)), int(3 * c + i), e, abs(e) / together[n, i]
                )
            )
    return tuple(sorted(found, key=lambda o: -o.sigmas))
