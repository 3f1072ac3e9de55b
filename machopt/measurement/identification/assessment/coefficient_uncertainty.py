"""Covariance and confidence intervals of the coefficients, with errors shared within a pose.

The covariance is the cluster-robust CR2 estimate (Bell & McCaffrey 2002; Pustejovsky & Tipton 2018) with one cluster
per pose and the weights of the fit as working covariance. It is valid for any correlation within a pose, and unbiased
if the weights are right. In the normal equations of the poses, H_g and h_g,

    u_g = (I − H_g M)^(−½) (h_g − H_g x),   M = (Σ H_g)⁻¹,   Cov x = M (Σ u_g u_gᵀ) M,

which needs P × P matrices only. Degrees of freedom are Satterthwaite's, per coefficient. If few poses determine a
joint, its degrees of freedom are few.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from scipy.special import stdtrit  # scipy.stats would take a second to load

from machopt.measurement.estimation.bounded_least_squares import compute_profile_bound
from machopt.measurement.identification.fitting.weighted_fit import StiffnessFit
from machopt.numerics.array_types import Array

NULL = 1e-10  # relative eigenvalue of the scaled normal matrix below which a direction has no data
LEAST_FREEDOM = 1.0  # least degrees of freedom for a quantile of Student's t


@dataclass(frozen=True, kw_only=True)
class CoefficientUncertainty:
    """Uncertainty of each coefficient of a fit."""

    level: float  # confidence level of the intervals, e.g. 0.9
    joint_count: int  # n; the first coefficients are the joint compliances
    sigma: Array  # (P,) standard error; inf without data
    freedom: Array  # (P,) degrees of freedom of sigma
    interval: Array  # (P, 2) confidence intervals within the bounds; may be infinite
    covariance: Array  # (P, P) without directions that have no data
    unobserved_directions: Array  # (P, U) unobservable unit directions in scaled coefficients
    condition: float  # condition number of the weighted, scaled design matrix
    condition_plain: float  # condition number of B in dumas2011 eq. 22, unscaled

    def stiffness_interval(self) -> Array:
        """Return the confidence intervals (n, 2) of the joint stiffnesses, N·m/rad.

        The upper end is infinite if the interval of the compliance includes zero. The lower end uses at least one
        standard error of the compliance.
        """
        n = self.joint_count
        least = np.where(np.isfinite(self.sigma[:n]), self.sigma[:n], 0.0)
        low, high = self.interval[:n, 0], np.maximum(self.interval[:n, 1], least)
        with np.errstate(divide="ignore"):
            return np.stack([1.0 / high, 1.0 / np.maximum(low, 0.0)], axis=1)


def compute_coefficient_uncertainty(fit: StiffnessFit, level: float = 0.9) -> CoefficientUncertainty:
    """Compute standard errors and two-sided confidence intervals.

    The intervals are too narrow if errors are shared by more than a pose, such as a common gain error of the force
    sensor, which no replicate shows.

    Args:
        fit: Any fit; in an unweighted one readings of a pose still count as dependent.
        level: Confidence level.

    Returns:
        The uncertainty.

    Source:
        Bell & McCaffrey 2002, Pustejovsky & Tipton 2018 (working-model CR2).
    """
    H, _ = fit.normal.total()
    values, vectors = np.linalg.eigh(H)
    seen = values > NULL * values[-1]
    unseen = vectors[:, ~seen]
    M = (vectors[:, seen] / values[seen]) @ vectors[:, seen].T
    covariance, freedom = compute_cluster_robust_covariance(fit.normal.H, fit.normal.h, M)
    model = np.diag(M).copy()
    robust = np.diag(covariance).copy()
    few = freedom < LEAST_FREEDOM  # a single pose determines the coefficient: its scatter is not observable
    left = float(fit.weighting.robust.sum()) - seen.sum()
    variance = np.where(few, np.maximum(model, robust), robust)
    freedom = np.where(few, max(LEAST_FREEDOM, min(left, fit.clusters.poses - 1.0)), freedom)
    blind = np.abs(unseen).max(axis=1, initial=0.0) > 1e-6
    sigma = np.where(blind | (left < 1), np.inf, np.sqrt(np.maximum(variance, 0.0)))
    interval = _compute_intervals(fit, H, sigma, model, freedom, level)
    unit = fit.column
    return CoefficientUncertainty(
        level=level,
        joint_count=fit.joint_count,
        sigma=sigma * unit,
        freedom=freedom,
        interval=interval * unit[:, None],
        covariance=covariance * np.outer(unit, unit),
        unobserved_directions=unseen,
        condition=float(np.sqrt(values[-1] / max(values[0], 0.0))) if values[0] > NULL * values[-1] else np.inf,
        condition_plain=_compute_condition_number(fit.A),
    )


def compute_cluster_robust_covariance(H: Array, h: Array, M: Array) -> tuple[Array, Array]:
    """Compute the CR2 covariance and Satterthwaite's degrees of freedom of each coefficient.

    Args:
        H: (G, P, P) normal matrices by cluster.
        h: (G, P) right-hand sides by cluster.
        M: (P, P) (pseudo-)inverse of the sum of H.

    Returns:
        (P, P) covariance, (P,) degrees of freedom.
    """
    values, vectors = np.linalg.eigh(M)
    values = np.maximum(values, 0.0)
    root = (vectors * np.sqrt(values)) @ vectors.T  # M^½
    whitened = root @ H @ root  # (G, P, P), eigenvalues in [0, 1]: the cluster's leverage
    share, basis = np.linalg.eigh((whitened + np.swapaxes(whitened, 1, 2)) / 2)
    with np.errstate(divide="ignore"):  # a direction that a single cluster determines has no residual to scale
        stretch = np.where(share < 1 - 1e-9, 1.0 / np.sqrt(np.maximum(1.0 - share, 1e-9)), 0.0)
    adjust = (basis * stretch[:, None, :]) @ np.swapaxes(basis, 1, 2)  # (I − M^½ H_g M^½)^(−½)
    x = M @ h.sum(axis=0)
    score = h - H @ x
    along = np.einsum("gij,gj->gi", adjust, score @ root)  # M^½ u_g
    q = along @ root  # (G, P) M u_g
    covariance = q.T @ q
    # E[q_g q_h] under the working covariance: a_gᵀ (δ_gh H_g − H_g M H_h) a_h for each coefficient
    a = np.einsum("gij,jk->gik", adjust, root)  # one column per coefficient, in M^½ coordinates
    b = np.einsum("gij,gjk->gik", whitened, a)  # (G, P, P)
    own = np.einsum("gik,gik->gk", a, b)
    cross = np.einsum("gik,gik->gk", b, b)
    outer = np.einsum("gik,gjk->kij", b, b)
    trace = (own - cross).sum(axis=0)
    square = (own**2 - 2.0 * own * cross).sum(axis=0) + np.einsum("kij,kij->k", outer, outer)
    freedom = np.divide(trace**2, square, out=np.zeros_like(trace), where=square > 0)
    return covariance, freedom


def _compute_intervals(fit: StiffnessFit, H: Array, sigma: Array, model: Array, freedom: Array, level: float) -> Array:
    """Return intervals (P, 2) of scaled coefficients: ± t σ, or the profile of the quadratic near a bound."""
    t = stdtrit(freedom, 0.5 + level / 2)
    lower = fit.lower / fit.column
    free, x = fit.free / fit.column, fit.x / fit.column
    with np.errstate(invalid="ignore"):
        out = np.stack([free - t * sigma, free + t * sigma], axis=1)
    if (out[:, 0] > lower).all() and np.isfinite(out).all():
        return out
    h = fit.normal.h.sum(axis=0)
    with np.errstate(invalid="ignore", divide="ignore"):
        wider = np.where(np.isfinite(sigma) & (model > 0), sigma**2 / model, 1.0)
    for j in range(len(x)):
        rise = float(t[j] ** 2 * wider[j])
        if np.isfinite(sigma[j]) and out[j, 0] > lower[j] and np.allclose(free, x, atol=1e-6 * np.abs(x).max()):
            continue  # no active bound: the profile equals the symmetric interval
        out[j] = [compute_profile_bound(H, h, lower, j, rise, sign) for sign in (-1, 1)]
    return out


def _compute_condition_number(A: Array) -> float:
    B = A.reshape(-1, A.shape[2])
    gram = np.linalg.svd(np.linalg.qr(B, mode="r"), compute_uv=False)
    return float(gram[0] / gram[-1]) if gram[-1] > 1e-13 * gram[0] else np.inf
