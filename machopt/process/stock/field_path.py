"""A whole toolpath of one tool with an axis that turns, removed from a stock of signed distances, with its contact."""

from __future__ import annotations

from math import ceil, cos, sin, sqrt

import numpy as np
from numpy.typing import NDArray

from machopt.numerics.array_types import Array
from machopt.numerics.compiled_functions import jit_compile
from machopt.process.stock.contact_kernels import CORNER_SLICES, SPACING
from machopt.process.stock.distance_field import MOST_BLOCKS, DistanceField, build_memory_error
from machopt.process.stock.end_cutting import SHORT, measure_field_end
from machopt.process.stock.field_contact import NODES, find_field_contact
from machopt.process.stock.field_removal import remove_step
from machopt.process.stock.field_types import Cutter, FieldArrays, Frame, Step
from machopt.process.stock.path_removal import ARCS, IDLE, LEAST_SAMPLES, NOTHING

STEP = 2.0  # cells that a place of the cutter moves in one step at most
_ROWS = ARCS * (CORNER_SLICES + NODES)


def remove_field_path(
    stock: DistanceField,
    position: Array,
    axis: Array,
    wanted: NDArray[np.bool_],
    cutter: Cutter,
    end: Array | None = None,
) -> tuple[Array, NDArray[np.int64], Array]:
    """Remove a cutter along a path from the stock, which changes, and return its contact at the end of each move.

    Args:
        stock: The stock; its arrays are changed.
        position: (N, 3) m, the tip, CAM frame.
        axis: (N, 3) unit, from tip to shank.
        wanted: (N,) whether the contact of a point is wanted.
        cutter: radius m, corner radius m, slope of the cone of its tip, height m.
        end: (N,) m³, above zero where what the flat end removes is wanted, which is written there.

    Returns:
        volume (N,) m³ removed by the move that ends at each point, point (M,) and low, high, start, end (M, 4) in m and
        rad of each arc.

    Raises:
        CuttingInputError: the surface has more cells than memory allows.
    """
    samples = max(int(np.ceil(np.pi * (cutter[0] + stock.size) / (SPACING * stock.size))), LEAST_SAMPLES)
    angle = np.linspace(0.0, np.pi, samples + 1)
    circle = np.column_stack([np.sin(angle), np.cos(angle)])
    found = _remove_path(
        stock.arrays,
        (stock.origin, stock.cell),
        stock.convert_vectors(position),
        stock.convert_vectors(axis),
        wanted,
        cutter,
        circle,
        np.zeros(len(position)) if end is None else end,
    )
    missing = int(stock.arrays[3][2])
    if missing:
        raise build_memory_error(stock.cell, 1.0 + missing / MOST_BLOCKS)
    return found


@jit_compile
def _build_step(ends: Array, turn: float, across: Array, first: float, last: float) -> Step:
    """Return the part of a move between two shares: the tip straight, the axis on the great circle.

    ``ends`` has the rows tip and axis at the start, tip and axis at the end.
    """
    p, d, a = ends[0] + first * (ends[2] - ends[0]), (last - first) * (ends[2] - ends[0]), ends[1]
    u, v = cos(first * turn), sin(first * turn)
    x, y = cos(last * turn) - u, sin(last * turn) - v
    return (
        *(p[0], p[1], p[2], d[0], d[1], d[2]),
        *(u * a[0] + v * across[0], u * a[1] + v * across[1], u * a[2] + v * across[2]),
        *(x * a[0] + y * across[0], x * a[1] + y * across[1], x * a[2] + y * across[2]),
    )


@jit_compile
def _find_turn(ends: Array) -> tuple[float, Array]:
    """Angle between the two axes, and the unit direction across the first one towards the second.

    Opposite axes turn about any line across.
    """
    a, b = ends[1], ends[3]
    cosine = a[0] * b[0] + a[1] * b[1] + a[2] * b[2]
    across = b - cosine * a
    sine = sqrt(across[0] * across[0] + across[1] * across[1] + across[2] * across[2])
    if sine > 1e-9:
        return np.arctan2(sine, cosine), across / sine
    if cosine > 0.0:
        return 0.0, np.zeros(3)
    across = np.zeros(3)
    across[0 if abs(a[0]) < 0.9 else 1] = 1.0
    across -= (across[0] * a[0] + across[1] * a[1] + across[2] * a[2]) * a
    return np.pi, across / sqrt(across[0] * across[0] + across[1] * across[1] + across[2] * across[2])


@jit_compile
def _remove_move(
    arrays: FieldArrays, frame: Frame, ends: Array, is_first: bool, cutter: Cutter, heights: Array, span: Array
) -> float:
    """Remove a move in short steps; returns the removed volume, m³.

    ``span`` receives lowest and highest removed material, and the most that a place of the cutter moves, m.
    """
    turn, across = _find_turn(ends)
    size = 0.0
    for n in range(3):
        size += (ends[2, n] - ends[0, n]) ** 2
    size = sqrt(size) + turn * sqrt(cutter[3] * cutter[3] + cutter[0] * cutter[0])
    count = max(ceil(size / (STEP * frame[1])), 1)
    span[0], span[1], span[2] = np.inf, -np.inf, size
    if size == 0.0 and not is_first:
        return 0.0
    heights[:] = 0.0
    total = 0.0
    for n in range(count):
        step = _build_step(ends, turn, across, n / count, (n + 1) / count)
        total += remove_step(arrays, frame, (step, size / count, is_first and n == 0), cutter, heights, span)
    return total


@jit_compile
def _set_axes(axes: Array, ends: Array) -> bool:
    """Write tip, normal, travel and axis at the end of a move; returns whether the tip travels across the axis."""
    size = 0.0
    along = 0.0
    for n in range(3):
        along += (ends[2, n] - ends[0, n]) * ends[3, n]
    for n in range(3):
        axes[0, n], axes[3, n] = ends[2, n], ends[3, n]
        axes[2, n] = ends[2, n] - ends[0, n] - along * ends[3, n]
        size += axes[2, n] * axes[2, n]
    size = sqrt(size)
    if size <= SHORT:
        return False
    axes[2] /= size
    axes[1] = np.cross(axes[3], axes[2])
    return True


@jit_compile
def _join_ranges(spans: Array, position: Array, axis: Array, k: int, h: float) -> tuple[float, float]:
    """Lowest and highest material above the tip at a point that its move, and those within a cell before, removed.

    The chip of a shorter move passes between the centres of cells.
    """
    low, high, travel = spans[k, 0], spans[k, 1], spans[k, 2]
    j = k - 1
    while j >= 0 and travel + spans[j, 2] <= h:
        travel += spans[j, 2]
        rise = 0.0
        for n in range(3):
            rise += (position[j, n] - position[k, n]) * axis[k, n]
        low, high = min(low, spans[j, 0] + rise), max(high, spans[j, 1] + rise)
        j -= 1
    return low, high


@jit_compile
def _drop_idle_arcs(
    rows: Array, number: int, ends: Array, axes: Array, cutter: Cutter, heights: Array, h: float
) -> int:
    """Leave out the arcs of slices that remove nothing: the cutter lies against a wall there; returns their number."""
    radius, corner = cutter[0], cutter[1]
    last = 0
    for m in range(number):
        low, high = rows[m, 0], rows[m, 1]
        middle = 0.5 * (low + high)
        r = radius
        if middle < corner:
            r = radius - corner + np.sqrt(max(corner * corner - (corner - middle) ** 2, 0.0))
        length = 0.0
        for n in range(3):
            length += (ends[2, n] - ends[0, n] + middle * (ends[3, n] - ends[1, n])) * axes[2, n]
        removed = 0.0
        for n in range(max(int(low / h) - 1, 0), min(int(high / h) + 2, len(heights))):
            removed += heights[n]
        expected = abs(length) * (high - low) * r * (np.cos(rows[m, 2]) - np.cos(rows[m, 3]))
        if removed > IDLE * expected:
            rows[last] = rows[m]
            last += 1
    return last


@jit_compile
def _remove_path(
    arrays: FieldArrays,
    frame: Frame,
    position: Array,
    axis: Array,
    wanted: NDArray[np.bool_],
    cutter: Cutter,
    circle: Array,
    end: Array,
) -> tuple[Array, NDArray[np.int64], Array]:
    volume = np.zeros(len(position))
    heights = np.zeros(max(ceil(cutter[3] / frame[1]), 1))
    arcs, rows = np.zeros((ARCS, 2)), np.zeros((_ROWS, 4))
    ends, axes, spans = np.zeros((4, 3)), np.zeros((4, 3)), np.zeros((len(position), 3))
    point, found = np.zeros(256, np.int64), np.zeros((256, 4))
    count = 0
    for k in range(len(position)):
        before = k - 1 if k else k
        ends[0], ends[1], ends[2], ends[3] = position[before], axis[before], position[k], axis[k]
        if end[k] > 0.0:
            end[k] = measure_field_end(arrays, frame, ends, cutter[0] - cutter[1])
        volume[k] = _remove_move(arrays, frame, ends, k == 0, cutter, heights, spans[k])
        if volume[k] <= NOTHING or not wanted[k] or not _set_axes(axes, ends):
            continue
        span = _join_ranges(spans, position, axis, k, frame[1])
        number = find_field_contact(arrays, frame, axes, cutter, heights, span, circle, arcs, rows)
        number = _drop_idle_arcs(rows, number, ends, axes, cutter, heights, frame[1])
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
