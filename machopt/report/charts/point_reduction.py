"""Reduction of points for charts, and compact JSON numbers."""

from __future__ import annotations

import base64
from collections.abc import Sequence
from math import isfinite
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from machopt.numerics.array_types import Array

if TYPE_CHECKING:
    from machopt.report.page_types.optimize_page_data import FeedDipRow

IndexArray = NDArray[np.intp]

PLOT_POINTS = 3000
"""Most points a chart carries; twice the pixels of a wide screen, so that no peak is lost to the eye."""


def select_plot_points(series: Sequence[Array], limit: int = PLOT_POINTS) -> IndexArray:
    """Indices that keep each series' least and largest value within equal buckets, its gaps, and both ends.

    Args:
        series: arrays (S,), NaN allowed.
        limit: most indices returned, gaps apart.
    """
    n = len(series[0])
    if n <= limit:
        return np.arange(n)
    buckets = max(1, (limit - 2) // (2 * len(series)))
    width = -(-n // buckets)
    starts = np.arange(0, n, width)
    chosen = [np.array([0, n - 1])]
    for values in series:
        padded = np.full(len(starts) * width, np.nan)
        padded[:n] = values
        block = padded.reshape(-1, width)
        chosen.append(starts + np.argmin(np.where(np.isnan(block), np.inf, block), axis=1))
        chosen.append(starts + np.argmax(np.where(np.isnan(block), -np.inf, block), axis=1))
        edges = np.flatnonzero(np.diff(np.isnan(values)))  # gaps must stay gaps
        chosen += [edges[:limit], edges[:limit] + 1]
    return np.unique(np.minimum(np.concatenate(chosen), n - 1))


def round_for_json(values: Array, digits: int = 6) -> list[float | None]:
    """Return rounded values; NaN and infinities become None.

    Args:
        values: The values.
        digits: Significant digits.
    """
    form = f".{digits}g"
    return [float(format(v, form)) if isfinite(v) else None for v in np.asarray(values, float).tolist()]


def pack_levels(values: Array, lowest: float, highest: float) -> str:
    """Return values as base64 of little-endian 16-bit levels 0 … 65534; 65535 is NaN.

    Args:
        values: The values.
        lowest: Value of level 0.
        highest: Value of level 65534.
    """
    span = highest - lowest or 1.0
    known = np.isfinite(values)
    level = np.full(values.shape, 65535, dtype="<u2")
    level[known] = np.round(np.clip((values[known] - lowest) / span, 0.0, 1.0) * 65534)
    return base64.b64encode(level.tobytes()).decode("ascii")


def pack_codes(codes: NDArray[np.uint8]) -> str:
    """Return codes as base64, one byte each.

    Args:
        codes: The codes.
    """
    return base64.b64encode(np.ascontiguousarray(codes, dtype=np.uint8).tobytes()).decode("ascii")


def select_deepest_dips(dips: Sequence[FeedDipRow], time: Array, most: int) -> list[FeedDipRow]:
    """Return the feed dips to mark, in order of time; of overlapping marks the deepest dip is kept.

    Args:
        dips: All feed dips.
        time: (S,) time of the motion samples, s.
        most: Maximum number of marks.
    """
    known = sorted((d for d in dips if np.isfinite(d.time)), key=lambda d: d.feed_lowest - d.feed_programmed)
    begin, whole = (float(time[0]), float(time[-1] - time[0]) or 1.0) if len(time) else (0.0, 1.0)
    deepest: dict[int, FeedDipRow] = {}
    for dip in known:
        deepest.setdefault(int(most * (dip.time + 0.5 * dip.duration - begin) / whole), dip)
    return [deepest[k] for k in sorted(deepest)]
