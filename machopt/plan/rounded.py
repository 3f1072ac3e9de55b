"""The rounded model of :mod:`machopt.plan.jointly` and its derivatives, station by station, compiled."""

from __future__ import annotations

import numpy as np

from machopt.arrays import Array, Bools
from machopt.compiled import compiled


@compiled
def valued(
    z: Array,
    gradient: Array,
    hessian: Array,
    cost: Array,
    slope: Array,
    bend: Array,
    counted: Bools,
    worst: float,
    jump: Array,
    lean: Array,
    price: Array,
    lost: Array,
    seconds: Array,
    slowness: Array,
    low: Array,
    high: Array,
    room: Array,
    under: Array,
    over: Array,
    width: float,
    stiff: float,
    narrow: float,
) -> tuple[float, Array, Array, Array, Array, Array, Array, Array]:
    """The model at offsets z (n, d): its value, and what its derivatives are made of.

    Args:
        gradient, hessian, cost, slope, bend, counted, worst: as in :class:`machopt.plan.jointly.Local`.
        jump, lean, price, lost, seconds, slowness: as in :class:`machopt.plan.jointly.Steps`.
        low, high, room, under, over: as in :class:`machopt.plan.jointly.Bounds`, where ``room`` is ``lean``.
        width: ε, rad, and c₀ for the worst index.
        stiff: price per rad² beyond the bounds.
        narrow: s/rad, what ε is times it for seconds lost.

    Returns:
        the value, and slope of the index (n, d), of the smooth terms (n, d), of the steps' prices and their parabolas'
        curvature (n − 1, k), shares of the worst index (n,), what is beyond the bounds (n, d) and (n, m).
    """
    n, d = z.shape
    k, m = lean.shape[1], room.shape[1]
    steep, down, index = np.empty((n, d)), np.empty((n, d)), np.empty(n)
    pull, curved, p = np.empty((n - 1, k)), np.empty((n - 1, k)), np.zeros(n)
    out, beyond = np.empty((n, d)), np.empty((n, m))
    value, top = 0.0, -np.inf
    for s in range(n):
        here = cost[s]
        for a in range(d):
            Bz, Hz = 0.0, 0.0
            for b in range(d):
                Bz += bend[s, a, b] * z[s, b]
                Hz += hessian[s, a, b] * z[s, b]
            here += (slope[s, a] + 0.5 * Bz) * z[s, a]
            value += (gradient[s, a] + 0.5 * Hz) * z[s, a]
            steep[s, a], down[s, a] = slope[s, a] + Bz, gradient[s, a] + Hz
            off = min(z[s, a] - low[s, a], 0.0) + max(z[s, a] - high[s, a], 0.0)
            out[s, a] = off
            value += stiff * off * off
        index[s] = here
        if counted[s]:
            top = max(top, here)
        for a in range(m):
            y = 0.0
            for b in range(d):
                y += room[s, a, b] * z[s, b]
            off = min(y - under[s, a], 0.0) + max(y - over[s, a], 0.0)
            beyond[s, a] = off
            value += stiff * off * off
    if top > -np.inf:
        total = 0.0
        for s in range(n):
            if counted[s]:
                p[s] = np.exp((index[s] - top) / width)
                total += p[s]
        p /= total
        value += worst * (top + width * np.log(total))
    for s in range(n - 1):
        for a in range(k):
            v = jump[s, a]
            for b in range(d):
                v += lean[s + 1, a, b] * z[s + 1, b] - lean[s, a, b] * z[s, b]
            far = np.sqrt(v * v + width * width)
            late = far * slowness[a] - seconds[s]
            root = np.sqrt(late * late + (width * narrow) ** 2)
            value += price[s, a] * far + 0.5 * lost[s] * (late + root)
            rise = price[s, a] + 0.5 * lost[s] * slowness[a] * (1.0 + late / root)
            pull[s, a], curved[s, a] = rise * v / far, rise / far
    return value, steep, down, pull, curved, p, out, beyond


@compiled
def derived(
    slope: Array,
    gradient: Array,
    pull: Array,
    curved: Array,
    p: Array,
    out: Array,
    beyond: Array,
    hessian: Array,
    bend: Array,
    worst: float,
    lean: Array,
    room: Array,
    width: float,
    stiff: float,
) -> tuple[Array, Array, Array, Array]:
    """Gradient (n, d) and Hessian in the offsets: blocks (n, d, d), those below (n − 1, d, d), and the dyad's (n, d).

    Args:
        slope … beyond: what :func:`valued` gives.
    """
    n, d = slope.shape
    k, m = lean.shape[1], room.shape[1]
    first, own = gradient.copy(), hessian.copy()
    on, dyad = np.zeros((n - 1, d, d)), np.empty((n, d))
    root = np.sqrt(worst / width)
    for s in range(n):
        share = worst * p[s]
        for a in range(d):
            first[s, a] += share * slope[s, a] + 2.0 * stiff * out[s, a]
            dyad[s, a] = root * p[s] * slope[s, a]
            for b in range(d):
                own[s, a, b] += share * (bend[s, a, b] + slope[s, a] * slope[s, b] / width)
            if out[s, a] != 0.0:
                own[s, a, a] += 2.0 * stiff
        for c in range(m):
            if beyond[s, c] != 0.0:
                for a in range(d):
                    first[s, a] += 2.0 * stiff * room[s, c, a] * beyond[s, c]
                    for b in range(d):
                        own[s, a, b] += 2.0 * stiff * room[s, c, a] * room[s, c, b]
    for s in range(n - 1):
        for c in range(k):
            pulled, much = pull[s, c], curved[s, c]
            for a in range(d):
                after, before = lean[s + 1, c, a], lean[s, c, a]
                first[s + 1, a] += after * pulled
                first[s, a] -= before * pulled
                for b in range(d):
                    own[s + 1, a, b] += much * after * lean[s + 1, c, b]
                    own[s, a, b] += much * before * lean[s, c, b]
                    on[s, a, b] -= much * after * lean[s, c, b]
    return first, own, on, dyad
