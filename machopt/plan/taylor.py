"""Three derivatives of unit vectors and frames along a curve, by truncated power series.

A jet is an array (M, 4, …) of a value and its derivatives 1…3; inside, series coefficients c_m = derivative / m!.
"""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]
FACTORIAL = np.array([1.0, 1.0, 2.0, 6.0])
STENCIL = 2e-4  # m, spacing of the samples that a callable rotation is differentiated from


def _times(a: Array, b: Array) -> Array:
    """Product of a series of scalars (M, 4) with one of vectors (M, 4, 3) or scalars."""
    a = a.reshape(a.shape + (1,) * (b.ndim - a.ndim))
    return np.stack([sum(a[:, k] * b[:, m - k] for k in range(m + 1)) for m in range(4)], axis=1)


def _dot(a: Array, b: Array) -> Array:
    return np.stack([sum(np.sum(a[:, k] * b[:, m - k], axis=-1) for k in range(m + 1)) for m in range(4)], axis=1)


def _cross(a: Array, b: Array) -> Array:
    return np.stack([sum(np.cross(a[:, k], b[:, m - k]) for k in range(m + 1)) for m in range(4)], axis=1)


def _unit(v: Array) -> Array:
    """Series of v / |v|."""
    s = _dot(v, v)
    r = np.empty_like(s)
    r[:, 0] = s[:, 0] ** -0.5
    for m in range(1, 4):
        r[:, m] = sum((-0.5 * k - (m - k)) * s[:, k] * r[:, m - k] for k in range(1, m + 1)) / (m * s[:, 0])
    return _times(r, v)


def _cos_sin(x: Array) -> tuple[Array, Array]:
    c, s = np.empty_like(x), np.empty_like(x)
    c[:, 0], s[:, 0] = np.cos(x[:, 0]), np.sin(x[:, 0])
    for m in range(1, 4):
        c[:, m] = -sum(k * x[:, k] * s[:, m - k] for k in range(1, m + 1)) / m
        s[:, m] = sum(k * x[:, k] * c[:, m - k] for k in range(1, m + 1)) / m
    return c, s


def frame_derivatives(axis: Array, reference: Array, spin: Array) -> Array:
    """Jets (M, 4, 3, 3) of the TCP rotation from jets of tool axis, reference (M, 4, 3), spin (M, 4)."""
    f = FACTORIAL[:, None]
    z = -_unit(axis / f)
    b = reference / f
    x0 = _unit(b - _times(_dot(b, z), z))
    c, s = _cos_sin(spin / FACTORIAL)
    x = _times(c, x0) + _times(s, _cross(z, x0))
    return np.asarray(np.stack([x, _cross(z, x), z], axis=-1) * FACTORIAL[:, None, None])


def twist_derivatives(position: Array, rotation: Array) -> Array:
    """Spatial twist (linear part at the origin, then angular) and its derivatives 1, 2: (M, 3, 6) from pose jets."""
    R, p = rotation, position

    def turn(i: int, j: int) -> Array:
        return np.asarray(0.5 * np.sum(np.cross(R[:, i], R[:, j], axis=1), axis=-1))

    w = np.stack([turn(0, 1), turn(0, 2), turn(1, 2) + turn(0, 3)], axis=1)
    v = np.empty_like(w)
    v[:, 0] = p[:, 1] - np.cross(w[:, 0], p[:, 0])
    v[:, 1] = p[:, 2] - np.cross(w[:, 1], p[:, 0]) - np.cross(w[:, 0], p[:, 1])
    v[:, 2] = p[:, 3] - np.cross(w[:, 2], p[:, 0]) - 2.0 * np.cross(w[:, 1], p[:, 1]) - np.cross(w[:, 0], p[:, 2])
    return np.concatenate([v, w], axis=-1)


def curve_derivatives(curve: Callable[[Array], Array], u: Array, low: float, high: float) -> Array:
    """Jets (M, 4) of a smooth callable inside [low, high], from five samples around each u."""
    d = min(STENCIL, (high - low) / 8.0)
    c = np.clip(u, low + 2 * d, high - 2 * d)
    y = np.asarray(curve((c[:, None] + d * np.arange(-2, 3)).ravel()), float).reshape(-1, 5)
    inverse = np.linalg.inv(np.vander(np.arange(-2.0, 3.0), 5, increasing=True))
    a = y @ inverse.T  # coefficients of the quartic in t = (u − c)/d
    t = (u - c) / d
    out = np.empty((len(u), 4))
    for m in range(4):
        k = np.arange(m, 5)
        fall = np.array([np.prod(np.arange(i - m + 1, i + 1)) for i in k])
        out[:, m] = (a[:, m:] * fall * t[:, None] ** (k - m)).sum(axis=1) / d**m
    out[:, 0] = np.asarray(curve(u), float)
    return out
