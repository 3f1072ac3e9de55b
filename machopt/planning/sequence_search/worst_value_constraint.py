"""The worst index traded exactly against the rest of the objective: branch and bound over a cap on it.

Under a cap c on the index the rest of the objective of the cheapest sequence, V(c), falls as c rises. Of all sequences
whose worst index lies above a and at or below b none is therefore better than V(b) + w·a. Intervals of caps are
halved, the one with the lowest bound first, until no interval can hold a sequence better than the best one found by
more than GAP.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from heapq import heappop, heappush

import numpy as np
from numpy.typing import NDArray

Ints = NDArray[np.int32]
GAP = 1e-3  # of the objective, at which the search ends
SOLVES = 60  # at most; each halves an interval, so that the gap is closed long before in all that was seen


@dataclass(frozen=True)
class WorstLimitedSequence:
    """The cheapest sequence under one cap."""

    vertex: Ints  # (S, 3) rotation, branch, turn
    value: float  # its objective without the worst index
    worst: float  # its worst index, in units of the scale


@dataclass(frozen=True)
class WorstTradeResult:
    """What the search found, and how sure that is the best."""

    best: WorstLimitedSequence
    total: float  # value + weight × worst of ``best``
    bound: float  # no sequence has less

    @property
    def gap(self) -> float:
        """How much of the total a better sequence could save at most."""
        return max(0.0, (self.total - self.bound) / self.total) if self.total > 0 else 0.0


def trade_worst_index(
    free: WorstLimitedSequence,
    floor: float,
    weight: float,
    solve: Callable[[float, float], WorstLimitedSequence | None],
    gap: float = GAP,
) -> WorstTradeResult:
    """The sequence with the least value + weight × worst.

    Args:
        free: the cheapest sequence without a cap.
        floor: no sequence has a worst index below this.
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
    left = np.inf  # what a sequence costs at least that a search with a limit passed over
    for _ in range(SOLVES):
        if not open_ or open_[0][0] >= total * (1 - gap):
            break
        _, a, b, value = heappop(open_)
        middle = 0.5 * (a + b)
        left = min(left, total * (1 - gap))
        found = solve(middle, total * (1 - gap) - weight * a)  # with more it cannot be better by the gap
        add(middle, b, value)
        if found is not None:
            add(a, found.worst, found.value)
            cost = found.value + weight * found.worst
            if cost < total:
                best, total = found, cost
    return WorstTradeResult(best, total, min(total, left, open_[0][0] if open_ else np.inf))
