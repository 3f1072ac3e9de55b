"""Robust estimation against gross errors: outlier-resistant start values, and outlier weights."""

from __future__ import annotations

import numpy as np

from machopt.measurement import thresholds
from machopt.numerics.array_types import Array
from machopt.numerics.compiled_functions import jit_compile

START_STEPS = 25
NORMAL = 0.6745  # median of |x| for a standard normal x


def compute_robust_weights(residual: Array, sigma: Array) -> Array:
    """Compute the weight of each coordinate: 1 for normal errors (99.7 %), decreasing to 0 (redescending
    M-estimator).

    Below three sigma the weight is exactly 1, so that intervals need no correction for lost efficiency.

    Args:
        residual: Residuals of any shape.
        sigma: Standard deviations, broadcastable to the residuals.

    Returns:
        Weights in [0, 1].
    """
    full, none = thresholds.LEVELS.three_sigma, thresholds.LEVELS.outlier_sigma
    u = np.clip((np.abs(residual) / sigma - full) / (none - full), 0.0, 1.0)
    return np.asarray((1.0 - u**2) ** 2)


def estimate_robust_scale(residual: Array, fitted: int = 0) -> float:
    """Estimate the standard deviation of the bulk: median of |x| / 0.6745.

    Args:
        residual: Residuals of any shape.
        fitted: Number of smallest residuals to ignore, because least absolute deviations fit as many points
            exactly as there are unknowns.

    Returns:
        Standard deviation; NaN of no residuals, or where one is NaN.
    """
    size = np.abs(residual).reshape(-1)
    if not len(size):
        return float("nan")
    first = min(fitted, len(size) - 1)  # the smallest ones are left out
    low, high = first + (len(size) - first - 1) // 2, first + (len(size) - first) // 2
    size = np.partition(size, (low, high, -1))  # NaN comes last; np.median would take twice as long
    return float((size[low] + size[high]) / 2.0 / NORMAL) if not np.isnan(size[-1]) else float("nan")


@jit_compile
def sum_absolute_deviations(X: Array, z: Array, x: Array, least: float) -> tuple[Array, Array]:
    """Return the normal equations of the next least squares that approach least absolute deviations.

    Args:
        X: (M, P) columns.
        z: (M,) right-hand side.
        x: (P,) present coefficients.
        least: Smallest robust scale of the residuals, in the unit of z.

    Returns:
        XᵀWX (P, P) and XᵀWz (P,), W inverse to the absolute residuals, but limited near zero.
    """
    P = X.shape[1]
    r = np.abs(z - X @ x)
    floor = 1e-3 * max(np.median(r) / NORMAL, least)
    H, h = np.zeros((P, P)), np.zeros(P)
    for n in range(len(z)):
        w = 1.0 / max(r[n], floor)
        for i in range(P):
            along = w * X[n, i]
            h[i] += along * z[n]
            for j in range(i + 1):
                H[i, j] += along * X[n, j]
    for i in range(P):
        for j in range(i):
            H[j, i] = H[i, j]
    return H, h


@jit_compile
def _solve_definite(H: Array, h: Array) -> Array:
    """Return H⁻¹ h for a positive definite H (P, P), by elimination in place."""
    for k in range(len(h)):
        for i in range(k + 1, len(h)):
            share = H[i, k] / H[k, k]
            h[i] -= share * h[k]
            for j in range(k + 1, len(h)):
                H[i, j] -= share * H[k, j]
    for k in range(len(h) - 1, -1, -1):
        for j in range(k + 1, len(h)):
            h[k] -= H[k, j] * h[j]
        h[k] /= H[k, k]
    return h


@jit_compile
def _minimise_absolute_deviations(X: Array, z: Array) -> Array:
    """Return coefficients (P,) of columns (M, P) of size one, by repeated weighted least squares."""
    x, H, h = np.zeros(X.shape[1]), X.T @ X, X.T @ z
    for _ in range(START_STEPS):
        ridge = 1e-9 * np.trace(H) / len(x)
        if not ridge > 0.0:
            break
        for k in range(len(x)):
            H[k, k] += ridge
        new = _solve_definite(H, h)
        moved = np.abs(new - x).max()
        x = new
        if moved <= 1e-4 * np.abs(x).max():
            break
        H, h = sum_absolute_deviations(X, z, x, 1e-9)
    return x


def fit_least_absolute_deviations(A: Array, y: Array, load: Array) -> Array:
    """Fit coefficients by least absolute deviations, each reading divided by its load.

    Least absolute deviations resist a wrong displacement. A force recorded ten times too large would still dominate
    by its leverage; division by the load limits the influence of each reading.

    Args:
        A: (N, D, P) columns.
        y: (N, D) displacements; channels may have different units.
        load: (N,) magnitude of each load, any unit.

    Returns:
        (P,) coefficients; small numbers for unobserved ones.
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
    return np.asarray(_minimise_absolute_deviations(np.ascontiguousarray(X / column), np.ascontiguousarray(z)) / column)
