"""Point tables with one hole per row, and how they are distinguished from paths.

A row gives the bottom of a hole. The surface lies ``depth`` above it along the tool axis; the feed begins ``approach``
above the surface. A table without a row kind is read as a path only where its rows cannot be holes.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from machopt.data_types.toolpath import MoveKind
from machopt.numerics.array_types import Array

PITCH = 2.0  # mm across the axis; holes lie at least two diameters apart, and no robot drills less than 1 mm
STEEP = 5.0  # times as far along the axis as across it: a plunge or a retract
MANY_NEAR = 0.05  # share of steps below PITCH that no pattern of holes has, a double or a close pair aside
FEW_PLUNGES = 0.4  # share of steps; holes with two rows each, top and bottom, have a half
ROWS_OF_HOLE = 3  # to the approach height, to the bottom, back


@dataclass(frozen=True)
class HoleRows:
    """Rows of a table with its holes written out as moves."""

    source: NDArray[np.int64]  # (M,) row of the table that each comes from
    offset: Array  # (M,) mm above that row along the tool axis
    move: NDArray[np.int32]  # (M,) Move codes
    is_hole: NDArray[np.bool_]  # (M,)


def find_possible_holes(position: Array, axis: Array, feed: Array, starts: list[int]) -> int | None:
    """Find an operation whose rows could be the bottoms of holes.

    An operation is a path where its feed changes, where it ends at its beginning, where many rows are nearer to the
    row before than holes can be, or where the tool plunges or retracts now and then. All other rows could be holes.

    Args:
        position: (N, 3) mm.
        axis: (N, 3) tool axes of any length.
        feed: (N,) mm/min, NaN where the table gives none.
        starts: first row of each operation.

    Returns:
        First row of such an operation, None where every operation is a path.
    """
    stops = [*starts[1:], len(position)]
    for start, stop in zip(starts, stops, strict=True):
        if stop > start and not _is_path_operation(position[start:stop], axis[start:stop], feed[start:stop]):
            return start
    return None


def _is_path_operation(p: Array, axis: Array, feed: Array) -> bool:
    known = feed[np.isfinite(feed)]
    if len(known) and float(np.ptp(known)) > 0.0:
        return True
    n = axis / np.maximum(np.linalg.norm(axis, axis=1), 1e-12)[:, None]
    step = np.diff(p, axis=0)
    distance = np.linalg.norm(step, axis=1)
    moves = distance > 1e-6  # a repeated row is no step
    if not moves.any():
        return False
    step, distance, along_axis = step[moves], distance[moves], n[1:][moves]
    along = np.abs(np.einsum("ij,ij->i", step, along_axis))
    across = np.sqrt(np.maximum(distance**2 - along**2, 0.0))
    plunges = along > STEEP * across
    near = (across < PITCH) & ~plunges
    closed = len(step) >= ROWS_OF_HOLE and float(np.linalg.norm(p[-1] - p[0])) < PITCH
    return bool(closed or near.mean() >= MANY_NEAR or 0.0 < plunges.mean() < FEW_PLUNGES)


def expand_hole_moves(is_hole: NDArray[np.bool_], move: NDArray[np.int32], depth: Array, approach: Array) -> HoleRows:
    """The moves of a table's rows: three for each hole, one for each other row.

    Args:
        is_hole: (N,) rows that are the bottom of a hole.
        move: (N,) Move codes of the rows.
        depth: (N,) mm from the surface to the row.
        approach: (N,) mm from the surface to where the feed starts.
    """
    count = np.where(is_hole, ROWS_OF_HOLE, 1)
    source = np.repeat(np.arange(len(is_hole)), count)
    place = np.arange(len(source)) - np.repeat(np.cumsum(count) - count, count)  # 0, 1, 2 within a hole
    hole = is_hole[source]
    above = np.where(hole & (place != 1), depth[source] + approach[source], 0.0)
    moves = np.choose(place, [int(MoveKind.RAPID), int(MoveKind.CUT), int(MoveKind.RETRACT)])
    return HoleRows(source, np.nan_to_num(above), np.where(hole, moves, move[source]).astype(np.int32), hole)
