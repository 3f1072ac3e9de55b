"""Removal of a moving cutter, whose axis may turn, from a stock of signed distances.

A short step moves the tip straight and turns the axis evenly. With d(x, s) the distance of a place from the cutter at
the share s of the step, the stock's distance f becomes

    f(x) = max(f(x), −min over s of d(x, s)).

d changes by at most the length of the step, so that places that the step cannot change are left out after one value of
d. Along a short step d has one minimum, which is found by halving.
"""

from __future__ import annotations

from math import sqrt

import numpy as np

from machopt.numerics.array_types import Array
from machopt.numerics.compiled_functions import jit_compile
from machopt.process.stock.field_types import (
    AIR,
    BLOCK,
    EDGE,
    KNOTS,
    LIMIT,
    MOST,
    WIDE,
    Cutter,
    FieldArrays,
    Frame,
    Step,
)

Motion = tuple[Step, float, bool]

ROUNDS = 3  # halvings of a step in the search of the nearest pose
SLOPE, FLAT = 0.05, 1e-4  # share of a step in which a fall of less than this share of its length is none
LEVEL = 1e-6  # of the step; a smaller descent is rounding
HALF = EDGE // 2  # stored; a cell whose centre lies farther outside of the surface held almost no material
CUT, EQUAL = 0.02, 2e-3  # of a short step, and cells: a surface that moves by less was cut there before
_HALF = 0.5 * (BLOCK - 1) * 1.7320508  # cells, from the middle of a block to its farthest centre


@jit_compile
def compute_cutter_distance(r: float, z: float, cutter: Cutter) -> float:
    """Distance from the cutter's surface at a radius from its axis and a height above its tip, negative inside, m.

    Args:
        r: m, distance from the axis.
        z: m, height above the tip.
        cutter: radius, corner radius, slope of the cone, height.
    """
    radius, corner, cone, height = cutter
    inner = radius - corner
    if corner > 0.0 and z < corner and r > inner:
        x, y = r - inner, z - corner
        out = sqrt(x * x + y * y) - corner
    else:
        out = r - radius
        out = max(out, (cone * r - z) / sqrt(1.0 + cone * cone) if cone > 0.0 else -z)
    return max(out, z - height)


@jit_compile
def _measure(x: float, y: float, z: float, step: Step, s: float, cutter: Cutter) -> float:
    """Distance of a place from the cutter at a share of a step."""
    px, py, pz, dx, dy, dz, ax, ay, az, bx, by, bz = step
    vx, vy, vz = x - px - s * dx, y - py - s * dy, z - pz - s * dz
    along = vx * (ax + s * bx) + vy * (ay + s * by) + vz * (az + s * bz)
    rest = vx * vx + vy * vy + vz * vz - along * along
    return compute_cutter_distance(sqrt(rest) if rest > 0.0 else 0.0, along, cutter)


@jit_compile
def _find_least(
    x: float, y: float, z: float, step: Step, ends: tuple[float, float], reach: float, cutter: Cutter
) -> float:
    """Least distance of a place from the cutter along a step with the distances ``ends`` at its ends."""
    first, last = ends
    if last <= first:
        if _measure(x, y, z, step, 1.0 - SLOPE, cutter) >= last - FLAT * reach:
            return last
    elif _measure(x, y, z, step, SLOPE, cutter) >= first - FLAT * reach:
        return first
    s, width = 0.5, 0.5
    m = _measure(x, y, z, step, s, cutter)
    for _ in range(ROUNDS):
        width *= 0.5
        left, right = _measure(x, y, z, step, s - width, cutter), _measure(x, y, z, step, s + width, cutter)
        if left < m and left <= right:
            m, s = left, s - width
        elif right < m:
            m, s = right, s + width
    return min(first, m, last)


@jit_compile
def compute_share(value: float) -> float:
    """Share of material of a cell from its stored distance, 0 … 1.

    It is a step averaged over two intervals, the distances of lattice planes across (1 0 0) and (1 1 0). The sum of
    shares across a flat surface with one of these normals is then exact wherever the surface lies. With the first
    interval alone a surface at 45° to the cells moves by up to 0.5 % of a cell, with its place in the grid.

    Args:
        value: Stored distance.
    """
    t = abs(value) / EDGE
    a, b = max(KNOTS[0] - t, 0.0), max(KNOTS[1] - t, 0.0)
    out = (a * a - b * b) / (2.0 * WIDE)
    return out if value > 0.0 else 1.0 - out


@jit_compile
def _is_unchanged(x: float, y: float, z: float, size: float, step: Step, reach: float, cutter: Cutter) -> bool:
    """Whether a step changes nothing within ``size`` of a place, where its start was removed before.

    The cutter's end does not come down on the place, and the place lies behind the cutter, or under its flat end.
    """
    px, py, pz, dx, dy, dz, ax, ay, az, bx, by, bz = step
    vx, vy, vz = x - px, y - py, z - pz
    down = vx * bx + vy * by + vz * bz - (dx * ax + dy * ay + dz * az)
    if cutter[2] > 0.0 or down + size * (abs(bx) + abs(by) + abs(bz)) > LEVEL * reach:
        return False
    along = vx * ax + vy * ay + vz * az
    rx, ry, rz = vx - along * ax, vy - along * ay, vz - along * az
    room = size + 2.0 * reach
    inner = cutter[0] - cutter[1] - room
    if inner > 0.0 and rx * rx + ry * ry + rz * rz < inner * inner:
        return True
    mx, my, mz = dx + along * bx, dy + along * by, dz + along * bz
    ahead = rx * mx + ry * my + rz * mz
    most = sqrt(mx * mx + my * my + mz * mz) + size * (abs(bx) + abs(by) + abs(bz))
    return bool(ahead < -room * most)


@jit_compile
def _add_height(heights: Array, x: float, y: float, z: float, step: Step, cell: float, volume: float) -> None:
    """Add a removed volume to the bin of its height above the tip at the end of the step; bins are one cell high."""
    px, py, pz, dx, dy, dz, ax, ay, az, bx, by, bz = step
    along = (x - px - dx) * (ax + bx) + (y - py - dy) * (ay + by) + (z - pz - dz) * (az + bz)
    heights[min(max(int(along / cell), 0), len(heights) - 1)] += volume


@jit_compile
def _widen_range(span: Array, x: float, y: float, z: float, step: Step, distance: float) -> None:
    """Widen the range of heights of removed material by a cell, from its distance to the surface before, m.

    No material ends nearer than at that distance: the range is never too wide. At a face across the axis it is exact.
    """
    px, py, pz, dx, dy, dz, ax, ay, az, bx, by, bz = step
    along = (x - px - dx) * (ax + bx) + (y - py - dy) * (ay + by) + (z - pz - dz) * (az + bz)
    span[0], span[1] = min(span[0], along + distance), max(span[1], along - distance)


@jit_compile
def _take_place(arrays: FieldArrays) -> int:
    """Return a free place of the pool; the first one, and a count, where there is none."""
    _, pool, free, state = arrays
    if state[1] > 0:
        state[1] -= 1
        return int(free[state[1]])
    if state[0] < len(pool):
        state[0] += 1
        return int(state[0] - 1)
    state[2] += 1
    return -1


@jit_compile
def _cut_block(
    arrays: FieldArrays,
    at: tuple[int, int, int],
    frame: Frame,
    motion: Motion,
    cutter: Cutter,
    heights: Array,
    span: Array,
) -> float:
    """Remove a step from one block; returns the removed volume in cells."""
    step, reach, is_first = motion
    table, pool, free, state = arrays
    place = table[at]
    origin, h = frame
    x0, y0 = origin[0] + (at[0] * BLOCK + 0.5) * h, origin[1] + (at[1] * BLOCK + 0.5) * h
    z0 = origin[2] + (at[2] * BLOCK + 0.5) * h
    row = 0.5 * (BLOCK - 1) * h + LIMIT * h + reach
    removed, lowest = 0.0, MOST
    value, least = -MOST, max(CUT * min(reach / h, 1.0), EQUAL) * EDGE
    for i in range(BLOCK):
        for j in range(BLOCK):
            x, y, first = x0 + i * h, y0 + j * h, (i * BLOCK + j) * BLOCK
            middle = z0 + 0.5 * (BLOCK - 1) * h
            if _measure(x, y, middle, step, 1.0, cutter) > row or (
                not is_first and _is_unchanged(x, y, middle, 0.5 * (BLOCK - 1) * h, step, reach, cutter)
            ):
                lowest = -MOST
                continue
            for k in range(BLOCK):
                if place >= 0:
                    value = pool[place, first + k]
                if value >= MOST:
                    continue
                z = z0 + k * h
                last = _measure(x, y, z, step, 1.0, cutter)
                if (reach - last) / h * EDGE <= value:
                    lowest = min(lowest, value)
                    continue
                if last > -LIMIT * h:
                    first_value = _measure(x, y, z, step, 0.0, cutter)
                    if 0.5 * (reach - last - first_value) / h * EDGE <= value:
                        lowest = min(lowest, value)
                        continue
                    last = _find_least(x, y, z, step, (first_value, last), reach, cutter)
                new = int(min(-last / h * EDGE + 32768.5, 32768.0 + MOST)) - 32768 if last < LIMIT * h else -MOST
                if new > value:
                    if place < 0:
                        place = _take_place(arrays)
                        if place < 0:
                            return removed
                        pool[place, :] = -MOST
                        table[at] = place
                    pool[place, first + k] = new
                    part = compute_share(value) - compute_share(new)
                    if part > 0.0:
                        removed += part
                        _add_height(heights, x, y, z, step, h, part * h * h * h)
                        if new - value > least and value < HALF:
                            _widen_range(span, x, y, z, step, value * h / EDGE)
                lowest = min(lowest, max(new, value))
    if lowest >= MOST and place >= 0:
        table[at] = AIR
        free[state[1]] = place
        state[1] += 1
    return removed


@jit_compile
def remove_step(
    arrays: FieldArrays, frame: Frame, motion: Motion, cutter: Cutter, heights: Array, span: Array
) -> float:
    """Remove a short step of the cutter from the stock; returns the removed volume, m³.

    Args:
        arrays: The field, which changes. Its state counts the blocks for which there was no place.
        frame: Corner of cell (0, 0, 0) and side of a cell, m.
        motion: The step; the most that a place of the cutter moves along it, m; whether its start was not removed yet.
        cutter: radius, corner radius, slope of the cone, height.
        heights: (n,) removed volume by height above the tip in bins of one cell, which is added to.
        span: (2 or more,) m, lowest and highest removed material above the tip, which is widened.
    """
    table = arrays[0]
    origin, h = frame
    step, reach, is_first = motion
    size = BLOCK * h
    low, high = np.zeros(3, np.int64), np.zeros(3, np.int64)
    for n in range(3):
        p, a = step[n] + step[3 + n], step[6 + n] + step[9 + n]
        side = cutter[0] * sqrt(max(1.0 - a * a, 0.0)) + reach + LIMIT * h
        bottom, top = min(p, p + cutter[3] * a) - side, max(p, p + cutter[3] * a) + side
        low[n] = max(int(np.floor((bottom - origin[n]) / size)), 0)
        high[n] = min(int(np.floor((top - origin[n]) / size)) + 1, table.shape[n])
    removed = 0.0
    far = (_HALF + LIMIT) * h + reach
    for bx in range(low[0], high[0]):
        x = origin[0] + (bx + 0.5) * size
        for by in range(low[1], high[1]):
            y = origin[1] + (by + 0.5) * size
            for bz in range(low[2], high[2]):
                if table[bx, by, bz] == AIR:
                    continue
                z = origin[2] + (bz + 0.5) * size
                if _measure(x, y, z, step, 1.0, cutter) <= far and (
                    is_first or not _is_unchanged(x, y, z, _HALF * h, step, reach, cutter)
                ):
                    removed += _cut_block(arrays, (bx, by, bz), frame, motion, cutter, heights, span)
    return removed * h * h * h
