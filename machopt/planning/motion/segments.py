"""Stretches of the motion from rest to rest, and where the file makes the machine stand between two of them.

A dwell of the file stands just before the move to a point (:class:`machopt.data_types.toolpath.ToolpathEvent`), so the
machine
comes to rest at the point before, and the motion has that many rows more there; at a stop it comes to rest only, as how
long it stands there is the operator's matter.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from machopt.data_types.toolpath import MoveKind, Toolpath
from machopt.errors import InputError
from machopt.numerics.array_types import Array
from machopt.planning.stations.planning_path import PlanningPath

BEND = np.radians(0.1)  # rotation that a straight move between two toolpath points may miss before a point is added
BOW = 2e-6  # m, the same of a shifted path; unshifted it is straight between toolpath points to rounding
LONGEST = 600.0  # s: what waits longer is no dwell, and a row a sample would make gigabytes of it
BEFORE_ALL = -1  # where a dwell ahead of the first point stands: before the motion begins


@dataclass(frozen=True, kw_only=True)
class MotionSegment:
    """A stretch of the motion from rest to rest."""

    name: str  # "rapid", "run", "lift"
    q: Array  # (S, 6) rad by encoder
    index: Array  # (S,) fractional toolpath index, NaN from and to home
    move: NDArray[np.int8]  # (S,)
    operation: NDArray[np.int32]  # (S,)
    gamma: Array  # (S,) rad, NaN in rapid moves
    waypoints: Array  # (W, 6) rad by encoder, targets in order, without the start
    waypoint_index: Array  # (W,) fractional toolpath index
    waypoint_feed: Array  # (W,) m/s of the straight move that ends there, NaN in rapid moves
    external: Array  # (S, E) m or rad
    waypoint_external: Array  # (W, E)

    def standing(self, row: int, count: int) -> MotionSegment:
        """The leg with its row there ``count`` times more: so many samples the machine stands."""
        if not count:
            return self
        times = np.ones(len(self.q), int)
        times[row] += count
        return replace(
            self,
            q=np.repeat(self.q, times, axis=0),
            index=np.repeat(self.index, times),
            move=np.repeat(self.move, times),
            operation=np.repeat(self.operation, times),
            gamma=np.repeat(self.gamma, times),
            external=np.repeat(self.external, times, axis=0),
        )


def count_rest_samples(toolpath: Toolpath, sample: float) -> dict[int, int]:
    """Samples that the machine stands at each toolpath point where it comes to rest for a dwell or a stop.

    Args:
        toolpath: with its events; point ``BEFORE_ALL`` is where the motion begins.
        sample: s.

    Raises:
        InputError: a dwell is too long to be told row by row.
    """
    seconds: dict[int, float] = {}
    for event in toolpath.events:
        if event.kind not in ("dwell", "stop"):
            continue
        point = min(event.index, len(toolpath)) - 1
        known = event.kind == "dwell" and event.value > 0.0  # NaN: the file gives turns of the spindle, or nothing
        if known and event.value > LONGEST:
            raise InputError(
                f"{event.text!r} waits {event.value:g} s; the longest dwell is {LONGEST:g} s; a program stop (M0) in "
                "its place would work, or a unit for the number where it is meant in ms",
                file=toolpath.source,
                where=f"before point {event.index}",
            )
        seconds[point] = seconds.get(point, 0.0) + (event.value if known else 0.0)
    return {point: math.ceil(time / sample - 1e-9) for point, time in seconds.items()}


def label_cut_samples(
    move: NDArray[np.int8], local: Array, index: Array, rows: NDArray[np.int32], path: PlanningPath
) -> NDArray[np.int8]:
    """(S,) moves of the samples, so that each cut point lies between two samples of a cut, or near one.

    Where points are denser than samples, the last points of a cut lie before a sample that already belongs to the
    retract (and the first ones behind a sample of the approach); such samples count to the cut they complete.
    """
    out = move.copy()
    place = np.interp(local, np.arange(len(rows)), index)
    points = 1 + np.flatnonzero((path.move[rows] == MoveKind.CUT)[1:] & path.is_point[rows][1:])
    after = np.clip(np.searchsorted(local, points - 1e-9), 1, len(local) - 1) if len(local) > 1 else points[:0]
    pair = after[:, None] + np.array([-1, 0])  # the samples before and behind each
    near = (np.abs(place[pair] - index[points[: len(after)], None]) <= 0.5) & (move[pair] == MoveKind.CUT)
    out[pair[~near.any(axis=1)]] = MoveKind.CUT
    return out


def select_program_points(phi: Array, is_point: NDArray[np.bool_], index: Array, position: Array) -> NDArray[np.bool_]:
    """(n,) planning points a program needs: toolpath points, and those where rotation or path leave the straight line.

    The path does so only where it is shifted against a deflection that changes along it.
    """
    keep = is_point.copy()
    keep[[0, -1]] = True
    at = np.flatnonzero(keep)
    line = np.column_stack([np.interp(index, index[at], position[at, c]) for c in range(3)])
    bowed = np.linalg.norm(position - line, axis=1) > BOW
    return np.asarray(keep | bowed | (np.abs(phi - np.interp(np.arange(len(phi)), at, phi[at])) > BEND))
