"""The best sequence over rotation × branch × turn for the whole path at once.

Dynamic programming over the stations. Inside a run a vertex is joined to the vertices of the station before
whose rotation differs by at most a window, in the same branch, with the turn that continuity gives; over a
rapid move anything may follow anything, at the price of the joint travel. The worst index is traded by
solving under a few caps on the cost and keeping the best total, which is exact at those caps.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numba import njit
from numpy.typing import NDArray

from machopt.domain.options import PlanOptions
from machopt.plan.candidates import Candidates
from machopt.plan.path import Path
from machopt.plan.score import AXIS_SPEED, Scores, preference
from machopt.se3 import wrap

Array = NDArray[np.float64]
Ints = NDArray[np.int32]
JUMP = np.radians(40.0)  # largest joint step between neighbouring stations that still counts as continuous
TURNING = 0.5  # share of the slowest axis's velocity limit that rotation about the tool axis may take
MAX_WINDOW = 8  # grid steps
FREE_PREDECESSORS = 64  # over a rapid move only the cheapest so many are tried
CAP_SHARES = (0.7, 0.4, 0.2, 0.1, 0.03)  # between the least possible worst cost and the unconstrained one
NEAR = 0.5  # m: rapid moves shorter than this should not turn the arm over
FREE, LIFT = -1, -2


@dataclass(frozen=True)
class Choice:
    """One vertex per station."""

    rotation: Ints  # (S,) index into candidates.phi, −1 where the station has no feasible vertex
    branch: Ints  # (S,)
    turn: Ints  # (S,)
    q: Array  # (S, 6) rad, NaN where dropped
    broken: tuple[int, ...]  # stations that no continuous way leads to from the station before

    @property
    def dropped(self) -> NDArray[np.bool_]:
        return self.rotation < 0


def choose(path: Path, candidates: Candidates, scores: Scores, velocity: Array, options: PlanOptions) -> Choice:
    """Global choice.

    Stations without a feasible vertex are dropped, and where no continuous way leads on the sequence starts
    afresh (``broken``); whether either is acceptable is the caller's decision.

    Args:
        velocity: (6,) rad/s, joint velocity limits.
    """
    feasible = candidates.feasible
    counted = path.counted[path.stations]
    window, seconds = _windows(path, candidates, float(velocity.min()))
    shift = _same_direction(path, len(candidates.phi))
    node = _node_cost(path, candidates, scores, options)
    share = path.motion_share[path.stations]
    price_q = options.weights.travel / np.pi * share * _swing(path, window)
    price_t = options.weights.feed / max(float(path.time[-1]), 1e-9)
    price_r = options.weights.rotation / np.pi * (2 * np.pi / len(candidates.phi)) * share
    raw = np.where(np.isfinite(scores.cost), scores.cost / scores.scale, np.inf)

    def solve(mask: NDArray[np.bool_]) -> tuple[Ints, float, int]:
        answer: tuple[Ints, float, int] = _sequence(
            node,
            candidates.q,
            candidates.turns,
            mask,
            window,
            candidates.stable,
            shift,
            seconds,
            1.0 / (AXIS_SPEED * velocity),
            price_q,
            price_r,
            price_t,
        )
        return answer

    broken: list[int] = []
    vertex, value, stop = solve(feasible)
    while stop >= 0:  # go on behind each break, so that every break is found and reported
        broken.append(int(stop))
        window[stop] = LIFT
        vertex, value, stop = solve(feasible)
    kept = vertex[:, 0] >= 0
    at = np.flatnonzero(kept & counted)

    def worst(v: Ints) -> float:
        return float(raw[at, v[at, 0], v[at, 1]].max(initial=0.0))

    best, best_total = vertex, value + options.weights.worst * worst(vertex)
    floor = float(raw[at].min(axis=(1, 2)).max(initial=0.0))
    start = worst(vertex)
    for cap_share in CAP_SHARES:
        cap = floor + cap_share * (start - floor)
        if options.weights.worst == 0 or start <= floor * (1 + 1e-9):
            break
        allowed = (raw <= cap) | ~counted[:, None, None]
        vertex, value, stop = solve(feasible & allowed[..., None])
        if stop >= 0 or ((vertex[:, 0] < 0) & kept).any():
            break  # a tighter cap cannot work either
        total = value + options.weights.worst * worst(vertex)
        if total < best_total:
            best, best_total = vertex, total
    r, b, t = best.T
    q = candidates.q[np.arange(len(r)), r, b] + candidates.turns[t]
    q[~kept] = np.nan
    return Choice(rotation=r, branch=b, turn=t, q=q, broken=tuple(broken))


def _windows(path: Path, candidates: Candidates, slowest: float) -> tuple[Ints, Array]:
    """Window of the step into each station, and the time the axes have for it.

    FREE over rapid moves, else grid steps of rotation, 0 keeps it. On dense paths a grid step would take longer than
    the way from station to station, so rotation may only change at ticks, as far apart as a grid step takes.
    """
    st = path.stations
    tick = 2 * np.pi / len(candidates.phi) / (TURNING * slowest)  # s
    t = path.time[st]
    out = np.zeros(len(st), np.int32)
    seconds = np.diff(t, prepend=t[0])
    same = np.r_[False, path.run[st][1:] == path.run[st][:-1]]
    dropped = np.asarray(~candidates.feasible.any(axis=(1, 2, 3)))
    plunged = np.r_[0, np.cumsum(~path.plunge)]
    since = 0.0
    for s in range(1, len(st)):
        if not same[s]:
            out[s], since = FREE, 0.0
        elif dropped[s - 1]:
            out[s], since = LIFT, 0.0
        elif plunged[st[s] + 1] == plunged[st[s - 1] + 1]:
            out[s] = 0  # made only of plunges: the rotation is kept
        else:
            since += seconds[s]
            if since >= 0.999 * tick:
                out[s] = min(int(since / tick + 1e-3), MAX_WINDOW)
                seconds[s], since = since, 0.0
    out[0] = FREE
    return out, seconds


def _same_direction(path: Path, rotations: int) -> Ints:
    """(S,) grid steps from a station's phi to the phi of the station before that points TCP x the same way."""
    st = path.stations
    reference, axis = path.reference[st], path.axis[st]
    before = np.roll(reference, 1, axis=0)
    angle = np.arctan2(np.sum(np.cross(before, reference) * -axis, axis=1), np.sum(before * reference, axis=1))
    return np.asarray(np.round(angle / (2 * np.pi / rotations)), dtype=np.int32)


def _swing(path: Path, window: Ints) -> Array:
    """(S,) how much dearer joint travel is on short rapid moves: the arm turns over on long ones, far from the part."""
    position = path.position[path.stations]
    distance = np.r_[np.inf, np.linalg.norm(np.diff(position, axis=0), axis=1)]
    return np.where(window == FREE, 1.0 + NEAR / (distance + 0.1 * NEAR), 1.0)


def _node_cost(path: Path, candidates: Candidates, scores: Scores, options: PlanOptions) -> Array:
    """(S, R, B) price of a vertex: its share of the mean index, and the preferred rotation."""
    share = path.station_weight
    gamma = wrap(candidates.phi[None, :] + path.offset[path.stations][:, None])
    price = options.weights.mean * np.where(np.isfinite(scores.cost), scores.cost, 0.0) / scores.scale
    return np.ascontiguousarray((price + preference(gamma, options)[:, :, None]) * share[:, None, None])


@njit(cache=True)
def _sequence(node, q, turns, feasible, window, stable, shift, seconds, slowness, price_q, price_r, price_t):  # type: ignore[no-untyped-def]  # numba infers
    """Cheapest sequence; returns (S, 3) rotation, branch, turn (−1 where dropped), its value, and where it stopped.

    ``stop`` ≥ 0 is the first station inside a run that no vertex of the station before reaches continuously.
    """
    S, R, B, T = feasible.shape
    inf = np.inf
    V = R * B * T
    back = np.full((S, V), -1, np.int32)
    before = np.full(V, inf)  # cost to come at the last kept station
    now = np.empty(V)
    best = np.full((S, 3), -1, np.int32)
    last = -1  # last kept station
    twopi = 2 * np.pi
    # turn index from whole turns per joint, −1 where that combination does not occur
    lookup = np.full(3**6, -1, np.int32)
    for t in range(T):
        code = 0
        for i in range(6):
            code = 3 * code + round(turns[t, i] / twopi) + 1
        lookup[code] = t
    for s in range(S):
        any_here = False
        now[:] = inf
        fresh = last < 0
        free = window[s] < 0
        if free and not fresh:  # the cheapest predecessors, by partial selection
            top = np.full(FREE_PREDECESSORS, -1, np.int64)
            cost = np.full(FREE_PREDECESSORS, inf)
            for v in range(V):
                if before[v] < cost[-1]:
                    j = FREE_PREDECESSORS - 1
                    while j > 0 and cost[j - 1] > before[v]:
                        cost[j] = cost[j - 1]
                        top[j] = top[j - 1]
                        j -= 1
                    cost[j] = before[v]
                    top[j] = v
        exists = False
        for r in range(R):
            for b in range(B):
                for t in range(T):
                    if not feasible[s, r, b, t]:
                        continue
                    exists = True
                    v = (r * B + b) * T + t
                    value, source = inf, -1
                    if fresh:
                        value = 0.0
                    elif free:
                        for j in range(FREE_PREDECESSORS):
                            u = top[j]
                            if u < 0 or cost[j] >= value:
                                break
                            ru, bu, tu = u // (B * T), u // T % B, u % T
                            step = 0.0
                            for i in range(6):
                                step += abs(q[s, r, b, i] + turns[t, i] - q[last, ru, bu, i] - turns[tu, i])
                            if cost[j] + price_q[s] * step < value:
                                value, source = cost[j] + price_q[s] * step, u
                        # and the same posture before, however dear: the arm may have turned over earlier
                        for tu in range(T):
                            u = (((r + shift[s]) % R) * B + b) * T + tu
                            if before[u] < value:
                                step = 0.0
                                for i in range(6):
                                    ru = (r + shift[s]) % R
                                    step += abs(q[s, r, b, i] + turns[t, i] - q[last, ru, b, i] - turns[tu, i])
                                if before[u] + price_q[s] * step < value:
                                    value, source = before[u] + price_q[s] * step, u
                    else:
                        for dr in range(-window[s], window[s] + 1):
                            ru = (r + dr) % R
                            for bu in range(b if stable else 0, b + 1 if stable else B):
                                code = 0
                                step = 0.0
                                slow = 0.0
                                for i in range(6):
                                    qi = q[s, r, b, i] + turns[t, i]
                                    whole = (qi - q[last, ru, bu, i]) / twopi
                                    if not (abs(whole) < 1.5):  # also a branch that does not exist there (NaN)
                                        code = -1
                                        break
                                    k = round(whole)
                                    d = abs(qi - q[last, ru, bu, i] - twopi * k)
                                    if d > JUMP:
                                        code = -1
                                        break
                                    step += d
                                    slow = max(slow, d * slowness[i])
                                    code = 3 * code + int(k) + 1
                                if code < 0 or lookup[code] < 0:
                                    continue
                                u = (ru * B + bu) * T + lookup[code]
                                total = (
                                    before[u]
                                    + price_q[s] * step
                                    + price_r[s] * abs(dr)
                                    + price_t * max(slow - seconds[s], 0.0)
                                )
                                if total < value:
                                    value, source = total, u
                    if value < inf:
                        any_here = True
                        now[v] = value + node[s, r, b]
                        back[s, v] = source
        if not exists:
            continue  # dropped: nothing is feasible here
        if not any_here:
            return best, inf, s
        before[:] = now
        last = s
    if last < 0:
        return best, 0.0, -1
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
    return best, value, -1
