"""Contact of a cutter with a height map: arcs of engagement at slices of its height.

The boundary of the stock is followed one cell outside of the cutter, where no earlier move of the pass has thinned the
material: the chip near the sides of the cutter is thinner than a cell, and the move before has removed cells inside of
the outline there. Each boundary point is carried back to the cutter along the boundary's tangent.
"""

from __future__ import annotations

from math import acos, cos, pi, sin

import numpy as np

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


@jit_compile
def measure_material(grid: Grid, origin: Pair, cell: Pair, u: float, v: float, w: float) -> float:
    """Material at a place, by the four cells around it: 1 inside, −1 outside, 0 on the boundary.

    Args:
        grid: (nv, nu, 4) high, low, share, bottom.
        origin: m, u and v of the corner of cell (0, 0).
        cell: m, size of a cell.
        u: m, of the place.
        v: m.
        w: m, height.
    """
    nv, nu = grid.shape[:2]
    x, y = (u - origin[0]) / cell[0] - 0.5, (v - origin[1]) / cell[1] - 0.5
    i, j = int(np.floor(x)), int(np.floor(y))
    fx, fy = x - i, y - j
    soft = SOFT * max(cell[0], cell[1])
    total = 0.0
    for b in range(2):
        for a in range(2):
            weight = (fx if a else 1.0 - fx) * (fy if b else 1.0 - fy)
            jj, ii = j + b, i + a
            value = -1.0
            if 0 <= jj < nv and 0 <= ii < nu and grid[jj, ii, HIGH] > grid[jj, ii, BOTTOM]:
                c = grid[jj, ii, SHARE]
                value = (1.0 - c) * min(max((grid[jj, ii, HIGH] - w) / soft, -1.0), 1.0)
                value += c * min(max((grid[jj, ii, LOW] - w) / soft, -1.0), 1.0)
                value = min(value, max((w - grid[jj, ii, BOTTOM]) / soft, -1.0))
            total += weight * value
    return total


@jit_compile
def _find_state(low: float, high: float, bottom: float, w: float, soft: float) -> int:
    """Whether four cells around a place leave no doubt: 1 inside, −1 outside, else 0.

    Args:
        low: m, least height of the deeper part of a cell.
        high: m, largest height of a cell.
        bottom: m, largest lower side of a cell.
        w: m, height of the place.
        soft: m, over which the surface passes from material to air.
    """
    if high <= w - soft:
        return -1
    return 1 if low >= w + soft and bottom <= w - soft else 0


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
    nv, nu = grid.shape[:2]
    top, count = 0.0, 0
    for n in range(len(circle)):
        s, c = reach * circle[n, 0], reach * circle[n, 1]
        i = int((p[0] + s * cu - c * cv - origin[0]) / cell[0])
        j = int((p[1] + s * cv + c * cu - origin[1]) / cell[1])
        if 0 <= i < nu and 0 <= j < nv and grid[j, i, HIGH] > grid[j, i, BOTTOM] and grid[j, i, HIGH] - p[2] > THIN:
            height = min(grid[j, i, HIGH] - p[2], most)
            top = max(top, height)
            same = max(_SAME_LEVEL * top, THIN)
            if count >= 0:
                count = _add_level(levels, count, height, same)
            if count >= 0 and grid[j, i, BOTTOM] - p[2] > THIN:
                count = _add_level(levels, count, grid[j, i, BOTTOM] - p[2], same)
    if count < 0:
        count = MOST_LEVELS
        for n in range(MOST_LEVELS):
            levels[n] = top * (n + 1) / MOST_LEVELS
    return count, top


@jit_compile
def _is_inside(
    grid: Grid, origin: Pair, cell: Pair, p: Array, cu: float, cv: float, reach: float, phi: float, w: float
) -> bool:
    """Whether the place at an angle on a circle about the cutter's axis lies in the material."""
    s, c = reach * sin(phi), reach * cos(phi)
    return measure_material(grid, origin, cell, p[0] + s * cu - c * cv, p[1] + s * cv + c * cu, w) > 0.0


@jit_compile
def _carry_back(
    grid: Grid,
    origin: Pair,
    cell: Pair,
    p: Array,
    cu: float,
    cv: float,
    phi: float,
    into: float,
    reach: float,
    radius: float,
    w: float,
) -> float:
    """Angle at which the stock's boundary meets the cutter, from the angle at which it meets the circle ``reach``.

    The boundary is followed one more cell outwards; both places give its tangent. Where the tangent leads far along the
    cutter, it must also fit the boundary a quarter of a cell outside of the cutter. Else the boundary is no straight
    line: it bends, or a corner of the stock lies between. Two places nearer to the cutter then give the tangent.

    Args:
        grid: (nv, nu, 4) high, low, share, bottom.
        origin: u and v of the corner of cell (0, 0).
        cell: size of a cell.
        p: (3,) u, v, w of the tip.
        cu: direction of travel along u.
        cv: along v.
        phi: angle on the circle ``reach``.
        into: 1 where the material lies at larger angles, −1 at smaller.
        reach: radius of the circle.
        radius: radius of the cutter's slice.
        w: height of the slice.
    """
    size = max(cell[0], cell[1])
    outer, close = reach + size, radius + CLOSE[0] * size
    far = _follow_boundary(grid, origin, cell, p, cu, cv, phi, into, outer, w, 0.5 * size / outer)
    carried, expected = phi, np.inf
    if np.isfinite(far):
        carried = extrapolate_boundary(phi, reach, far, outer, radius)
        misses = measure_line(phi, reach, far, outer) > radius + CLOSE[0] * size
        if abs(carried - phi) * radius < size and not misses:
            return carried
        expected = extrapolate_boundary(phi, reach, far, outer, close)
    near = _follow_boundary(grid, origin, cell, p, cu, cv, phi, into, close, w, 0.25 * size / radius)
    if not np.isfinite(near) or abs(near - expected) * radius < FITS * size:
        return carried
    middle = radius + CLOSE[1] * size
    between = _follow_boundary(grid, origin, cell, p, cu, cv, near, into, middle, w, 0.25 * size / radius)
    return extrapolate_boundary(near, close, between, middle, radius) if np.isfinite(between) else near


@jit_compile
def _follow_boundary(
    grid: Grid,
    origin: Pair,
    cell: Pair,
    p: Array,
    cu: float,
    cv: float,
    phi: float,
    into: float,
    reach: float,
    w: float,
    step: float,
) -> float:
    """Angle at which a boundary meets another circle, near an angle; NaN where it does not.

    Arguments are those of :func:`_carry_back`; ``step`` is that of the search, rad.
    """
    begins_inside = _is_inside(grid, origin, cell, p, cu, cv, reach, phi, w)
    sign = -into if begins_inside else into
    for n in range(1, SEARCH + 1):
        there = phi + sign * n * step
        if _is_inside(grid, origin, cell, p, cu, cv, reach, there, w) != begins_inside:
            near = there - sign * step
            inside, outside = (near, there) if begins_inside else (there, near)
            return _find_crossing(grid, origin, cell, p, cu, cv, reach, w, inside, outside)
    return np.nan


@jit_compile
def _find_crossing(
    grid: Grid,
    origin: Pair,
    cell: Pair,
    p: Array,
    cu: float,
    cv: float,
    reach: float,
    w: float,
    inside: float,
    outside: float,
) -> float:
    """Angle of the boundary between an angle in the material and one outside, by halving and linear interpolation."""
    more, less = 1.0, -1.0  # material at both
    u, v = p[0], p[1]
    for _ in range(_HALVINGS):
        phi = 0.5 * (inside + outside)
        s, c = reach * sin(phi), reach * cos(phi)
        value = measure_material(grid, origin, cell, u + s * cu - c * cv, v + s * cv + c * cu, w)
        if value > 0.0:
            inside, more = phi, value
        else:
            outside, less = phi, value
    return inside + (outside - inside) * more / (more - less)


@jit_compile
def _add_arcs(
    grid: Grid,
    origin: Pair,
    cell: Pair,
    p: Array,
    cu: float,
    cv: float,
    radius: float,
    w: float,
    circle: Array,
    arcs: Array,
) -> int:
    """Write start and end of each arc of a slice; returns their number."""
    size = max(cell[0], cell[1])
    reach = radius + size
    last = len(circle) - 1
    stride = max(int(last * SPACING * size / (pi * reach)), 1)
    count, start, phi_before, is_before = 0, 0.0, 0.0, False
    steps = (last + stride - 1) // stride
    nv, nu = grid.shape[:2]
    per_u, per_v, soft = 1.0 / cell[0], 1.0 / cell[1], SOFT * size
    for n in range(steps + 2):  # the step behind the last sample ends the arc there
        is_inside, phi = False, pi
        if n <= steps:
            m = min(n * stride, last)
            phi = pi * m / last
            s, c = reach * circle[m, 0], reach * circle[m, 1]
            u, v = p[0] + s * cu - c * cv, p[1] + s * cv + c * cu
            i, j = int((u - origin[0]) * per_u + 0.5), int((v - origin[1]) * per_v + 0.5)
            state = 0
            if 0 < i < nu and 0 < j < nv:
                most = max(grid[j - 1, i - 1, HIGH], grid[j - 1, i, HIGH], grid[j, i - 1, HIGH], grid[j, i, HIGH])
                least = min(grid[j - 1, i - 1, LOW], grid[j - 1, i, LOW], grid[j, i - 1, LOW], grid[j, i, LOW])
                under = max(
                    grid[j - 1, i - 1, BOTTOM], grid[j - 1, i, BOTTOM], grid[j, i - 1, BOTTOM], grid[j, i, BOTTOM]
                )
                state = _find_state(least, most, under, w, soft)
            is_inside = state > 0
            if state == 0:
                is_inside = measure_material(grid, origin, cell, u, v, w) > 0.0
        if is_inside and not is_before:
            start = 0.0
            if n > 0:
                start = _find_crossing(grid, origin, cell, p, cu, cv, reach, w, phi, phi_before)
                start = _carry_back(grid, origin, cell, p, cu, cv, start, 1.0, reach, radius, w)
        elif is_before and not is_inside:
            end = pi
            if phi_before < pi:
                end = _find_crossing(grid, origin, cell, p, cu, cv, reach, w, phi_before, phi)
                end = _carry_back(grid, origin, cell, p, cu, cv, end, -1.0, reach, radius, w)
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
        grid: (nv, nu, 4) high, low, share, bottom.
        origin: u and v of the corner of cell (0, 0).
        cell: size of a cell.
        p: (3,) u, v, w of the tip.
        cu: direction of travel along u.
        cv: along v.
        cutter: radius, corner radius, slope of the cone.
        most: m, usable height of the cutter.
        circle: (n, 2) sine and cosine of even angles from 0 to π.
        levels: (MOST_LEVELS,) work space.
        arcs: (n, 2) work space.
        rows: (m, 4) low, high, start, end of each arc.
    """
    radius, corner = cutter[0], cutter[1]
    size = max(cell[0], cell[1])
    count, top = _find_levels(grid, origin, cell, p, cu, cv, radius + size, most, circle, levels)
    if count == 0:
        return 0
    heights = np.sort(levels[:count])
    found, below = 0, 0.0
    if corner > 0.0:
        reach = min(top, corner)
        last = acos(max(1.0 - reach / corner, 0.0))
        for n in range(CORNER_SLICES):
            a, b = last * n / CORNER_SLICES, last * (n + 1) / CORNER_SLICES
            low, high = corner * (1.0 - cos(a)), corner * (1.0 - cos(b))
            r = radius - corner + corner * sin(0.5 * (a + b))
            number = _add_arcs(grid, origin, cell, p, cu, cv, r, p[2] + 0.5 * (low + high), circle, arcs)
            found = _write_rows(rows, found, arcs, number, low, high)
        below = corner
    for n in range(count):
        if heights[n] <= below + THIN:
            continue
        low, high = below, heights[n]
        number = _add_arcs(grid, origin, cell, p, cu, cv, radius, p[2] + 0.5 * (low + high), circle, arcs)
        found = _write_rows(rows, found, arcs, number, low, high)
        below = high
    return found
