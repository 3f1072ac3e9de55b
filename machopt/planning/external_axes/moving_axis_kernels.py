"""Compiled search of :mod:`machopt.planning.external_axes.moving_axis_search` over values, rotations and branches.

This file imports no planner: it is compiled while a wheel is built, where only NumPy and numba are installed.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from machopt.numerics.array_types import Array, Bools
from machopt.numerics.compiled_functions import jit_compile
from machopt.planning.cost.objective import edge_price_compiled, late_compiled


@jit_compile
def _measure_external_step(e: Array, before: Array, weight: Array, slowness: Array) -> tuple[float, float]:
    """Return the weighted travel of external joints (E,) in equivalent rad, and the time in s of the slowest."""
    way, slow = 0.0, 0.0
    for c in range(len(e)):
        d = abs(e[c] - before[c])
        way += weight[c] * d
        slow = max(slow, d * slowness[6 + c])
    return way, slow


@jit_compile
def _measure_step(
    q: Array, before: Array, winds: Bools, slowness: Array, way: float, slow: float
) -> tuple[float, float, float]:
    """Return travel in rad, time in s and largest joint step in rad of a step of the arm (6,).

    Travel ``way`` and time ``slow`` of the external joints are included. An unreachable place adds nothing: it has its
    own price.
    """
    length, late, largest_step = way, slow, 0.0
    for c in range(6):
        d = q[c] - before[c]
        if winds[c]:
            d -= 2.0 * np.pi * np.round(d / (2.0 * np.pi))
        d = abs(d)
        length += d
        late = max(late, d * slowness[c])
        largest_step = max(largest_step, d)
    if np.isnan(length):
        return way, slow, 0.0
    return length, late, largest_step


@jit_compile
def _price_step(
    arm_step: tuple[float, float, float],
    turned: float,
    seconds: float,
    prices: tuple[float, float, float],
    most: float,
    lost: float,
) -> float:
    """Return the price of a step: travel, time and largest joint step of the arm, and its turn about the tool axis."""
    length, late, largest_step = arm_step
    price = edge_price_compiled(length, turned, late_compiled(late, seconds), prices[0], prices[1], prices[2])
    return price + (lost if largest_step > most else 0.0)  # type: ignore[no-any-return]  # numba has no types


@jit_compile
def compute_transition_costs(
    q: Array,
    e: Array,
    near: NDArray[np.int64],
    R: int,
    B: int,
    joined: Bools,
    is_plunge: Bools,
    winds: Bools,
    seconds: Array,
    slowness: Array,
    weight: Array,
    travel: Array,
    rotation: Array,
    feed: Array,
    most: float,
    lost: float,
) -> NDArray[np.float32]:
    """Return the (S, K·3, V) price of the step into each vertex from the neighbours of its value and rotation.

    Args:
        q: (S, V, 6) rad, NaN where there is no pose; vertex (g·R + r)·B + b.
        e: (S, G, E) external joints, lengths scaled to equivalent rad.
        near: (G, K) indices of neighbouring values, −1 outside the grid.
        R: number of rotations.
        B: number of branches.
        joined: (S,) the step into the station is inside a run.
        is_plunge: (S,) value and rotation are kept into it: the tool drills or plunges.
        winds: (6,) joints whose whole turns are not counted: they may pass from one end of ``q`` to the other.
        seconds: (S,) s, time of the step at the programmed feed.
        slowness: (6 + E,) s/rad, inverse of the usable speed of each axis.
        weight: (E,) factor of the travel of each external joint.
        travel: (S,) price per rad of the axes.
        rotation: (S,) price per rad about the tool axis.
        feed: (S,) price per s of lost time.
        most: rad, a larger joint step means another branch.
        lost: price of such a step.
    """
    S, V, K = q.shape[0], q.shape[1], near.shape[1]
    turn = 2.0 * np.pi / R
    out = np.zeros((S, K * 3, V), np.float32)
    for s in range(1, S):
        if not joined[s]:
            continue
        prices = travel[s], rotation[s], feed[s]
        for v in range(V):
            b, r, g = v % B, (v // B) % R, v // (B * R)
            for k in range(K):
                h = near[g, k]
                way, slow = 0.0, 0.0
                if h >= 0:
                    way, slow = _measure_external_step(e[s, g], e[s - 1, h], weight, slowness)
                for dr in range(-1, 2):
                    if h < 0 or (is_plunge[s] and (k > 0 or dr != 0)):
                        out[s, 3 * k + dr + 1, v] = np.inf
                        continue
                    u = (h * R + (r + dr) % R) * B + b
                    arm_step = _measure_step(q[s, v], q[s - 1, u], winds, slowness, way, slow)
                    out[s, 3 * k + dr + 1, v] = _price_step(arm_step, turn * abs(dr), seconds[s], prices, most, lost)
    return out


@jit_compile
def _fly_to_values(
    before: Array, e_from: Array, e_to: Array, flown: float, node: Array, here: Array, back: NDArray[np.int64]
) -> None:
    """Fill ``here`` and ``back`` (V,) with price and predecessor of each vertex behind a rapid move.

    Args:
        before: (V,) price up to the station before.
        e_from: (G, E) external joints there in equivalent rad, times their weight.
        e_to: (G, E) external joints here.
        flown: price per equivalent rad.
        node: (V,) price of each vertex.
        here: (V,) filled.
        back: (V,) filled.
    """
    G = len(e_to)
    size = len(node) // G  # vertices of one value
    last = np.zeros(G, np.int64)
    for g in range(G):
        last[g] = g * size + np.argmin(before[g * size : (g + 1) * size])
    for g in range(G):
        least, which = np.inf, -1
        for h in range(G):
            way = 0.0
            for c in range(e_to.shape[1]):
                way += abs(e_to[g, c] - e_from[h, c])
            price = before[last[h]] + flown * way
            if price < least:
                least, which = price, last[h]
        for v in range(g * size, (g + 1) * size):
            here[v], back[v] = least + node[v], which


@jit_compile
def find_cheapest_value_sequence(
    node: Array,
    edges: NDArray[np.float32],
    near: NDArray[np.int64],
    e: Array,
    R: int,
    B: int,
    joined: Bools,
    flown: Array,
) -> tuple[NDArray[np.int64], float]:
    """Return the vertices (S,) of the cheapest sequence and its price.

    Args:
        node: (S, V) price of each vertex.
        edges: (S, K·3, V) from :func:`compute_transition_costs`.
        near: (G, K) indices of neighbouring values, −1 outside the grid.
        e: (S, G, E) external joints in equivalent rad, times their weight.
        R: number of rotations.
        B: number of branches.
        joined: (S,) the step into the station is inside a run.
        flown: (S,) price per equivalent rad of the external joints over a rapid move.
    """
    S, V = node.shape
    K = near.shape[1]
    back = np.full((S, V), -1, np.int64)
    here, before = node[0].copy(), np.empty(V)
    for s in range(1, S):
        before[:] = here
        if not joined[s]:
            _fly_to_values(before, e[s - 1], e[s], flown[s], node[s], here, back[s])
            continue
        for v in range(V):
            b, r, g = v % B, (v // B) % R, v // (B * R)
            least, which = np.inf, -1
            for k in range(K):
                h = near[g, k]
                if h < 0:
                    continue
                for dr in range(-1, 2):
                    u = (h * R + (r + dr) % R) * B + b
                    price = before[u] + edges[s, 3 * k + dr + 1, v]
                    if price < least:
                        least, which = price, u
            here[v], back[s, v] = least + node[s, v], which
    vertex = np.zeros(S, np.int64)
    vertex[S - 1] = np.argmin(here)
    for s in range(S - 1, 0, -1):
        vertex[s - 1] = back[s, vertex[s]]
    return vertex, here[vertex[S - 1]]
