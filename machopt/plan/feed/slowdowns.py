"""Where a run is driven slower than programmed, and which limit of which axis is to blame."""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import Literal

import numpy as np

from machopt.arrays import Array

HELD = 0.95  # of the programmed feed
Limit = Literal["velocity", "acceleration", "jerk"]
LIMITS: tuple[Limit, ...] = ("velocity", "acceleration", "jerk")
Where = Literal["path", "start", "stop", "reversal", "reorientation", "rest"]


@dataclass(frozen=True, kw_only=True)
class Dip:
    """A stretch driven slower than HELD times the programmed feed, and what is to blame."""

    first: float  # fractional point index
    last: float
    ratio: float  # lowest share of the programmed feed
    where: Where  # start, stop: the unavoidable ramps from and to rest; reorientation: the tool turns on the spot
    joint: int  # 1…6, then the external ones
    limit: Limit

    def at(self, ends: Array) -> Dip:
        """The same dip with other indices for its ends."""
        return replace(self, first=float(ends[0]), last=float(ends[1]))


def dips_of(
    ratio: Array,
    at: Array,
    point: Array,
    v: Array,
    slope: Array,
    u: Array,
    single: Array,
    use: Array,
    begin: Where,
    finish: Where,
) -> list[Dip]:
    """Stretches below HELD. Blamed is what bounds the speed lowest there, or in a ramp the limit that is used most."""
    low = np.r_[False, ratio[1:] < HELD, False]
    edge = np.flatnonzero(np.diff(low.astype(int)))
    dips = []
    for first, last in zip(edge[::2], edge[1::2], strict=True):  # samples first … last enclose the slow steps
        where: Where = begin if first == 0 else finish if last == len(ratio) - 1 else "path"
        slowest = first + 1 + int(np.argmin(ratio[first + 1 : last + 1]))
        if where == "path" and slope[slowest] < 0.05:
            where = "reorientation"
        a, b = np.searchsorted(u, at[first]), np.searchsorted(u, at[last], side="right")
        bound = single[a:b]
        joint, limit = np.unravel_index(int(np.argmax(use[first : last + 1].max(axis=0))), use.shape[1:])
        if where in {"path", "reorientation"} and len(bound) and bound.min() < 1.25 * v[slowest]:
            _, joint, limit = np.unravel_index(int(np.argmin(bound)), bound.shape)
        dips.append(
            Dip(
                first=float(point[first]),
                last=float(point[last]),
                ratio=float(ratio[slowest]),
                where=where,
                joint=int(joint) + 1,
                limit=LIMITS[int(limit)],
            )
        )
    return dips
