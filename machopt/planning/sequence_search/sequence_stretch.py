"""Search of the sequence over a stretch of stations, with and without a cap on the worst index."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from machopt.numerics.array_types import Array, Bools, compute_any_last
from machopt.planning.sampling.candidate_grid import CandidateGrid
from machopt.planning.sequence_search.forbidden_transitions import ForbiddenTransitions
from machopt.planning.sequence_search.joint_turns import compute_shortest_turns, count_whole_turns, fit_turns
from machopt.planning.sequence_search.rapid_move_prices import FlightPrices
from machopt.planning.sequence_search.search_kernels import find_cheapest_sequence
from machopt.planning.sequence_search.sequence_prices import Ints, SequencePrices
from machopt.planning.sequence_search.worst_index_across_swings import compute_worst_index
from machopt.planning.sequence_search.worst_value_constraint import (
    GAP,
    WorstLimitedSequence,
    WorstTradeResult,
    trade_worst_index,
)

NO_LIMIT = 1e300  # a limit above all sequences: with a finite limit, breaks are excluded


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
class SequenceStretch:
    """A stretch of the stations while it is chosen."""

    grid: SequencePrices
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
        flight = FlightPrices.build(g.rapid, len(g.window))
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
            _build_shut_branches(g.candidates),
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
            vertex, value, stop, broken = self._find_turnless(compute_any_last(mask), np.inf)
            turned = None if stop >= 0 or broken.any() else self._resolve_turns(vertex, mask)
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
            vertex, value, stop, _ = self._find_turnless(some & allowed, limit, allowed)
            if stop >= 0:
                return None
            turned = self._resolve_turns(vertex, mask)
            if turned is not None:
                return turned, value
        vertex, value, stop, *_ = self.solve(mask & allowed[..., None], limit, allowed=allowed)
        return None if stop >= 0 else (vertex, value)

    def _find_turnless(self, some: Bools, limit: float, allowed: Bools | None = None) -> tuple[Ints, float, int, Bools]:
        """Return the cheapest sequence over some (S, R, B) as if every turn were feasible, its value, its stop, its
        breaks.
        """
        edges = self.edges.in_every_turn(self.grid.candidates.feasible)
        return self.solve(some[..., None], limit, edges, loose=True, allowed=allowed)[:4]

    def _resolve_turns(self, vertex: Ints, mask: Bools) -> Ints | None:
        """Return the sequence with continuous turns from station to station; None where these do not fit the mask."""
        c, rows = self.grid.candidates, self.rows
        return fit_turns(c, rows, vertex, compute_shortest_turns(c, rows, vertex), mask, self.edges, self._get_home())

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
            turned = fit_turns(c, rows, vertex, turns, c.feasible[rows], self.edges, self._get_home())
            if turned is not None:
                return turned
        return vertex

    def _get_home(self) -> Array | None:
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


def _build_shut_branches(c: CandidateGrid) -> Bools:
    """Return (B, B) the branch pairs without a rapid move between them."""
    return np.zeros((c.q.shape[2],) * 2, bool) if c.shut is None else c.shut[np.ix_(c.branch, c.branch)]
