"""Contact of a cutter with a stock of signed distances: arcs of engagement at slices along the tool axis.

Slices lie between the lowest and the highest material that was removed: beyond it, a wall that was cut before touches
the cutter over the whole length of the outline. Where arcs of two slices differ, their boundary is found.
"""

from __future__ import annotations

from math import acos, cos, sqrt

import numpy as np

from machopt.numerics.array_types import Array
from machopt.numerics.compiled_functions import jit_compile
from machopt.process.stock.contact_kernels import CORNER_SLICES
from machopt.process.stock.field_arcs import HALVINGS, Axes, add_arcs
from machopt.process.stock.field_types import Cutter, FieldArrays, Frame

SLICES = 24  # of the cylindrical part, at most
THICKNESS = 2.0  # cells, of a slice, at least
SAME_ANGLE = 0.004  # rad; neighbouring slices whose arcs differ by less become one
STEP_ANGLE = 0.1  # rad of all arcs of a slice; at a larger difference of neighbours their boundary is found
RISING = 1e-3  # of the largest removed volume of a bin; bins with less are left out


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
    for _ in range(HALVINGS):
        w = 0.5 * (a + b)
        if add_arcs(arrays, frame, axes, _compute_radius(cutter, w), w, circle, arcs):
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
    for n in range(add_arcs(arrays, frame, axes, _compute_radius(cutter, w), w, circle, arcs)):
        total += arcs[n, 1] - arcs[n, 0]
    return total


@jit_compile
def _choose_height(low: float, high: float, ends: tuple[float, float], corner: float, h: float) -> float:
    """Height at which a slice is measured, for contact between ``ends``.

    A field rounds the edges of the stock within a cell of where the contact ends.
    """
    w = 0.5 * (low + high)
    if low < corner:
        return w
    margin = min(h, 0.5 * (ends[1] - ends[0]))
    return min(max(w, ends[0] + margin if ends[0] > 0.0 else 0.0), ends[1] - margin)


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
    """Move the boundary of two slices above the corner to where the arcs change."""
    ends = (slices[has[0], 0], slices[has[1], 1])
    for m in has:
        w = _choose_height(slices[m, 0], slices[m, 1], ends, cutter[1], frame[1])
        slices[m, 2], slices[m, 3] = _measure_width(arrays, frame, axes, cutter, w, circle, arcs), w
    for m in range(has[0], has[1]):
        first, last = slices[m, 2], slices[m + 1, 2]
        if slices[m, 0] < cutter[1] or abs(last - first) < STEP_ANGLE:
            continue
        a, b = slices[m, 3], slices[m + 1, 3]
        for _ in range(HALVINGS):
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
    ends = (slices[lowest, 0], slices[highest, 1])
    found, before = 0, (0, 0)
    for n in range(lowest, highest + 1):
        low, high = slices[n, 0], slices[n, 1]
        w = _choose_height(low, high, ends, cutter[1], h)
        number = add_arcs(arrays, frame, axes, _compute_radius(cutter, w), w, circle, arcs) if high > low else 0
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
