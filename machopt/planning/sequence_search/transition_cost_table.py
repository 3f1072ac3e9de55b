"""Table of step prices between neighbouring stations: each step is priced once for all searches over the same grid.

The price of a step depends on the joints and the prices of the grid alone, not on what is still feasible or allowed.
Searches under successive caps, and those after exclusions, therefore read the prices that an earlier search stored.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from machopt.numerics.array_types import Array

MOST = 16_000_000  # maximum number of stored steps; later ones are priced each time. Only used entries take memory


@dataclass(frozen=True)
class TransitionCostTable:
    """Flat table: per station its (R, B) vertices, the steps of its window into each, the previous branches."""

    start: NDArray[np.int64]  # (S,) first entry of a station's steps, −1 where none are stored
    price: Array  # (n,) filled in by the searches, where ``turns`` is not 0
    turns: NDArray[np.int16]  # (n,) 0: not priced yet, −1: leads nowhere, else 1 + the code of its whole turns

    @classmethod
    def none_yet(cls, window: NDArray[np.int32], rotations: int, branches: int, stable: bool) -> TransitionCostTable:
        """Return an empty table.

        Args:
            window: (S,) windows as in :mod:`machopt.planning.sequence_search.dynamic_programming`.
            rotations: number of rotations R.
            branches: number of branches B.
            stable: the branch index is an assembly mode.
        """
        steps = np.where(window >= 0, 2 * window.astype(np.int64) + 1, 0) * (1 if stable else branches)
        end = np.cumsum(steps * rotations * branches)
        is_stored = (steps > 0) & (end <= MOST)
        n = int(end[is_stored][-1]) if is_stored.any() else 0
        start = np.where(is_stored, end - steps * rotations * branches, -1)
        return cls(start, np.zeros(n), np.zeros(n, np.int16))
