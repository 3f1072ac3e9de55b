"""Points of closed contours at which the tool may be lifted."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from machopt.data_types.toolpath import MoveKind, Toolpath
from machopt.planning.stations.planning_path import PlanningPath

CLOSED = 0.002  # m: a cut that ends this near to its beginning is closed
WINDING = np.radians(330.0)  # turn of the direction of travel about the tool axis from which a cut winds around
END_SHARE = 0.03  # of the length of a cut: nearer to its ends a lift divides nothing


def find_reentry_points(path: PlanningPath, toolpath: Toolpath) -> NDArray[np.int64]:
    """Return the toolpath points of closed contours at which the tool may be lifted.

    They are toolpath points of a cut that ends where it began, or whose direction of travel turns by WINDING about the
    tool axis, as in a spiral; the operation goes on behind them. Holes and cuts along the tool axis have none.

    Args:
        path: planning points, without re-entries.
        toolpath: its toolpath.
    """
    found = [rows for first, last in path.runs for rows in _list_cuts(path, first, last) if _is_closed(path, rows)]
    rows = np.concatenate([np.empty(0, np.int64), *(_list_inner_points(path, rows) for rows in found)])
    points = np.round(path.index[rows]).astype(np.int64)
    goes_on = (toolpath.move[points + 1] == MoveKind.CUT) & (
        toolpath.operation[points + 1] == toolpath.operation[points]
    )
    return np.asarray(points[goes_on])


def _list_cuts(path: PlanningPath, first: int, last: int) -> list[NDArray[np.int64]]:
    """Stretches of a run without other moves than cuts: their points, with the one that the first cut begins at."""
    rows = np.arange(first, last + 1)
    cut = (path.move[rows] == MoveKind.CUT) & ~path.is_drilling[rows] & ~path.plunge[rows]
    cut[0] = False
    edges = np.flatnonzero(np.diff(np.r_[False, cut, False].astype(int))).reshape(-1, 2)
    return [rows[begin - 1 : end] for begin, end in edges.tolist() if end - begin >= 3]


def _is_closed(path: PlanningPath, rows: NDArray[np.int64]) -> bool:
    position, axis = path.position[rows], path.axis[rows[:-1]]
    if np.linalg.norm(position[-1] - position[0]) <= CLOSED:
        return True
    travel = path.travel[rows[:-1]]
    turn = np.arctan2(
        np.einsum("ij,ij->i", np.cross(travel[:-1], travel[1:]), axis[1:]),
        np.einsum("ij,ij->i", travel[:-1], travel[1:]),
    )
    return bool(abs(turn.sum()) >= WINDING)


def _list_inner_points(path: PlanningPath, rows: NDArray[np.int64]) -> NDArray[np.int64]:
    length = np.r_[0.0, np.cumsum(np.linalg.norm(np.diff(path.position[rows], axis=0), axis=1))]
    if not length[-1] > 0.0:
        return np.empty(0, np.int64)
    share = length / length[-1]
    return np.asarray(rows[(share > END_SHARE) & (share < 1.0 - END_SHARE) & path.is_point[rows]])
