"""The best sequence over rotation × branch × turn for the whole path at once.

Dynamic programming over the stations. Inside a run a vertex is joined to the vertices of the station before
whose rotation differs by at most a window, in the same branch, with the turn that continuity gives; over a
rapid move anything may follow anything, at the price of the joint travel. The worst index is traded exactly, by branch
and bound over a cap on it (:mod:`machopt.plan.caps`), and what the best sequence of the grid costs at least is told.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from machopt.domain.options import PlanOptions
from machopt.model.compiled import compiled
from machopt.plan.candidates import Candidates
from machopt.plan.caps import Capped, trade
from machopt.plan.path import Path
from machopt.plan.score import AXIS_SPEED, Scores, preference
from machopt.se3 import wrap

Array = NDArray[np.float64]
Ints = NDArray[np.int32]
JUMP = np.radians(40.0)  # largest joint step between neighbouring stations that still counts as continuous
TURNING = 0.5  # share of the slowest axis's velocity limit that rotation about the tool axis may take
MAX_TURN = np.radians(45.0)  # of the rotation between neighbouring stations
NEAR = 0.5  # m: rapid moves shorter than this should not turn the arm over
GROUP = 6  # rotations whose vertices are bounded together where a rapid move comes from any of them
FREE, LIFT = -1, -2


@dataclass(frozen=True)
class Edges:
    """Ways from a station to the next that were looked at and do not work (a contact, or no pose in between)."""

    station: Ints  # (E,) the station they lead into, not falling
    source: Ints  # (E,) vertex at the station before, (rotation · B + branch) · T + turn
    target: Ints  # (E,) vertex at the station

    @classmethod
    def none(cls) -> Edges:
        return cls(*(np.zeros(0, np.int32) for _ in range(3)))

    def plus(self, station: Ints, source: Ints, target: Ints) -> Edges:
        """These and more, each once."""
        rows = np.column_stack(
            [np.r_[self.station, station], np.r_[self.source, source], np.r_[self.target, target]]
        ).astype(np.int32)
        return Edges(*np.ascontiguousarray(np.unique(rows, axis=0).T))

    def __len__(self) -> int:
        return len(self.station)


@dataclass(frozen=True)
class Choice:
    """One vertex per station."""

    rotation: Ints  # (S,) index into candidates.phi, −1 where the station has no feasible vertex
    branch: Ints  # (S,)
    turn: Ints  # (S,)
    q: Array  # (S, 6) rad, NaN where dropped
    broken: tuple[int, ...]  # stations that no continuous way leads to from the station before
    total: float = np.nan  # what the sequence costs, by the prices of the grid
    bound: float = np.nan  # no sequence over the grid costs less
    reached: NDArray[np.bool_] | None = None  # (S, R·B·T) vertices a continuous way leads to from the last break

    @property
    def dropped(self) -> NDArray[np.bool_]:
        return self.rotation < 0


def choose(
    path: Path,
    candidates: Candidates,
    scores: Scores,
    velocity: Array,
    options: PlanOptions,
    edges: Edges | None = None,
    wide: NDArray[np.bool_] | None = None,
) -> Choice:
    """Global choice.

    Stations without a feasible vertex are dropped, and where no continuous way leads on the sequence starts
    afresh (``broken``); whether either is acceptable is the caller's decision. A sequence goes on as far as any does,
    so there are no more breaks than there must be.

    Args:
        velocity: (6,) rad/s, joint velocity limits.
        edges: ways that must not be taken; default none.
        wide: (S,) stations into which the rotation may turn faster than the feed leaves time for; default none.
    """
    edges = Edges.none() if edges is None else edges
    before = np.searchsorted(edges.station, np.arange(len(path.stations) + 1)).astype(np.int64)
    feasible = candidates.feasible
    counted = path.counted[path.stations]
    window, seconds = _windows(path, candidates, float(velocity.min()), wide)
    shift = _same_direction(path, len(candidates.phi))
    node = _node_cost(path, candidates, scores, options)
    share = path.motion_share[path.stations]
    price_q = options.weights.travel / np.pi * share * _swing(path, window)
    price_t = options.weights.feed / max(float(path.time[-1]), 1e-9)
    price_r = options.weights.rotation / np.pi * (2 * np.pi / len(candidates.phi)) * share
    raw = np.where(np.isfinite(scores.cost), scores.cost / scores.scale, np.inf)

    def solve(
        mask: NDArray[np.bool_], limit: float = np.inf
    ) -> tuple[Ints, float, int, NDArray[np.bool_], NDArray[np.bool_]]:
        answer: tuple[Ints, float, int, NDArray[np.bool_], NDArray[np.bool_]] = _sequence(
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
            limit,
            before,
            edges.source,
            edges.target,
        )
        return answer

    vertex, value, _, broken, reached = solve(feasible)
    window[broken] = LIFT  # a cap may add no further break
    kept = vertex[:, 0] >= 0
    at = np.flatnonzero(kept & counted)

    def capped(vertex: Ints, value: float) -> Capped:
        return Capped(vertex, value, float(raw[at, vertex[at, 0], vertex[at, 1]].max(initial=0.0)))

    def under(cap: float, limit: float) -> Capped | None:
        allowed = (raw <= cap) | ~counted[:, None, None]
        vertex, value, stop, *_ = solve(feasible & allowed[..., None], limit)
        return None if stop >= 0 or ((vertex[:, 0] < 0) & kept).any() else capped(vertex, value)

    floor = float(raw[at].min(axis=(1, 2)).max(initial=0.0))
    traded = trade(capped(vertex, value), floor, options.weights.worst, under)
    r, b, t = traded.best.vertex.T
    q = candidates.q[np.arange(len(r)), r, b] + candidates.turns[t]
    q[~kept] = np.nan
    return Choice(
        rotation=r, branch=b, turn=t, q=q, broken=tuple(np.flatnonzero(broken).tolist()), total=traded.total,
        bound=traded.bound, reached=reached,
    )  # fmt: skip


def widest(rotations: int) -> int:
    """Grid steps that the rotation may turn between neighbouring stations at most."""
    return max(1, int(MAX_TURN * rotations / (2 * np.pi) + 1e-6))


def _windows(
    path: Path, candidates: Candidates, slowest: float, wide: NDArray[np.bool_] | None = None
) -> tuple[Ints, Array]:
    """Window of the step into each station, and the time the axes have for it.

    FREE over rapid moves, else grid steps of rotation, 0 keeps it. On dense paths a grid step would take longer than
    the way from station to station, so rotation may only change at ticks, as far apart as a grid step takes. Where
    nothing else leads on (``wide``), it may change from any station to the next, and the feed waits for it.
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
        elif wide is not None and wide[s]:
            out[s] = widest(len(candidates.phi))
        else:
            since += seconds[s]
            if since >= 0.999 * tick:
                out[s] = min(int(since / tick + 1e-3), widest(len(candidates.phi)))
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
    gamma = wrap(candidates.phi_at() + path.offset[path.stations][:, None])
    price = options.weights.mean * np.where(np.isfinite(scores.cost), scores.cost, 0.0) / scores.scale
    return np.ascontiguousarray((price + preference(gamma, options)[:, :, None]) * share[:, None, None])


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
def _sequence(
    node: Any, q: Any, turns: Any, feasible: Any, window: Any, stable: Any, shift: Any, seconds: Any, slowness: Any,
    price_q: Any, price_r: Any, price_t: Any, limit: float, ban: Any, ban_u: Any, ban_v: Any,
) -> Any:  # numba infers  # fmt: skip
    """Cheapest sequence; returns (S, 3) rotation, branch, turn (−1 where dropped), its value, where it stopped, breaks
    (S,) and what is reached (S, V).

    A break is a station inside a run that no vertex of the station before reaches continuously; the sequence goes on
    there as after a rapid move. With a finite ``limit`` only sequences below it are looked for, without breaks, and
    ``stop`` ≥ 0 is where the last of them ends. ``ban[s]`` … ``ban[s + 1]`` are the forbidden edges into s.
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
                            if not (least[ru, bu] + price_r[s] * abs(dr) < highest):
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
                            edge = price_q[s] * step + price_r[s] * abs(dr) + price_t * max(slow - seconds[s], 0.0)
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
