"""Corners between straight rapid moves that the motion rounds instead of stopping there."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from machopt.numerics.array_types import Array


@dataclass(frozen=True, kw_only=True)
class RapidCorners:
    """C rounded corners in order; samples count the rows of the motion from 0."""

    sample: NDArray[np.int64]  # (C,) row that represents the corner
    before: NDArray[np.int64]  # (C,) row of the corner or stop where the move to it begins
    after: NDArray[np.int64]  # (C,) row of the corner or stop where the move from it ends
    q: Array  # (C, 6) rad by encoder, where the straight moves meet
    external: Array  # (C, E) rad or m
    share: Array  # (C, 2) of the moves to and from it, counted from the corner, over which it is rounded

    def __len__(self) -> int:
        return len(self.sample)

    @property
    def x(self) -> Array:
        """(C, 6 + E) rad or m, all joints at the corners."""
        return np.hstack([self.q, self.external])

    def select(self, first: int, stop: int) -> RapidCorners:
        """Return the corners of some rows of the motion, which are then counted from the first of them.

        Args:
            first: first row.
            stop: row behind the last one.
        """
        rows = (self.sample >= first) & (self.sample < stop)
        return RapidCorners(
            sample=self.sample[rows] - first,
            before=self.before[rows] - first,
            after=self.after[rows] - first,
            q=self.q[rows],
            external=self.external[rows],
            share=self.share[rows],
        )


def join_rapid_corners(parts: Sequence[tuple[RapidCorners | None, int]]) -> RapidCorners | None:
    """Return the corners of consecutive motions.

    Args:
        parts: corners of each, and the row of the whole motion that is its first one.

    Returns:
        None where no motion has any.
    """
    found = [(corners, first) for corners, first in parts if corners is not None]
    if not found:
        return None
    return RapidCorners(
        sample=np.concatenate([c.sample + n for c, n in found]),
        before=np.concatenate([c.before + n for c, n in found]),
        after=np.concatenate([c.after + n for c, n in found]),
        q=np.vstack([c.q for c, _ in found]),
        external=np.vstack([c.external for c, _ in found]),
        share=np.vstack([c.share for c, _ in found]),
    )
