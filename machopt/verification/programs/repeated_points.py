"""Points of a toolpath that repeat the one before or behind them."""

from __future__ import annotations

import numpy as np

from machopt.data_types.toolpath import Toolpath


def count_repeats_before(path: Toolpath, k: int) -> int:
    """Return how many points before k are the same place with the same axis: the file's own doubled moves.

    Args:
        path: the toolpath.
        k: index of the point.
    """
    count = 0
    while k > count and (
        np.abs(path.position[k - count - 1] - path.position[k]).max() < 1e-9
        and np.abs(path.axis[k - count - 1] - path.axis[k]).max() < 1e-9
    ):
        count += 1
    return count


def count_repeats_after(path: Toolpath, k: int) -> int:
    """Return how many points from k on are the place of the point before with its axis.

    Args:
        path: the toolpath.
        k: index of the point.
    """
    count = 0
    while k > 0 and k + count < len(path) and count_repeats_before(path, k + count) > count:
        count += 1
    return count
