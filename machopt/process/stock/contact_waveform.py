"""Peak force within a revolution, and force that makes the wall, of cutters in contact with the stock."""

from __future__ import annotations

from collections import defaultdict

import numpy as np
from numpy.typing import NDArray

from machopt.data_types.cutting_coefficients import MillingCoefficients
from machopt.data_types.stock import StockEngagement
from machopt.numerics.array_types import Array
from machopt.process.milling.instantaneous_force import (
    CutterSlice,
    compute_slices_waveform,
    find_generation_angles,
    find_peak_force,
)
from machopt.process.milling.milling_cut import CutSide, MillingCut, MillingCutter, SpindleDirection
from machopt.process.stock.contact_load import compute_slice_geometry

SAME_ANGLE = np.radians(0.5)  # contacts that differ by less share one waveform
SAME_HEIGHT = 20e-6  # m
FEEDS = 3  # feeds per tooth of a shared waveform; linear between them
HEIGHTS = 33  # heights of the wall
_SIDES: dict[int, CutSide] = {1: "up", -1: "down", 0: "slot"}


def compute_contact_peaks(
    coefficients: MillingCoefficients,
    cutter: MillingCutter,
    spindle: SpindleDirection,
    engagement: StockEngagement,
    side: NDArray[np.int8],
    bite: Array,
) -> tuple[Array, Array]:
    """Return the largest resultant of a revolution, and the force along axis × travel that makes the wall, (N,) N each.

    Both are NaN and zero where nothing is cut. Points whose contact is the same within ``SAME_ANGLE`` and
    ``SAME_HEIGHT`` share the waveform of the first of them.

    Args:
        coefficients: Milling coefficients.
        cutter: End mill.
        spindle: Direction of the spindle.
        engagement: Contact of N points.
        side: (N,) 1 up, −1 down, 0 slot.
        bite: (N,) m, feed per tooth.
    """
    n = len(engagement.volume)
    peak, wall = np.full(n, np.nan), np.zeros(n)
    begins = np.searchsorted(engagement.point, np.arange(n + 1))
    shape = compute_slice_geometry(cutter, engagement)
    table = np.column_stack([engagement.low, engagement.high, engagement.start, engagement.end])
    key = np.round(table / np.array([SAME_HEIGHT, SAME_HEIGHT, SAME_ANGLE, SAME_ANGLE])).astype(np.int64)
    groups: dict[tuple[int, bytes], list[int]] = defaultdict(list)
    for k in np.flatnonzero(np.diff(begins)).tolist():
        groups[int(side[k]), key[begins[k] : begins[k + 1]].tobytes()].append(k)
    for (code, _), points in groups.items():
        rows = slice(begins[points[0]], begins[points[0] + 1])
        parts = [
            CutterSlice(low=a, high=b, radius=r, kappa=kappa, start=start, end=end)
            for (a, b, start, end), r, kappa in zip(
                table[rows].tolist(), shape.radius[rows].tolist(), shape.kappa[rows].tolist(), strict=True
            )
        ]
        cut = MillingCut(_SIDES[code], spindle)
        at = find_generation_angles(cutter, cut, np.linspace(0.0, max(p.high for p in parts), HEIGHTS))
        feeds = np.unique(np.linspace(bite[points].min(), bite[points].max(), FEEDS))
        peaks, walls = [], []
        for f in feeds.tolist():
            peaks.append(find_peak_force(compute_slices_waveform(coefficients, cutter, cut, parts, f)))
            load = compute_slices_waveform(coefficients, cutter, cut, parts, f, at).load[:, 1]
            walls.append(load[np.argmax(np.abs(load))])
        peak[points], wall[points] = np.interp(bite[points], feeds, peaks), np.interp(bite[points], feeds, walls)
    return peak, wall
