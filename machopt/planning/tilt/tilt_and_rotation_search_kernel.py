"""Compiled search for the cheapest sequence of rotation, branch and tilt over a sparse list of vertices."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from machopt.numerics.array_types import Array, Bools
from machopt.numerics.compiled_functions import jit_compile

Ints = NDArray[np.int64]


@jit_compile
def _measure_step(q: Array, before: Array, slowness: Array) -> tuple[float, float, float]:
    """Return travel in rad, time in s of the slowest axis, and largest joint step in rad between two poses (6,)."""
    length, slow, largest = 0.0, 0.0, 0.0
    for j in range(6):
        d = abs(q[j] - before[j])
        if d > np.pi:
            d = abs(2.0 * np.pi - d)
        length += d
        largest = max(largest, d)
        slow = max(slow, d * slowness[j])
    return length, slow, largest


@jit_compile
def _find_source(
    n: int,
    label: Ints,
    value: Array,
    q: Array,
    begin: Ints,
    run: bool,
    step: Array,
    slowness: Array,
    rule: Array,
    most: float,
) -> tuple[float, int]:
    """Return the least price below ``most`` of a step from the station before to vertex n, and its source, else −1.

    The arguments are as in :func:`find_joint_sequence`, for one step: ``begin`` (R + 1,), ``run``: no rapid move,
    ``step`` (4,), and ``value`` (N,) the price up to each vertex.
    """
    count, window, angle, stable, jump = int(rule[0]), int(rule[1]), rule[2], rule[3] > 0, rule[4]
    best, source = most, -1
    for r in range(count):
        turn = abs(label[n, 0] - r)
        turn = min(turn, count - turn)
        if run and turn > window:
            continue
        for m in range(begin[r], begin[r + 1]):
            if value[m] >= best or (run and stable and label[m, 1] != label[n, 1]):
                continue
            length, slow, largest = _measure_step(q[n], q[m], slowness)
            if run and largest > jump:
                continue
            total = value[m] + step[0] * length
            if run:
                total += step[1] * turn * angle + step[2] * max(slow - step[3], 0.0)
            if total < best:
                best, source = total, m
    return best, source


@jit_compile
def _find_cheapest(value: Array, begin: int, end: int) -> int:
    """Return the first vertex from ``begin`` to below ``end`` with the least value; −1 where all are infinite."""
    least, at = np.inf, -1
    for m in range(begin, end):
        if value[m] < least:
            least, at = value[m], m
    return at


@jit_compile
def find_joint_sequence(
    first: Ints,
    label: Ints,
    price: Array,
    q: Array,
    begin: Ints,
    joined: Bools,
    step: Array,
    slowness: Array,
    rule: Array,
) -> Ints:
    """Return the (S,) vertex of each station, −1 where it has none; a break of the sequence costs ``rule[5]``.

    Args:
        first: (S + 1,) first vertex of each station; the vertices of a station are successive.
        label: (N, 2) rotation and branch of each vertex.
        price: (N,) price of each vertex, inf where it is excluded.
        q: (N, 6) rad.
        begin: (S, R + 1) first vertex of each rotation at a station; its vertices are ordered by rotation.
        joined: (S,) whether a station follows the one before without a rapid move.
        step: (S, 4) travel price per rad, rotation price per rad, feed price per s, seconds at the feed.
        slowness: (6,) s/rad.
        rule: rotations of a full turn, largest step of the rotation, its angle in rad, 1 where a branch has one number
            everywhere, largest joint step in rad, price of a break.
    """
    S, N = len(first) - 1, len(price)
    value, back = np.full(N, np.inf), np.full(N, -1, np.int64)
    before = -1  # the last station with a vertex
    for s in range(S):
        at = -1 if before < 0 else _find_cheapest(value, first[before], first[before + 1])
        run = joined[s] and before == s - 1
        any_vertex = False
        for n in range(first[s], first[s + 1]):
            if price[n] == np.inf:
                continue
            any_vertex = True
            if before < 0:
                value[n] = price[n]
                continue
            broken = (value[at] if at >= 0 else np.inf) + rule[5]
            best, source = _find_source(n, label, value, q, begin[before], run, step[s], slowness, rule, broken)
            value[n] = best + price[n]
            back[n] = source if source >= 0 else at
        if any_vertex:
            before = s
    out = np.full(S, -1, np.int64)
    if before < 0:
        return out
    n = max(_find_cheapest(value, first[before], first[before + 1]), first[before])
    while n >= 0:
        out[np.searchsorted(first, n, side="right") - 1] = n
        n = back[n]
    return out
