"""Newton's equations on the central path of :mod:`machopt.planning.continuous_refinement.quadratic_model`, compiled.

A term w·|v| is w·(p + m) with p − m = v and p, m ≥ 0; y, between −w and w, is the multiplier of the equation. The
worst index is t with t − index = r ≥ 0 at each station that counts, and shares π ≥ 0 of its price as multipliers. On
the central path p·(w − y) = m·(w + y) = r·π = μ, and μ goes to zero.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from machopt.numerics.array_types import Array, Bools
from machopt.numerics.compiled_functions import jit_compile

BOUNDARY = 0.995  # maximum share of the distance to a zero product that a step takes


@jit_compile
def compute_indices(z: Array, cost: Array, slope: Array, bend: Array) -> Array:
    """Return the (n,) index at given offsets, from its quadratic model.

    Args:
        z: (n, d) offsets.
        cost: (n,) index at z = 0.
        slope: (n, d) gradient of the index.
        bend: (n, d, d) Hessian of the index.
    """
    n, d = z.shape
    out = cost.copy()
    for s in range(n):
        for a in range(d):
            for b in range(d):
                out[s] += 0.5 * bend[s, a, b] * z[s, b] * z[s, a]
            out[s] += slope[s, a] * z[s, a]
    return out


@jit_compile
def compute_absolute_arguments(z: Array, row: NDArray[np.int64], lean: Array, at: Array) -> Array:
    """Return the (J,) arguments of the absolute values.

    Args:
        z: (n, d) offsets.
        row: (J,) station of each absolute value.
        lean: (J, 2d) derivative with respect to the offsets at that station and the next.
        at: (J,) value at z = 0.
    """
    n, d = z.shape
    out = at.copy()
    for j in range(len(row)):
        s = row[j]
        for a in range(d):
            out[j] += lean[j, a] * z[s, a]
            if s + 1 < n:
                out[j] += lean[j, d + a] * z[s + 1, a]
    return out


@jit_compile
def compute_newton_terms(
    z: Array,
    t: float,
    gradient: Array,
    hessian: Array,
    cost: Array,
    slope: Array,
    bend: Array,
    counted: Bools,
    worst: float,
    row: NDArray[np.int64],
    lean: Array,
    at: Array,
    p: Array,
    m: Array,
    above: Array,
    below: Array,
    r: Array,
    share: Array,
    mu: float,
) -> tuple[Array, Array, Array, Array, Array, Array, Array, Array]:
    """Return gradient and Hessian of Newton's equations in the offsets, with all other unknowns eliminated.

    Args:
        z: (n, d) offsets.
        t: worst index.
        gradient: (n, d) as in :class:`machopt.planning.continuous_refinement.quadratic_model.LocalModel`.
        hessian: (n, d, d) as there.
        cost: (n,) as there.
        slope: (n, d) as there.
        bend: (n, d, d) as there.
        counted: (n,) as there.
        worst: price of the worst index, as there.
        row: (J,) station of each absolute value.
        lean: (J, 2d) derivative of its argument with respect to the offsets at that station and the next.
        at: (J,) its argument at z = 0.
        p: (J,) positive part of the argument.
        m: (J,) negative part of the argument.
        above: (J,) w − y.
        below: (J,) w + y.
        r: (n,) slack of the worst index, at stations that count.
        share: (n,) multiplier of the worst index, at stations that count.
        mu: target of the products.

    Returns:
        Gradient (n, d), Hessian blocks (n, d, d), those below (n − 1, d, d) and the vector of the dyad (n, d); then
        the inputs of :func:`take_newton_step`: curvature (J,) and offset (J,) of the multipliers, slope of the index
        (n, d)
        and the residual of the worst index (n,).
    """
    n, d = z.shape
    first, own = np.empty((n, d)), hessian.copy()
    on, dyad = np.zeros((n - 1, d, d)), np.zeros((n, d))
    index, v = compute_indices(z, cost, slope, bend), compute_absolute_arguments(z, row, lean, at)
    index_slope, residual = np.empty((n, d)), t - index - r
    curvature, multiplier_offset = np.empty(len(row)), np.empty(len(row))
    total, missed = 0.0, -worst
    for s in range(n):
        for a in range(d):
            index_slope[s, a], first[s, a] = slope[s, a], gradient[s, a]
            for b in range(d):
                index_slope[s, a] += bend[s, a, b] * z[s, b]
                first[s, a] += hessian[s, a, b] * z[s, b]
        if counted[s]:
            curved = share[s] / r[s]
            total += curved
            missed += mu / r[s] - curved * residual[s]
    for s in range(n):
        if counted[s]:
            curved = share[s] / r[s]
            pull = mu / r[s] - curved * residual[s] - missed / total * curved
            for a in range(d):
                first[s, a] += pull * index_slope[s, a]
                dyad[s, a] = curved * index_slope[s, a] / np.sqrt(total)
                for b in range(d):
                    own[s, a, b] += share[s] * bend[s, a, b] + curved * index_slope[s, a] * index_slope[s, b]
    for j in range(len(row)):
        s = row[j]
        curved = 1.0 / (p[j] / above[j] + m[j] / below[j])
        curvature[j], multiplier_offset[j] = curved, curved * (v[j] - mu / above[j] + mu / below[j])
        pull = 0.5 * (below[j] - above[j]) + multiplier_offset[j]
        for a in range(d):
            first[s, a] += pull * lean[j, a]
            for b in range(d):
                own[s, a, b] += curved * lean[j, a] * lean[j, b]
            if s + 1 < n:
                first[s + 1, a] += pull * lean[j, d + a]
                for b in range(d):
                    own[s + 1, a, b] += curved * lean[j, d + a] * lean[j, d + b]
                    on[s, a, b] += curved * lean[j, d + a] * lean[j, b]
    return first, own, on, dyad, curvature, multiplier_offset, index_slope, residual


@jit_compile
def _find_term_steps(
    ahead: Array,
    mu: float,
    curvature: Array,
    multiplier_offset: Array,
    p: Array,
    m: Array,
    above: Array,
    below: Array,
    most: float,
) -> tuple[Array, Array, Array, float]:
    """Return the full steps of the parts and multipliers of the absolute values, (J,) each, and the share permitted.

    ``ahead`` (J,) is the change of the arguments, ``most`` the share that other unknowns permit.
    """
    dp, dm, dy = np.empty(len(p)), np.empty(len(p)), np.empty(len(p))
    for j in range(len(p)):
        dy[j] = curvature[j] * ahead[j] + multiplier_offset[j]
        dp[j] = (mu + p[j] * dy[j]) / above[j] - p[j]
        dm[j] = (mu - m[j] * dy[j]) / below[j] - m[j]
        if dp[j] < 0.0:
            most = min(most, -p[j] / dp[j])
        if dm[j] < 0.0:
            most = min(most, -m[j] / dm[j])
        if dy[j] > 0.0:
            most = min(most, above[j] / dy[j])
        elif dy[j] < 0.0:
            most = min(most, -below[j] / dy[j])
    return dp, dm, dy, most


@jit_compile
def _find_worst_index_steps(
    step: Array,
    mu: float,
    worst: float,
    counted: Bools,
    index_slope: Array,
    residual: Array,
    r: Array,
    share: Array,
    most: float,
) -> tuple[Array, Array, float, float]:
    """Return the full steps of slack (n,), multiplier (n,) and worst index, and the share permitted."""
    n, d = step.shape
    dr, dshare = np.zeros(n), np.zeros(n)
    total, missed = 0.0, -worst
    for s in range(n):
        if counted[s]:
            curved, across = share[s] / r[s], 0.0
            for a in range(d):
                across += index_slope[s, a] * step[s, a]
            dr[s] = residual[s] - across
            total += curved
            missed += mu / r[s] - curved * dr[s]
    dt = missed / total if total > 0.0 else 0.0
    for s in range(n):
        if counted[s]:
            dr[s] += dt
            dshare[s] = (mu - share[s] * dr[s]) / r[s] - share[s]
            if dr[s] < 0.0:
                most = min(most, -r[s] / dr[s])
            if dshare[s] < 0.0:
                most = min(most, -share[s] / dshare[s])
    return dr, dshare, dt, most


@jit_compile
def take_newton_step(
    step: Array,
    t: float,
    mu: float,
    worst: float,
    counted: Bools,
    row: NDArray[np.int64],
    lean: Array,
    curvature: Array,
    multiplier_offset: Array,
    index_slope: Array,
    residual: Array,
    r: Array,
    share: Array,
    p: Array,
    m: Array,
    above: Array,
    below: Array,
) -> tuple[float, float]:
    """Take a Newton step of the offsets and of all eliminated unknowns, as far as the bounds permit.

    Arrays from ``r`` on change, except for those documented as read only there.

    Args:
        step: (n, d) full step of the offsets.
        t: worst index.
        mu: target of the products.
        worst: price of the worst index.
        counted: (n,) stations that count for the worst index.
        row: (J,) station of each absolute value.
        lean: (J, 2d) derivative of its argument.
        curvature: (J,) curvature of the multipliers, from :func:`compute_newton_terms`.
        multiplier_offset: (J,) offset of the multipliers, from there.
        index_slope: (n, d) slope of the index, from there.
        residual: (n,) residual of the worst index, from there.
        r: (n,) slack of the worst index; changed.
        share: (n,) its multiplier; changed.
        p: (J,) positive part; changed.
        m: (J,) negative part; changed.
        above: (J,) w − y; changed.
        below: (J,) w + y; changed.

    Returns:
        Share of the step that was taken, and the worst index t.
    """
    ahead = compute_absolute_arguments(step, row, lean, np.zeros(len(row)))
    most = 1.0 / BOUNDARY
    dp, dm, dy, most = _find_term_steps(ahead, mu, curvature, multiplier_offset, p, m, above, below, most)
    dr, dshare, dt, most = _find_worst_index_steps(step, mu, worst, counted, index_slope, residual, r, share, most)
    taken = min(1.0, BOUNDARY * most)
    for j in range(len(row)):
        p[j] += taken * dp[j]
        m[j] += taken * dm[j]
        above[j] -= taken * dy[j]
        below[j] += taken * dy[j]
    for s in range(len(r)):
        if counted[s]:
            r[s] += taken * dr[s]
            share[s] += taken * dshare[s]
    return taken, t + taken * dt
