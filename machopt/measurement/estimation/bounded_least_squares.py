"""Minimum of a quadratic with lower bounds, and the profile of a single coefficient."""

from __future__ import annotations

import numpy as np
from scipy.optimize import nnls

from machopt.numerics.array_types import Array

RANK = 1e-11  # relative eigenvalue below which a direction has no data
ZERO_DIAGONAL = 1e-40  # relative diagonal element that counts as zero
BISECTIONS = 50


def minimise_bounded_quadratic(H: Array, h: Array, lower: Array) -> Array:
    """Minimise ½ xᵀ H x − hᵀ x subject to x ≥ lower.

    Coefficients without a bound are eliminated. The rest is a non-negative least-squares problem (Lawson & Hanson).

    Args:
        H: (P, P) symmetric positive semidefinite matrix. A direction without data stays at its bound or 0.
        h: (P,) linear term.
        lower: (P,) lower bounds, −inf for unbounded coefficients.

    Returns:
        (P,) minimiser.
    """
    if not len(h):  # no further coefficients
        return np.zeros(0)
    diagonal = np.diag(H)
    unit = 1.0 / np.sqrt(np.where(diagonal > ZERO_DIAGONAL * diagonal.max(), diagonal, 1.0))
    return np.asarray(unit * _minimise_bounded_part(H * np.outer(unit, unit), h * unit, lower / unit))


def _minimise_bounded_part(H: Array, h: Array, lower: Array) -> Array:
    bounded = np.isfinite(lower)
    free = ~bounded
    x = np.zeros(len(h))
    if not bounded.any():
        return _solve_least_norm(H, h)
    low, Hbb, hb = lower, H, h
    if free.any():
        low, Hff, Hfb = lower[bounded], H[np.ix_(free, free)], H[np.ix_(free, bounded)]
        gain = _solve_least_norm(Hff, np.column_stack([Hfb, h[free]]))
        Hbb, hb = H[np.ix_(bounded, bounded)] - Hfb.T @ gain[:, :-1], h[bounded] - Hfb.T @ gain[:, -1]
    values, vectors = np.linalg.eigh((Hbb + Hbb.T) / 2)
    seen = values > RANK * max(values[-1], 0.0)
    if seen.any():
        root = np.sqrt(values[seen])
        x[bounded] = low + nnls(root[:, None] * vectors[:, seen].T, vectors[:, seen].T @ (hb - Hbb @ low) / root)[0]
    else:
        x[bounded] = low
    if free.any():
        x[free] = _solve_least_norm(Hff, h[free] - Hfb @ x[bounded])
    return x


def compute_profile_bound(H: Array, h: Array, lower: Array, j: int, rise: float, sign: int) -> float:
    """Compute how far a coefficient can move before the profiled quadratic xᵀ H x − 2 hᵀ x rises by ``rise``.

    Args:
        H: (P, P) symmetric positive semidefinite matrix.
        h: (P,) linear term.
        lower: (P,) lower bounds.
        j: Index of the coefficient.
        rise: (t · sigma)² in units of the quadratic.
        sign: +1 upwards, −1 downwards.

    Returns:
        Value of the coefficient; ±inf if nothing limits it, ``lower`` if the bound does.
    """
    best = minimise_bounded_quadratic(H, h, lower)
    least = _compute_quadratic(H, h, best)
    others = np.arange(len(h)) != j

    def too_far(value: float) -> bool:
        x = np.zeros(len(h))
        x[j] = value
        x[others] = minimise_bounded_quadratic(
            H[np.ix_(others, others)], h[others] - H[others, j] * value, lower[others]
        )
        return bool(_compute_quadratic(H, h, x) - least > rise)

    if sign < 0 and np.isfinite(lower[j]) and not too_far(float(lower[j])):
        return float(lower[j])
    step = max(np.sqrt(rise / H[j, j]) if H[j, j] > 0 else np.inf, 1e-9 * abs(best[j]))
    if not np.isfinite(step):
        return sign * np.inf
    near, far = float(best[j]), float(best[j]) + sign * step
    for _ in range(40):
        if too_far(far):
            break
        near, far = far, far + 2.0 * (far - near)
    else:
        return sign * np.inf
    if sign < 0:
        far = max(far, float(lower[j]))
    for _ in range(BISECTIONS):
        middle = 0.5 * (near + far)
        near, far = (near, middle) if too_far(middle) else (middle, far)
        if abs(far - near) <= 1e-6 * abs(far - best[j]):
            break
    return float(0.5 * (near + far))


def _compute_quadratic(H: Array, h: Array, x: Array) -> float:
    return float(x @ H @ x - 2.0 * h @ x)


def _solve_least_norm(H: Array, h: Array) -> Array:
    """Least-norm solution of H x = h for a positive semidefinite H."""
    values, vectors = np.linalg.eigh(H)
    seen = values > RANK * max(values[-1], 0.0)
    inverse = np.zeros_like(values)
    inverse[seen] = 1.0 / values[seen]
    return np.asarray((vectors * inverse) @ (vectors.T @ h))
