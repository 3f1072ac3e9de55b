"""Moves that are driven slower than programmed, and the message of points.csv at the points where they end.

The planner writes these messages, and the verification compares them with the feed dips of result.json.

A stop that the path itself demands is no feed dip: at both ends of a run, at a dwell or stop of the file, and where
the path turns back by more than ``TURN_BACK``. The ramps from and to such a stop are listed separately
(``feed_stops`` of result.json) and give no reason in points.csv. A part of a ramp that the axes could not drive at
the programmed feed even without the stop is a separate dip.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from machopt.numerics.array_types import Array

RAMPS = ("start", "stop", "reversal", "rest")  # from and to stops that the path demands
TURN_BACK = float(np.radians(120.0))  # a corner that turns the path by more is stopped in
ARM = 0.1  # m per rad: what a turn of the tool axis counts as path length
NEAR = 2e-6  # m: points nearer than this are one place
ON_POINT = 1e-9  # of the index


@dataclass(frozen=True, kw_only=True)
class SlowStretch:
    """A stretch of the toolpath below its feed."""

    first: float  # fractional toolpath index
    last: float  # fractional toolpath index
    ratio: float  # lowest share of the programmed feed
    where: str  # as :data:`machopt.planning.retiming.slowdowns.Where`
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
        """Return the points at which the stretch's moves end.

        Args:
            count: Number of toolpath points.
        """
        begin = int(np.floor(self.first + ON_POINT)) + 1
        return range(begin, min(max(int(np.ceil(self.last - ON_POINT)), begin), count - 1) + 1)


def is_turn_back(position: Array, axis: Array, point: int, least: float = TURN_BACK) -> bool:
    """True where the path turns back at a point; position and tool axis count, the chosen rotation does not.

    Args:
        position: (N, 3) m.
        axis: (N, 3) unit.
        point: index of the point.
        least: rad, smallest turn that counts.
    """

    def steps(way: range) -> Array | None:
        for k in way:
            step = np.concatenate([position[k] - position[point], ARM * (axis[k] - axis[point])])
            if np.linalg.norm(step) >= NEAR:
                return step
        return None

    before, after = steps(range(point - 1, -1, -1)), steps(range(point + 1, len(position)))
    if before is None or after is None:
        return False
    return bool(-before @ after < np.cos(least) * np.linalg.norm(before) * np.linalg.norm(after))


def describe_slow_points(stretches: Sequence[SlowStretch], count: int) -> dict[int, str]:
    """Return the message of each point whose move is slow, of the deepest stretch that is no ramp.

    Args:
        stretches: Stretches below the programmed feed.
        count: Number of toolpath points.

    Returns:
        Point → message.
    """
    out: dict[int, str] = {}
    for one in sorted((s for s in stretches if s.where not in RAMPS), key=lambda s: s.ratio):
        for k in one.ends(count):
            out.setdefault(k, one.words)
    return out
