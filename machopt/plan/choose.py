"""The best sequence over rotation × branch × turn for the whole path at once.

Dynamic programming over the stations. Inside a run a vertex is joined to the vertices of the station before
whose rotation differs by at most a window, in the same branch, with the turn that continuity gives; over a
rapid move anything may follow anything, at the price of the joint travel. The worst index is traded exactly, by branch
and bound over a cap on it (:mod:`machopt.plan.caps`), and what the best sequence of the grid costs at least is told.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from machopt.domain.options import PlanOptions
from machopt.plan.candidates import Candidates
from machopt.plan.caps import Capped, trade
from machopt.plan.objective import Terms, node_price, preference
from machopt.plan.path import Path
from machopt.plan.score import Scores
from machopt.plan.sequence import cheapest_sequence
from machopt.se3 import wrap

Array = NDArray[np.float64]
Ints = NDArray[np.int32]
TURNING = 0.5  # share of the slowest axis's velocity limit that rotation about the tool axis may take
MAX_TURN = np.radians(45.0)  # of the rotation between neighbouring stations
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
    terms, w = Terms.at_stations(path, velocity, options), options.weights
    node = _node_price(terms, candidates, scores)
    nudge = np.zeros(len(path.stations)) if candidates.nudge is None else candidates.nudge
    raw = np.where(np.isfinite(scores.cost), scores.cost / scores.scale, np.inf)

    def solve(
        mask: NDArray[np.bool_], limit: float = np.inf
    ) -> tuple[Ints, float, int, NDArray[np.bool_], NDArray[np.bool_]]:
        answer: tuple[Ints, float, int, NDArray[np.bool_], NDArray[np.bool_]] = cheapest_sequence(
            node,
            candidates.q,
            candidates.turns,
            mask,
            window,
            candidates.stable,
            shift,
            seconds,
            terms.slowness,
            w.travel * terms.travel,
            w.rotation * terms.rotation,
            w.feed * terms.lost,
            np.diff(nudge, prepend=nudge[:1]),
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


def _node_price(terms: Terms, candidates: Candidates, scores: Scores) -> Array:
    """(S, R, B) price of a vertex: its share of the mean index, and the preferred rotation."""
    cost = np.where(np.isfinite(scores.cost), scores.cost, 0.0) / scores.scale
    gamma = np.asarray(wrap(candidates.phi_at() + terms.offset[:, None]))
    liked = preference(gamma, terms.options)[:, :, None]
    return np.ascontiguousarray(node_price(cost, liked, terms.weights.mean) * terms.share[:, None, None])
