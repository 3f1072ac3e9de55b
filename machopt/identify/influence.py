"""Which readings and poses decide the result, and which contradict the rest."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from machopt.arrays import Array, Ints
from machopt.estimate.clusters import shifts
from machopt.identify import calibrated
from machopt.identify.fit import Fit
from machopt.identify.identifiability import Settled


@dataclass(frozen=True)
class Influence:
    """Leverage and influence; leverages sum to the number of unknowns."""

    leverage: Array  # (N,) share of the unknowns that each reading fixes
    cook: Array  # (N,) how far the result moves without the reading, in its own covariance, per unknown (first order)
    pose: Ints  # (G,) label of each pose
    pose_leverage: Array  # (G,)
    pose_cook: Array  # (G,) the same without the pose, exactly


@dataclass(frozen=True)
class Outlier:
    """A coordinate that the fit put aside."""

    reading: int  # 0-based
    place: str  # file and line
    axis: int  # 0 … D − 1
    residual: float  # m or rad
    sigmas: float  # per standard deviation of a reading


def influence(fit: Fit, settled: Settled) -> Influence:
    """Leverage h = tr(A M Aᵀ W) and Cook's distance of readings and poses."""
    H, h = fit.normal.total()
    M = np.linalg.pinv(H + np.diag(settled.pull), hermitian=True)
    leverage, moved = np.zeros(len(fit.y)), np.zeros((len(fit.y), len(fit.x)))
    for c, share in enumerate(fit.weighting.components):
        rows = slice(3 * c, 3 * c + 3)
        A = fit.A[:, rows] * fit.column
        Q = fit.weighting.precision[c]
        WA = Q @ (A - shifts(fit.clusters, Q, A, share)) / share.scale
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
    return Influence(leverage, cook, fit.experiment.pose[first], pose_leverage, pose_cook)


def outliers(fit: Fit) -> tuple[Outlier, ...]:
    """Coordinates that the fit put aside, the worst first."""
    found = []
    residual = fit.residual
    for c, (V, share) in enumerate(zip(fit.weighting.covariance, fit.weighting.components, strict=True)):
        together = np.sqrt(share.scale * (V[:, [0, 1, 2], [0, 1, 2]] + share.cycle + share.visit))
        for n, i in np.argwhere(fit.weighting.robust[:, 3 * c : 3 * c + 3] < calibrated.IDENTIFIED.out):
            e = float(residual[n, 3 * c + i])
            found.append(Outlier(int(n), fit.experiment.place(int(n)), int(3 * c + i), e, abs(e) / together[n, i]))
    return tuple(sorted(found, key=lambda o: -o.sigmas))
