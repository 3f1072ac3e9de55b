"""Sequences over values of external joints, rotations and branches, and the cheapest of them.

:mod:`machopt.planning.external_axis_optimization.external_axis_bound` builds them;
:mod:`~machopt.planning.external_axis_optimization.value_grid_search_kernels` searches them.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from machopt.numerics.array_types import Array, Bools
from machopt.planning.external_axis_optimization.value_grid_search_kernels import (
    compute_reach_costs,
    trace_cheapest_sequence,
)
from machopt.planning.sequence_search.worst_value_constraint import GAP, WorstLimitedSequence, trade_worst_index

LIMITS = 0.0, 0.02, 0.15, 1.0  # shares of the way from the lower bound to a known sequence, tried as limits in turn
SLACK = 1e-12  # of a limit, rounding tolerance between forward and backward sums


@dataclass(frozen=True, kw_only=True)
class ValueGridSequences:
    """Vertices over values, rotations and branches, and the prices of sequences through them."""

    node: Array  # (S, V) price of the vertices without the worst index, infinite where there is none
    raw: Array  # (S, V) index in units of c₀ where it counts, 0 elsewhere
    q: Array  # (S, V, 6) rad, smallest joint angles inside the limits, up to whole turns
    more: NDArray[np.int8]  # (S, V, 6) further whole turns inside the limits
    e: Array  # (S, G, E) lengths in equivalent rad
    phi: Array  # (S, R) rad
    held: NDArray[np.int64]  # (S, G) number of the position of the joints that keep one value
    branches: int
    stable: bool
    kind: Bools  # (S, 3) as in ``value_grid_search_kernels.compute_reach_costs``
    priced: Array  # (S, 4) likewise
    slowness: Array  # (6 + E,) s/rad
    worst: float  # price of the worst index
    turns: int = 1  # number of copies of the vertices, one per set of whole turns; ``G`` includes them

    def best(
        self, gap: float = GAP, onward: Array | None = None, known: float = np.inf
    ) -> tuple[float, float, NDArray[np.int64]] | None:
        """Return J of the best sequence, a lower bound of all, and the vertices (S,) of the best; None where there is
        none.

        Args:
            gap: share of J by which a better one may be missed.
            onward: result of :meth:`onward` with the same ``known``; it may be from before vertices were excluded.
            known: J of a sequence that is one of them.
        """
        ahead = self.onward() if onward is None else onward
        if not np.isfinite(ahead[0].min()):
            return None if onward is None else self.best(gap)
        low = float(ahead[0].min())
        high = max(low, known - self.worst * self.floor()) if onward is not None and np.isfinite(known) else low
        # Where vertices were excluded since, ``low`` is a lower bound only. A search with a lower limit is far faster.
        limits = [(low + share * (high - low)) * (1.0 + SLACK) for share in (LIMITS if high > low else LIMITS[:1])]
        free = next(
            (one for one in (self._find_capped_sequence(self.node, ahead, most) for most in limits) if one is not None),
            None,
        )
        if free is None and onward is None:
            raise AssertionError("the cheapest sequence is within its own price")
        if free is None:
            return self.best(gap)

        def under(cap: float, most: float) -> WorstLimitedSequence | None:
            return self._find_capped_sequence(np.where(self.raw <= cap, self.node, np.inf), ahead, most)

        found = trade_worst_index(free, self.floor(), self.worst, under, gap)
        return found.total, min(found.bound, found.total), found.best.vertex.astype(np.int64)

    def floor(self) -> float:
        """Return the lower bound of the worst index of all sequences."""
        return float(np.where(np.isfinite(self.node), self.raw, np.inf).min(axis=1).max())

    def through(self, onward: Array, known: float) -> Array:
        """Return the (S, V) lower bound of a sequence through each vertex; infinite where that is more than ``known``.

        Args:
            onward: (S, V) result of :meth:`onward`.
            known: J of a known sequence.
        """
        floor = self.floor()
        reached = self._reach(self.node, self.kind, self.priced, onward, known - self.worst * floor)
        with np.errstate(invalid="ignore"):
            total = reached + onward - self.node + self.worst * np.maximum(self.raw, floor)
        return np.asarray(np.where(total <= known, total, np.inf))

    def onward(self, known: float = np.inf) -> Array:
        """Return the (S, V) price from each vertex to the end, its own price included.

        It is infinite where no sequence of at most J ``known`` continues.

        Args:
            known: J of a known sequence.
        """
        after = np.r_[0, np.arange(len(self.node) - 1, 0, -1)]  # the step into a station of the reversed path
        node = np.ascontiguousarray(self.node[::-1])
        before = np.r_[0.0, np.cumsum(self.node.min(axis=1))[:-1]][::-1, None] + node  # lower bound, with its own price
        limit = known if np.isinf(known) else (known - self.worst * self.floor()) * (1.0 + SLACK)
        back = self._reach(node, self.kind[after], self.priced[after], before, limit, reverse=True)
        return np.ascontiguousarray(back[::-1])

    def _find_capped_sequence(self, node: Array, onward: Array, limit: float) -> WorstLimitedSequence | None:
        """Return the cheapest sequence over the finite vertices of ``node`` (S, V); None where none is below the
        limit.
        """
        reached = self._reach(node, self.kind, self.priced, onward, limit)
        value = float(reached[-1].min())
        if not np.isfinite(value):
            return None
        along = self.q, self.more, self.e, self.phi, self.held, self.branches, self.stable, self.kind, self.priced
        vertex = trace_cheapest_sequence(reached, *along, self.slowness, self.turns)
        return WorstLimitedSequence(
            vertex.astype(np.int32), value, float(self.raw[np.arange(len(vertex)), vertex].max())
        )

    def _reach(
        self, node: Array, kind: Bools, priced: Array, onward: Array, limit: float, reverse: bool = False
    ) -> Array:
        q, more, e, phi, position_number = self.q, self.more, self.e, self.phi, self.held
        if reverse:
            q, e, phi = (np.ascontiguousarray(a[::-1]) for a in (q, e, phi))
            more, position_number = np.ascontiguousarray(more[::-1]), np.ascontiguousarray(position_number[::-1])
        found: Array = compute_reach_costs(
            node,
            q,
            more,
            e,
            phi,
            position_number,
            self.branches,
            self.stable,
            kind,
            priced,
            self.slowness,
            self.turns,
            onward,
            limit,
        )
        return found
