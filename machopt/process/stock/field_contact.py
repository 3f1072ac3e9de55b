"""Contact of a cutter with a stock of signed distances: arcs of engagement at slices along the tool axis.

Slices lie between the lowest and the highest material that was removed: beyond it, a wall that was cut before touches
the cutter over the whole length of the outline. Where arcs of two slices differ, heights between them are measured: an
edge across the axis is found, and a slope, as an axis that sways leaves it, is followed. A wall that was cut before,
nearer than a cell, is no contact.
"""

from __future__ import annotations

from math import acos, cos, pi, sqrt

import numpy as np

from machopt.numerics.array_types import Array
from machopt.numerics.compiled_functions import jit_compile
from machopt.process.stock.contact_kernels import CORNER_SLICES
from machopt.process.stock.field_arcs import HALVINGS, Axes, add_arcs, leave_out_gaps
from machopt.process.stock.field_types import Cutter, FieldArrays, Frame

SLICES = 24  # of the cylindrical part, at most, where no arcs change: an even wall needs one
THICKNESS = 2.0  # cells, of a slice where no arcs change: the sampling distance of a field without aliasing
SAME_ANGLE = 0.004  # rad; neighbouring slices whose arcs differ by less become one
# rad of all arcs of a slice; where neighbours differ by more, arcs are measured between them. A height between two
# nodes then has arcs within half of it of those stated: 1 sigma of an angle is at most 0.1/√12 rad = 1.7°.
STEP_ANGLE = 0.1
SHORTEST = 0.5  # cells between such heights, at least: the field is known at every cell
EDGE_HEIGHT = 1.0  # cells over which an edge across the axis is rounded
NARROWER = (
    0.8  # of the width a cell from the end; at a slope it falls to 0.5, at a round one to 0.71 half a cell from it
)
NEAR = 0.5 * SHORTEST  # cells from an end of the contact that is no edge: the middle of the thinnest slice
NODES = SLICES + 2 * 20  # heights at which arcs are measured, at most: an edge across the axis divides an interval of
# ``THICKNESS`` twice until it is ``SHORTEST``; there is room for 20 edges at one point
RISING = 1e-3  # of the largest removed volume of a bin; less is the rounding of stored distances (EQUAL cells)


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
def _measure_node(
    arrays: FieldArrays, frame: Frame, axes: Axes, cutter: Cutter, w: float, circle: Array, node: Array
) -> None:
    """Write a height, the number of its arcs and the arcs to the rows of a node."""
    node[0, 0] = w
    radius, arcs = _compute_radius(cutter, w), node[1:]
    number = add_arcs(arrays, frame, axes, radius, w, circle, arcs)
    node[0, 1] = leave_out_gaps(arrays, frame, axes, radius, w, circle, arcs, number) if number else 0


@jit_compile
def _sum_arcs(node: Array) -> float:
    """Sum of the arcs of a node, rad."""
    total = 0.0
    for m in range(1, int(node[0, 1]) + 1):
        total += node[m, 1] - node[m, 0]
    return total


@jit_compile
def _compare_nodes(a: Array, b: Array) -> float:
    """Return how far the arcs of two nodes differ, rad; π where their numbers differ."""
    if a[0, 1] != b[0, 1]:
        return pi
    total = 0.0
    for m in range(1, int(a[0, 1]) + 1):
        total += abs(a[m, 0] - b[m, 0]) + abs(a[m, 1] - b[m, 1])
    return total


@jit_compile
def _find_margins(
    arrays: FieldArrays,
    frame: Frame,
    axes: Axes,
    cutter: Cutter,
    ends: tuple[float, float],
    circle: Array,
    nodes: Array,
) -> tuple[float, float]:
    """Distances from the ends of the contact at which its arcs are measured first and last.

    A field rounds the edges of the stock within a cell of where the contact ends. Where the contact is much narrower
    half a cell from there than a cell from there, it ends at a slope and is measured up to it. ``nodes`` is work space.
    """
    h, half = frame[1], 0.5 * (ends[1] - ends[0])
    near = NEAR * min(h, half)
    margins = (near, near)
    for is_top in (False, True):
        if not is_top and ends[0] <= cutter[1]:
            continue
        sign = -1.0 if is_top else 1.0
        for n in range(2):
            at = ends[1 if is_top else 0] + sign * (1.0 - 0.5 * n) * min(h, half)
            _measure_node(arrays, frame, axes, cutter, at, circle, nodes[n])
        if _sum_arcs(nodes[1]) > NARROWER * _sum_arcs(nodes[0]):
            margins = (margins[0], min(h, half)) if is_top else (min(h, half), margins[1])
    return margins


@jit_compile
def _find_boundary(
    arrays: FieldArrays, frame: Frame, axes: Axes, cutter: Cutter, circle: Array, a: Array, b: Array, work: Array
) -> float:
    """Height between two nodes where the arcs change from those of the first to those of the second."""
    low, high = a[0, 0], b[0, 0]
    first, last = _sum_arcs(a), _sum_arcs(b)
    if abs(first - last) < STEP_ANGLE:
        return float(0.5 * (low + high))
    for _ in range(HALVINGS):
        w = 0.5 * (low + high)
        _measure_node(arrays, frame, axes, cutter, w, circle, work)
        if abs(_sum_arcs(work) - first) < abs(_sum_arcs(work) - last):
            low = w
        else:
            high = w
    return float(0.5 * (low + high))


@jit_compile
def _sample_heights(
    arrays: FieldArrays,
    frame: Frame,
    axes: Axes,
    cutter: Cutter,
    ends: tuple[float, float],
    circle: Array,
    nodes: Array,
) -> int:
    """Measure the arcs at heights above the corner, denser where they change; returns the number of nodes."""
    h = frame[1]
    below, above = _find_margins(arrays, frame, axes, cutter, ends, circle, nodes)
    low, high = ends[0] + below, ends[1] - above
    count = min(max(int(np.ceil((high - low) / (THICKNESS * h))) + 1, 2), SLICES)
    for n in range(count):
        w = low + (high - low) * n / (count - 1)
        _measure_node(arrays, frame, axes, cutter, w, circle, nodes[n])
    n = 0
    while n < count - 1:
        a, b = nodes[n, 0, 0], nodes[n + 1, 0, 0]
        if count == len(nodes) - 1 or b - a <= SHORTEST * h or _compare_nodes(nodes[n], nodes[n + 1]) < STEP_ANGLE:
            n += 1
            continue
        for m in range(count, n + 1, -1):
            nodes[m] = nodes[m - 1]
        _measure_node(arrays, frame, axes, cutter, 0.5 * (a + b), circle, nodes[n + 1])
        count += 1
    return count


@jit_compile
def _place_boundaries(
    arrays: FieldArrays,
    frame: Frame,
    axes: Axes,
    cutter: Cutter,
    circle: Array,
    nodes: Array,
    number: int,
    tops: Array,
) -> int:
    """Write the upper end of the slice of each node but the last; returns the number of nodes.

    Arcs that change within a cell of height change at an edge across the axis, which the field rounds: the nodes within
    are left out, and the place of the edge is found. Arcs that change over more follow a slope.
    """
    h, n, count = frame[1], 0, 1
    while n < number - 1:
        m = n
        while m < number - 1 and _compare_nodes(nodes[m], nodes[m + 1]) >= STEP_ANGLE:
            m += 1
        if m > n and nodes[m, 0, 0] - nodes[n, 0, 0] <= EDGE_HEIGHT * h:
            edge = _find_boundary(arrays, frame, axes, cutter, circle, nodes[n], nodes[m], nodes[len(nodes) - 1])
            while (
                count > 1
                and edge - nodes[count - 1, 0, 0] < EDGE_HEIGHT * h
                and _compare_nodes(nodes[count - 2], nodes[count - 1]) < STEP_ANGLE
            ):
                count -= 1
            while (
                m < number - 1
                and nodes[m, 0, 0] - edge < EDGE_HEIGHT * h
                and _compare_nodes(nodes[m], nodes[m + 1]) < STEP_ANGLE
            ):
                m += 1
            tops[count - 1], n = edge, m
        else:
            tops[count - 1], n = 0.5 * (nodes[n, 0, 0] + nodes[n + 1, 0, 0]), n + 1
        nodes[count] = nodes[n]
        count += 1
    return count


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
def _add_rows(rows: Array, found: int, low: float, high: float, node: Array) -> int:
    """Write the arcs of a node for a range of heights; returns the number of rows."""
    for m in range(1, min(int(node[0, 1]), len(rows) - found) + 1):
        rows[found, 0], rows[found, 1] = low, high
        rows[found, 2], rows[found, 3] = node[m, 0], node[m, 1]
        found += 1
    return found


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
    slices = np.zeros((CORNER_SLICES + SLICES, 3))  # low, high, width of the arcs in the middle
    nodes = np.zeros((NODES, 1 + len(arcs), 2))  # height and number of arcs, then the arcs
    low, high = max((first - 1) * h, span[0], 0.0), min((last + 1) * h, span[1], cutter[3])
    if low >= high:
        return 0
    count = _divide(cutter, low, high, h, slices)
    lowest, highest = -1, -1
    for n in range(count):
        w = 0.5 * (slices[n, 0] + slices[n, 1])
        slices[n, 2] = _measure_width(arrays, frame, axes, cutter, w, circle, arcs)
        if slices[n, 2] > 0.0:
            lowest, highest = (n if lowest < 0 else lowest), n
    if lowest < 0:
        return 0
    _refine_ends(arrays, frame, axes, cutter, slices, (lowest, highest, count), (low, high), circle, arcs)
    found = 0
    for n in range(lowest, highest + 1):
        if slices[n, 0] < cutter[1] and slices[n, 1] > slices[n, 0]:
            w = 0.5 * (slices[n, 0] + slices[n, 1])
            _measure_node(arrays, frame, axes, cutter, w, circle, nodes[0])
            found = _add_rows(rows, found, slices[n, 0], slices[n, 1], nodes[0])
    ends = (max(slices[lowest, 0], cutter[1]), slices[highest, 1])
    count = _sample_heights(arrays, frame, axes, cutter, ends, circle, nodes) if ends[1] > ends[0] else 0
    tops = np.zeros(NODES)
    count = _place_boundaries(arrays, frame, axes, cutter, circle, nodes, count, tops) if count else 0
    before = (0, 0)
    for n in range(count):
        low, high = tops[n - 1] if n > 0 else ends[0], tops[n] if n + 1 < count else ends[1]
        second = found
        found = _add_rows(rows, found, low, high, nodes[n])
        if n > 0 and _merge(rows, (before[0], second), found):
            found = second
        else:
            before = (second, found)
    return found
