"""Cheapest sequence over rotation × branch × turn for the whole path at once.

Dynamic programming over the stations. Inside a run a vertex is joined to the vertices of the previous station
whose rotation differs by at most a window, in the same branch, with the turn that continuity gives. Over a
rapid move any vertex may follow any other, at the price of the joint travel. The worst index is traded exactly, by
branch and bound over a cap on it (:mod:`machopt.planning.sequence_search.worst_value_constraint`). The lower bound of
all sequences is returned too.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from machopt.data_types.plan_options import PlanOptions
from machopt.numerics.array_types import Array, Bools, compute_any_last, make_arrays_read_only
from machopt.planning.cost.objective import ObjectiveTerms
from machopt.planning.cost.rapid_time import RapidPricing
from machopt.planning.cost.stiffness_index import CandidateScores
from machopt.planning.sampling.candidate_grid import CandidateGrid
from machopt.planning.sequence_search.forbidden_transitions import ForbiddenTransitions
from machopt.planning.sequence_search.joint_turns import compute_shortest_turns, count_whole_turns, fit_turns
from machopt.planning.sequence_search.rapid_move_prices import FlightPrices
from machopt.planning.sequence_search.search_kernels import find_cheapest_sequence
from machopt.planning.sequence_search.transition_cost_table import TransitionCostTable
from machopt.planning.sequence_search.transition_windows import (
    LIFT,
    compute_transition_windows,
    match_tcp_directions,
    vertex_price,
)
from machopt.planning.sequence_search.worst_index_across_swings import compute_worst_index, find_hidden_points
from machopt.planning.sequence_search.worst_value_constraint import (
    GAP,
    WorstLimitedSequence,
    WorstTradeResult,
    trade_worst_index,
)
from machopt.planning.stations.planning_path import PlanningPath

Ints = NDArray[np.int32]
_LARGE = 1e300  # a limit above all sequences: with a finite limit, breaks are excluded


@dataclass(frozen=True, kw_only=True)
class SequenceChoice:
    """One vertex per station."""

    rotation: Ints  # (S,) index into candidates.phi, −1 where the station has no feasible vertex
    branch: Ints  # (S,)
    turn: Ints  # (S,)
    q: Array  # (S, 6) rad, NaN where dropped
    broken: tuple[int, ...]  # stations without a continuous edge from the previous station
    total: float = np.nan  # price of the sequence on the grid
    bound: float = np.nan  # lower bound of all sequences over the grid
    reached: NDArray[np.bool_] | None = None  # (S, R·B·T) continuously reachable vertices; None: no break

    def __post_init__(self) -> None:
        make_arrays_read_only(self)

    @property
    def dropped(self) -> NDArray[np.bool_]:
        """(S,) stations without a vertex."""
        return self.rotation < 0


def choose_sequence(
    path: PlanningPath,
    candidates: CandidateGrid,
    scores: CandidateScores,
    velocity: Array,
    options: PlanOptions,
    edges: ForbiddenTransitions | None = None,
    wide: NDArray[np.bool_] | None = None,
) -> SequenceChoice:
    """Return the cheapest sequence of the whole path.

    Stations without a feasible vertex are dropped. Where no continuous edge exists, the sequence starts
    again (``broken``). Whether either is acceptable is the caller's decision. A sequence continues as far as any does,
    so the number of breaks is minimal.

    Args:
        path: planning points.
        candidates: candidate grid.
        scores: cost of the candidates.
        velocity: (6,) rad/s, joint velocity limits.
        options: plan options with the weights.
        edges: forbidden edges; default none.
        wide: (S,) stations into which the rotation may change faster than the feed permits; default none.
    """
    return SequenceGrid.of(path, candidates, scores, velocity, options, wide).choose(edges)


@dataclass(frozen=True, kw_only=True)
class SequenceGrid:
    """Prices and permitted steps of sequences over one grid; a step is numbered by the station it leads into.

    ``candidates`` may lose vertices while it is in use: every choice uses what is feasible at that time.
    """

    candidates: CandidateGrid
    counted: NDArray[np.bool_]  # (S,) the worst index counts there
    window: Ints  # (S,) grid steps that the rotation may change, FREE or LIFT
    seconds: Array  # (S,) s
    shift: Ints  # (S,) :func:`match_tcp_directions`
    node: Array  # (S, R, B) price of a vertex
    raw: Array  # (S, R, B) index, in units of the scale, inf where there is none
    slowness: Array  # (6,) s/rad
    price_q: Array  # (S,) 1/rad
    price_r: Array  # (S,) 1/rad
    price_t: Array  # (S,) 1/s
    nudged: Array  # (S,) rad, shift of its grid relative to that of the previous station
    hidden: Bools  # (S,) further planning points lie between it and the previous station
    worst: float  # price of the worst index
    priced: TransitionCostTable  # prices of steps computed so far
    elsewhere: float = 0.0  # worst index outside this grid, in units of the scale
    rapid: RapidPricing | None = None  # prices of rapid moves beyond their travel; None: there are none

    @classmethod
    def of(
        cls,
        path: PlanningPath,
        candidates: CandidateGrid,
        scores: CandidateScores,
        velocity: Array,
        options: PlanOptions,
        wide: NDArray[np.bool_] | None = None,
    ) -> SequenceGrid:
        """Build the grid of a path.

        Args:
            path: planning points.
            candidates: candidate grid.
            scores: cost of the candidates.
            velocity: (6,) rad/s, joint velocity limits.
            options: plan options with the weights.
            wide: as for :func:`choose_sequence`.
        """
        window, seconds = compute_transition_windows(path, candidates, float(velocity.min()), wide)
        terms, w = ObjectiveTerms.at_stations(path, velocity, options), options.weights
        nudge = np.zeros(len(path.stations)) if candidates.nudge is None else candidates.nudge
        rotations, branches = candidates.feasible.shape[1:3]
        return cls(
            candidates=candidates,
            counted=path.counted[path.stations],
            window=window,
            seconds=seconds,
            shift=match_tcp_directions(path, len(candidates.phi)),
            node=vertex_price(terms, candidates, scores),
            raw=scores.raw,
            slowness=terms.slowness,
            price_q=w.travel * terms.travel,
            price_r=w.rotation * terms.rotation,
            price_t=w.feed * terms.lost,
            nudged=np.diff(nudge, prepend=nudge[:1]),
            hidden=find_hidden_points(path),
            worst=options.weights.worst,
            priced=TransitionCostTable.none_yet(window, rotations, branches, candidates.stable),
            rapid=scores.rapid,
            elsewhere=scores.elsewhere,
        )

    def choose(self, edges: ForbiddenTransitions | None = None) -> SequenceChoice:
        """Return the best sequence of the whole path.

        Args:
            edges: forbidden edges; default none.
        """
        part = _Part(self, ForbiddenTransitions.none() if edges is None else edges, slice(0, len(self.window)))
        free, broken, reached = part.free(self.candidates.feasible)
        part.window[broken] = LIFT  # a cap must not add a break
        traded = part.traded(self.candidates.feasible, free)
        return self._made(
            part.near_zero(traded.best.vertex),
            tuple(np.flatnonzero(broken).tolist()),
            traded.total,
            traded.bound,
            reached,
        )

    def capped(
        self, edges: ForbiddenTransitions
    ) -> tuple[WorstLimitedSequence, float, Callable[[float, float], WorstLimitedSequence | None]] | None:
        """Return the cheapest sequence and the search under caps: :meth:`_Part.capped`. None if the path has breaks or
        gaps.

        Args:
            edges: forbidden edges.
        """
        part = _Part(self, edges, slice(0, len(self.window)))
        free, broken, _ = part.free(self.candidates.feasible)
        if broken.any() or (free.vertex[:, 0] < 0).any():
            return None
        return (free, *part.capped(self.candidates.feasible, free))

    def again(
        self, choice: SequenceChoice, first: int, last: int, edges: ForbiddenTransitions, gap: float = GAP
    ) -> SequenceChoice | None:
        """Return the choice with the stations between ``first`` and ``last`` chosen again, the best that keeps the
        others.

        Args:
            choice: without breaks; the vertices that it keeps are feasible.
            first: station that keeps its vertex, −1 for none before the stretch.
            last: the same behind it; S for none.
            edges: forbidden edges.
            gap: share of the objective by which a better one may be missed.

        Returns:
            None where no continuous sequence keeps the others. ``bound`` is unchanged: removing vertices or edges
            from a grid makes no sequence cheaper.
        """
        S = len(self.window)
        rows = slice(max(first, 0), min(last, S - 1) + 1)
        part = _Part(self, edges, rows)
        old = np.stack([choice.rotation, choice.branch, choice.turn], axis=1)
        mask = self.candidates.feasible[rows]
        if first >= 0 or last < S:  # otherwise there are no other stations
            only = np.zeros_like(mask)
            has_vertex = np.flatnonzero(old[rows, 0] >= 0)
            r, b, t = old[rows][has_vertex].T
            only[has_vertex, r, b, t] = True
            _, before, stop, broken, _ = part.solve(only, _LARGE, ForbiddenTransitions.none())
            mask = mask.copy()
            for end in ([0] if first >= 0 else []) + ([-1] if last < S else []):
                mask[end] = only[end]
            if stop >= 0 or broken.any():
                return None
            part.value_elsewhere = choice.total - self.worst * self._worst(choice) - before
        some = compute_any_last(mask)
        found = part.below(mask, some, some, _LARGE)
        if found is None or ((found[0][:, 0] >= 0) != (old[rows, 0] >= 0)).any():
            return None
        vertex, value = found
        elsewhere = np.ones(S, bool)
        elsewhere[rows] = False
        others = np.where(elsewhere, choice.rotation, -1).astype(np.int32)
        worst_elsewhere = compute_worst_index(self.raw, self.counted, self.hidden, others, choice.branch)
        part.worst_elsewhere = max(worst_elsewhere, self.elsewhere)
        traded = part.traded(mask, WorstLimitedSequence(vertex, value + part.value_elsewhere, part.most(vertex)), gap)
        old[rows] = traded.best.vertex
        return self._made(old, (), traded.total, choice.bound, choice.reached)

    def _worst(self, choice: SequenceChoice) -> float:
        here = compute_worst_index(self.raw, self.counted, self.hidden, choice.rotation, choice.branch)
        return max(here, self.elsewhere)

    def _made(
        self, vertex: Ints, broken: tuple[int, ...], total: float, bound: float, reached: NDArray[np.bool_] | None
    ) -> SequenceChoice:
        r, b, t = vertex.T
        q = self.candidates.q[np.arange(len(r)), r, b] + self.candidates.turns[t]
        q[r < 0] = np.nan
        return SequenceChoice(
            rotation=r, branch=b, turn=t, q=q, broken=broken, total=total, bound=bound, reached=reached
        )


def _find_whole_rows(q: Array) -> tuple[Array, int]:
    """Return contiguous joints and the stride of the rotations in them: a thinned grid is a view of the fine one."""
    whole, rotations = q.base, q.shape[1]
    if q.flags.c_contiguous or whole is None or whole.ndim != q.ndim or not whole.flags.c_contiguous:
        return np.ascontiguousarray(q), 1
    every = whole.shape[1] // rotations
    thinned = whole[:, ::every]
    same = thinned.shape == q.shape and thinned.strides == q.strides and whole.ctypes.data == q.ctypes.data
    return (whole, every) if same else (np.ascontiguousarray(q), 1)


@dataclass
class _Part:
    """A stretch of the stations while it is chosen."""

    grid: SequenceGrid
    edges: ForbiddenTransitions
    rows: slice
    worst_elsewhere: float = 0.0  # in units of the scale
    value_elsewhere: float = 0.0  # of the sequence without its worst index

    def __post_init__(self) -> None:
        self.window = self.grid.window[self.rows].copy()
        self.raw, self.counted = self.grid.raw[self.rows], self.grid.counted[self.rows]
        self.there = compute_any_last(self.grid.candidates.feasible[self.rows])
        self.worst_elsewhere = max(self.worst_elsewhere, self.grid.elsewhere)

    def solve(
        self,
        mask: NDArray[np.bool_],
        limit: float = np.inf,
        edges: ForbiddenTransitions | None = None,
        loose: bool = False,
        allowed: Bools | None = None,
    ) -> tuple[Ints, float, int, NDArray[np.bool_], NDArray[np.bool_]]:
        """Call :func:`machopt.planning.sequence_search.search_kernels.find_cheapest_sequence` for the stretch.

        Args:
            mask: (S, R, B, T) feasible vertices.
            limit: upper limit on the value of the stretch.
            edges: forbidden edges; None: those of the stretch.
            loose: whole turns are free and unlimited, as there.
            allowed: (S, R, B) rotations that may be crossed between stations, where there are hidden points; None: all.
        """
        g, rows = self.grid, self.rows
        edges = self.edges if edges is None else edges
        flight = FlightPrices.of(g.rapid, len(g.window))
        q, every = _find_whole_rows(g.candidates.q)
        stations = np.arange(rows.start, rows.stop + 1)
        before, closed = (np.searchsorted(s, stations).astype(np.int64) for s in (edges.station, edges.closed[:, 0]))
        answer: tuple[Ints, float, int, NDArray[np.bool_], NDArray[np.bool_]] = find_cheapest_sequence(
            g.node[rows],
            q[rows],
            every,
            np.zeros((1, 6)) if loose else g.candidates.turns,
            mask,
            self.window,
            g.candidates.stable,
            g.shift[rows],
            g.seconds[rows],
            g.slowness,
            g.price_q[rows],
            g.price_r[rows],
            g.price_t[rows],
            g.nudged[rows],
            limit,
            before,
            edges.source,
            edges.target,
            closed,
            edges.closed,
            g.hidden[rows],
            self.there if allowed is None else self.there & allowed,
            _shut(g.candidates),
            loose,
            g.priced.start[rows],
            g.priced.price,
            g.priced.turns,
            flight.need,
            flight.external_need[rows],
            flight.prices,
        )
        return answer

    def free(self, mask: Bools) -> tuple[WorstLimitedSequence, Bools, Bools | None]:
        """Return the cheapest sequence without a cap, its breaks (S,), and the reached vertices where it has some, else
        None.

        It is first searched without turns, as in :meth:`below`: with tens of turns that is tens of times faster.

        Args:
            mask: (S, R, B, T) feasible vertices.
        """
        if mask.shape[3] > 1:
            vertex, value, stop, broken = self._turnless(compute_any_last(mask), np.inf)
            turned = None if stop >= 0 or broken.any() else self._turned(vertex, mask)
            if turned is not None:
                return WorstLimitedSequence(turned, value, self.most(turned)), broken, None
        vertex, value, _, broken, reached = self.solve(mask)
        return WorstLimitedSequence(vertex, value, self.most(vertex)), broken, reached

    def below(self, mask: Bools, some: Bools, allowed: Bools, limit: float) -> tuple[Ints, float] | None:
        """Return the cheapest sequence over allowed vertices, and its value; None where none is below ``limit``.

        Whole turns change no price, only the feasibility. The search therefore first assumes that every turn is
        feasible. Where
        the turns of the result are, as is usual, no other sequence is cheaper.

        Args:
            mask: (S, R, B, T) feasible vertices.
            some: (S, R, B) mask.any(axis=3).
            allowed: (S, R, B) vertices that may be used.
            limit: upper limit on the value.
        """
        if mask.shape[3] > 1:
            vertex, value, stop, _ = self._turnless(some & allowed, limit, allowed)
            if stop >= 0:
                return None
            turned = self._turned(vertex, mask)
            if turned is not None:
                return turned, value
        vertex, value, stop, *_ = self.solve(mask & allowed[..., None], limit, allowed=allowed)
        return None if stop >= 0 else (vertex, value)

    def _turnless(self, some: Bools, limit: float, allowed: Bools | None = None) -> tuple[Ints, float, int, Bools]:
        """Return the cheapest sequence over some (S, R, B) as if every turn were feasible, its value, its stop, its
        breaks.
        """
        edges = self.edges.in_every_turn(self.grid.candidates.feasible)
        return self.solve(some[..., None], limit, edges, loose=True, allowed=allowed)[:4]

    def _turned(self, vertex: Ints, mask: Bools) -> Ints | None:
        """Return the sequence with continuous turns from station to station; None where these do not fit the mask."""
        c, rows = self.grid.candidates, self.rows
        return fit_turns(c, rows, vertex, compute_shortest_turns(c, rows, vertex), mask, self.edges, self._home())

    def near_zero(self, vertex: Ints) -> Ints:
        """Return the sequence shifted by whole turns towards home, where possible at the same price.

        Args:
            vertex: (S, 3) rotation, branch and turn.
        """
        c, rows = self.grid.candidates, self.rows
        for turns in (
            compute_shortest_turns(c, rows, vertex),
            count_whole_turns(c.turns)[vertex[:, 2]],
        ):  # where travel has no price, avoid unnecessary turns
            turned = fit_turns(c, rows, vertex, turns, c.feasible[rows], self.edges, self._home())
            if turned is not None:
                return turned
        return vertex

    def _home(self) -> Array | None:
        rapid = self.grid.rapid
        return None if rapid is None else rapid.home[:6]

    def traded(self, mask: NDArray[np.bool_], free: WorstLimitedSequence, gap: float = GAP) -> WorstTradeResult:
        """Return the best sequence under caps on the worst index, starting from the best without one.

        Args:
            mask: (S, R, B, T) feasible vertices.
            free: cheapest sequence without a cap.
            gap: share of the objective by which a better one may be missed.
        """
        floor, under = self.capped(mask, free)
        return trade_worst_index(free, floor, self.grid.worst, under, gap)

    def capped(
        self, mask: NDArray[np.bool_], free: WorstLimitedSequence
    ) -> tuple[float, Callable[[float, float], WorstLimitedSequence | None]]:
        """Return the lowest feasible cap, and a function for the cheapest sequence under a cap, as
        :func:`trade_worst_index`
        needs it.

        Args:
            mask: (S, R, B, T) feasible vertices.
            free: cheapest sequence without a cap.
        """
        has_vertex = free.vertex[:, 0] >= 0
        at = np.flatnonzero(has_vertex & self.counted)
        some = compute_any_last(mask)

        def under(cap: float, limit: float) -> WorstLimitedSequence | None:
            if cap < self.worst_elsewhere:
                return None
            allowed = (self.raw <= cap) | ~self.counted[:, None, None]
            found = self.below(mask, some, allowed, limit - self.value_elsewhere)
            if found is None or ((found[0][:, 0] < 0) & has_vertex).any():
                return None
            vertex, value = found
            return WorstLimitedSequence(vertex, value + self.value_elsewhere, self.most(vertex))

        return max(float(self.raw[at].min(axis=(1, 2)).max(initial=0.0)), self.worst_elsewhere), under

    def most(self, vertex: Ints) -> float:
        """Return the worst index of a sequence, here or elsewhere.

        Args:
            vertex: (S, 3) rotation, branch and turn.
        """
        here = compute_worst_index(self.raw, self.counted, self.grid.hidden[self.rows], vertex[:, 0], vertex[:, 1])
        return max(here, self.worst_elsewhere)


def _shut(c: CandidateGrid) -> Bools:
    """Return (B, B) the branch pairs without a rapid move between them."""
    return np.zeros((c.q.shape[2],) * 2, bool) if c.shut is None else c.shut[np.ix_(c.branch, c.branch)]
