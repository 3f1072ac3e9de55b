"""A whole toolpath of one tool removed from a height map, with the contact at the points that want it."""

from __future__ import annotations

from math import sqrt

import numpy as np
from numpy.typing import NDArray

from machopt.numerics.array_types import Array
from machopt.numerics.compiled_functions import jit_compile
from machopt.process.stock.contact_kernels import CORNER_SLICES, MOST_LEVELS, SPACING, find_contact
from machopt.process.stock.end_cutting import SHORT, measure_map_end
from machopt.process.stock.height_map import HeightMap
from machopt.process.stock.kernel_types import Grid, Pair, Tip
from machopt.process.stock.removal_kernels import remove_move

LEAST_SAMPLES = 24  # along half the circumference
ARCS = 6  # arcs of one slice
_ROWS = ARCS * (MOST_LEVELS + CORNER_SLICES)
IDLE = 3e-3  # of the volume that an arc removes in a steady cut; a slice that removes less is idle
NOTHING = 1e-13  # m³ (0.0001 mm³); a move that removes less cuts air: rounding of single precision


def remove_path(
    stock: HeightMap,
    position: Array,
    wanted: NDArray[np.bool_],
    cutter: Tip,
    height: float,
    end: Array | None = None,
) -> tuple[Array, NDArray[np.int64], Array]:
    """Remove a cutter along a path from the stock, which changes, and return its contact before each move.

    Args:
        stock: The stock; its arrays are changed.
        position: (N, 3) m, u, v, w of the tip.
        wanted: (N,) whether the contact of a point is wanted.
        cutter: radius m, corner radius m, slope of the cone of its tip.
        height: m, usable height of the cutter.
        end: (N,) m³, above zero where what the flat end removes is wanted, which is written there.

    Returns:
        volume (N,) m³ removed by the move that ends at each point, point (M,) and low, high, start, end (M, 4) in m and
        rad of each arc.
    """
    samples = max(int(np.ceil(np.pi * (cutter[0] + stock.size) / (SPACING * stock.size))), LEAST_SAMPLES)
    angle = np.linspace(0.0, np.pi, samples + 1)
    circle = np.column_stack([np.sin(angle), np.cos(angle)])
    return _remove_path(
        stock.grid,
        stock.origin,
        stock.cell,
        np.ascontiguousarray(position),
        wanted,
        cutter,
        float(height),
        circle,
        np.zeros(len(position)) if end is None else end,
    )


@jit_compile
def _drop_idle_arcs(rows: Array, bands: Array, number: int, cutter: Tip, size: tuple[float, float], peak: float) -> int:
    """Leave out the arcs of slices that remove nothing: the cutter lies against a wall there; returns their number.

    Nothing is cut above the highest material that the move removes.

    A slice with arcs from a to b removes about length × height × r (cos a − cos b) on its way. Slices at the tip of a
    ball that are smaller than a cell may pass between columns: they count where the one above does.

    ``size`` is the length of the move across the axis, and the size of a cell, m.
    """
    radius, corner = cutter[0], cutter[1]
    length, cell = size
    last, is_above = 0, False
    keeps = np.zeros(number, np.bool_)
    for m in range(number - 1, -1, -1):
        low, high = rows[m, 0], rows[m, 1]
        r = radius
        if low < corner:
            x = corner - 0.5 * (low + high)
            r = radius - corner + np.sqrt(max(corner * corner - x * x, 0.0))
        expected = length * (high - low) * r * (np.cos(rows[m, 2]) - np.cos(rows[m, 3]))
        is_above = low < peak and (bands[m, 2] > IDLE * expected or (is_above and r < cell))
        keeps[m] = is_above
    for m in range(number):
        if keeps[m]:
            rows[m, 1] = min(rows[m, 1], peak)
            rows[last] = rows[m]
            last += 1
    return last


@jit_compile
def _remove_path(
    grid: Grid,
    origin: Pair,
    cell: Pair,
    position: Array,
    wanted: NDArray[np.bool_],
    cutter: Tip,
    height: float,
    circle: Array,
    end: Array,
) -> tuple[Array, NDArray[np.int64], Array]:
    n = len(position)
    volume = np.zeros(n)
    levels, arcs, rows = np.zeros(MOST_LEVELS), np.zeros((ARCS, 2)), np.zeros((_ROWS, 4))
    bands, peak = np.zeros((_ROWS, 3)), np.zeros(1)
    point, found = np.zeros(256, np.int64), np.zeros((256, 4))
    count = 0
    for k in range(n):
        p1 = position[k]
        p0 = position[k - 1] if k else p1
        x, y = p1[0] - p0[0], p1[1] - p0[1]
        length = sqrt(x * x + y * y)
        number = 0
        if wanted[k] and length > SHORT:
            number = find_contact(
                grid, origin, cell, p1, x / length, y / length, cutter, height, circle, levels, arcs, rows
            )
        if end[k] > 0.0:
            end[k] = measure_map_end(grid, origin, cell, p0, p1, cutter[0] - cutter[1])
        bands[:number, :2] = rows[:number, :2]
        bands[:number, 2], peak[0] = 0.0, 0.0
        volume[k] = remove_move(grid, origin, cell, p0, p1, cutter, k == 0, bands[: number if number > 1 else 0], peak)
        if number == 1:
            bands[0, 2] = volume[k]
        if volume[k] <= NOTHING:
            continue
        number = _drop_idle_arcs(rows, bands, number, cutter, (length, max(cell[0], cell[1])), peak[0])
        if count + number > len(point):
            room = 2 * len(point) + number
            more_point, more_found = np.zeros(room, np.int64), np.zeros((room, 4))
            more_point[:count], more_found[:count] = point[:count], found[:count]
            point, found = more_point, more_found
        for m in range(number):
            point[count + m] = k
            found[count + m] = rows[m]
        count += number
    return volume, point[:count].copy(), found[:count].copy()
