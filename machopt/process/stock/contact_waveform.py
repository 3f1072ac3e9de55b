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
    bite: Array,
) -> Array:
    """Return (N,) N, the largest resultant of a revolution; NaN where nothing is cut.

    Points whose contact is the same within ``SAME_ANGLE`` and ``SAME_HEIGHT`` share the waveform of the first of them.

    Args:
        coefficients: Milling coefficients.
        cutter: End mill.
        spindle: Direction of the spindle.
        engagement: Contact of N points.
        bite: (N,) m, feed per tooth.
    """
    peak = np.full(len(engagement.volume), np.nan)
    table = np.column_stack([engagement.low, engagement.high, engagement.start, engagement.end])
    key = np.round(table / np.array([SAME_HEIGHT, SAME_HEIGHT, SAME_ANGLE, SAME_ANGLE])).astype(np.int64)
    groups: dict[bytes, list[int]] = defaultdict(list)
    parts = _list_parts(cutter, engagement)
    begins = np.searchsorted(engagement.point, np.arange(len(engagement.volume) + 1))
    for k in parts:
        groups[key[begins[k] : begins[k + 1]].tobytes()].append(k)
    cut = MillingCut("slot", spindle)
    for points in groups.values():
        own = parts[points[0]]
        feeds = np.unique(np.linspace(bite[points].min(), bite[points].max(), FEEDS))
        found = [find_peak_force(compute_slices_waveform(coefficients, cutter, cut, own, f)) for f in feeds.tolist()]
        peak[points] = np.interp(bite[points], feeds, found)
    return peak


def compute_contact_wall_forces(
    coefficients: MillingCoefficients,
    cutter: MillingCutter,
    spindle: SpindleDirection,
    engagement: StockEngagement,
    side: NDArray[np.int8],
    bite: Array,
) -> Array:
    """Return (N,) N, the force along axis × travel at the moment the wall is made, where it is largest over the height.

    Args:
        coefficients: Milling coefficients.
        cutter: End mill.
        spindle: Direction of the spindle.
        engagement: Contact of N points.
        side: (N,) 1 up, −1 down, 0 slot.
        bite: (N,) m, feed per tooth.
    """
    wall = np.zeros(len(engagement.volume))
    for k, parts in _list_parts(cutter, engagement).items():
        cut = MillingCut(_SIDES[int(side[k])], spindle)
        at = find_generation_angles(cutter, cut, np.linspace(0.0, max(p.high for p in parts), HEIGHTS))
        load = compute_slices_waveform(coefficients, cutter, cut, parts, float(bite[k]), at).load[:, 1]
        wall[k] = load[np.argmax(np.abs(load))]
    return wall


def _list_parts(cutter: MillingCutter, engagement: StockEngagement) -> dict[int, list[CutterSlice]]:
    """Return the slices of each point that is in contact."""
    shape = compute_slice_geometry(cutter, engagement)
    columns = (engagement.low, engagement.high, shape.radius, shape.kappa, engagement.start, engagement.end)
    out: dict[int, list[CutterSlice]] = defaultdict(list)
    for k, values in zip(engagement.point.tolist(), np.column_stack(columns).tolist(), strict=True):
        low, high, radius, kappa, start, end = values
        out[k].append(CutterSlice(low=low, high=high, radius=radius, kappa=kappa, start=start, end=end))
    return out
