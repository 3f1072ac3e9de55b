"""Compiled search for the vertex before a rapid move; groups of neighbouring vertices bound the price."""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray

from machopt.numerics.array_types import Array
from machopt.numerics.compiled_functions import jit_compile
from machopt.planning.sequence_search.rapid_move_prices import price_flight

GROUP = 6  # number of rotations whose vertices are bounded together for a rapid move


@jit_compile
def sort_indices(value: Array, order: NDArray[np.int64]) -> None:
    """Sort indices by value, equal ones by index, in place (heap sort).

    Args:
        value: (V,) values.
        order: (N,) indices into them; sorted in place.
    """
    n = len(order)
    root, end = n // 2, n
    while end > 1:
        if root > 0:  # build the heap
            root -= 1
        else:  # remove the largest
            end -= 1
            order[0], order[end] = order[end], order[0]
        k = root
        item = order[k]
        while 2 * k + 1 < end:
            c = 2 * k + 1
            if c + 1 < end and (value[order[c]], order[c]) < (value[order[c + 1]], order[c + 1]):
                c += 1
            if not (value[item], item) < (value[order[c]], order[c]):
                break
            order[k] = order[c]
            k = c
        order[k] = item


@jit_compile
def group_vertices(before: Array, q: Array, every: int, turns: Array) -> Any:  # numba infers
    """Group the reachable vertices by neighbourhood; the groups bound a rapid move.

    Args:
        before: (V,) cost of the cheapest sequence to each vertex.
        q: (R, B, 6) rad, joints of the station.
        every: Step of the rotations in ``q``.
        turns: (T, 6) rad, whole turns.

    Returns:
        (K,) the vertices, (G, 2) where each group begins and ends in them, (G, 2, 6) rad its corners in joint space and
        (G,) its least cost to come; the groups with the least cost first.
    """
    R, B, _ = q.shape
    R, T = R // every, len(turns)
    members = np.empty(len(before), np.int64)
    most = ((R + GROUP - 1) // GROUP) * B * T
    group, corner = np.zeros((most, 2), np.int64), np.empty((most, 2, 6))
    cheapest = np.empty(most)
    G, n = 0, 0
    for first in range(0, R, GROUP):
        for b in range(B):
            for t in range(T):
                start = n
                for r in range(first, min(first + GROUP, R)):
                    u = (r * B + b) * T + t
                    if before[u] < np.inf:
                        for i in range(6):
                            x = q[r * every, b, i] + turns[t, i]
                            corner[G, 0, i] = min(corner[G, 0, i], x) if n > start else x
                            corner[G, 1, i] = max(corner[G, 1, i], x) if n > start else x
                        cheapest[G] = min(cheapest[G], before[u]) if n > start else before[u]
                        members[n] = u
                        n += 1
                if n > start:
                    group[G, 0], group[G, 1] = start, n
                    G += 1
    order = np.empty(G, np.int64)  # numba's argsort takes ten times as long to compile
    for g in range(G):
        order[g] = g
    sort_indices(cheapest, order)
    group_out, corner_out, cheapest_out = np.empty((G, 2), np.int64), np.empty((G, 2, 6)), np.empty(G)
    for g in range(G):
        k = order[g]
        cheapest_out[g] = cheapest[k]
        for e in range(2):
            group_out[g, e] = group[k, e]
            for i in range(6):
                corner_out[g, e, i] = corner[k, e, i]
    return members[:n], group_out, corner_out, cheapest_out


@jit_compile
def find_flight_source(
    q: Any,
    every: int,
    turns: Any,
    here: tuple[int, int, int, int],
    last: int,
    rotation: int,
    before: Any,
    members: Any,
    group: Any,
    corner: Any,
    cheapest: Any,
    shut: Any,
    loose: bool,
    travel: float,
    need: Any,
    external_need: Any,
    flight: Any,
    most: float,
) -> Any:  # numba infers
    """Find the cheapest vertex before a rapid move to a vertex.

    Args:
        q: (S, R, B, 6) rad, joints.
        every: Step of the rotations in ``q``.
        turns: (T, 6) rad, whole turns.
        here: Station, row of ``q``, branch and turn of the vertex.
        last: Station before the rapid move.
        rotation: Rotation of the same posture at that station.
        before: (V,) cost of the cheapest sequence to each vertex of that station.
        members: Vertices in groups, as :func:`group_vertices` returns them.
        group: Begin and end of each group.
        corner: Corners of each group in joint space, rad.
        cheapest: Least cost of each group.
        shut: (B, B) changes of branch that are not allowed.
        loose: Whether whole turns are free.
        travel: Price per rad of the joints.
        need: (3, 6) s, s², s³ per rad.
        external_need: (S, 3) s, s², s³ of moves of external joints.
        flight: (3,) price of a second, of a branch change, of a whole turn.
        most: Price above which a vertex is of no use.

    Returns:
        The least price below ``most`` up to the vertex, without its own, and the source; −1 where there is none.
    """
    s, r, b, t = here
    B, T = q.shape[2], len(turns)
    value, source = most, -1
    for tu in range(T):  # the same posture first: near, so that few others are examined
        u = (rotation * B + b) * T + tu
        if before[u] < value:
            start = (last, rotation * every, b, tu)
            room = value - before[u]
            way = price_flight(q, turns, here, start, loose, travel, room, need, external_need, flight)
            if before[u] + way < value:
                value, source = before[u] + way, u
    for g in range(len(cheapest)):
        if cheapest[g] >= value:
            break
        away = 0.0
        for i in range(6):
            x = q[s, r, b, i] + turns[t, i]
            away += max(corner[g, 0, i] - x, 0.0) + max(x - corner[g, 1, i], 0.0)
        other = members[group[g, 0]] // T % B != b
        away = (0.0 if loose else travel * away) + (flight[1] if other else 0.0)
        if cheapest[g] + away >= value:
            continue
        for j in range(group[g, 0], group[g, 1]):
            u = members[j]
            bj = u // T % B
            if before[u] >= value or shut[bj, b]:
                continue
            start = (last, u // (B * T) * every, bj, u % T)
            room = value - before[u]
            way = price_flight(q, turns, here, start, loose, travel, room, need, external_need, flight)
            if before[u] + way < value:
                value, source = before[u] + way, u
    return value, source
