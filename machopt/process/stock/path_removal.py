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
from machopt.process.stock.kernel_types import BOTTOM, HIGH, LOW, SHARE, Grid, Pair, Tip
from machopt.process.stock.removal_kernels import compute_profile, find_ceiling, remove_move

LEAST_SAMPLES = 24  # along half the circumference
ARCS = 6  # arcs of one slice
_ROWS = ARCS * (MOST_LEVELS + CORNER_SLICES)
SAMPLES, DEPTH = 6, 0.75  # of an arc; cells inside of the cutter, so that most cells there are covered whole
IDLE = 3e-3  # of the volume that an arc removes in a steady cut; a slice that removes less is idle
CEILING_MOVES = 64  # moves between two searches of the highest material around: 16,000 cells, as in 7 moves of a ball
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
def _compute_radius(low: float, high: float, cutter: Tip) -> float:
    """Radius of the cutter in the middle of a slice."""
    radius, corner = cutter[0], cutter[1]
    x = max(corner - 0.5 * (low + high), 0.0)
    return radius - corner + sqrt(max(corner * corner - x * x, 0.0))


@jit_compile
def _compute_idle_volumes(rows: Array, bands: Array, number: int, cutter: Tip, length: float, cell: float) -> None:
    """Write heights and idle volume of the slice of each arc to its band: an arc that removes less is idle.

    A slice with arcs from a to b removes about length × height × r (cos a − cos b) on its way. Slices at the tip of a
    ball that are smaller than a cell may pass between columns: their volume does not matter, −1.
    """
    for m in range(number):
        low, high = rows[m, 0], rows[m, 1]
        r, last = _compute_radius(low, high, cutter), _compute_radius(rows[number - 1, 0], rows[number - 1, 1], cutter)
        expected = length * (high - low) * r * (np.cos(rows[m, 2]) - np.cos(rows[m, 3]))
        bands[m, 0], bands[m, 1], bands[m, 2], bands[m, 3] = low, high, 0.0, IDLE * expected
        if r < cell <= last:
            bands[m, 3] = -1.0


@jit_compile
def _measure_samples(
    grid: Grid, origin: Pair, cell: Pair, p: Array, cu: float, cv: float, cutter: Tip, rows: Array, bands: Array
) -> int:
    """Write to each band what the cutter at p removes of some cells of its arc; returns the number of idle bands.

    A part of the removed volume that is above the idle volume proves that the slice is not idle; the others go first.
    """
    nv, nu = grid.shape[1:]
    size, idle = max(cell[0], cell[1]), 0
    for m in range(len(bands)):
        r = _compute_radius(bands[m, 0], bands[m, 1], cutter)
        thin, thick = rows[m, 2], rows[m, 3]
        if thin + thick > np.pi:
            thin, thick = thick, thin
        for n in range(SAMPLES):
            if bands[m, 2] > bands[m, 3]:
                break
            share = 0.85 - 0.1 * n  # of the arc, from its thinner end
            phi = (1.0 - share) * thin + share * thick
            at = max(r - DEPTH * size, 0.0)
            s, c = at * np.sin(phi), at * np.cos(phi)
            u, v = (p[0] + s * cu - c * cv - origin[0]) / cell[0], (p[1] + s * cv + c * cu - origin[1]) / cell[1]
            i, j = int(u), int(v)
            if not (0.0 <= u < nu and 0.0 <= v < nv):
                continue
            x, y = origin[0] + (i + 0.5) * cell[0] - p[0], origin[1] + (j + 0.5) * cell[1] - p[1]
            distance = sqrt(x * x + y * y)
            covered = min(0.5 + (cutter[0] - distance) / size, 1.0)
            low = max(compute_profile(distance, *cutter), grid[BOTTOM, j, i] - p[2], bands[m, 0])
            upper, under = min(grid[HIGH, j, i] - p[2], bands[m, 1]), min(grid[LOW, j, i] - p[2], bands[m, 1])
            removed = max(covered - grid[SHARE, j, i], 0.0) * max(upper - low, 0.0)
            removed += min(max(covered, 0.0), grid[SHARE, j, i]) * max(under - low, 0.0)
            bands[m, 2] = max(bands[m, 2], cell[0] * cell[1] * removed)
        if bands[m, 2] <= bands[m, 3]:
            bands[m, 2] = 0.0
            idle += 1
    return idle


@jit_compile
def _drop_idle_arcs(rows: Array, bands: Array, number: int, peak: float) -> int:
    """Leave out the arcs of slices that remove nothing: the cutter lies against a wall there; returns their number.

    Nothing is cut above the highest material that the move removes. Slices smaller than a cell count where they remove
    material, or the one above does.
    """
    last, is_above = 0, False
    keeps = np.zeros(number, np.bool_)
    for m in range(number - 1, -1, -1):
        removes = bands[m, 2] > max(bands[m, 3], 0.0) or (bands[m, 3] < 0.0 and is_above)
        is_above = rows[m, 0] < peak and removes
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
    levels, arcs, rows = np.zeros(MOST_LEVELS), np.zeros((CORNER_SLICES, ARCS, 2)), np.zeros((_ROWS, 4))
    bands, peak, work = np.zeros((_ROWS, 4)), np.zeros(1), np.zeros((2, grid.shape[2]), np.float32)
    some = np.zeros((_ROWS, 4))
    work[0] = np.arange(grid.shape[2])
    point, found = np.zeros(256, np.int64), np.zeros((256, 4))
    count, ceiling, size = 0, 0.0, max(cell[0], cell[1])
    for k in range(n):
        p1 = position[k]
        p0 = position[k - 1] if k else p1
        x, y = p1[0] - p0[0], p1[1] - p0[1]
        length = sqrt(x * x + y * y)
        if k % CEILING_MOVES == 0:
            ceiling = find_ceiling(grid, origin, cell, position[max(k - 1, 0) : k + CEILING_MOVES], cutter[0] + size)
        number = 0
        if wanted[k] and length > SHORT:
            number = find_contact(
                grid, origin, cell, p1, x / length, y / length, cutter, height, circle, levels, arcs, rows
            )
        if end[k] > 0.0:
            end[k] = measure_map_end(grid, origin, cell, p0, p1, cutter[0] - cutter[1])
        _compute_idle_volumes(rows, bands, number, cutter, length, size)
        peak[0], idle = 0.0, 0
        if number > 1:
            idle = _measure_samples(grid, origin, cell, p1, x / length, y / length, cutter, rows, bands[:number])
        last = 0
        for m in range(number if idle else 0):
            if bands[m, 2] <= bands[m, 3]:
                some[last] = bands[m]
                last += 1
        volume[k] = remove_move(grid, origin, cell, p0, p1, cutter, k == 0, ceiling, some[:idle], peak, work)
        last = 0
        for m in range(number if idle else 0):
            if bands[m, 2] <= bands[m, 3]:
                bands[m, 2] = some[last, 2]
                last += 1
        if number == 1:
            bands[0, 2] = volume[k]
        if volume[k] <= NOTHING:
            continue
        number = _drop_idle_arcs(rows, bands, number, peak[0])
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
