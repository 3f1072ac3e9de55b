"""Contact of a cutter with a height map: arcs of engagement at slices of its height.

The boundary of the stock is followed one cell outside of the cutter, where no earlier move of the pass has thinned the
material: the chip near the sides of the cutter is thinner than a cell, and the move before has removed cells inside of
the outline there. Each boundary point is carried back to the cutter along the boundary's tangent.
"""

from __future__ import annotations

from math import acos, asin, cos, pi, sin, sqrt

import numpy as np
from numpy.typing import NDArray

from machopt.numerics.array_types import Array
from machopt.numerics.compiled_functions import jit_compile
from machopt.process.stock.boundary_extrapolation import extrapolate_boundary, measure_line
from machopt.process.stock.kernel_types import BOTTOM, HIGH, LOW, SHARE, Grid, Pair, Tip

THIN = 5e-6  # m; material less than this above the tip is none: CAM files state 1 to 10 µm
MOST_LEVELS = 8  # heights of the stock around a point that get slices of their own
CORNER_SLICES = 12  # of the rounded corner
SOFT = 0.25  # cells of height over which a smooth surface passes from material to air
THIN_CHIP = 0.1  # cells: a contact less deep than this is none
SPACING = 2.0  # cells between two samples along the circle; a narrower contact may be missed
_HALVINGS = 5  # of a sampling interval, to 1/16 of a cell before the linear interpolation
SEARCH = 48  # steps along the circle in which the boundary is followed: 24 cells, a tangent within 2.4° of the circle
CLOSE = (0.25, 0.75)  # cells outside of the cutter where its tangent is checked, and found anew
FITS = 0.5  # cells; a tangent that is nearer there fits
_SAME_LEVEL = 5e-3  # of the largest height
LINEAR = 0.5  # cells: half of the slope between the centres of two cells, on which a boundary is interpolated
BOUNDARY_SIGMA = 1.0 / sqrt(12.0)  # cells, 1 sigma of the place of a boundary: a uniform distribution within its cell

View = tuple[float, float, float, float, float, float, float, float]
# x and its changes along travel and left of it, y and its changes, size of a cell m, 1 / m of a soft height


@jit_compile
def _build_view(origin: Pair, cell: Pair, p: Array, cu: float, cv: float) -> View:
    """Return the change from a place s along travel and c left of it, m, to coordinates x, y in the grid.

    Cell (i, j) has its centre at x = i + 1, y = j + 1: the four cells around a place are int(x) − 1, int(x) and so on.
    """
    return (
        *((p[0] - origin[0]) / cell[0] + 0.5, cu / cell[0], -cv / cell[0]),
        *((p[1] - origin[1]) / cell[1] + 0.5, cv / cell[1], cu / cell[1]),
        *(max(cell[0], cell[1]), 1.0 / (SOFT * max(cell[0], cell[1]))),
    )


@jit_compile
def _measure_cell(high: float, low: float, share: float, bottom: float, w: float, per_soft: float) -> float:
    """Material of a cell at a height: 1 inside, −1 outside.

    It takes numbers, because each array that a compiled function takes has its references counted at every call.
    """
    above = (high - w) * per_soft
    if above <= -1.0 or high <= bottom:
        return -1.0
    value = min(above, 1.0)
    if share > 0.0:
        value += share * (min(max((low - w) * per_soft, -1.0), 1.0) - value)
    return min(value, max((w - bottom) * per_soft, -1.0))


@jit_compile
def _measure(grid: Grid, view: View, s: float, c: float, w: float) -> float:
    """Material at a place, by the four cells around it: 1 inside, −1 outside, 0 on the boundary.

    Args:
        grid: (4, nv, nu) high, low, share, bottom.
        view: Place in the grid.
        s: m, of the place from the axis, along travel.
        c: m, left of it.
        w: m, height.
    """
    x, y, per_soft = view[0] + s * view[1] + c * view[2], view[3] + s * view[4] + c * view[5], view[7]
    nv, nu = grid.shape[1:]
    if not (0.0 < x < nu + 1.0 and 0.0 < y < nv + 1.0):
        return -1.0
    i, j = int(x), int(y)
    fx, fy = x - i, y - j
    total = 0.0
    for b in range(max(j - 1, 0), min(j + 1, nv)):
        at_b = fy if b == j else 1.0 - fy
        for a in range(max(i - 1, 0), min(i + 1, nu)):
            value = _measure_cell(grid[HIGH, b, a], grid[LOW, b, a], grid[SHARE, b, a], grid[BOTTOM, b, a], w, per_soft)
            total += at_b * (fx if a == i else 1.0 - fx) * (value + 1.0)
    return total - 1.0


@jit_compile
def _add_level(levels: Array, count: int, height: float, same: float) -> int:
    """Insert a height into the list; returns the new count, −1 where there are too many."""
    for n in range(count):
        if abs(levels[n] - height) <= same:
            return count
    if count == MOST_LEVELS:
        return -1
    levels[count] = height
    return count + 1


@jit_compile
def _find_levels(
    grid: Grid,
    origin: Pair,
    cell: Pair,
    p: Array,
    cu: float,
    cv: float,
    reach: float,
    most: float,
    circle: Array,
    levels: Array,
) -> tuple[int, float]:
    """Write the heights of stock (top and bottom) above the tip ahead of the cutter; returns count and largest."""
    nv, nu = grid.shape[1:]
    top, count = 0.0, 0
    for n in range(len(circle)):
        s, c = reach * circle[n, 0], reach * circle[n, 1]
        i = int((p[0] + s * cu - c * cv - origin[0]) / cell[0])
        j = int((p[1] + s * cv + c * cu - origin[1]) / cell[1])
        if 0 <= i < nu and 0 <= j < nv and grid[HIGH, j, i] > grid[BOTTOM, j, i] and grid[HIGH, j, i] - p[2] > THIN:
            height = min(grid[HIGH, j, i] - p[2], most)
            top = max(top, height)
            same = max(_SAME_LEVEL * top, THIN)
            if count >= 0:
                count = _add_level(levels, count, height, same)
            if count >= 0 and grid[BOTTOM, j, i] - p[2] > THIN:
                count = _add_level(levels, count, grid[BOTTOM, j, i] - p[2], same)
    if count < 0:
        count = MOST_LEVELS
        for n in range(MOST_LEVELS):
            levels[n] = top * (n + 1) / MOST_LEVELS
    return count, top


@jit_compile
def _carry_back(grid: Grid, view: View, phi: float, into: float, reach: float, radius: float, w: float) -> float:
    """Angle at which the stock's boundary meets the cutter, from the angle at which it meets the circle ``reach``.

    The boundary is followed one more cell outwards; both places give its tangent. Where the tangent leads far along the
    cutter, it must also fit the boundary a quarter of a cell outside of the cutter. Else the boundary is no straight
    line: it bends, or a corner of the stock lies between. Two places nearer to the cutter then give the tangent.

    Args:
        grid: (4, nv, nu) high, low, share, bottom.
        view: Place in the grid.
        phi: angle on the circle ``reach``.
        into: 1 where the material lies at larger angles, −1 at smaller.
        reach: radius of the circle.
        radius: radius of the cutter's slice.
        w: height of the slice.
    """
    size = view[6]
    outer, close = reach + size, radius + CLOSE[0] * size
    far = _follow_boundary(grid, view, phi, into, outer, w, 0.5 * size / outer)
    carried, expected = phi, np.inf
    if np.isfinite(far):
        carried = extrapolate_boundary(phi, reach, far, outer, radius)
        misses = measure_line(phi, reach, far, outer) > radius + CLOSE[0] * size
        if abs(carried - phi) * radius < size and not misses:
            return carried
        expected = extrapolate_boundary(phi, reach, far, outer, close)
    near = _follow_boundary(grid, view, phi, into, close, w, 0.25 * size / radius)
    if not np.isfinite(near) or abs(near - expected) * radius < FITS * size:
        return carried
    middle = radius + CLOSE[1] * size
    between = _follow_boundary(grid, view, near, into, middle, w, 0.25 * size / radius)
    return extrapolate_boundary(near, close, between, middle, radius) if np.isfinite(between) else near


@jit_compile
def _follow_boundary(grid: Grid, view: View, phi: float, into: float, reach: float, w: float, step: float) -> float:
    """Angle at which a boundary meets another circle, near an angle; NaN where it does not.

    Arguments are those of :func:`_carry_back`; ``step`` is that of the search, rad.
    """
    s, c = reach * sin(phi), reach * cos(phi)
    before = _measure(grid, view, s, c, w)
    is_inside = before > 0.0
    sign = -into if is_inside else into
    turn_s, turn_c = sin(sign * step), cos(step)
    for n in range(1, SEARCH + 1):
        s, c = s * turn_c + c * turn_s, c * turn_c - s * turn_s
        value = _measure(grid, view, s, c, w)
        if (value > 0.0) != is_inside:
            there = phi + sign * n * step
            near = there - sign * step
            if is_inside:
                return _find_crossing(grid, view, reach, w, near, there, before, value)
            return _find_crossing(grid, view, reach, w, there, near, value, before)
        before = value
    return np.nan


@jit_compile
def _find_crossing(
    grid: Grid, view: View, reach: float, w: float, inside: float, outside: float, more: float, less: float
) -> float:
    """Angle of the boundary between an angle in the material and one outside, by halving and linear interpolation.

    ``more`` and ``less`` are the material there. It is linear where a cell is crossed, so that halving ends when both
    places lie within half a cell on such a slope.
    """
    near = LINEAR * view[6]
    for _ in range(_HALVINGS):
        if more < 1.0 and less > -1.0 and abs(outside - inside) * reach <= near:
            break
        phi = 0.5 * (inside + outside)
        value = _measure(grid, view, reach * sin(phi), reach * cos(phi), w)
        if value > 0.0:
            inside, more = phi, value
        else:
            outside, less = phi, value
    return inside + (outside - inside) * more / (more - less)


@jit_compile
def _find_end(grid: Grid, view: View, reach: float, radius: float, w: float, inside: float, outside: float) -> float:
    """Angle at which the cutter leaves the material, between two samples that the nearest cell distinguishes.

    The four cells around a sample may say else where the boundary lies within a cell of it; then the next sample holds.
    """
    spacing = outside - inside
    more = _measure(grid, view, reach * sin(inside), reach * cos(inside), w)
    if more <= 0.0:
        outside, less, inside, more = inside, more, inside - spacing, 1.0
    else:
        less = _measure(grid, view, reach * sin(outside), reach * cos(outside), w)
        if less > 0.0:
            inside, more, outside, less = outside, less, outside + spacing, -1.0
    phi = _find_crossing(grid, view, reach, w, inside, outside, more, less)
    return _carry_back(grid, view, phi, 1.0 if spacing < 0.0 else -1.0, reach, radius, w)


@jit_compile
def _add_arcs(grid: Grid, view: View, radius: float, w: float, circle: Array, arcs: Array) -> int:
    """Write start and end of each arc of a slice; returns their number."""
    size = view[6]
    reach = radius + size
    last = len(circle) - 1
    stride = max(int(last * SPACING * size / (pi * reach)), 1)
    nv, nu = grid.shape[1:]
    count, start, phi_before, is_before = 0, 0.0, 0.0, False
    steps = (last + stride - 1) // stride
    for n in range(steps + 2):  # the step behind the last sample ends the arc there
        is_inside, phi = False, pi
        if n <= steps:
            m = min(n * stride, last)
            phi = pi * m / last
            s, c = reach * circle[m, 0], reach * circle[m, 1]
            if 0 < n < steps:  # by the nearest cell
                x, y = view[0] + s * view[1] + c * view[2] - 0.5, view[3] + s * view[4] + c * view[5] - 0.5
                if 0.0 <= x < nu and 0.0 <= y < nv:
                    i, j = int(x), int(y)
                    height = grid[HIGH, j, i] if grid[SHARE, j, i] < 0.5 else grid[LOW, j, i]
                    is_inside = height > w > grid[BOTTOM, j, i]
            else:
                is_inside = _measure(grid, view, s, c, w) > 0.0
        if is_inside and not is_before:
            start = 0.0
            if n > 0:
                start = _find_end(grid, view, reach, radius, w, phi, phi_before)
        elif is_before and not is_inside:
            end = pi
            if phi_before < pi:
                end = _find_end(grid, view, reach, radius, w, phi_before, phi)
            a, b = max(start, 0.0), min(end, pi)
            is_side = a <= 0.0 or b >= pi
            depth = radius * (1.0 - cos(min(b - a if is_side else 0.5 * (b - a), pi))) if b > a else 0.0
            if depth > THIN_CHIP * size and count < len(arcs):
                arcs[count, 0], arcs[count, 1] = a, b
                count += 1
        is_before, phi_before = is_inside, phi
    return count


@jit_compile
def _write_rows(rows: Array, found: int, arcs: Array, number: int, low: float, high: float) -> int:
    """Write the arcs of a slice behind the rows found, as far as there is space; returns the new number of rows."""
    for k in range(min(number, len(rows) - found)):
        rows[found, 0], rows[found, 1] = low, high
        rows[found, 2], rows[found, 3] = arcs[k, 0], arcs[k, 1]
        found += 1
    return found


@jit_compile
def _interpolate_angle(phi: Pair, radii: Pair, r: float, is_along: bool) -> float:
    """Angle of a boundary at the radius r, on a straight line between those at two radii.

    The place left of the axis is linear over the radius, or with ``is_along`` that along travel, where both places lie
    on one side of it.
    """
    a, b = phi
    if (a <= 0.0 and b <= 0.0) or (a >= pi and b >= pi):
        return a
    share = (r - radii[0]) / (radii[1] - radii[0])
    if not is_along or (a - 0.5 * pi) * (b - 0.5 * pi) <= 0.0:
        return acos(min(max(((1.0 - share) * radii[0] * cos(a) + share * radii[1] * cos(b)) / r, -1.0), 1.0))
    out = asin(min(max(((1.0 - share) * radii[0] * sin(a) + share * radii[1] * sin(b)) / r, 0.0), 1.0))
    return out if a < 0.5 * pi else pi - out


@jit_compile
def _fill_between(arcs: Array, numbers: NDArray[np.int64], radii: Array, a: int, m: int, b: int, most: float) -> bool:
    """Interpolate arcs between the slices a, m and b where m fits a straight line from a to b; return whether it does.

    Walls along travel and parallel passes give a line of the place left of the axis, walls across one of the place
    along travel. ``most`` is the largest misfit, m.
    """
    number = numbers[m]
    if number == 0 or numbers[a] != number or numbers[b] != number:
        return False
    for n in range(a + 1, b):
        numbers[n] = number
    for k in range(number):
        for side in range(2):
            first, middle, last = arcs[a, k, side], arcs[m, k, side], arcs[b, k, side]
            left = _interpolate_angle((first, last), (radii[a], radii[b]), radii[m], False)
            along = _interpolate_angle((first, last), (radii[a], radii[b]), radii[m], True)
            misfit, misfit_along = abs(cos(left) - cos(middle)) * radii[m], abs(sin(along) - sin(middle)) * radii[m]
            is_along = misfit_along < misfit and (first - 0.5 * pi) * (middle - 0.5 * pi) > 0.0
            if min(misfit, misfit_along if is_along else misfit) > most:
                return False
            for n in range(a + 1, b):
                c, d = (a, m) if n < m else (m, b)
                if n != m:
                    ends = (arcs[c, k, side], arcs[d, k, side])
                    arcs[n, k, side] = _interpolate_angle(ends, (radii[c], radii[d]), radii[n], is_along)
    return True


@jit_compile
def _measure_corner(
    grid: Grid, view: View, cutter: Tip, tip: float, width: float, circle: Array, arcs: Array
) -> NDArray[np.int64]:
    """Write the arcs of the slices of the rounded corner; returns their number in each slice.

    Where the arcs of a slice lie within ``BOUNDARY_SIGMA`` of a straight line between two others, those between are
    interpolated: a quarter of the misfit is left of a smooth curve. Else both halves are divided again.

    Args:
        grid: high, low, share, bottom.
        view: Place in the grid.
        cutter: radius, corner radius, slope of the cone.
        tip: m, height of the tip.
        width: rad, of a slice along the corner.
        circle: (n, 2) sine and cosine of even angles from 0 to π.
        arcs: (CORNER_SLICES, n, 2) which are written.
    """
    radius, corner = cutter[0], cutter[1]
    radii, heights = np.empty(CORNER_SLICES), np.empty(CORNER_SLICES)
    for n in range(CORNER_SLICES):
        radii[n] = radius - corner + corner * sin(width * (n + 0.5))
        heights[n] = tip + corner * (1.0 - 0.5 * (cos(width * n) + cos(width * (n + 1))))
    numbers, todo = np.zeros(CORNER_SLICES, np.int64), np.empty((CORNER_SLICES, 2), np.int64)
    last, half = CORNER_SLICES - 1, (CORNER_SLICES - 1) // 2
    for n in (0, half, last):
        numbers[n] = _add_arcs(grid, view, radii[n], heights[n], circle, arcs[n])
    todo[0, 0], todo[0, 1], todo[1, 0], todo[1, 1], count = 0, half, half, last, 2
    while count:
        count -= 1
        a, b = todo[count]
        m = (a + b) // 2
        if m == a:
            continue
        numbers[m] = _add_arcs(grid, view, radii[m], heights[m], circle, arcs[m])
        if not _fill_between(arcs, numbers, radii, a, m, b, BOUNDARY_SIGMA * view[6]):
            todo[count, 0], todo[count, 1], todo[count + 1, 0], todo[count + 1, 1] = a, m, m, b
            count += 2
    return numbers


@jit_compile
def find_contact(
    grid: Grid,
    origin: Pair,
    cell: Pair,
    p: Array,
    cu: float,
    cv: float,
    cutter: Tip,
    most: float,
    circle: Array,
    levels: Array,
    arcs: Array,
    rows: Array,
) -> int:
    """Write the arcs of contact of a cutter at p that moves along (cu, cv); returns their number.

    Args:
        grid: (4, nv, nu) high, low, share, bottom.
        origin: u and v of the corner of cell (0, 0).
        cell: size of a cell.
        p: (3,) u, v, w of the tip.
        cu: direction of travel along u.
        cv: along v.
        cutter: radius, corner radius, slope of the cone.
        most: m, usable height of the cutter.
        circle: (n, 2) sine and cosine of even angles from 0 to π.
        levels: (MOST_LEVELS,) work space.
        arcs: (CORNER_SLICES, n, 2) work space.
        rows: (m, 4) low, high, start, end of each arc.
    """
    radius, corner = cutter[0], cutter[1]
    size = max(cell[0], cell[1])
    count, top = _find_levels(grid, origin, cell, p, cu, cv, radius + size, most, circle, levels)
    if count == 0:
        return 0
    heights = np.sort(levels[:count])
    view = _build_view(origin, cell, p, cu, cv)
    found, below = 0, 0.0
    if corner > 0.0:
        last = acos(max(1.0 - min(top, corner) / corner, 0.0)) / CORNER_SLICES
        numbers = _measure_corner(grid, view, cutter, p[2], last, circle, arcs)
        for n in range(CORNER_SLICES):
            low, high = corner * (1.0 - cos(last * n)), corner * (1.0 - cos(last * (n + 1)))
            found = _write_rows(rows, found, arcs[n], numbers[n], low, high)
        below = corner
    for n in range(count):
        if heights[n] <= below + THIN:
            continue
        low, high = below, heights[n]
        number = _add_arcs(grid, view, radius, p[2] + 0.5 * (low + high), circle, arcs[0])
        found = _write_rows(rows, found, arcs[0], number, low, high)
        below = high
    return found
