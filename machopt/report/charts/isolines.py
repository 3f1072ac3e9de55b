"""Isolines of a quantity on an even grid, by contourpy."""

from __future__ import annotations

import numpy as np

from machopt.numerics.array_types import Array


def compute_isolines(values: Array, level: float) -> list[Array]:
    """The line value = level, in as few pieces as it has; pieces that close end where they began.

    Args:
        values: (nu, nv) at the grid's nodes; NaN is a hole, and no line runs through a square that touches one.
        level: in the unit of the values.

    Returns:
        (P, 2) points of each piece as (i, j) in grid steps.
    """
    from contourpy import LineType, contour_generator  # late: only still pictures of maps need it

    if min(values.shape) < 2:
        return []
    lines = contour_generator(
        z=np.ma.masked_invalid(values), name="serial", corner_mask=False, line_type=LineType.Separate
    ).lines(level)
    return [np.asarray(line, float)[:, ::-1] for line in lines]  # contourpy's x runs along the second index


def choose_round_levels(low: float, high: float, most: int = 8) -> Array:
    """Return round numbers between two values.

    Args:
        low: The lower end.
        high: The upper end.
        most: Approximate maximum number of levels.
    """
    span = high - low
    if not span > 0:
        return np.empty(0)
    size = 10.0 ** np.floor(np.log10(span / most))
    step = next(f * size for f in (1.0, 2.0, 2.5, 5.0, 10.0, 20.0) if span / (f * size) <= most)
    return np.asarray(np.arange(np.ceil(low / step - 1e-9), np.floor(high / step + 1e-9) + 1) * step + 0.0)
