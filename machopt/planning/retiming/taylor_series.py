"""Three derivatives of unit vectors and frames along a curve, by truncated power series.

A jet is an array (M, 4, …) of a value and its derivatives 1…3; inside, series coefficients c_m = derivative / m!.
"""

from __future__ import annotations

from collections.abc import Callable

import numpy as np

from machopt.numerics.array_types import Array
from machopt.numerics.compiled_functions import jit_compile

FACTORIAL = np.array([1.0, 1.0, 2.0, 6.0])
STENCIL = 2e-4  # m, spacing of the samples that a callable rotation is differentiated from


def compute_frame_derivatives(axis: Array, reference: Array, spin: Array) -> Array:
    """Return jets (M, 4, 3, 3) of the TCP rotation.

    Args:
        axis: (M, 4, 3) jets of the tool axis.
        reference: (M, 4, 3) jets of the reference direction.
        spin: (M, 4) jets of the rotation about the axis, rad.
    """
    f = FACTORIAL[:, None]
    return np.asarray(_frames(axis / f, reference / f, spin / FACTORIAL) * FACTORIAL[:, None, None])


def compute_twist_derivatives(position: Array, rotation: Array) -> Array:
    """Return the spatial twist (linear part at the origin, then angular) and its derivatives 1, 2: (M, 3, 6).

    Args:
        position: (M, 4, 3) jets of the position.
        rotation: (M, 4, 3, 3) jets of the rotation.
    """
    return np.asarray(_twists(np.ascontiguousarray(position), np.ascontiguousarray(rotation)))


@jit_compile
def _times(a: Array, b: Array, out: Array) -> None:
    """Product of a series of scalars (4,) with one of vectors (4, 3)."""
    for m in range(4):
        for c in range(3):
            out[m, c] = 0.0
            for k in range(m + 1):
                out[m, c] += a[k] * b[m - k, c]


@jit_compile
def _dot(a: Array, b: Array, out: Array) -> None:
    for m in range(4):
        out[m] = 0.0
        for k in range(m + 1):
            out[m] += a[k, 0] * b[m - k, 0] + a[k, 1] * b[m - k, 1] + a[k, 2] * b[m - k, 2]


@jit_compile
def _cross(a: Array, b: Array, out: Array) -> None:
    for m in range(4):
        for c in range(3):
            i, j = (c + 1) % 3, (c + 2) % 3
            out[m, c] = 0.0
            for k in range(m + 1):
                out[m, c] += a[k, i] * b[m - k, j] - a[k, j] * b[m - k, i]


@jit_compile
def _unit(v: Array, s: Array, r: Array, out: Array) -> None:
    """Series of v / |v|; s and r (4,) are overwritten."""
    _dot(v, v, s)
    r[0] = 1.0 / np.sqrt(s[0]) if s[0] > 0.0 else np.nan
    for m in range(1, 4):
        r[m] = 0.0
        for k in range(1, m + 1):
            r[m] += (-0.5 * k - (m - k)) * s[k] * r[m - k]
        r[m] = r[m] / (m * s[0]) if s[0] > 0.0 else np.nan
    _times(r, v, out)


@jit_compile
def _cos_sin(x: Array, c: Array, s: Array) -> None:
    c[0], s[0] = np.cos(x[0]), np.sin(x[0])
    for m in range(1, 4):
        c[m] = s[m] = 0.0
        for k in range(1, m + 1):
            c[m] -= k * x[k] * s[m - k] / m
            s[m] += k * x[k] * c[m - k] / m


@jit_compile
def _frames(axis: Array, reference: Array, spin: Array) -> Array:
    """Series (M, 4, 3, 3) of the rotation from series of its inputs."""
    out = np.empty((len(axis), 4, 3, 3))
    v, flat = np.empty((6, 4, 3)), np.empty((4, 4))
    x, y, z, part, turned, carried = v[0], v[1], v[2], v[3], v[4], v[5]
    c, s, a, b = flat[0], flat[1], flat[2], flat[3]
    for n in range(len(axis)):
        _unit(axis[n], a, b, z)
        for m in range(4):
            for k in range(3):
                z[m, k] = -z[m, k]
        _dot(reference[n], z, a)
        _times(a, z, part)
        for m in range(4):
            for k in range(3):
                part[m, k] = reference[n, m, k] - part[m, k]
        _unit(part, a, b, y)  # reference orthogonal to the axis
        _cos_sin(spin[n], c, s)
        _cross(z, y, part)
        _times(c, y, turned)
        _times(s, part, carried)
        for m in range(4):
            for k in range(3):
                x[m, k] = turned[m, k] + carried[m, k]
        _cross(z, x, y)
        for m in range(4):
            for k in range(3):
                out[n, m, k, 0], out[n, m, k, 1], out[n, m, k, 2] = x[m, k], y[m, k], z[m, k]
    return out


@jit_compile
def _twists(p: Array, R: Array) -> Array:
    """w is half the sum of r0 × r1 over the columns of R, r0 … r3 being a column's derivatives; w' that of r0 × r2;
    w'' that of r1 × r2 + r0 × r3. The linear part is p' − w × p, and its derivatives."""
    out = np.empty((len(p), 3, 6))
    w = np.empty((3, 3))
    for n in range(len(p)):
        for c in range(3):
            i, j = (c + 1) % 3, (c + 2) % 3
            first = second = third = 0.0
            for k in range(3):
                a, b = R[n, 0, i, k], R[n, 0, j, k]
                first += a * R[n, 1, j, k] - b * R[n, 1, i, k]
                second += a * R[n, 2, j, k] - b * R[n, 2, i, k]
                third += R[n, 1, i, k] * R[n, 2, j, k] - R[n, 1, j, k] * R[n, 2, i, k]
                third += a * R[n, 3, j, k] - b * R[n, 3, i, k]
            w[0, c], w[1, c], w[2, c] = 0.5 * first, 0.5 * second, 0.5 * third
        for c in range(3):
            i, j = (c + 1) % 3, (c + 2) % 3
            for m in range(3):
                v = p[n, m + 1, c]
                for k in range(m + 1):
                    times = 2.0 if m == 2 and k == 1 else 1.0  # m over k: 1, 1 1, 1 2 1
                    v -= times * (w[m - k, i] * p[n, k, j] - w[m - k, j] * p[n, k, i])
                out[n, m, c], out[n, m, 3 + c] = v, w[m, c]
    return out


def compute_curve_derivatives(curve: Callable[[Array], Array], u: Array, low: float, high: float) -> Array:
    """Return jets (M, 4) of a smooth callable inside [low, high], from five samples around each u.

    Args:
        curve: function to differentiate.
        u: (M,) m, places.
        low: lower end of its domain.
        high: upper end of its domain.
    """
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
