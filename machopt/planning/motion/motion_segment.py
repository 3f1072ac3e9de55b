"""Stretches of the motion from rest to rest, and the dwells of the file between them.

A dwell of the file occurs just before the move to a point (:class:`machopt.data_types.toolpath.ToolpathEvent`). The
machine comes to rest at the previous point, and the motion has that many additional rows there. At a stop it comes to
rest only, because the operator decides when it continues.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from machopt.data_types.toolpath import MoveKind, Toolpath
from machopt.errors import CellError
from machopt.numerics.array_types import Array
from machopt.numerics.rigid_transforms import interpolate_axis
from machopt.planning.stations.planning_path import PlanningPath

BEND = np.radians(0.1)  # maximum rotation error of a straight move between two toolpath points before a point is added
LEAN = np.radians(0.02)  # the same of the tool axis, which a ball cutter's tip follows over its radius
BOW = 2e-6  # m, the same for a shifted path; an unshifted one is straight between toolpath points
LONGEST = 600.0  # s: longest dwell; one row per sample would otherwise give gigabytes
BEFORE_ALL = -1  # index of a dwell before the first point: before the motion begins


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
    waypoint_row: NDArray[np.int64] | None = None  # (W,) sample at or nearest to each target; None: it is searched
    rounded: Array | None = None  # (W, 2) shares of the moves to and from each target that round the corner; None: 0

    def standing(self, row: int, count: int) -> MotionSegment:
        """Return the leg with one row repeated, so that the machine rests there.

        Args:
            row: row to repeat.
            count: number of additional samples.
        """
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
            waypoint_row=None if self.waypoint_row is None else np.cumsum(times)[self.waypoint_row] - 1,
        )


def count_rest_samples(toolpath: Toolpath, sample: float) -> dict[int, int]:
    """Return the samples of rest at each toolpath point with a dwell or a stop.

    Args:
        toolpath: with its events; point ``BEFORE_ALL`` is the start of the motion.
        sample: s.

    Raises:
        InputError: a dwell is too long to be written row by row.
    """
    seconds: dict[int, float] = {}
    for event in toolpath.events:
        if event.kind not in ("dwell", "stop"):
            continue
        point = min(event.index, len(toolpath)) - 1
        known = event.kind == "dwell" and event.value > 0.0  # NaN: the file gives spindle revolutions, or nothing
        if known and event.value > LONGEST:
            raise CellError(
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
    """Return the (S,) moves of the samples, so that each cut point lies between two samples of a cut, or near one.

    Where points are denser than samples, the last points of a cut lie before a sample that already belongs to the
    retract (and the first ones behind a sample of the approach). Such samples count as part of the cut they complete.

    Args:
        move: (S,) move of each sample.
        local: (S,) fractional index into ``rows``.
        index: (S,) fractional toolpath index.
        rows: planning points of the run.
        path: planning points.
    """
    out = move.copy()
    place = np.interp(local, np.arange(len(rows)), index)
    points = 1 + np.flatnonzero((path.move[rows] == MoveKind.CUT)[1:] & path.is_point[rows][1:])
    after = np.clip(np.searchsorted(local, points - 1e-9), 1, len(local) - 1) if len(local) > 1 else points[:0]
    pair = after[:, None] + np.array([-1, 0])  # the samples before and behind each
    near = (np.abs(place[pair] - index[points[: len(after)], None]) <= 0.5) & (move[pair] == MoveKind.CUT)
    out[pair[~near.any(axis=1)]] = MoveKind.CUT
    return out


def select_program_points(
    phi: Array, is_point: NDArray[np.bool_], index: Array, position: Array, axis: Array
) -> NDArray[np.bool_]:
    """Return (n,) planning points a program needs: toolpath points, and those where rotation or path are not linear.

    Position and axis are not linear only where the path is shifted against a deflection, or the tool tilted.

    Args:
        phi: (n,) rad, rotation.
        is_point: (n,) toolpath points.
        index: (n,) fractional toolpath index.
        position: (n, 3) m.
        axis: (n, 3) unit, tip to shank.
    """
    keep = is_point.copy()
    keep[[0, -1]] = True
    at = np.flatnonzero(keep)
    after = np.clip(np.searchsorted(at, np.arange(len(keep))), 1, len(at) - 1)
    low, high = at[after - 1], at[after]
    share = np.clip((index - index[low]) / np.where(index[high] > index[low], index[high] - index[low], 1.0), 0.0, 1.0)
    even = interpolate_axis(axis[low], axis[high], share)
    leaning = np.linalg.norm(axis - even, axis=1) > LEAN
    line = np.column_stack([np.interp(index, index[at], position[at, c]) for c in range(3)])
    bowed = np.linalg.norm(position - line, axis=1) > BOW
    return np.asarray(keep | bowed | leaning | (np.abs(phi - np.interp(np.arange(len(phi)), at, phi[at])) > BEND))
