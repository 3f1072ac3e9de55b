"""Isolines of a quantity on an even grid, by marching squares."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]


def isolines(values: Array, level: float) -> Array:
    """Segments of the line value = level.

    Args:
        values: (nu, nv) at the grid's nodes; NaN is a hole, and no line runs through a square that touches one.
        level: in the unit of the values.

    Returns:
        (S, 2, 2) ends of segments as (i, j) in grid steps, in the order of the squares.
    """
    corner = np.stack([values[:-1, :-1], values[1:, :-1], values[1:, 1:], values[:-1, 1:]], axis=-1)
    place = np.array([[0, 0], [1, 0], [1, 1], [0, 1]], float)
    with np.errstate(invalid="ignore"):
        below = corner < level
    crossed = np.isfinite(corner).all(axis=-1) & (below.any(axis=-1) != below.all(axis=-1))
    segments = []
    for i, j in np.argwhere(crossed):
        c, b = corner[i, j], below[i, j]
        cut = {}
        for edge in range(4):
            n = (edge + 1) % 4
            if b[edge] != b[n]:
                t = (level - c[edge]) / (c[n] - c[edge])
                cut[edge] = place[edge] + t * (place[n] - place[edge]) + (i, j)
        if len(cut) == 2:
            segments.append(list(cut.values()))
        else:  # a saddle: the middle of the square decides which corners hang together
            pairs = ((0, 1), (2, 3)) if (c.mean() < level) == b[0] else ((3, 0), (1, 2))
            segments += [[cut[a], cut[b]] for a, b in pairs]
    return np.array(segments).reshape(-1, 2, 2)


def round_levels(low: float, high: float, most: int = 8) -> Array:
    """Round numbers between two, at most ``most`` or so."""
    span = high - low
    if not span > 0:
        return np.empty(0)
    size = 10.0 ** np.floor(np.log10(span / most))
    step = next(f * size for f in (1.0, 2.0, 2.5, 5.0, 10.0, 20.0) if span / (f * size) <= most)
    return np.asarray(np.arange(np.ceil(low / step - 1e-9), np.floor(high / step + 1e-9) + 1) * step + 0.0)
