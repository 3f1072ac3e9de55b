"""Against slipped decimals: a start that gross outliers cannot move, and weights that put them aside."""

from __future__ import annotations

import numpy as np

from machopt.measurement.estimation import thresholds
from machopt.numerics.array_types import Array

START_STEPS = 25
NORMAL = 0.6745  # median of |x| for a standard normal x


def compute_robust_weights(residual: Array, sigma: Array) -> Array:
    """Weight in [0, 1] of each coordinate: 1 for normal errors (99.7 %), falling to 0 (a redescending M-estimator).

    Below three sigma nothing changes, so that intervals need no correction for lost efficiency.
    """
    full, none = thresholds.ESTIMATED.full, thresholds.ESTIMATED.none
    u = np.clip((np.abs(residual) / sigma - full) / (none - full), 0.0, 1.0)
    return np.asarray((1.0 - u**2) ** 2)


def estimate_robust_scale(residual: Array, fitted: int = 0) -> float:
    """Standard deviation of the bulk: median of |x| / 0.6745.

    Args:
        residual: any shape.
        fitted: so many of the smallest do not count: least absolute deviations put the fit through as many points as
            there are unknowns.
    """
    size = np.sort(np.abs(residual), axis=None)
    return float(np.median(size[min(fitted, len(size) - 1) :]) / NORMAL)


def fit_least_absolute_deviations(A: Array, y: Array, load: Array) -> Array:
    """Coefficients by least absolute deviations, each reading divided by its load.

    Least absolute deviations alone withstand a wrong displacement, but a force recorded ten times too large would
    pull the fit by its leverage; divided by the load, no reading has more than its share.

    Args:
        A: (N, D, P), y: (N, D); channels of unlike units.
        load: (N,) size of each reading's load, any unit.

    Returns:
        (P,); where the readings say nothing, small numbers.
    """
    D, P = A.shape[1:]
    typical = np.median(load[load > 0]) if (load > 0).any() else 1.0
    size = np.array(
        [
            max(estimate_robust_scale(y[:, c : c + 3]), np.abs(y[:, c : c + 3]).max() * 1e-6, 1e-300)
            for c in range(0, D, 3)
        ]
    )
    row = 1.0 / (np.maximum(load, typical)[:, None] / typical * np.repeat(size, 3))
    X, z = (A * row[:, :, None]).reshape(-1, P), (y * row).reshape(-1)
    column = np.sqrt(np.mean(X**2, axis=0))
    column = np.where(column > 0, column, 1.0)
    X = X / column
    w = np.ones(len(z))
    x = np.zeros(P)
    for _ in range(START_STEPS):
        H = (X * w[:, None]).T @ X
        new = np.linalg.solve(H + 1e-9 * np.trace(H) / P * np.eye(P), X.T @ (w * z))
        moved = np.abs(new - x).max()
        x = new
        r = np.abs(z - X @ x)
        w = 1.0 / np.maximum(r, 1e-3 * max(estimate_robust_scale(r), 1e-9))
        if moved <= 1e-4 * np.abs(x).max():
            break
    return np.asarray(x / column)
