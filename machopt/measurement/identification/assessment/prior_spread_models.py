"""Likelihood of the readings under prior spreads of the coefficients, and the average over likely models.

A model is one prior standard deviation λ for each coefficient. Its likelihood integrates over the coefficients
(Patterson & Thompson 1971). Means and covariances of several models are averaged by their likelihoods.
"""

from __future__ import annotations

from collections.abc import Sequence
from itertools import product

import numpy as np
from numpy.typing import NDArray

from machopt.measurement.estimation.error_clusters import NormalEquations
from machopt.numerics.array_types import Array

GRID = np.concatenate([[0.0], np.logspace(-2.5, 0.5, 13)])  # λ; 1: as compliant as the adjacent joints
UNKNOWN_COMPLIANCE_SIGMA = 1.0  # relative 1 sigma of an unobserved joint's compliance
PRIOR_LOADED = 0.25  # prior 1 sigma of ``loaded`` about 1: URDF masses are good to 15 %, and it is a first-order effect

LambdaLikelihood = tuple[float, Array, float]  # log-likelihood, prior 1 sigma of every column, sum of both λ


def rate_spreads(H: Array, h: Array, group: Array) -> list[LambdaLikelihood]:
    """Compute the log-likelihood of each pair of the grid of prior spreads, for elastic effects and for gears.

    Args:
        H: (P, P) normal matrix of the columns in prior units.
        h: (P,) right-hand side.
        group: (P,) index of each column's spread: own, elastic, gear, loaded.

    Returns:
        One entry per pair.
    """
    rated: list[LambdaLikelihood] = []
    for elastic, gears in product(GRID, GRID):
        spread = np.array([UNKNOWN_COMPLIANCE_SIGMA, elastic, gears, PRIOR_LOADED])[group]
        rated.append((compute_log_likelihood(H, h, spread), spread, elastic + gears))
    return rated


def average_models(equations: NormalEquations, near: Sequence[LambdaLikelihood]) -> tuple[Array, Array]:
    """Compute mean and covariance of the coefficients over several models, weighted by their likelihoods.

    Args:
        equations: Normal equations by pose, in prior units.
        near: The models.

    Returns:
        (P,) mean and (P, P) covariance; the data part of the covariance is cluster-robust.
    """
    H, h = equations.total()
    share = np.exp(np.array([b[0] for b in near]) - max(b[0] for b in near))
    share /= share.sum()
    mean, second = np.zeros(len(h)), np.zeros_like(H)
    part: _ColumnEquations | None = None
    for w, (_, spread, _) in zip(share, near, strict=True):
        use, P = select_possible_columns(H, spread)
        if part is None or not np.array_equal(part.use, use):
            part = _ColumnEquations(use, equations)
        S = np.asarray(np.linalg.inv(P), float)
        x = np.zeros(len(h))
        x[use] = S @ h[use]
        mean += w * x
        second[np.ix_(use, use)] += w * _robustify_information(part, S, x)
        second += w * np.outer(x, x)
    return mean, second - np.outer(mean, mean)


def compute_log_likelihood(H: Array, h: Array, spread: Array) -> float:
    """Compute the log-likelihood of the readings up to a constant common to all models.

    Args:
        H: (P, P) normal matrix of the columns in prior units.
        h: (P,) right-hand side.
        spread: (P,) prior standard deviation of each column; 0 leaves it out.

    Returns:
        The log-likelihood.
    """
    use, P = select_possible_columns(H, spread)
    L = np.linalg.cholesky(P)
    half = np.linalg.solve(L, h[use])
    return -float(np.log(np.diag(L)).sum() + np.log(spread[use]).sum()) + 0.5 * float(half @ half)


def select_possible_columns(H: Array, spread: Array) -> tuple[NDArray[np.intp], Array]:
    """Select the columns whose prior standard deviation is not zero.

    Args:
        H: (P, P) normal matrix of the columns in prior units.
        spread: (P,) prior standard deviation of each column.

    Returns:
        Their indices (U,), and their precision (U, U) including the prior.
    """
    use = np.flatnonzero(spread > 0)
    return use, np.asarray(H[np.ix_(use, use)] + np.diag(spread[use] ** -2.0))


class _ColumnEquations:
    """Normal equations of some columns by pose, and their sum; most models that are averaged share their columns.

    Args:
        use: indices of the columns.
        equations: normal equations of all columns.
    """

    def __init__(self, use: NDArray[np.intp], equations: NormalEquations) -> None:
        self.use = use
        self.H, self.h = equations.H[:, use][:, :, use], equations.h[:, use]
        self.total = self.H.sum(axis=0)


def _robustify_information(part: _ColumnEquations, S: Array, x: Array) -> Array:
    """Return S with a cluster-robust data part where that is larger."""
    scores = part.h - part.H @ x[part.use]
    more = S @ (scores.T @ scores - part.total) @ S
    values, vectors = np.linalg.eigh(0.5 * (more + more.T))
    return np.asarray(S + (vectors * np.maximum(values, 0.0)) @ vectors.T)
