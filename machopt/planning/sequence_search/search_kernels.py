"""Compiled search of :mod:`machopt.planning.sequence_search.dynamic_programming`: the cheapest sequence of
vertices, one per station.

A vertex is (rotation, branch, turn). Whole turns do not change the price of a step, so a step is priced once for all
turns. Rapid moves, which may start at any vertex, are bounded by groups of neighbouring vertices.
"""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray

from machopt.numerics.array_types import Array
from machopt.numerics.compiled_functions import jit_compile
from machopt.planning.cost.objective import edge_price_compiled, late_compiled
from machopt.planning.sequence_search.rapid_source_kernels import find_flight_source, group_vertices

Ints = NDArray[np.int32]
JUMP = np.radians(80.0)  # largest joint step between neighbouring stations that still counts as continuous
GUESSED = np.radians(40.0)  # the same where it alone distinguishes branches


def compute_joint_jump_limit(stable: bool) -> float:
    """Return the largest joint step in rad of a continuous edge between neighbouring stations.

    Inside a branch whose index is an assembly mode every path that keeps the singularity margins is
    continuous, however far the tool rotates. The branches of other solvers are followed by the step itself.

    Args:
        stable: the branch index is an assembly mode.
    """
    return float(JUMP if stable else GUESSED)


@jit_compile
def _step(here: Array, before: Array, slowness: Array, largest: float) -> tuple[int, float, float]:
    """Return the step between two configurations (6,) rad, nearest by whole turns: code of these turns, Σ|Δq| (rad) and
    the time (s) of the slowest axis. The code is −1 where an axis moves by more than ``largest``, or where the branch
    does not exist (NaN).
    """
    code, step, slow = 0, 0.0, 0.0
    twopi = 2 * np.pi
    for i in range(6):
        apart = here[i] - before[i]
        if not (abs(apart) < 1.5 * twopi):
            return -1, step, slow
        whole = round(apart / twopi)
        d = abs(apart - twopi * whole)
        if d > largest:
            return -1, step, slow
        step += d
        slow = max(slow, d * slowness[i])
        code = 3 * code + int(whole) + 1
    return code, step, slow


@jit_compile
def _is_listed(ways: Any, low: int, high: int, source: int, target: int) -> Any:  # numba infers
    """Return whether one of the sorted edges (n, 3) from ``low`` to ``high`` leads from the source to the target."""
    end = high
    while low < high:
        middle = (low + high) // 2
        u, v = ways[middle, 1], ways[middle, 2]
        if u < source or (u == source and v < target):
            low = middle + 1
        else:
            high = middle
    return low < end and ways[low, 1] == source and ways[low, 2] == target


@jit_compile
def _bound_vertices(node: Any, feasible: Any) -> Any:  # numba infers
    """Return (S, R, B) whether a vertex has a feasible turn, and (S + 1,) a lower bound of the vertices from a station
    on.
    """
    S, R, B, T = feasible.shape
    usable, to_go = np.zeros((S, R, B), np.bool_), np.zeros(S + 1)
    for s in range(S - 1, -1, -1):
        low = np.inf
        for r in range(R):
            for b in range(B):
                for t in range(T):
                    if feasible[s, r, b, t]:
                        usable[s, r, b] = True
                        break
                if usable[s, r, b]:
                    low = min(low, node[s, r, b])
        to_go[s] = to_go[s + 1] + (low if low < np.inf else 0.0)
    return usable, to_go


@jit_compile
def _list_source_turns(turns: Array) -> Ints:
    """Return (3⁶, T) the turn before, from the whole turns between two base configurations and the turn now.

    −1 where there is none.
    """
    twopi, T = 2 * np.pi, len(turns)
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
    return source_turn


@jit_compile
def _trace_sequence(back: Ints, exists_at: Any, v: int, last: int, size: tuple[int, int]) -> Ints:
    """Return (S, 3) rotation, branch and turn of the sequence that ends in vertex v of station ``last``; −1 where a
    station is dropped. ``size``: numbers of branches and turns.
    """
    B, T = size
    best = np.full((len(back), 3), -1, np.int32)
    s = last
    while s >= 0:
        best[s, 0], best[s, 1], best[s, 2] = v // (B * T), v // T % B, v % T
        v = back[s, v]
        s -= 1
        while s >= 0 and v >= 0 and not exists_at[s]:
            s -= 1
        if v < 0:
            break
    return best


@jit_compile
def find_cheapest_sequence(
    node: Any,
    q: Any,
    every: int,
    turns: Any,
    feasible: Any,
    window: Any,
    stable: Any,
    shift: Any,
    seconds: Any,
    slowness: Any,
    price_q: Any,
    price_r: Any,
    price_t: Any,
    nudged: Any,
    limit: float,
    ban: Any,
    ban_u: Any,
    ban_v: Any,
    closed: Any,
    ways: Any,
    hidden: Any,
    crossed: Any,
    shut: Any,
    loose: bool,
    start: Any,
    price: Any,
    turned: Any,
    need: Any,
    external_need: Any,
    flight: Any,
) -> Any:  # numba infers
    """Return the cheapest sequence.

    Prices are those of :mod:`machopt.planning.cost.objective`. A break is a station inside a
    run that no vertex of the previous station reaches continuously; the sequence continues there as after a rapid move.

    Args:
        node: (S, R, B) price of each vertex.
        q: (S, R·every, B, 6) rad, NaN where the branch does not exist.
        every: each how many rotations of q belong to the grid; a copy of them would take 100 MiB on long jobs.
        turns: (T, 6) rad, whole turns.
        feasible: (S, R, B, T) vertices that may be used.
        window: (S,) grid steps that the rotation may change, FREE or LIFT.
        stable: the branch index is an assembly mode.
        shift: (S,) grid steps between equal TCP directions of neighbouring stations.
        seconds: (S,) s, time of the step at the programmed feed.
        slowness: (6,) s/rad, inverse of the usable joint speeds.
        price_q: (S,) price per rad of the joints.
        price_r: (S,) price per rad of the rotation.
        price_t: (S,) price per s of lost time.
        nudged: (S,) rad, shift of the station's grid relative to that of the previous station.
        limit: only sequences below it are searched, without breaks, if it is finite.
        ban: (S + 1,) the forbidden edges into s are ``ban[s]`` … ``ban[s + 1]``.
        ban_u: source vertex of each forbidden edge.
        ban_v: target vertex of each forbidden edge.
        closed: (S + 1,) the edges into s in ``ways`` are ``closed[s]`` … ``closed[s + 1]``.
        ways: (n, 3) edges forbidden in every turn
            (:class:`machopt.planning.sequence_search.forbidden_transitions.ForbiddenTransitions`).
        hidden: (S,) on the edge into s, in one branch, the rotation crosses only rotations that one of the stations has
            in
            ``crossed`` (:mod:`machopt.planning.sequence_search.worst_index_across_swings`).
        crossed: (S, R, B) rotations that may be crossed.
        shut: (B, B) branch changes that rapid moves must not make.
        loose: with one turn only: whole turns cost nothing and have no limits, so that the value is a lower bound of
            that
            with turns.
        start: (S,) of :class:`machopt.planning.sequence_search.transition_cost_table.TransitionCostTable`.
        price: (n,) of that table; filled in here.
        turned: (n,) of that table; filled in here.
        need: (3, 6) of :class:`machopt.planning.sequence_search.rapid_move_prices.FlightPrices`.
        external_need: (S, 3) of the same.
        flight: (3,) its prices of a second, of a branch change and of a whole turn.

    Returns:
        (S, 3) rotation, branch, turn (−1 where dropped); its value; the station where the last sequence below the limit
        ends, or −1; the breaks (S,); and the reached vertices (S, V).
    """
    S, R, B, T = feasible.shape
    inf = np.inf
    V = R * B * T
    back = np.empty((S, V), np.int32)  # only written entries are read; with tens of turns most are never written
    reached = np.zeros((S, V), np.bool_)
    broken, exists_at = np.zeros(S, np.bool_), np.zeros(S, np.bool_)
    before = np.full(V, inf)  # cost to come at the last kept station
    least = np.full((R, B), inf)  # and the minimum over its turns
    now = np.empty(V)
    best = np.full((S, 3), -1, np.int32)
    last = -1  # last kept station
    step_r = 2 * np.pi / R
    largest = JUMP if stable else GUESSED
    usable, to_go = _bound_vertices(node, feasible)
    source_turn = _list_source_turns(turns)
    values, sources = np.empty(T), np.empty(T, np.int64)
    members, group, corner, cheapest = group_vertices(before, q[0], every, turns)
    s = -1
    lift = False  # the station is repeated as after a rapid move
    while s < S - 1 or lift:
        if not lift:
            s += 1
        any_here, exists = False, False
        fresh = last < 0
        free = window[s] < 0 or lift
        lift = False
        if free and not fresh:
            members, group, corner, cheapest = group_vertices(before, q[last], every, turns)
        for r in range(R):
            for b in range(B):
                if not usable[s, r, b]:
                    continue
                exists = True
                most = limit - node[s, r, b] - to_go[s + 1]  # maximum price of the sequence up to here
                for t in range(T):
                    values[t], sources[t] = 0.0 if fresh else most, -1
                if fresh:
                    pass  # no predecessor: any vertex starts at zero
                elif free:
                    ru = (r + shift[s]) % R
                    for t in range(T):
                        if feasible[s, r, b, t]:
                            values[t], sources[t] = find_flight_source(
                                q, every, turns, (s, r * every, b, t), last, ru, before, members, group, corner,
                                cheapest, shut, loose, price_q[s], need, external_need, flight, most,
                            )  # fmt: skip
                else:
                    highest = most  # upper bound of the values found so far: higher ones are irrelevant for every turn
                    up, down = True, True  # no forbidden rotation crossed so far
                    for k in range(2 * window[s] + 1):
                        dr = (k + 1) // 2 if k % 2 else -(k // 2)
                        ru = (r + dr) % R
                        if hidden[s] and abs(dr) > 1:
                            across = (ru - 1) % R if dr > 0 else (ru + 1) % R
                            open_ = crossed[s, across, b] or crossed[last, across, b]
                            up = up and (dr < 0 or open_)
                            down = down and (dr > 0 or open_)
                        for bu in range(b if stable else 0, b + 1 if stable else B):
                            if bu == b and not (up if dr > 0 else down):
                                continue
                            turn = abs(nudged[s] - dr * step_r)
                            if not (least[ru, bu] + price_r[s] * turn < highest):
                                continue
                            at = -1
                            if start[s] >= 0 and last == s - 1:  # the previous station is that of the table
                                at = ((r * B + b) * (2 * window[s] + 1) + k) * (1 if stable else B)
                                at += start[s] + (0 if stable else bu)
                            if at < 0 or turned[at] == 0:
                                code, step, slow = _step(q[s, r * every, b], q[last, ru * every, bu], slowness, largest)
                                late = late_compiled(slow, seconds[s])
                                edge = edge_price_compiled(step, turn, late, price_q[s], price_r[s], price_t[s])
                                if at >= 0:
                                    turned[at], price[at] = code + 1 if code >= 0 else -1, edge
                            else:
                                code, edge = turned[at] - 1, price[at]
                            if code < 0 or not (least[ru, bu] + edge < highest):
                                continue
                            if _is_listed(ways, closed[s], closed[s + 1], ru * B + bu, r * B + b):
                                continue
                            better = False
                            for t in range(T):
                                tu = 0 if loose else source_turn[code, t]
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
                    now[(r * B + b) * T + t] = inf
                    if feasible[s, r, b, t] and (fresh or sources[t] >= 0) and values[t] < inf and values[t] <= most:
                        any_here = True
                        now[(r * B + b) * T + t] = values[t] + node[s, r, b]
                        back[s, (r * B + b) * T + t] = sources[t]
                        reached[s, (r * B + b) * T + t] = True
        exists_at[s] = exists
        if not exists:
            continue  # dropped: nothing is feasible here
        if not any_here and (limit < inf or free):
            return best, inf, s, broken, reached
        if not any_here:
            broken[s] = lift = True
            continue
        for r in range(R):
            for b in range(B):
                if not usable[s, r, b] and not (least[r, b] < inf):
                    continue  # all infinite, as before
                least[r, b] = inf
                for v in range((r * B + b) * T, (r * B + b + 1) * T):
                    before[v] = now[v] if usable[s, r, b] else inf
                    least[r, b] = min(least[r, b], before[v])
        last = s
    if last < 0:
        return best, 0.0, -1, broken, reached
    v = 0
    for u in range(V):
        if before[u] < before[v]:
            v = u
    return _trace_sequence(back, exists_at, v, last, (B, T)), before[v], -1, broken, reached
