"""Steps between neighbouring stations, each priced once: a table that every search over the same grid reads.

What a step costs follows from the joints and the prices of the grid alone, not from what is still feasible or allowed.
So the searches under one cap after another, and those after vertices were struck out, find it where the first that
needed it left it.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from machopt.numerics.array_types import Array

MOST = 16_000_000  # steps kept; those into the stations behind are priced each time. Only what is used takes memory


@dataclass(frozen=True)
class TransitionCostTable:
    """The table, flat: of each station its (R, B) vertices, the steps of its window into each, the branches before."""

    start: NDArray[np.int64]  # (S,) where a station's steps begin, −1 where none are kept
    price: Array  # (n,) filled in by the searches, where ``turns`` is not 0
    turns: NDArray[np.int16]  # (n,) 0: not priced yet, −1: leads nowhere, else 1 + the code of its whole turns

    @classmethod
    def none_yet(cls, window: NDArray[np.int32], rotations: int, branches: int, stable: bool) -> TransitionCostTable:
        """An empty one for windows (S,) as in :mod:`machopt.planning.sequence_search.dynamic_programming`."""
        steps = np.where(window >= 0, 2 * window.astype(np.int64) + 1, 0) * (1 if stable else branches)
        end = np.cumsum(steps * rotations * branches)
        kept = (steps > 0) & (end <= MOST)
        n = int(end[kept][-1]) if kept.any() else 0
        start = np.where(kept, end - steps * rotations * branches, -1)
        return cls(start, np.zeros(n), np.zeros(n, np.int16))
