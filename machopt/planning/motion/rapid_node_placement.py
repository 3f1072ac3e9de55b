"""Points of the file that straight rapid moves pass within ``rapid_blend_mm``, without a corner there.

Where the straight move between the corners before and behind a point comes near enough to it, the target for that point
is the place of the move nearest to it. The move is straight then, and faster than with a rounded corner. A corner of a
chain is rounded over half of the way to its neighbour at most, also where that is a part of a straight move with a
passed point on it.
"""

from __future__ import annotations

import itertools
from collections.abc import Callable
from dataclasses import dataclass, replace

import numpy as np

from machopt.numerics.array_types import Array, Bools
from machopt.planning.motion.corner_timing import measure_fastest_time

HALF = 0.5  # of a move, at most, is rounded at either end: no controller begins before
PASSED = 0.995  # of the deviation
PLACES = 65  # of a straight move, that are compared with the points
ENDS = 0.02  # share of a straight move at either end where no passed point may lie
STILL = 1e-6  # rad or m, a move that is none
LEAST_GAIN = 2e-3  # of the time
SWEEPS = 2


@dataclass(frozen=True, kw_only=True)
class NodePlacement:
    """The K + 1 nodes of a chain, as they are driven."""

    nodes: Array  # (K + 1, n) rad or m, by encoder
    passed: Bools  # (K + 1,) nodes on the straight move between their neighbours that are not
    share: Array  # (K + 1,) of that move, of passed nodes; NaN

    @classmethod
    def build(cls, nodes: Array) -> NodePlacement:
        """Return the nodes where the file has them.

        Args:
            nodes: (K + 1, n) rad or m.
        """
        return cls(nodes=nodes, passed=np.zeros(len(nodes), bool), share=np.full(len(nodes), np.nan))

    @property
    def kept(self) -> list[int]:
        """Nodes at which straight moves begin and end."""
        return np.flatnonzero(~self.passed).tolist()

    def limit_shares(self, most: Array) -> Array:
        """Return the largest shares of the kept inner nodes, of the straight moves between kept nodes.

        Args:
            most: (K − 1,) largest share of all inner nodes, of the moves between nodes; 0: a stop.
        """
        out = []
        for before, here, after in zip(self.kept, self.kept[1:], self.kept[2:], strict=False):
            last = 1.0 - float(self.share[here - 1]) if here - 1 > before else 1.0
            first = float(self.share[here + 1]) if here + 1 < after else 1.0
            out.append(most[here - 1] * min(last, first, 1.0))
        return np.array(out)


@dataclass(frozen=True)
class PassingReach:
    """How near, and by what a move, a point has to be passed."""

    deviation: float  # m by which the tool may pass a node
    least: float  # s, least time of a move from rest to rest for each of the parts that passed nodes make of it
    compute_place: Callable[[Array], Array]  # (S, n) joints → (S, 3) m, the tool in the workpiece


def place_nodes(nodes: Array, movable: Bools, most: Array, limits: Array, reach: PassingReach) -> NodePlacement:
    """Return the nodes of a chain; those are passed where that is faster.

    Args:
        nodes: (K + 1, n) rad or m, by encoder.
        movable: (K + 1,) nodes that may be passed; never the first and the last one.
        most: (K − 1,) largest share at each inner node; 0: a stop.
        limits: (3, n) speed, acceleration and jerk.
        reach: how near a node is passed.
    """
    out = NodePlacement.build(nodes)
    if not movable.any():
        return out
    points = reach.compute_place(nodes)
    time = _measure(out, most, limits)
    for _ in range(SWEEPS):
        before = time
        for k in np.flatnonzero(movable & ~out.passed).tolist():
            trial = _pass_node(out, k, points, limits, reach)
            taken = np.inf if trial is None else _measure(trial, most, limits)
            if trial is not None and taken < (1.0 - LEAST_GAIN) * time:
                out, time = trial, taken
        if time == before:
            break
    return out


def _measure(placement: NodePlacement, most: Array, limits: Array) -> float:
    """Return the time in s of the whole chain."""
    shares, steps = placement.limit_shares(most), np.diff(placement.nodes[placement.kept], axis=0)
    stops = [0, *(n + 1 for n in np.flatnonzero(shares <= 0.0).tolist()), len(steps)]
    return sum(measure_fastest_time(steps[a:b], limits, True, shares[a : b - 1]) for a, b in itertools.pairwise(stops))


def _pass_node(
    placement: NodePlacement, k: int, points: Array, limits: Array, reach: PassingReach
) -> NodePlacement | None:
    """Return the placement with one more node passed; None where the straight move is too far from a point."""
    passed = placement.passed.copy()
    passed[k] = True
    first, last = (next(n for n in range(k + s, -1 if s < 0 else len(passed), s) if not passed[n]) for s in (-1, 1))
    nodes, share = placement.nodes.copy(), placement.share.copy()
    way = nodes[last] - nodes[first]
    if not np.abs(way).max() > STILL or measure_fastest_time(way[None], limits, False) < (last - first) * reach.least:
        return None
    along = np.linspace(ENDS, 1.0 - ENDS, PLACES)
    rows = nodes[first] + along[:, None] * way
    place, floor = reach.compute_place(rows), 0
    for n in range(first + 1, last):
        away = np.linalg.norm(place - points[n], axis=1)
        away[:floor] = np.inf
        best = int(np.argmin(away))
        if not away[best] <= PASSED * reach.deviation:
            return None
        nodes[n], share[n], floor = rows[best], along[best], best + 2
    return replace(placement, nodes=nodes, passed=passed, share=share)
