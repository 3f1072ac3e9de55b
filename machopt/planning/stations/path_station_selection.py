"""Selection of stations: the points of a path at which postures are chosen.

Stations follow the detail of the path: its length, the bends of its direction of travel and the changes of the tool
axis.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from machopt.numerics.array_types import Array

ALL_STATIONS = 1500  # number of points up to which every point is a station
MAX_STATIONS = 6000  # limit for a longer path because of memory (0.1 MB each); above it all distances increase equally
SPACING = 0.005  # m, between the stations of a longer path on straight parts
BEND = np.radians(6.0)  # change of the direction of travel, and of the force, between two stations
TILT = np.radians(1.0)  # change of the tool axis between two stations
CHORD = 0.001  # m to either side: averaging length of the direction of travel, so that rounded coordinates are no bends


def select_stations(
    position: Array, axis: Array, move: NDArray[np.int8], runs: tuple[tuple[int, int], ...], fixed: NDArray[np.intp]
) -> NDArray[np.int32]:
    """Select every planning point of a short path; of a longer one as many as its detail requires.

    Stations are a unit of detail apart (:func:`_accumulate_detail`). Both ends of every run, the first and the last
    point of a stretch with one kind of move, and the fixed points are stations too.

    Args:
        position: (P, 3) m, points of the path.
        axis: (P, 3) tool axes, unit vectors.
        move: (P,) kind of move to each point.
        runs: First and last point of each run.
        fixed: Points that are stations in any case.

    Returns:
        (S,) indices of the stations.
    """
    n = len(position)
    if n <= ALL_STATIONS:
        return np.arange(n, dtype=np.int32)
    keep = np.zeros(n, bool)
    keep[fixed[fixed < n]] = True
    change = np.flatnonzero(move[1:] != move[:-1])
    keep[change] = keep[change + 1] = True
    for first, last in runs:
        keep[[first, last]] = True
    detail = _accumulate_detail(position, axis, runs)
    room = max(MAX_STATIONS - int(keep.sum()), MAX_STATIONS // 4)
    unit = max(1.0, float(detail[-1]) / room)
    start = np.zeros(n)  # detail at the start of the point's run
    for first, last in runs:
        start[first : last + 1] = detail[first]
    cell = np.floor((detail - start) / unit)
    keep[1:] |= cell[1:] > cell[:-1]
    return np.flatnonzero(keep).astype(np.int32)


def _accumulate_detail(position: Array, axis: Array, runs: tuple[tuple[int, int], ...]) -> Array:
    """Return (P,) cumulative detail: lengths by SPACING, bends by BEND, tilts by TILT, the largest of them.

    One more station improves the choice by the change of index and joints between two stations. These
    depend on place, tool axis and, through the force, on the direction of travel.
    """
    out = np.zeros(len(position))
    total = 0.0
    for first, last in runs:
        rows = slice(first, last + 1)
        p, n = position[rows], axis[rows]
        step = np.linalg.norm(np.diff(p, axis=0), axis=1)
        along = np.r_[0.0, np.cumsum(step)]
        ahead, behind = ([np.interp(along + side * CHORD, along, p[:, c]) for c in range(3)] for side in (1.0, -1.0))
        chord = np.column_stack(ahead) - np.column_stack(behind)
        size = np.linalg.norm(chord, axis=1, keepdims=True)
        chord = np.divide(chord, size, out=np.zeros_like(chord), where=size > 0)
        bend, tilt = (
            2.0 * np.arcsin(np.minimum(0.5 * np.linalg.norm(np.diff(d, axis=0), axis=1), 1.0)) for d in (chord, n)
        )
        share = np.maximum(np.maximum(step / SPACING, bend / BEND), tilt / TILT)
        out[rows] = total + np.r_[0.0, np.cumsum(share)]
        total = float(out[last])
    return out
