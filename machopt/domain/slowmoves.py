"""Moves that are driven slower than programmed, and what the row of points.csv that they end in says of it.

Written by the planner, and held by the verification against the dips of result.json: both ask this.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

RAMPS = ("start", "stop", "rest")  # no plan is without them
ON_POINT = 1e-9  # of the index


@dataclass(frozen=True, kw_only=True)
class Slow:
    """A stretch of the toolpath below its feed."""

    first: float  # fractional toolpath index
    last: float
    ratio: float  # lowest share of the programmed feed
    where: str  # as :data:`machopt.plan.feed.slowdowns.Where`
    axis: int  # 1…6, then the external ones
    limit: str  # velocity, acceleration or jerk

    @property
    def words(self) -> str:
        axis = f"joint {self.axis}" if self.axis <= 6 else f"e{self.axis - 6}"
        turns = " (the tool turns on the spot)" if self.where == "reorientation" else ""
        return (
            f"feed not held: down to {100 * self.ratio:.0f} % of the programmed one between points {self.first:.2f} "
            f"and {self.last:.2f}, by {self.limit} of {axis}{turns}"
        )

    def ends(self, count: int) -> range:
        """Points at which the moves end that it lies on, of ``count`` points."""
        begin = int(np.floor(self.first + ON_POINT)) + 1
        return range(begin, min(max(int(np.ceil(self.last - ON_POINT)), begin), count - 1) + 1)


def said_at(stretches: Sequence[Slow], count: int) -> dict[int, str]:
    """Point → what is said of the move that ends there: of the stretches that no ramp is, the deepest one."""
    out: dict[int, str] = {}
    for one in sorted((s for s in stretches if s.where not in RAMPS), key=lambda s: s.ratio):
        for k in one.ends(count):
            out.setdefault(k, one.words)
    return out
