"""Moves on which the end of a milling cutter removes material: plunges and ramps, whose force no model here gives.

Beneath the flat end at the start of a move, all above the end is gone already. What the move removes there is removed
by the end. The side of the cutter removes the rest, and the arcs of contact give its force.
"""

from __future__ import annotations

from math import cos, pi, sin, sqrt

import numpy as np
from numpy.typing import NDArray

from machopt.data_types.stock import StockEngagement
from machopt.numerics.array_types import Array
from machopt.numerics.compiled_functions import jit_compile
from machopt.process.stock.contact_kernels import THIN
from machopt.process.stock.field_arcs import measure_field
from machopt.process.stock.field_types import FieldArrays, Frame
from machopt.process.stock.kernel_types import BOTTOM, HIGH, LOW, SHARE, Grid, Pair

END_SHARE = 0.01  # of the removed material; less by the end changes the force by less than verify's 3 %
THROUGH = 1e-12  # m³ (0.001 mm³); moves that remove less touch the stock by rounding
SHORT = 1e-9  # m, a move without travel across the axis
ROUNDING = 1e-9  # m, of heights: a move that descends less is level
# Places of equal area beneath the end, and their depths. The part of a disc on one side of a line is found with an
# error of at most 1 % of the disc (1 sigma) and 4 % (worst: test_stock_removal.py), a surface across the axis to an
# eighth of the descent.
_RINGS, _ANGLES, _DEPTHS = 8, 32, 4


def measure_descents(position: Array, axis: Array, cutting: NDArray[np.bool_]) -> tuple[Array, Array, Array]:
    """Return how far each move descends along its axis, travels across it, and descends since cuts last did not.

    Args:
        position: (N, 3) m, the tip.
        axis: (N, 3) unit, from tip to shank.
        cutting: (N,) cut moves.

    Returns:
        (N,) m each; the first point has no move.
    """
    step = np.diff(position, axis=0, prepend=position[:1])
    along = np.sum(step * axis, axis=1)
    across = np.linalg.norm(step - along[:, None] * axis, axis=1)
    total = np.zeros(len(position))
    for k in np.flatnonzero(cutting & (along < -ROUNDING)).tolist():
        before = total[k - 1] if k and cutting[k - 1] else 0.0
        total[k] = before - along[k]
    return -along, across, total


def find_end_cuts(
    position: Array,
    axis: Array,
    cutting: NDArray[np.bool_],
    stock_engagement: StockEngagement,
    end: Array,
    radius: float,
) -> NDArray[np.bool_]:
    """Return (N,) whether the end of the cutter removes material on the way to a point, so that its force is unknown.

    A move without travel across the axis, or that descends more than it travels, counts with all that it removes. On
    another descending move the end counts from ``END_SHARE`` of what end and side remove.

    Args:
        position: (N, 3) m, the tip.
        axis: (N, 3) unit.
        cutting: (N,) cut moves.
        stock_engagement: Contact of the points.
        end: (N,) m³ that each move removes beneath the flat end at its start.
        radius: m, of the cutter.
    """
    _, across, total = measure_descents(position, axis, cutting)
    side = np.zeros(len(position))
    np.add.at(
        side,
        stock_engagement.point,
        (stock_engagement.high - stock_engagement.low)
        * radius
        * (np.cos(stock_engagement.start) - np.cos(stock_engagement.end)),
    )
    descends = total > THIN + ROUNDING
    ramps = descends & (end > np.maximum(THROUGH, END_SHARE * (end + side * across)))
    return stock_engagement.is_computed & (
        ramps | (find_plunges(position, axis, cutting) & (stock_engagement.volume > THROUGH))
    )


def find_plunges(position: Array, axis: Array, cutting: NDArray[np.bool_]) -> NDArray[np.bool_]:
    """Return (N,) whether a cut does not travel across its axis, or descends at least as far as it travels.

    Args:
        position: (N, 3) m, the tip.
        axis: (N, 3) unit.
        cutting: (N,) cut moves.
    """
    down, across, total = measure_descents(position, axis, cutting)
    return cutting & ((across <= SHORT) | ((total > THIN + ROUNDING) & (down >= across - ROUNDING)))


@jit_compile
def _find_descent_share(x: float, y: float, length: float, inner: float) -> float:
    """Share of a move after which the end leaves a place, at x along travel and y across it from the start."""
    if length <= SHORT:
        return 1.0
    return min((x + sqrt(max(inner * inner - y * y, 0.0))) / length, 1.0)


@jit_compile
def measure_map_end(grid: Grid, origin: Pair, cell: Pair, p0: Array, p1: Array, inner: float) -> float:
    """Volume of a height map that a descending move removes beneath the flat end at its start, m³.

    Args:
        grid: high, low, share, bottom, before the move.
        origin: u and v of the corner of cell (0, 0).
        cell: size of a cell.
        p0: (3,) u, v, w of the tip at the start.
        p1: (3,) at the end.
        inner: m, radius of the flat end.
    """
    nv, nu = grid.shape[1:]
    x, y, rise = p1[0] - p0[0], p1[1] - p0[1], p1[2] - p0[2]
    length = sqrt(x * x + y * y)
    cu, cv = (x / length, y / length) if length > SHORT else (1.0, 0.0)
    if inner <= 0.0 or rise >= 0.0:
        return 0.0
    total = 0.0
    for m in range(_RINGS):
        r = inner * sqrt((m + 0.5) / _RINGS)
        for n in range(_ANGLES):
            a, b = r * cos(2.0 * pi * n / _ANGLES), r * sin(2.0 * pi * n / _ANGLES)
            u, v = p0[0] + a * cu - b * cv, p0[1] + a * cv + b * cu
            i, j = int(np.floor((u - origin[0]) / cell[0])), int(np.floor((v - origin[1]) / cell[1]))
            if not (0 <= i < nu and 0 <= j < nv):
                continue
            z = max(p0[2] + rise * _find_descent_share(a, b, length, inner), grid[BOTTOM, j, i])
            c = grid[SHARE, j, i]
            total += (1.0 - c) * max(min(grid[HIGH, j, i], p0[2]) - z, 0.0) + c * max(
                min(grid[LOW, j, i], p0[2]) - z, 0.0
            )
    return float(total * pi * inner * inner / (_RINGS * _ANGLES))


@jit_compile
def measure_field_end(arrays: FieldArrays, frame: Frame, ends: Array, inner: float) -> float:
    """Volume of a field that a descending move removes beneath the flat end at its start, m³.

    Args:
        arrays: The field before the move.
        frame: Corner of cell (0, 0, 0) and side of a cell.
        ends: (4, 3) tip and axis at the start, tip and axis at the end.
        inner: m, radius of the flat end.
    """
    step, axis = ends[2] - ends[0], ends[3]
    rise = step[0] * axis[0] + step[1] * axis[1] + step[2] * axis[2]
    if inner <= 0.0 or rise >= 0.0:
        return 0.0
    travel = step - rise * axis
    length = sqrt(travel[0] ** 2 + travel[1] ** 2 + travel[2] ** 2)
    if length <= SHORT:
        travel[:] = 0.0
        travel[0 if abs(axis[0]) < 0.9 else 1] = 1.0
        travel -= (travel[0] * axis[0] + travel[1] * axis[1] + travel[2] * axis[2]) * axis
    travel /= sqrt(travel[0] ** 2 + travel[1] ** 2 + travel[2] ** 2)
    normal = np.cross(axis, travel)
    total = 0.0
    for m in range(_RINGS):
        r = inner * sqrt((m + 0.5) / _RINGS)
        for n in range(_ANGLES):
            a, b = r * cos(2.0 * pi * n / _ANGLES), r * sin(2.0 * pi * n / _ANGLES)
            depth = rise * _find_descent_share(a, b, length, inner)
            for k in range(_DEPTHS):
                p = ends[0] + a * travel + b * normal + (k + 0.5) / _DEPTHS * depth * axis
                if measure_field(arrays, frame, p[0], p[1], p[2]) < 0.0:
                    total -= depth / _DEPTHS
    return float(total * pi * inner * inner / (_RINGS * _ANGLES))
