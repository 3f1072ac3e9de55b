"""Stretches of a run that are slower than programmed, with the limiting axis and limit."""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import Literal

import numpy as np

from machopt.data_types.slow_moves import RAMPS
from machopt.numerics.array_types import Array

HELD = 0.95  # share of the programmed feed that counts as kept
ON_THE_SPOT = 0.05  # m of the TCP per m of path parameter: below it the tool turns rather than travels
Limit = Literal["velocity", "acceleration", "jerk"]
LIMITS: tuple[Limit, ...] = ("velocity", "acceleration", "jerk")
Where = Literal["path", "start", "stop", "reversal", "reorientation", "rest"]


@dataclass(frozen=True, kw_only=True)
class FeedSlowdown:
    """A stretch driven slower than HELD times the programmed feed, with the limiting axis."""

    first: float  # fractional point index
    last: float
    ratio: float  # lowest share of the programmed feed
    where: Where  # one of RAMPS: from or to a stop that the path demands; reorientation: the tool turns on the spot
    joint: int  # 1…6, then the external ones
    limit: Limit

    @property
    def lost(self) -> bool:
        """Whether the axes cannot keep the feed; False: the ramp leads from or to a stop that the path requires."""
        return self.where not in RAMPS

    def at(self, ends: Array) -> FeedSlowdown:
        """Return the same slowdown with other indices for its ends.

        Args:
            ends: (2,) first and last index.
        """
        return replace(self, first=float(ends[0]), last=float(ends[1]))


@dataclass(frozen=True, kw_only=True)
class NodeBounds:
    """Speed bounds at the M nodes of a curve, for J axes."""

    u: Array  # (M,) rising
    single: Array  # (M, J, 3) largest du/dt that each axis allows by velocity, acceleration and jerk alone
    programmed: Array  # (M,) du/dt of the programmed feed; NaN where the tool turns on the spot


@dataclass(frozen=True, kw_only=True)
class SampledSpeeds:
    """Speed and use of the limits at the S samples of a curve, for J axes."""

    ratio: Array  # (S,) share of the programmed feed of the step that ends at each sample; the first is NaN
    u: Array  # (S,) m, path parameter
    point: Array  # (S,) fractional point index
    speed: Array  # (S,) m/s, du/dt
    slope: Array  # (S,) m of the TCP per m of path parameter
    use: Array  # (S, J, 3) use of the limits of velocity, acceleration and jerk of each axis


def find_slowdowns(samples: SampledSpeeds, nodes: NodeBounds, begin: Where, finish: Where) -> list[FeedSlowdown]:
    """Return the stretches below HELD, each with the bound that is lowest there, or in a ramp the limit that is used
    most.

    Part of a ramp that the axes could not drive at the feed even at constant speed follows as a slowdown of the path.

    Args:
        samples: speed and use of the limits at the samples.
        nodes: speed bounds at the nodes.
        begin: kind of the first ramp.
        finish: kind of the last ramp.
    """
    ratio, at, point, use = samples.ratio, samples.u, samples.point, samples.use
    low = np.r_[False, ratio[1:] < HELD, False]
    edge = np.flatnonzero(np.diff(low.astype(int)))
    dips = []
    for first, last in zip(edge[::2], edge[1::2], strict=True):  # samples first … last enclose the slow steps
        where: Where = begin if first == 0 else finish if last == len(ratio) - 1 else "path"
        slowest = first + 1 + int(np.argmin(ratio[first + 1 : last + 1]))
        if where == "path" and samples.slope[slowest] < ON_THE_SPOT:
            where = "reorientation"
        a, b = np.searchsorted(nodes.u, at[first]), np.searchsorted(nodes.u, at[last], side="right")
        bound = nodes.single[a:b]
        joint, limit = np.unravel_index(int(np.argmax(use[first : last + 1].max(axis=0))), use.shape[1:])
        if where in {"path", "reorientation"} and len(bound) and bound.min() < 1.25 * samples.speed[slowest]:
            _, joint, limit = np.unravel_index(int(np.argmin(bound)), bound.shape)
        dips.append(
            FeedSlowdown(
                first=float(point[first]),
                last=float(point[last]),
                ratio=float(ratio[slowest]),
                where=where,
                joint=int(joint) + 1,
                limit=LIMITS[int(limit)],
            )
        )
        if not dips[-1].lost and len(bound):
            dips += _unheld(bound, nodes.programmed[a:b], np.interp(nodes.u[a:b], at, point))
    return dips


def _unheld(bound: Array, programmed: Array, point: Array) -> list[FeedSlowdown]:
    """Return the slowdown of nodes where an axis allows less than HELD of the feed, regardless of stops; empty if none.

    Args:
        bound: (M, J, 3) largest du/dt by each limit of each axis alone.
        programmed: (M,) du/dt of the feed, NaN where it is undefined.
        point: (M,) fractional point index.
    """
    allowed = bound.min(axis=(1, 2)) / programmed
    slow = np.flatnonzero(allowed < HELD)
    if not len(slow):
        return []
    worst = int(slow[np.argmin(allowed[slow])])
    joint, limit = np.unravel_index(int(np.argmin(bound[worst])), bound.shape[1:])
    return [
        FeedSlowdown(
            first=float(point[slow[0]]),
            last=float(point[slow[-1]]),
            ratio=float(allowed[worst]),
            where="path",
            joint=int(joint) + 1,
            limit=LIMITS[int(limit)],
        )
    ]
