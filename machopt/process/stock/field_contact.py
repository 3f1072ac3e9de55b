"""Contact of a cutter with a stock of signed distances: arcs of engagement at slices along the tool axis.

The stock is measured after the move, one cell outside of the cutter: the move has not changed there what is material,
and neither have the moves before it near the sides of the cutter, where the chip is thinner than a cell. Each boundary
is carried back to the cutter along its tangent, as on a height map (:mod:`machopt.process.stock.contact_kernels`).
"""

from __future__ import annotations

from math import acos, cos, pi, sin, sqrt

import numpy as np

from machopt.numerics.array_types import Array
from machopt.numerics.compiled_functions import jit_compile
from machopt.process.stock.contact_kernels import (
    CLOSE,
    CORNER_SLICES,
    FITS,
    SEARCH,
    SPACING,
    THIN_CHIP,
    extrapolate_boundary,
    measure_line,
)
from machopt.process.stock.field_types import (
    AIR,
    BLOCK,
    EDGE,
    LAST,
    LIMIT,
    MOST,
    SHIFT,
    SOLID,
    Cutter,
    FieldArrays,
    Frame,
    Table,
)

SLICES = 24  # of the cylindrical part, at most
THICKNESS = 2.0  # cells, of a slice, at least
SAME_ANGLE = 0.004  # rad; neighbouring slices whose arcs differ by less become one
RISING = 1e-3  # of the largest removed volume of a bin; bins with less are left out
_HALVINGS = 6
STEP_ANGLE = 0.1  # rad of all arcs of a slice; at a larger difference of neighbours their boundary is found

Axes = Array  # (4, 3) tip, normal, travel, tool axis


@jit_compile
def measure_field(arrays: FieldArrays, frame: Frame, x: float, y: float, z: float) -> float:
    """Distance of a place from the stock's surface in cells, negative in the material, by the eight cells around it.

    Args:
        arrays: The field.
        frame: Corner of cell (0, 0, 0) and side of a cell.
        x: m, CAM frame.
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
    for _ in range(_HALVINGS):
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
def _add_arcs(
    arrays: FieldArrays, frame: Frame, axes: Axes, radius: float, w: float, circle: Array, arcs: Array
) -> int:
    """Write start and end of each arc of a slice; returns their number."""
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
            a, b = max(start, 0.0), min(end, pi)
            is_side = a <= 0.0 or b >= pi
            depth = radius * (1.0 - cos(min(b - a if is_side else 0.5 * (b - a), pi))) if b > a else 0.0
            if depth > THIN_CHIP * h and count < len(arcs):
                arcs[count, 0], arcs[count, 1] = a, b
                count += 1
        is_before, phi_before = is_inside, phi
    return count


@jit_compile
def _divide(cutter: Cutter, low: float, high: float, h: float, slices: Array) -> int:
    """Write lower and upper end of the slices between two heights; returns their number."""
    corner = cutter[1]
    count = 0
    if low < corner:
        top = min(high, corner)
        a, b = acos(max(1.0 - low / corner, 0.0)), acos(max(1.0 - top / corner, 0.0))
        for n in range(CORNER_SLICES):
            slices[count, 0] = corner * (1.0 - cos(a + (b - a) * n / CORNER_SLICES))
            slices[count, 1] = corner * (1.0 - cos(a + (b - a) * (n + 1) / CORNER_SLICES))
            count += 1
        low = corner
    if high > low:
        number = min(max(int((high - low) / (THICKNESS * h)), 1), SLICES)
        for n in range(number):
            slices[count, 0] = low + (high - low) * n / number
            slices[count, 1] = low + (high - low) * (n + 1) / number
            count += 1
    return count


@jit_compile
def _compute_radius(cutter: Cutter, w: float) -> float:
    """Radius of the cutter at a height above its tip; that of a drill's point counts as a cylinder."""
    radius, corner = cutter[0], cutter[1]
    if w >= corner:
        return radius
    return radius - corner + sqrt(max(corner * corner - (corner - w) * (corner - w), 0.0))


@jit_compile
def _find_end(
    arrays: FieldArrays, frame: Frame, axes: Axes, cutter: Cutter, ends: Array, circle: Array, arcs: Array
) -> float:
    """Height at which the contact ends between ``ends[0]``, in contact, and ``ends[1]``, without."""
    a, b = float(ends[0]), float(ends[1])
    for _ in range(_HALVINGS):
        w = 0.5 * (a + b)
        if _add_arcs(arrays, frame, axes, _compute_radius(cutter, w), w, circle, arcs):
            a = w
        else:
            b = w
    return 0.5 * (a + b)


@jit_compile
def _refine_ends(
    arrays: FieldArrays,
    frame: Frame,
    axes: Axes,
    cutter: Cutter,
    slices: Array,
    has: tuple[int, int, int],
    span: tuple[float, float],
    circle: Array,
    arcs: Array,
) -> None:
    """Move the lower end of the first slice in contact and the upper end of the last to where the contact ends.

    That is within ``span``: beyond it, a wall that was cut before may touch the cutter.
    """
    first, last, count = has
    h = frame[1]
    ends = np.zeros(2)
    bottom, top = slices[0, 0], slices[count - 1, 1]
    ends[0] = 0.5 * (slices[last, 0] + slices[last, 1])
    ends[1] = 0.5 * (slices[last + 1, 0] + slices[last + 1, 1]) if last + 1 < count else min(top + h, cutter[3] + h)
    above = min(_find_end(arrays, frame, axes, cutter, ends, circle, arcs), cutter[3])
    ends[0] = 0.5 * (slices[first, 0] + slices[first, 1])
    ends[1] = 0.5 * (slices[first - 1, 0] + slices[first - 1, 1]) if first > 0 else max(bottom - h, 0.0)
    below = 0.0
    if ends[1] > 0.0:
        below = _find_end(arrays, frame, axes, cutter, ends, circle, arcs)
    above, below = min(above, span[1]), max(below, span[0])
    for m, is_top, height in ((last, True, above), (first, False, below)):
        is_corner = slices[m, 1] <= cutter[1]
        limit = cutter[1]
        if is_top:
            slices[m, 1] = min(height, limit) if is_corner else height
        elif is_corner or limit <= 0.0:
            slices[m, 0] = height
        else:
            slices[m, 0] = max(height, limit)


@jit_compile
def _measure_width(
    arrays: FieldArrays, frame: Frame, axes: Axes, cutter: Cutter, w: float, circle: Array, arcs: Array
) -> float:
    """Sum of the arcs of contact at a height, rad."""
    total = 0.0
    for n in range(_add_arcs(arrays, frame, axes, _compute_radius(cutter, w), w, circle, arcs)):
        total += arcs[n, 1] - arcs[n, 0]
    return total


@jit_compile
def _refine_boundaries(
    arrays: FieldArrays,
    frame: Frame,
    axes: Axes,
    cutter: Cutter,
    slices: Array,
    has: tuple[int, int],
    circle: Array,
    arcs: Array,
) -> None:
    """Move the boundary of two slices to where the arcs change, above the corner."""
    for m in range(has[0], has[1]):
        first, last = slices[m, 2], slices[m + 1, 2]
        if slices[m, 0] < cutter[1] or abs(last - first) < STEP_ANGLE:
            continue
        a, b = slices[m, 3], slices[m + 1, 3]
        for _ in range(_HALVINGS):
            w = 0.5 * (a + b)
            width = _measure_width(arrays, frame, axes, cutter, w, circle, arcs)
            if abs(width - first) < abs(width - last):
                a = w
            else:
                b = w
        slices[m, 1] = slices[m + 1, 0] = 0.5 * (a + b)


@jit_compile
def _merge(rows: Array, before: tuple[int, int], found: int) -> bool:
    """Join the rows from ``before[1]`` with those of the slice below where their arcs are equal."""
    first, second = before
    number = found - second
    if number == 0 or number != second - first:
        return False
    for n in range(number):
        a, b = rows[first + n], rows[second + n]
        if a[1] != b[0] or abs(a[2] - b[2]) > SAME_ANGLE or abs(a[3] - b[3]) > SAME_ANGLE:
            return False
    for n in range(number):
        rows[first + n, 1] = rows[second + n, 1]
    return True


@jit_compile
def find_field_contact(
    arrays: FieldArrays,
    frame: Frame,
    axes: Axes,
    cutter: Cutter,
    heights: Array,
    span: tuple[float, float],
    circle: Array,
    arcs: Array,
    rows: Array,
) -> int:
    """Write the arcs of contact of a cutter at the end of a move; returns their number.

    Args:
        arrays: The field after the move.
        frame: Corner of cell (0, 0, 0) and side of a cell.
        axes: (4, 3) tip, normal (axis × travel), travel across the axis, tool axis.
        cutter: radius, corner radius, slope of the cone, height.
        heights: (n,) volume that the move removed by height above the tip, bins of one cell.
        span: m, lowest and highest material above the tip that was removed within a cell of travel.
        circle: (n, 2) sine and cosine of even angles from 0 to π.
        arcs: (n, 2) work space.
        rows: (m, 4) low, high, start, end of each arc.
    """
    h, most = frame[1], 0.0
    for n in range(len(heights)):
        most = max(most, heights[n])
    if most <= 0.0:
        return 0
    first, last = -1, 0
    for n in range(len(heights)):
        if heights[n] > RISING * most:
            first, last = (n if first < 0 else first), n
    slices = np.zeros((CORNER_SLICES + SLICES, 4))  # low, high, width of the arcs at a height, that height
    low, high = max((first - 1) * h, span[0], 0.0), min((last + 1) * h, span[1], cutter[3])
    if low >= high:
        return 0
    count = _divide(cutter, low, high, h, slices)
    lowest, highest = -1, -1
    for n in range(count):
        w = 0.5 * (slices[n, 0] + slices[n, 1])
        slices[n, 2], slices[n, 3] = _measure_width(arrays, frame, axes, cutter, w, circle, arcs), w
        if slices[n, 2] > 0.0:
            lowest, highest = (n if lowest < 0 else lowest), n
    if lowest < 0:
        return 0
    _refine_ends(arrays, frame, axes, cutter, slices, (lowest, highest, count), (low, high), circle, arcs)
    _refine_boundaries(arrays, frame, axes, cutter, slices, (lowest, highest), circle, arcs)
    bottom, top = slices[lowest, 0], slices[highest, 1]
    margin = min(h, 0.5 * (top - bottom))
    found, before = 0, (0, 0)
    for n in range(lowest, highest + 1):
        low, high = slices[n, 0], slices[n, 1]
        w = 0.5 * (low + high)
        if low >= cutter[1]:  # a field rounds the edges of the stock within a cell of where the contact ends
            w = min(max(w, bottom + margin if bottom > 0.0 else 0.0), top - margin)
        number = _add_arcs(arrays, frame, axes, _compute_radius(cutter, w), w, circle, arcs) if high > low else 0
        second = found
        for m in range(min(number, len(rows) - found)):
            rows[found, 0], rows[found, 1] = low, high
            rows[found, 2], rows[found, 3] = arcs[m, 0], arcs[m, 1]
            found += 1
        if low >= cutter[1] and _merge(rows, (before[0], second), found):
            found = second
        else:
            before = (second, found)
    return found
