"""Arcs of contact of a cutter with a stock of signed distances, at one height of its outline.

The stock is measured after the move, one cell outside of the cutter: the move has not changed there what is material,
and neither have the moves before it near the sides of the cutter, where the chip is thinner than a cell. Each boundary
is carried back to the cutter along its tangent, as on a height map (:mod:`machopt.process.stock.contact_kernels`).
"""

from __future__ import annotations

from math import cos, pi, sin

import numpy as np

from machopt.numerics.array_types import Array
from machopt.numerics.compiled_functions import jit_compile
from machopt.process.stock.boundary_extrapolation import extrapolate_boundary, measure_line
from machopt.process.stock.contact_kernels import FITS, SEARCH, SPACING, THIN_CHIP
from machopt.process.stock.field_types import (
    AIR,
    BLOCK,
    EDGE,
    LAST,
    LIMIT,
    MOST,
    SHIFT,
    SOLID,
    FieldArrays,
    Frame,
    Table,
)

CLOSE = (0.35, 0.85)  # cells outside of the cutter where a tangent is checked, and found anew: nearer, edges are round
GAP = (
    0.2  # cells of distance from the material at the nearer circle; interpolation lays an edge up to 0.3 cells inwards
)
HALVINGS = 6  # of an interval of two cells: to 1/32 of a cell, below the accuracy of the field

Axes = Array  # (4, 3) tip, normal, travel, tool axis


@jit_compile
def measure_field(arrays: FieldArrays, frame: Frame, x: float, y: float, z: float) -> float:
    """Distance of a place from the stock's surface in cells, negative in the material, by the eight cells around it.

    Args:
        arrays: The field.
        frame: Corner of cell (0, 0, 0) and side of a cell.
        x: m, along the axes of the grid.
        y: m.
        z: m.
    """
    table, pool = arrays[0], arrays[1]
    origin, h = frame
    gx, gy, gz = (x - origin[0]) / h - 0.5, (y - origin[1]) / h - 0.5, (z - origin[2]) / h - 0.5
    i, j, k = int(np.floor(gx)), int(np.floor(gy)), int(np.floor(gz))
    fx, fy, fz = gx - i, gy - j, gz - k
    if (i & LAST) < LAST and (j & LAST) < LAST and (k & LAST) < LAST:
        place = _find_block(table, i, j, k)
        if place < 0:
            return -LIMIT if place == SOLID else LIMIT
        cells, n = pool[place], ((i & LAST) * BLOCK + (j & LAST)) * BLOCK + (k & LAST)
        m = n + BLOCK * BLOCK
        low = (1.0 - fz) * cells[n] + fz * cells[n + 1]
        low += fy * ((1.0 - fz) * cells[n + BLOCK] + fz * cells[n + BLOCK + 1] - low)
        high = (1.0 - fz) * cells[m] + fz * cells[m + 1]
        high += fy * ((1.0 - fz) * cells[m + BLOCK] + fz * cells[m + BLOCK + 1] - high)
        return float((low + fx * (high - low)) / EDGE)
    total = 0.0
    for n in range(8):
        ii, jj, kk = i + (n & 1), j + ((n >> 1) & 1), k + (n >> 2)
        weight = (fx if n & 1 else 1.0 - fx) * (fy if n & 2 else 1.0 - fy) * (fz if n & 4 else 1.0 - fz)
        value = MOST
        place = _find_block(table, ii, jj, kk)
        if place >= 0:
            value = pool[place, ((ii & LAST) * BLOCK + (jj & LAST)) * BLOCK + (kk & LAST)]
        elif place == SOLID:
            value = -MOST
        total += weight * value
    return total / EDGE


@jit_compile
def _find_block(table: Table, i: int, j: int, k: int) -> int:
    """Entry of the block of a cell; AIR outside of the grid."""
    if i < 0 or j < 0 or k < 0:
        return AIR
    bx, by, bz = i >> SHIFT, j >> SHIFT, k >> SHIFT
    if bx >= table.shape[0] or by >= table.shape[1] or bz >= table.shape[2]:
        return AIR
    return int(table[bx, by, bz])


@jit_compile
def _is_inside(
    arrays: FieldArrays, frame: Frame, axes: Axes, reach: float, sine: float, cosine: float, w: float
) -> bool:
    """Whether the place at an angle on a circle about the tool axis lies in the material."""
    s, c = reach * sine, reach * cosine
    x = axes[0, 0] + c * axes[1, 0] + s * axes[2, 0] + w * axes[3, 0]
    y = axes[0, 1] + c * axes[1, 1] + s * axes[2, 1] + w * axes[3, 1]
    z = axes[0, 2] + c * axes[1, 2] + s * axes[2, 2] + w * axes[3, 2]
    return measure_field(arrays, frame, x, y, z) < 0.0


@jit_compile
def _find_crossing(
    arrays: FieldArrays, frame: Frame, axes: Axes, reach: float, w: float, inside: float, outside: float
) -> float:
    """Angle of the boundary between an angle in the material and one outside, by halving."""
    for _ in range(HALVINGS):
        phi = 0.5 * (inside + outside)
        if _is_inside(arrays, frame, axes, reach, sin(phi), cos(phi), w):
            inside = phi
        else:
            outside = phi
    return 0.5 * (inside + outside)


@jit_compile
def _follow_boundary(
    arrays: FieldArrays, frame: Frame, axes: Axes, phi: float, into: float, reach: float, w: float, step: float
) -> float:
    """Angle at which a boundary meets another circle, near an angle; NaN where it does not.

    ``into`` is 1 where the material lies at larger angles, −1 at smaller; ``step`` is that of the search, rad.
    """
    begins_inside = _is_inside(arrays, frame, axes, reach, sin(phi), cos(phi), w)
    sign = -into if begins_inside else into
    for n in range(1, SEARCH + 1):
        there = phi + sign * n * step
        if _is_inside(arrays, frame, axes, reach, sin(there), cos(there), w) != begins_inside:
            near = there - sign * step
            inside, outside = (near, there) if begins_inside else (there, near)
            return _find_crossing(arrays, frame, axes, reach, w, inside, outside)
    return np.nan


@jit_compile
def _carry_back(
    arrays: FieldArrays, frame: Frame, axes: Axes, phi: float, into: float, radius: float, w: float
) -> float:
    """Angle at which the stock's boundary meets the cutter, from the angle at which it meets the circle outside.

    A boundary that is no straight line is found anew nearer to the cutter, as on a height map. ``into`` is 1 where the
    material lies at larger angles, −1 at smaller.
    """
    h = frame[1]
    reach, outer, close = radius + h, radius + 2.0 * h, radius + CLOSE[0] * h
    far = _follow_boundary(arrays, frame, axes, phi, into, outer, w, 0.5 * h / outer)
    carried, expected = phi, np.inf
    if np.isfinite(far):
        carried = extrapolate_boundary(phi, reach, far, outer, radius)
        misses = measure_line(phi, reach, far, outer) > radius + CLOSE[0] * h
        if abs(carried - phi) * radius < h and not misses:
            return carried
        expected = extrapolate_boundary(phi, reach, far, outer, close)
    near = _follow_boundary(arrays, frame, axes, phi, into, close, w, 0.25 * h / radius)
    if not np.isfinite(near) or abs(near - expected) * radius < FITS * h:
        return carried
    middle = radius + CLOSE[1] * h
    between = _follow_boundary(arrays, frame, axes, near, into, middle, w, 0.25 * h / radius)
    return extrapolate_boundary(near, close, between, middle, radius) if np.isfinite(between) else near


@jit_compile
def _add_arc(start: float, end: float, radius: float, h: float, arcs: Array, count: int) -> int:
    """Write an arc whose chip is not too thin; returns the number of arcs."""
    is_side = start <= 0.0 or end >= pi
    depth = radius * (1.0 - cos(min(end - start if is_side else 0.5 * (end - start), pi))) if end > start else 0.0
    if depth > THIN_CHIP * h and count < len(arcs):
        arcs[count, 0], arcs[count, 1] = start, end
        count += 1
    return count


@jit_compile
def add_arcs(arrays: FieldArrays, frame: Frame, axes: Axes, radius: float, w: float, circle: Array, arcs: Array) -> int:
    """Write start and end of each arc of a slice; returns their number.

    Args:
        arrays: The field after the move.
        frame: Corner of cell (0, 0, 0) and side of a cell.
        axes: (4, 3) tip, normal, travel, tool axis.
        radius: m, of the slice.
        w: m, height of the slice above the tip.
        circle: (n, 2) sine and cosine of even angles from 0 to π.
        arcs: (n, 2) rad, start and end of each arc, which are written.
    """
    h = frame[1]
    reach = radius + h
    last = len(circle) - 1
    stride = max(int(last * SPACING * h / (pi * reach)), 1)
    count, start, phi_before, is_before = 0, 0.0, 0.0, False
    steps = (last + stride - 1) // stride
    for n in range(steps + 2):  # the step behind the last sample ends the arc there
        is_inside, phi = False, pi
        if n <= steps:
            m = min(n * stride, last)
            phi = pi * m / last
            is_inside = _is_inside(arrays, frame, axes, reach, circle[m, 0], circle[m, 1], w)
        if is_inside and not is_before:
            start = 0.0
            if n > 0:
                start = _find_crossing(arrays, frame, axes, reach, w, phi, phi_before)
                start = _carry_back(arrays, frame, axes, start, 1.0, radius, w)
        elif is_before and not is_inside:
            end = pi
            if phi_before < pi:
                end = _find_crossing(arrays, frame, axes, reach, w, phi_before, phi)
                end = _carry_back(arrays, frame, axes, end, -1.0, radius, w)
            count = _add_arc(max(start, 0.0), min(end, pi), radius, h, arcs, count)
        is_before, phi_before = is_inside, phi
    return count


@jit_compile
def _touches(arrays: FieldArrays, frame: Frame, axes: Axes, reach: float, phi: float, w: float) -> bool:
    """Return whether the material reaches a circle just outside of the cutter, at an angle."""
    s, c = reach * sin(phi), reach * cos(phi)
    x = axes[0, 0] + c * axes[1, 0] + s * axes[2, 0] + w * axes[3, 0]
    y = axes[0, 1] + c * axes[1, 1] + s * axes[2, 1] + w * axes[3, 1]
    z = axes[0, 2] + c * axes[1, 2] + s * axes[2, 2] + w * axes[3, 2]
    return bool(measure_field(arrays, frame, x, y, z) < GAP)


@jit_compile
def _find_gap_edge(
    arrays: FieldArrays,
    frame: Frame,
    axes: Axes,
    reach: float,
    w: float,
    between: tuple[float, float],
    begins_touching: bool,
) -> float:
    """Return the angle between two samples where a gap begins or ends, to a 64th of their distance."""
    low, high = between
    for _ in range(6):
        middle = 0.5 * (low + high)
        if _touches(arrays, frame, axes, reach, middle, w) == begins_touching:
            low = middle
        else:
            high = middle
    return 0.5 * (low + high)


@jit_compile
def leave_out_gaps(
    arrays: FieldArrays, frame: Frame, axes: Axes, radius: float, w: float, circle: Array, arcs: Array, number: int
) -> int:
    """Keep the parts of arcs where the material reaches the cutter; returns the number of arcs.

    A wall that was cut before, less than a cell away from the cutter, lies within the circle outside and not within a
    nearer one. Within a cell of the ends of an arc, edges are round.

    Args:
        arrays: The field after the move.
        frame: Corner of cell (0, 0, 0) and side of a cell.
        axes: (4, 3) tip, normal, travel, tool axis.
        radius: m, of the slice.
        w: m, height of the slice above the tip.
        circle: (n, 2) sine and cosine of even angles from 0 to π.
        arcs: (n, 2) rad, start and end of each arc, which change.
        number: Of the arcs.
    """
    h, last = frame[1], len(circle) - 1
    close, room = radius + CLOSE[0] * h, h / radius
    spacing = max(int(last * SPACING * h / (pi * (radius + h))), 1)
    count, remaining = 0, arcs.copy()
    for n in range(number):
        start, end, is_open = arcs[n, 0], arcs[n, 1], True
        for m in range(int((start + room) * last / pi) + 1, last + 1, spacing):
            phi = pi * m / last
            if phi >= end - room:
                break
            touches = _touches(arrays, frame, axes, close, phi, w)
            if touches != is_open:
                before = max(phi - spacing * pi / last, start if is_open else arcs[n, 0])
                edge = _find_gap_edge(arrays, frame, axes, close, w, (before, phi), is_open)
                if touches:
                    start = edge
                elif edge > start + room:
                    count = _add_arc(start, edge, radius, h, remaining, count)
            is_open = touches
        count = _add_arc(start, end, radius, h, remaining, count) if is_open else count
    arcs[:count] = remaining[:count]
    return count
