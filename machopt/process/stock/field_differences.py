"""Differences of a stock of signed distances from a finished part: volumes by cells, depths along normals."""

from __future__ import annotations

import numpy as np

from machopt.numerics.array_types import Array
from machopt.numerics.compiled_functions import jit_compile
from machopt.process.stock.field_arcs import measure_field
from machopt.process.stock.field_removal import compute_share
from machopt.process.stock.field_types import AIR, BLOCK, CELLS, LIMIT, FieldArrays, Frame

NOTICED_SHARE = 0.05  # of a cell; smaller differences are rounding at edges


@jit_compile
def compare_volumes(left: FieldArrays, wanted: FieldArrays) -> tuple[float, float]:
    """Return the volumes, in cells, that are missing in the part and that are left on it.

    Args:
        left: The stock after the job.
        wanted: The finished part on the same grid.
    """
    a, b = left[0].ravel(), wanted[0].ravel()
    gouged, rest = 0.0, 0.0
    for n in range(len(a)):
        if a[n] < 0 and b[n] < 0:
            if a[n] != b[n]:
                if a[n] == AIR:
                    gouged += CELLS
                else:
                    rest += CELLS
            continue
        for k in range(CELLS):
            is_left = compute_share(left[1][a[n], k]) if a[n] >= 0 else (0.0 if a[n] == AIR else 1.0)
            is_wanted = compute_share(wanted[1][b[n], k]) if b[n] >= 0 else (0.0 if b[n] == AIR else 1.0)
            difference = is_left - is_wanted
            if difference > NOTICED_SHARE:
                rest += difference
            elif difference < -NOTICED_SHARE:
                gouged -= difference
    return gouged, rest


@jit_compile
def measure_depths(arrays: FieldArrays, frame: Frame, place: Array, normal: Array) -> Array:
    """Return (N,) m, the depth of a gouge at each place, negative for material left.

    Args:
        arrays: The stock after the job.
        frame: Corner of cell (0, 0, 0) and side of a cell.
        place: (N, 3) m, on the surface of the part, CAM frame.
        normal: (N, 3) unit, out of the part.
    """
    h = frame[1]
    most = BLOCK * (arrays[0].shape[0] + arrays[0].shape[1] + arrays[0].shape[2])
    out = np.zeros(len(place))
    for n in range(len(place)):
        before = measure_field(arrays, frame, place[n, 0], place[n, 1], place[n, 2])
        if abs(before) < 0.8 * LIMIT:
            out[n] = before * h
            continue
        sign = 1.0 if before > 0.0 else -1.0
        for k in range(1, most):
            p = place[n] - sign * k * h * normal[n]
            value = measure_field(arrays, frame, p[0], p[1], p[2])
            if value * before <= 0.0:
                out[n] = sign * h * (k - 1 + before / (before - value))
                break
            before = value
    return out
