"""Compiled search of :mod:`machopt.planning.external_axis_optimization.external_axis_bound`: sequences over
values of external joints, rotations and branches.

A vertex is v = (g·R + r)·B + b, with the values g repeated for each set of whole turns in a turn-resolved grid. Inside
a run any vertex of the same branch may follow, over a rapid move any vertex. An external joint that keeps one value
keeps it. No step has a negative price. A vertex is therefore reached from the cheapest vertices first, and only from
those that can still be better.

This file imports no planner: it is compiled while a wheel is built, where only NumPy and numba are installed.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from machopt.numerics.array_types import Array, Bools
from machopt.numerics.compiled_functions import jit_compile
from machopt.planning.cost.objective import edge_price_compiled, late_compiled
from machopt.planning.sequence_search.rapid_source_kernels import sort_indices

TWO_PI = 2.0 * np.pi
SECONDS, TRAVEL, ROTATION, FEED = range(4)  # columns of ``priced``: s, and the prices per rad, rad and s
SAME, JOINED, KEPT = range(3)  # columns of ``kind``


@jit_compile
def _step(
    q: Array,
    more: NDArray[np.int8],
    v: int,
    last: Array,
    before: NDArray[np.int8],
    u: int,
    way: float,
    slow: float,
    turn: float,
    slowness: Array,
    priced: Array,
    most: float,
) -> float:
    """Return the price of a step between the joints of vertices ``v`` of ``q`` (V, 6) rad and ``u`` of ``last``, the
    shortest by the whole turns (V, 6) that either end has ``more``; infinite where the price is certain to exceed
    ``most``.

    ``way`` rad and ``slow`` s are those of the external joints.
    """
    length, longest = way, 0.0
    for c in range(6):
        d = abs(q[v, c] - last[u, c])
        length += d
        longest = max(longest, d)
    if longest > np.pi:
        length = way
        for c in range(6):
            length += _shorten(q[v, c] - last[u, c], before[u, c], more[v, c])
    price = edge_price_compiled(length, turn, 0.0, priced[TRAVEL], priced[ROTATION], priced[FEED])
    if price > most:
        return np.inf
    for c in range(6):
        d = q[v, c] - last[u, c]
        d = abs(d) if longest <= np.pi else _shorten(d, before[u, c], more[v, c])
        slow = max(slow, d * slowness[c])
    late = late_compiled(slow, priced[SECONDS])
    return edge_price_compiled(length, turn, late, priced[TRAVEL], priced[ROTATION], priced[FEED])  # type: ignore[no-any-return]  # numba has no types


@jit_compile
def _shorten(d: float, before: int, more: int) -> float:
    """Return the shortest difference in rad of two joint angles that have further whole turns inside their limits."""
    return abs(d + TWO_PI * min(max(np.round(-d / TWO_PI), -float(before)), float(more)))  # type: ignore[no-any-return]


@jit_compile
def _compute_rotation_steps(phi: Array, last: Array, out: Array) -> None:
    """Write (R, R) rad between the rotations of a station and those of the previous one, the shorter way round."""
    for r in range(len(phi)):
        for p in range(len(last)):
            d = phi[r] - last[p]
            out[r, p] = abs(d - TWO_PI * np.round(d / TWO_PI))


@jit_compile
def _compute_value_steps(
    e: Array,
    last: Array,
    position_number: NDArray[np.int64],
    before: NDArray[np.int64],
    same: bool,
    slowness: Array,
    way: Array,
    slow: Array,
) -> None:
    """Write (G, G) rad and s between values of two stations; infinite where a joint that keeps its value would
    change it.
    """
    for g in range(len(e)):
        for h in range(len(last)):
            total, most = 0.0, 0.0
            for c in range(e.shape[1]):
                d = abs(e[g, c] - last[h, c])
                total += d
                most = max(most, d * slowness[6 + c])
            way[g, h] = np.inf if same and position_number[g] != before[h] else total
            slow[g, h] = most


@jit_compile
def _sort_groups(
    before: Array, R: int, B: int, group: Array, order: NDArray[np.int64], count: NDArray[np.int64]
) -> None:
    """Group the vertices of a station by value and branch, and sort the groups of each branch by their least price.

    Args:
        before: (V,) price up to each vertex.
        R: number of rotations.
        B: number of branches.
        group: (G·B,) filled with the least price of each group.
        order: (B, G) filled with the values whose group can be reached, the cheapest first.
        count: (B,) filled with the number of these.
    """
    G = len(group) // B
    group[:] = np.inf
    for h in range(G):
        for u in range(h * R * B, (h + 1) * R * B, B):
            for b in range(B):
                group[h * B + b] = min(group[h * B + b], before[u + b])
    for b in range(B):
        count[b] = 0
        for h in range(G):
            if group[h * B + b] < np.inf:
                order[b, count[b]] = h
                count[b] += 1
        sort_indices(group[b::B], order[b, : count[b]])


@jit_compile
def compute_reach_costs(
    node: Array,
    q: Array,
    more: NDArray[np.int8],
    e: Array,
    phi: Array,
    position_number: NDArray[np.int64],
    branches: int,
    stable: bool,
    kind: Bools,
    priced: Array,
    slowness: Array,
    turns: int,
    onward: Array,
    limit: float,
) -> Array:
    """Return the (S, V) price of the cheapest sequence up to each vertex, inclusive; infinite where that exceeds
    ``limit``.

    Args:
        node: (S, V) price of the vertices, infinite where there is none.
        q: (S, V, 6) rad, the smallest joint angles inside the limits among those equal up to whole turns.
        more: (S, V, 6) whole turns that the limits leave beyond that; each step uses them independently of the next.
        e: (S, G, E) external joints, lengths in equivalent rad.
        phi: (S, R) rad, rotations.
        position_number: (S, G) number of the position of the joints that keep one value.
        branches: number of branches B.
        stable: the branch is an assembly mode, which no motion leaves inside a run.
        kind: (S, 3) of the step into each station. SAME: its operations share their values with the previous ones;
            JOINED:
            it is no rapid move; KEPT: value and rotation are kept, the tool drills or plunges.
        priced: (S, 4) SECONDS … FEED.
        slowness: (6 + E,) s/rad.
        turns: number of copies of the vertices, one per set of whole turns of the arm's joints; a step that
            keeps value and rotation may lead to any copy.
        onward: (S, V) lower bound of the price from each vertex to the end, its own price included.
        limit: of the whole sequence.
    """
    S, V = node.shape
    G, R, B = e.shape[1], phi.shape[1], branches
    same = V // turns
    out = np.full((S, V), np.inf)
    group, count, order = np.empty(G * B), np.empty(B, np.int64), np.empty((B, G), np.int64)
    turn, way, slow, likely = np.empty((R, R)), np.empty((G, G)), np.empty((G, G)), np.zeros(B, np.int64)
    for v in range(V):
        if onward[0, v] <= limit:
            out[0, v] = node[0, v]
    for s in range(1, S):
        before, is_plunge, paid = out[s - 1], kind[s, KEPT], priced[s]
        here, last, own, gone = q[s], q[s - 1], more[s], more[s - 1]
        every = not (stable and kind[s, JOINED])
        if not is_plunge:
            _sort_groups(before, R, B, group, order, count)
        _compute_rotation_steps(phi[s], phi[s - 1], turn)
        _compute_value_steps(
            e[s], e[s - 1], position_number[s], position_number[s - 1], kind[s, SAME], slowness, way, slow
        )
        for g in range(G):
            for b in range(B):
                likely[b] = g * R * B + b  # a source of an earlier step may have another branch
            for v in range(g * R * B, (g + 1) * R * B):
                if not (node[s, v] < np.inf and onward[s, v] <= limit):
                    continue
                b, r = v % B, (v // B) % R
                most = np.nextafter(limit - onward[s, v], np.inf)  # a price equal to the limit is permitted
                value = most
                if is_plunge:
                    for u in range(v % same, V, same):
                        h = u // (B * R)
                        if before[u] < value and way[g, h] < np.inf:
                            to = value - before[u]
                            price = _step(
                                here, own, v, last, gone, u, way[g, h], slow[g, h], turn[r, r], slowness, paid, to
                            )
                            value = min(value, before[u] + price)
                    if value < most:
                        out[s, v] = value + node[s, v]
                    continue
                for u in (v, likely[b]):  # near values and the source of the last vertex first: few others are examined
                    p, h = (u // B) % R, u // (B * R)
                    if before[u] < value and way[g, h] < np.inf:
                        to = value - before[u]
                        price = _step(
                            here, own, v, last, gone, u, way[g, h], slow[g, h], turn[r, p], slowness, paid, to
                        )
                        value = min(value, before[u] + price)
                for a in range(0 if every else b, B if every else b + 1):
                    for k in range(count[a]):
                        h = order[a, k]
                        if group[h * B + a] >= value:
                            break
                        flown = paid[TRAVEL] * way[g, h]
                        if not group[h * B + a] + flown < value:
                            continue
                        for p in range(R):
                            u = (h * R + p) * B + a
                            if not before[u] + flown + paid[ROTATION] * turn[r, p] < value:
                                continue
                            to = value - before[u]
                            price = _step(
                                here, own, v, last, gone, u, way[g, h], slow[g, h], turn[r, p], slowness, paid, to
                            )
                            if before[u] + price < value:
                                value, likely[b] = before[u] + price, u
                if value < most:
                    out[s, v] = value + node[s, v]
    return out


@jit_compile
def trace_cheapest_sequence(
    reached: Array,
    q: Array,
    more: NDArray[np.int8],
    e: Array,
    phi: Array,
    position_number: NDArray[np.int64],
    branches: int,
    stable: bool,
    kind: Bools,
    priced: Array,
    slowness: Array,
    turns: int,
) -> NDArray[np.int64]:
    """Return the (S,) vertices of the cheapest sequence.

    Args:
        reached: (S, V) result of :func:`compute_reach_costs`.
        q: as in :func:`compute_reach_costs`.
        more: as there.
        e: as there.
        phi: as there.
        position_number: as there.
        branches: as there.
        stable: as there.
        kind: as there.
        priced: as there.
        slowness: as there.
        turns: as there.
    """
    S, V = reached.shape
    G, R, B = e.shape[1], phi.shape[1], branches
    same, out = V // turns, np.zeros(S, np.int64)
    out[S - 1] = np.argmin(reached[S - 1])
    turn, way, slow = np.empty((R, R)), np.empty((G, G)), np.empty((G, G))
    for s in range(S - 1, 0, -1):
        _compute_rotation_steps(phi[s], phi[s - 1], turn)
        _compute_value_steps(
            e[s], e[s - 1], position_number[s], position_number[s - 1], kind[s, SAME], slowness, way, slow
        )
        v, least = out[s], np.inf
        b, r, g = v % B, (v // B) % R, v // (B * R)
        for u in range(V):
            a, p, h = u % B, (u // B) % R, u // (B * R)
            if (kind[s, KEPT] and u % same != v % same) or (kind[s, JOINED] and stable and a != b):
                continue
            if not reached[s - 1, u] + priced[s, TRAVEL] * way[g, h] < least:
                continue
            price = _step(
                q[s],
                more[s],
                v,
                q[s - 1],
                more[s - 1],
                u,
                way[g, h],
                slow[g, h],
                turn[r, p],
                slowness,
                priced[s],
                np.inf,
            )
            if reached[s - 1, u] + price < least:
                least, out[s - 1] = reached[s - 1, u] + price, u
    return out
