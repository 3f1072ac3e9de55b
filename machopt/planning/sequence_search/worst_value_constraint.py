"""Exact trade of the worst index against the rest of the objective: branch and bound over a cap on it.

Under a cap c on the index the rest of the objective of the cheapest sequence, V(c), decreases with c. Of all sequences
whose worst index lies above a and at or below b none is therefore better than V(b) + w·a. Intervals of caps are
halved, the one with the lowest bound first, until no interval can contain a sequence better than the best one found by
more than GAP.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from heapq import heappop, heappush

import numpy as np
from numpy.typing import NDArray

Ints = NDArray[np.int32]
GAP = 1e-3  # share of the objective at which the search ends
SOLVES = 60  # maximum number of searches; each halves an interval, in practice the gap is closed long before


@dataclass(frozen=True)
class WorstLimitedSequence:
    """The cheapest sequence under one cap."""

    vertex: Ints  # (S, 3) rotation, branch, turn
    value: float  # its objective without the worst index
    worst: float  # its worst index, in units of the scale


@dataclass(frozen=True)
class WorstTradeResult:
    """Result of the search with its lower bound."""

    best: WorstLimitedSequence
    total: float  # value + weight × worst of ``best``
    bound: float  # lower bound of all sequences

    @property
    def gap(self) -> float:
        """Maximum share of the total that a better sequence could save."""
        return max(0.0, (self.total - self.bound) / self.total) if self.total > 0 else 0.0


def trade_worst_index(
    free: WorstLimitedSequence,
    floor: float,
    weight: float,
    solve: Callable[[float, float], WorstLimitedSequence | None],
    gap: float = GAP,
) -> WorstTradeResult:
    """Return the sequence with the least value + weight × worst.

    Args:
        free: the cheapest sequence without a cap.
        floor: lower bound of the worst index of all sequences.
        weight: price of the worst index.
        solve: the cheapest sequence with an index of at most its first argument everywhere; None where there is none
            whose value is below its second.
        gap: share of the total by which a better one may be missed.
    """
    best, total = free, free.value + weight * free.worst
    # sequences worse than ``free`` in the worst index cost more in both terms; left: worst in [floor, free.worst)
    open_: list[tuple[float, float, float, float]] = []  # bound, a, b, V(b)

    def add(a: float, b: float, value: float) -> None:
        if b > a * (1 + 1e-12):
            heappush(open_, (value + weight * a, a, b, value))

    if weight > 0:
        add(floor, free.worst, free.value)
    skipped_bound = np.inf  # lower bound of the sequences skipped by a search with a limit
    for _ in range(SOLVES):
        if not open_ or open_[0][0] >= total * (1 - gap):
            break
        _, a, b, value = heappop(open_)
        middle = 0.5 * (a + b)
        skipped_bound = min(skipped_bound, total * (1 - gap))
        found = solve(middle, total * (1 - gap) - weight * a)  # above this limit it cannot be better by the gap
        add(middle, b, value)
        if found is not None:
            add(a, found.worst, found.value)
            cost = found.value + weight * found.worst
            if cost < total:
                best, total = found, cost
    return WorstTradeResult(best, total, min(total, skipped_bound, open_[0][0] if open_ else np.inf))
