"""The compiled search behind :mod:`machopt.plan.choose`: the cheapest sequence of vertices, one a station.

A vertex is (rotation, branch, turn). Whole turns do not change what a step costs, so a step is priced once for all
turns; rapid moves, which may come from anywhere, are bounded by groups of vertices that lie near each other.
"""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray

from machopt.model.compiled import compiled
from machopt.plan.objective import edge_price_compiled, late_compiled

Array = NDArray[np.float64]
Ints = NDArray[np.int32]
JUMP = np.radians(40.0)  # largest joint step between neighbouring stations that still counts as continuous
GROUP = 6  # rotations whose vertices are bounded together where a rapid move comes from any of them


@compiled
def _groups(before: Array, q: Array, turns: Array) -> Any:  # numba infers
    """The vertices that can be come from, in groups that lie near each other: what a rapid move is bounded by.

    Returns (K,) the vertices, (G, 2) where each group begins and ends in them, (G, 2, 6) rad its corners in joint space
    and (G,) its least cost to come; the groups with the least cost first.
    """
    R, B, _ = q.shape
    T = len(turns)
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
                        x = q[r, b] + turns[t]
                        if n == start:
                            corner[G, 0], corner[G, 1], cheapest[G] = x, x, before[u]
                        corner[G, 0], corner[G, 1] = np.minimum(corner[G, 0], x), np.maximum(corner[G, 1], x)
                        cheapest[G] = min(cheapest[G], before[u])
                        members[n] = u
                        n += 1
                if n > start:
                    group[G, 0], group[G, 1] = start, n
                    G += 1
    order = np.argsort(cheapest[:G])
    return members[:n], group[:G][order], corner[:G][order], cheapest[:G][order]


@compiled
def cheapest_sequence(
    node: Any, q: Any, turns: Any, feasible: Any, window: Any, stable: Any, shift: Any, seconds: Any, slowness: Any,
    price_q: Any, price_r: Any, price_t: Any, nudged: Any, limit: float, ban: Any, ban_u: Any, ban_v: Any,
) -> Any:  # numba infers  # fmt: skip
    """Cheapest sequence; returns (S, 3) rotation, branch, turn (−1 where dropped), its value, where it stopped, breaks
    (S,) and what is reached (S, V).

    Prices are those of :mod:`machopt.plan.objective`, (S,) per rad, rad and s on the way into each station; ``nudged``
    (S,) rad is how far its grid is turned against that of the station before. A break is a station inside a run that
    no vertex of the station before reaches continuously; the sequence goes on there as after a rapid move. With a
    finite ``limit`` only sequences below it are looked for, without breaks, and ``stop`` ≥ 0 is where the last of them
    ends. ``ban[s]`` … ``ban[s + 1]`` are the forbidden edges into s.
    """
    S, R, B, T = feasible.shape
    inf = np.inf
    V = R * B * T
    back = np.full((S, V), -1, np.int32)
    reached = np.zeros((S, V), np.bool_)
    broken = np.zeros(S, np.bool_)
    before = np.full(V, inf)  # cost to come at the last kept station
    least = np.full((R, B), inf)  # and the least over its turns
    now = np.empty(V)
    best = np.full((S, 3), -1, np.int32)
    last = -1  # last kept station
    twopi = 2 * np.pi
    step_r = twopi / R
    usable = np.zeros((S, R, B), np.bool_)
    to_go = np.zeros(S + 1)  # the nodes from a station on cost at least this much
    for s in range(S - 1, -1, -1):
        low = inf
        for r in range(R):
            for b in range(B):
                if feasible[s, r, b].any():
                    usable[s, r, b] = True
                    low = min(low, node[s, r, b])
        to_go[s] = to_go[s + 1] + (low if low < inf else 0.0)
    # the turn before from the turn now and the whole turns between two base configurations, −1 where there is none
    lookup = np.full(3**6, -1, np.int32)
    for t in range(T):
        code = 0
        for i in range(6):
            code = 3 * code + round(turns[t, i] / twopi) + 1
        lookup[code] = t
    source_turn = np.full((3**6, T), -1, np.int32)
    for code in range(3**6):
        for t in range(T):
            rest, other, unit = code, 0, 1
            for i in range(5, -1, -1):
                digit = rest % 3 - 1 + round(turns[t, i] / twopi)
                rest //= 3
                if abs(digit) > 1:
                    other = -1
                    break
                other += unit * (digit + 1)
                unit *= 3
            if other >= 0:
                source_turn[code, t] = lookup[other]
    values, sources = np.empty(T), np.empty(T, np.int64)
    members, group, corner, cheapest = _groups(before, q[0], turns)
    s = -1
    lift = False  # the station is tried again as after a rapid move
    while s < S - 1 or lift:
        if not lift:
            s += 1
        any_here, exists = False, False
        now[:] = inf
        fresh = last < 0
        free = window[s] < 0 or lift
        lift = False
        if free and not fresh:
            members, group, corner, cheapest = _groups(before, q[last], turns)
        for r in range(R):
            for b in range(B):
                if not usable[s, r, b]:
                    continue
                exists = True
                most = limit - node[s, r, b] - to_go[s + 1]  # what the way here may cost
                if fresh:
                    values[:], sources[:] = 0.0, -1
                elif free:
                    ru = (r + shift[s]) % R
                    for t in range(T):
                        value, source = most, -1
                        if feasible[s, r, b, t]:
                            for tu in range(T):  # first the same posture before: near, so that few others need a look
                                u = (ru * B + b) * T + tu
                                if before[u] < value:
                                    step = 0.0
                                    for i in range(6):
                                        step += abs(q[s, r, b, i] + turns[t, i] - q[last, ru, b, i] - turns[tu, i])
                                    if before[u] + price_q[s] * step < value:
                                        value, source = before[u] + price_q[s] * step, u
                            for g in range(len(cheapest)):
                                if cheapest[g] >= value:
                                    break
                                away = 0.0
                                for i in range(6):
                                    x = q[s, r, b, i] + turns[t, i]
                                    away += max(corner[g, 0, i] - x, 0.0) + max(x - corner[g, 1, i], 0.0)
                                if cheapest[g] + price_q[s] * away >= value:
                                    continue
                                for j in range(group[g, 0], group[g, 1]):
                                    u = members[j]
                                    if before[u] >= value:
                                        continue
                                    rj, bj, tj = u // (B * T), u // T % B, u % T
                                    step = 0.0
                                    for i in range(6):
                                        step += abs(q[s, r, b, i] + turns[t, i] - q[last, rj, bj, i] - turns[tj, i])
                                    if before[u] + price_q[s] * step < value:
                                        value, source = before[u] + price_q[s] * step, u
                        values[t], sources[t] = value, source
                else:
                    values[:], sources[:] = most, -1
                    highest = most  # of the values found so far: what cannot beat it is of no use to any turn
                    for k in range(2 * window[s] + 1):
                        dr = (k + 1) // 2 if k % 2 else -(k // 2)
                        ru = (r + dr) % R
                        for bu in range(b if stable else 0, b + 1 if stable else B):
                            turn = abs(nudged[s] - dr * step_r)
                            if not (least[ru, bu] + price_r[s] * turn < highest):
                                continue
                            code = 0
                            step = 0.0
                            slow = 0.0
                            for i in range(6):
                                apart = q[s, r, b, i] - q[last, ru, bu, i]
                                if not (abs(apart) < 1.5 * twopi):  # also a branch that does not exist there (NaN)
                                    code = -1
                                    break
                                whole = round(apart / twopi)
                                d = abs(apart - twopi * whole)
                                if d > JUMP:
                                    code = -1
                                    break
                                step += d
                                slow = max(slow, d * slowness[i])
                                code = 3 * code + int(whole) + 1
                            if code < 0:
                                continue
                            late = late_compiled(slow, seconds[s])
                            edge = edge_price_compiled(step, turn, late, price_q[s], price_r[s], price_t[s])
                            better = False
                            for t in range(T):
                                tu = source_turn[code, t]
                                if tu < 0 or not feasible[s, r, b, t]:
                                    continue
                                u = (ru * B + bu) * T + tu
                                if before[u] + edge < values[t]:
                                    banned = False
                                    for e in range(ban[s], ban[s + 1]):
                                        if ban_u[e] == u and ban_v[e] == (r * B + b) * T + t:
                                            banned = True
                                            break
                                    if not banned:
                                        values[t], sources[t], better = before[u] + edge, u, True
                            if better:
                                highest = 0.0
                                for t in range(T):
                                    if feasible[s, r, b, t]:
                                        highest = max(highest, values[t])
                for t in range(T):
                    if feasible[s, r, b, t] and (fresh or sources[t] >= 0) and values[t] < inf and values[t] <= most:
                        any_here = True
                        now[(r * B + b) * T + t] = values[t] + node[s, r, b]
                        back[s, (r * B + b) * T + t] = sources[t]
                        reached[s, (r * B + b) * T + t] = True
        if not exists:
            continue  # dropped: nothing is feasible here
        if not any_here and (limit < inf or free):
            return best, inf, s, broken, reached
        if not any_here:
            broken[s] = lift = True
            continue
        before[:] = now
        for r in range(R):
            for b in range(B):
                least[r, b] = before[(r * B + b) * T : (r * B + b + 1) * T].min()
        last = s
    if last < 0:
        return best, 0.0, -1, broken, reached
    v = int(np.argmin(before))
    value = before[v]
    s = last
    while s >= 0:
        best[s, 0], best[s, 1], best[s, 2] = v // (B * T), v // T % B, v % T
        v = back[s, v]
        s -= 1
        while s >= 0 and v >= 0 and not feasible[s].any():
            s -= 1
        if v < 0:
            break
    return best, value, -1, broken, reached
