"""Newton's equations on the central path of :mod:`machopt.planning.continuous_refinement.quadratic_model`, station by
station, compiled.

A price w·|v| is w·(p + m) with p − m = v and p, m ≥ 0; y, between −w and w, is the multiplier of the equation. The
worst index is t with t − index = r ≥ 0 at each station that counts, and shares π ≥ 0 of its price as multipliers. On
the central path p·(w − y) = m·(w + y) = r·π = μ, and μ goes to zero.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from machopt.numerics.array_types import Array, Bools
from machopt.numerics.compiled_functions import jit_compile

BOUNDARY = 0.995  # share of the way to where a product would be zero that a step takes at most


@jit_compile
def compute_indices(z: Array, cost: Array, slope: Array, bend: Array) -> Array:
    """(n,) the index at offsets z (n, d)."""
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
    """(J,) what the absolute values are of: ``at`` and ``lean`` (J, 2d) on the offsets at stations ``row`` and next."""
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
    """Gradient (n, d) and Hessian in the offsets: blocks (n, d, d), those below (n − 1, d, d), and the dyad's (n, d).

    Everything but the offsets is eliminated; what :func:`take_newton_step` needs for it follows: curvature and offset
    (J,) of the
    multipliers, slope of the index (n, d), and what the worst index misses (n,).

    Args:
        z: (n, d) offsets.
        t: the worst index.
        gradient, hessian, cost, slope, bend, counted, worst: as in
            :class:`machopt.planning.continuous_refinement.quadratic_model.LocalModel`.
        row, lean, at: (J,), (J, 2d), (J,) of the absolute values.
        p, m, above, below: (J,) each, the last two w − y and w + y; r, share: (n,) each, at stations that count.
        mu: what the products are to become.
    """
    n, d = z.shape
    first, own = np.empty((n, d)), hessian.copy()
    on, dyad = np.zeros((n - 1, d, d)), np.zeros((n, d))
    index, v = compute_indices(z, cost, slope, bend), compute_absolute_arguments(z, row, lean, at)
    steep, short = np.empty((n, d)), t - index - r
    bent, pushed = np.empty(len(row)), np.empty(len(row))
    total, missed = 0.0, -worst
    for s in range(n):
        for a in range(d):
            steep[s, a], first[s, a] = slope[s, a], gradient[s, a]
            for b in range(d):
                steep[s, a] += bend[s, a, b] * z[s, b]
                first[s, a] += hessian[s, a, b] * z[s, b]
        if counted[s]:
            curved = share[s] / r[s]
            total += curved
            missed += mu / r[s] - curved * short[s]
    for s in range(n):
        if counted[s]:
            curved = share[s] / r[s]
            pull = mu / r[s] - curved * short[s] - missed / total * curved
            for a in range(d):
                first[s, a] += pull * steep[s, a]
                dyad[s, a] = curved * steep[s, a] / np.sqrt(total)
                for b in range(d):
                    own[s, a, b] += share[s] * bend[s, a, b] + curved * steep[s, a] * steep[s, b]
    for j in range(len(row)):
        s = row[j]
        curved = 1.0 / (p[j] / above[j] + m[j] / below[j])
        bent[j], pushed[j] = curved, curved * (v[j] - mu / above[j] + mu / below[j])
        pull = 0.5 * (below[j] - above[j]) + pushed[j]
        for a in range(d):
            first[s, a] += pull * lean[j, a]
            for b in range(d):
                own[s, a, b] += curved * lean[j, a] * lean[j, b]
            if s + 1 < n:
                first[s + 1, a] += pull * lean[j, d + a]
                for b in range(d):
                    own[s + 1, a, b] += curved * lean[j, d + a] * lean[j, d + b]
                    on[s, a, b] += curved * lean[j, d + a] * lean[j, b]
    return first, own, on, dyad, bent, pushed, steep, short


@jit_compile
def take_newton_step(
    step: Array,
    t: float,
    mu: float,
    worst: float,
    counted: Bools,
    row: NDArray[np.int64],
    lean: Array,
    bent: Array,
    pushed: Array,
    steep: Array,
    short: Array,
    r: Array,
    share: Array,
    p: Array,
    m: Array,
    above: Array,
    below: Array,
) -> tuple[float, float]:
    """Take a step (n, d) of the offsets with all that was eliminated, as far as it may; arrays from ``r`` on change.

    Args:
        bent, pushed, steep, short: as :func:`compute_newton_terms` gives them; the others as there.

    Returns:
        how much of it was taken, and the worst index t.
    """
    n, d = step.shape
    ahead = compute_absolute_arguments(step, row, lean, np.zeros(len(row)))
    dp, dm, dy = np.empty(len(row)), np.empty(len(row)), np.empty(len(row))
    dr, dshare = np.zeros(n), np.zeros(n)
    most = 1.0 / BOUNDARY
    for j in range(len(row)):
        dy[j] = bent[j] * ahead[j] + pushed[j]
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
    total, missed = 0.0, -worst
    for s in range(n):
        if counted[s]:
            curved, across = share[s] / r[s], 0.0
            for a in range(d):
                across += steep[s, a] * step[s, a]
            dr[s] = short[s] - across
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
    taken = min(1.0, BOUNDARY * most)
    for j in range(len(row)):
        p[j] += taken * dp[j]
        m[j] += taken * dm[j]
        above[j] -= taken * dy[j]
        below[j] += taken * dy[j]
    for s in range(n):
        if counted[s]:
            r[s] += taken * dr[s]
            share[s] += taken * dshare[s]
    return taken, t + taken * dt
