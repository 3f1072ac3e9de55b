"""Side of the cut of each milled move: up or down, which changes from pass to pass where passes reverse."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from machopt.data_types.process import ProcessOperation
from machopt.data_types.toolpath import Toolpath

ALONG = 0.5  # |cosine| to the first pass: a steeper move is a step to the next pass, and counts like it


def find_reversed_moves(one: ProcessOperation, toolpath: Toolpath, rows: NDArray[np.intp]) -> NDArray[np.bool_]:
    """Return (k,) whether a move belongs to a pass in the opposite direction of the first one.

    Args:
        one: The operation.
        toolpath: The toolpath.
        rows: (k,) cut points of the operation, in order.
    """
    reversed_moves = np.zeros(len(rows), bool)
    if not one.is_alternating or not len(rows):
        return reversed_moves
    step = toolpath.position[rows] - toolpath.position[np.maximum(rows - 1, 0)]
    size = np.linalg.norm(step, axis=1)
    long = np.flatnonzero(size > 0)
    if not len(long):
        return reversed_moves
    direction = step / np.maximum(size, 1e-300)[:, None]
    cosine = direction @ direction[long[0]]
    known = np.flatnonzero((np.abs(cosine) >= ALONG) & (size > 0))
    nearest = known[np.minimum(np.searchsorted(known, np.arange(len(rows))), len(known) - 1)]
    return np.asarray(cosine[nearest] < 0)
