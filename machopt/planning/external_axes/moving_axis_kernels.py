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
def _measure_step(
    q: Array, v: int, before: Array, u: int, winds: Bools, slowness: Array, slow: float
) -> tuple[float, float, float]:
    """Return travel in rad, time in s and largest joint step in rad of a step of the arm from row u to row v.

    The time ``slow`` of the external joints is included. An unreachable place adds nothing: it has its own price.
    """
    length, late, largest_step = 0.0, slow, 0.0
    if np.isnan(q[v, 0]) or np.isnan(before[u, 0]):
        return length, late, largest_step
    for c in range(6):
        d = abs(q[v, c] - before[u, c])
        if winds[c] and d > np.pi:
            d = abs(d - 2.0 * np.pi * np.round(d / (2.0 * np.pi)))
        length += d
        late = max(late, d * slowness[c])
        largest_step = max(largest_step, d)
    return length, late, largest_step


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
    travel: Array,
    rotation: Array,
    feed: Array,
    most: float,
    lost: float,
) -> NDArray[np.float32]:
    """Return the (S, K·3, V) price of the step into each vertex from the neighbours of its value and rotation.

    The travel of the external joints is left out: it is added with its weight
    (:func:`find_cheapest_value_sequence`). Their time is included.

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
        here, before = q[s], q[s - 1]
        for g in range(V // (R * B)):
            for k in range(K):
                h = near[g, k]
                slow = 0.0
                if h >= 0:
                    for c in range(e.shape[2]):
                        slow = max(slow, abs(e[s, g, c] - e[s - 1, h, c]) * slowness[6 + c])
                for dr in range(-1, 2):
                    row = out[s, 3 * k + dr + 1]
                    if h < 0 or (is_plunge[s] and (k > 0 or dr != 0)):
                        row[g * R * B : (g + 1) * R * B] = np.inf
                        continue
                    for r in range(R):
                        for b in range(B):
                            v, u = (g * R + r) * B + b, (h * R + (r + dr) % R) * B + b
                            length, late, largest_step = _measure_step(here, v, before, u, winds, slowness, slow)
                            late = late_compiled(late, seconds[s])
                            price = edge_price_compiled(length, turn * abs(dr), late, travel[s], rotation[s], feed[s])
                            row[v] = price + (lost if largest_step > most else 0.0)
    return out


@jit_compile
def _take_cheaper(
    before: Array, edges: NDArray[np.float32], more: float, first: int, here: Array, back: NDArray[np.int64]
) -> None:
    """Take a step into each of n vertices from a vertex of its own where that is cheaper than the steps before.

    Args:
        before: (n,) price up to the sources.
        edges: (n,) price of the steps.
        more: price that all steps have in common.
        first: number of the first source.
        here: (n,) least price up to now, updated.
        back: (n,) its source, updated.
    """
    for i in range(len(before)):
        price = before[i] + (more + edges[i])
        is_less = price < here[i]
        here[i] = price if is_less else here[i]
        back[i] = first + i if is_less else back[i]


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
        flown: (S,) price per equivalent rad of the external joints.
    """
    S, V = node.shape
    K, size = near.shape[1], R * B
    back = np.full((S, V), -1, np.int64)
    here, before = node[0].copy(), np.empty(V)
    for s in range(1, S):
        before[:] = here
        if not joined[s]:
            _fly_to_values(before, e[s - 1], e[s], flown[s], node[s], here, back[s])
            continue
        here[:] = np.inf
        for g in range(V // size):
            to = g * size
            for k in range(K):
                h = near[g, k]
                if h < 0:
                    continue
                way, at = 0.0, h * size
                for c in range(e.shape[2]):
                    way += abs(e[s, g, c] - e[s - 1, h, c])
                more = flown[s] * way
                for dr in range(-1, 2):  # from rotation r + dr, once round the circle
                    row, shift = edges[s, 3 * k + dr + 1], (dr % R) * B
                    middle = to + size - shift
                    for i, j, n in ((at + shift, to, size - shift), (at, middle, shift)):
                        _take_cheaper(before[i : i + n], row[j : j + n], more, i, here[j : j + n], back[s, j : j + n])
        here += node[s]
    vertex = np.zeros(S, np.int64)
    vertex[S - 1] = np.argmin(here)
    for s in range(S - 1, 0, -1):
        vertex[s - 1] = back[s, vertex[s]]
    return vertex, here[vertex[S - 1]]
