"""Removal of the swept cutter from a height map, one straight move at a time.

A cutter of radius R has the height f(r) above its tip at the distance r from its axis: 0 inside of R − r_c, the arc of
the corner radius r_c outside, plus c r for the cone of a drill. A move from p₀ to p₁ leaves over each cell

    z = min over the move of w(s) + f(d(s)),   d(s) the distance of the cell from the axis at s.

Closed forms hold for level moves (s nearest to the cell), for flat cutters (the ends of the chord) and for a sphere on
an inclined move; other cutters on inclined moves are searched by golden section (the function is convex). A cell within
half a cell of the outline is covered in part, by its distance from the outline. Parts of one cell that several moves
cover count as nested, which holds for the moves of one pass.
"""

from __future__ import annotations

from math import ceil, floor, sqrt

import numpy as np

from machopt.numerics.array_types import Array
from machopt.numerics.compiled_functions import jit_compile
from machopt.process.stock.kernel_types import BOTTOM, HIGH, LOW, SHARE, Grid, Pair, Tip

SLIVER = 0.05  # of a cell; less is the rounding of an outline that was cut before
LEVEL = 1e-6  # m, heights that are equal
LEVEL_MOVE = 1e-9  # m; a move that rises or descends less is level
_GOLDEN = 0.6180339887498949
_STEPS = 24  # of the golden section: 1e-5 of the chord, whose height differs by the square of that
_REACH = 0.7072  # half the diagonal of a cell, in cells


@jit_compile
def compute_profile(r: float, radius: float, corner: float, cone: float) -> float:
    """Height of the cutter's surface above its tip at a distance from its axis, m.

    Args:
        r: m, distance from the axis.
        radius: m, of the cutter.
        corner: m, corner radius.
        cone: Slope of the cone of its tip.
    """
    out = cone * r
    inner = radius - corner
    if corner > 0.0 and r > inner:
        x = min(r - inner, corner)
        out += corner - sqrt(max(corner * corner - x * x, 0.0))
    return out


@jit_compile
def _lower_cell(top: float, deep: float, c: float, z: float, k: float) -> tuple[float, float, float]:
    """Return upper and lower height and share of a cell of which the part k is lowered to the height z.

    It takes numbers, because each array that a compiled function takes has its references counted at every call.
    """
    if k >= 1.0:
        top, deep = min(top, z), min(deep, z)
    elif c <= 0.0 or top - deep <= LEVEL:
        if z < top - LEVEL:
            deep, c = z, k
    elif z >= top:
        return top, deep, c
    elif k <= c:
        if z < deep:
            deep = deep - k / c * (deep - z)
    elif z < deep or z - deep <= LEVEL:
        deep, c = min(deep, z), k
    else:
        top = top - (k - c) / (1.0 - c) * (top - z)
    if top - deep <= LEVEL and k >= 1.0:
        c = 0.0
        deep = top
    return top, deep, c


@jit_compile
def _compute_height(x: float, y: float, length: float, rise: float, radius: float, corner: float, cone: float) -> float:
    """Height above the start that a move leaves at a place x along and y across it."""
    s = min(max(x, 0.0), length)
    slope = rise / length if length > 0.0 else 0.0
    if length == 0.0:
        return min(rise, 0.0) + compute_profile(sqrt(y * y + (x - s) * (x - s)), radius, corner, cone)
    if rise == 0.0:
        return compute_profile(sqrt(y * y + (x - s) * (x - s)), radius, corner, cone)
    rest = radius * radius - y * y
    if rest <= 0.0:
        return slope * s + compute_profile(radius, radius, corner, cone)
    half = sqrt(rest)
    first, last = max(x - half, 0.0), min(x + half, length)
    if first > last:
        return slope * s + compute_profile(radius, radius, corner, cone)
    if corner == 0.0 and cone == 0.0:
        return slope * (last if slope < 0.0 else first)
    if cone == 0.0 and radius - corner <= 1e-12:
        s = min(max(x - slope * half / sqrt(1.0 + slope * slope), first), last)
        d = sqrt(y * y + (x - s) * (x - s))
        return slope * s + compute_profile(d, radius, corner, cone)
    a, b = first, last
    e, f = b - _GOLDEN * (b - a), a + _GOLDEN * (b - a)
    at_e = slope * e + compute_profile(sqrt(y * y + (x - e) * (x - e)), radius, corner, cone)
    at_f = slope * f + compute_profile(sqrt(y * y + (x - f) * (x - f)), radius, corner, cone)
    for _ in range(_STEPS):
        if at_e < at_f:
            b, f, at_f = f, e, at_e
            e = b - _GOLDEN * (b - a)
            at_e = slope * e + compute_profile(sqrt(y * y + (x - e) * (x - e)), radius, corner, cone)
        else:
            a, e, at_e = e, f, at_f
            f = a + _GOLDEN * (b - a)
            at_f = slope * f + compute_profile(sqrt(y * y + (x - f) * (x - f)), radius, corner, cone)
    return min(at_e, at_f)


@jit_compile
def _compute_level_height(squared: float, radius: float, corner: float, cone: float) -> float:
    """Height that a level move leaves at a place, from the square of its distance from the path, m²."""
    inner = radius - corner
    if cone > 0.0 or inner > 1e-12:
        return compute_profile(sqrt(squared), radius, corner, cone)
    return corner - sqrt(max(corner * corner - squared, 0.0))


@jit_compile
def _find_row_range(x: float, y: float, z: float, cu: float, cv: float, length: float, reach: float) -> Pair:
    """Range of u in which a row meets the outline of a move widened to ``reach``; empty where first > last.

    ``x`` and ``y`` are u of the ends of the move; ``z`` is v of the row from the start.
    """
    first, last = 1e30, -1e30
    end = z - length * cv
    rest = reach * reach - z * z
    if rest >= 0.0:
        half = sqrt(rest)
        first, last = x - half, x + half
    rest = reach * reach - end * end
    if rest >= 0.0:
        half = sqrt(rest)
        first, last = min(first, y - half), max(last, y + half)
    if length > 0.0 and abs(cv) > 1e-9:
        for side in (-1.0, 1.0):
            u = x + (z * cu + side * reach) / cv
            along = (u - x) * cu + z * cv
            if 0.0 <= along <= length:
                first, last = min(first, u), max(last, u)
    return first, last


@jit_compile
def _find_columns(
    x: float, y: float, z: float, cu: float, cv: float, length: float, reach: float, inner: float, only_ahead: bool
) -> tuple[float, float, float, float]:
    """Range of u in which a move may remove material of a row, empty where first > last, and the range to skip in it.

    Behind the start nothing is left where ``only_ahead``; a flat end of the radius ``inner`` has also removed all below
    it there. Other arguments are those of :func:`_find_row_range`.
    """
    first, last = _find_row_range(x, y, z, cu, cv, length, reach)
    skip_first, skip_last = 1e30, -1e30
    if first > last or not only_ahead:
        return first, last, skip_first, skip_last
    if abs(cu) > 1e-9:
        ahead = x - z * cv / cu
        if cu > 0.0:
            first = max(first, ahead)
        else:
            last = min(last, ahead)
    elif z * cv < 0.0:
        return 1e30, -1e30, skip_first, skip_last
    rest = inner * inner - z * z
    if inner > 0.0 and rest > 0.0:
        skip_first, skip_last = x - sqrt(rest), x + sqrt(rest)
    return first, last, skip_first, skip_last


@jit_compile
def remove_move(
    grid: Grid, origin: Pair, cell: Pair, p0: Array, p1: Array, cutter: Tip, is_first: bool, bands: Array, peak: Array
) -> float:
    """Remove the cutter swept from p0 to p1 from the map; returns the removed volume, m³.

    Args:
        grid: (nv, nu, 4) high, low, share, bottom.
        origin: u and v of the corner of cell (0, 0).
        cell: size of a cell.
        p0: (3,) u, v, w of the tip at the start.
        p1: (3,) at the end.
        cutter: radius, corner radius, slope of the cone.
        is_first: Nothing was removed at p0 before: else cells that p0 covers are left out where they cannot change.
        bands: (n, 3) lower and upper height above the tip at p1, and the removed volume between them, which is added.
        peak: (1,) largest height above the tip at p1 of what is removed, which is raised.
    """
    radius, corner, cone = cutter
    nv, nu = grid.shape[:2]
    size = max(cell[0], cell[1])
    reach = radius + _REACH * size
    x, y, rise = p1[0] - p0[0], p1[1] - p0[1], p1[2] - p0[2]
    if abs(rise) < LEVEL_MOVE:
        rise = 0.0
    length = sqrt(x * x + y * y)
    cu, cv = (x / length, y / length) if length > 1e-12 else (1.0, 0.0)
    if length <= 1e-12:
        length = 0.0
    only_ahead = not is_first and rise >= 0.0
    if only_ahead and length == 0.0:
        return 0.0
    j0 = max(int((min(p0[1], p1[1]) - reach - origin[1]) / cell[1]), 0)
    j1 = min(int((max(p0[1], p1[1]) + reach - origin[1]) / cell[1]) + 1, nv)
    area = cell[0] * cell[1]
    p0u, p0v, p0w, p1u, p1w, per_cell = p0[0], p0[1], p0[2], p1[0], p1[2], 1.0 / size
    inner = radius - corner - _REACH * size if cone == 0.0 else 0.0
    lowest, farthest = float(np.float32(p0w + min(rise, 0.0))), (radius + 0.5 * size) ** 2
    nearest = max(radius - 0.5 * size, 0.0) ** 2
    centre, corner_squared, is_ball = lowest + corner, corner * corner, cone == 0.0 and radius - corner <= 1e-12
    offset = origin[0] + 0.5 * cell[0] - p0u
    total, highest, n, number = 0.0, -1e30, 0, len(bands)
    for j in range(j0, j1):
        v = origin[1] + (j + 0.5) * cell[1]
        z0 = v - p0v
        first, last, skip_first, skip_last = _find_columns(
            p0u, p1u, z0, cu, cv, length, reach, inner if only_ahead else 0.0, only_ahead
        )
        if first > last:
            continue
        i0 = max(int((first - origin[0]) / cell[0] - 0.5), 0)
        i1 = min(int((last - origin[0]) / cell[0] + 0.5) + 1, nu)
        skip, resume = i1, i1
        if skip_first < skip_last:
            skip = max(ceil((skip_first - origin[0]) / cell[0] - 0.5), i0)
            resume = max(floor((skip_last - origin[0]) / cell[0] - 0.5), i0)
        i = i0
        while i < i1:
            if skip <= i < resume:
                i = resume
                continue
            column = i
            i += 1
            top = grid[j, column, HIGH]
            if top <= lowest:
                continue
            d = offset + column * cell[0]
            along, across = d * cu + z0 * cv, z0 * cu - d * cv
            beyond = along - length if along > length else 0.0
            if along < 0.0:
                if only_ahead:
                    continue
                beyond = along
            squared = across * across + beyond * beyond
            if squared >= farthest:
                continue
            drop = centre - top  # of the height below the centre of the corner; the move reaches less deep at the place
            if cone > 0.0:
                if top - lowest <= cone * sqrt(squared):
                    continue
            elif is_ball:
                if drop >= 0.0 and drop * drop >= corner_squared - squared:
                    continue
            elif drop >= 0.0:
                ring = max(sqrt(squared) - radius + corner, 0.0)
                if drop * drop >= corner_squared - ring * ring:
                    continue
            if rise == 0.0:
                height = _compute_level_height(squared, radius, corner, cone)
            else:
                height = _compute_height(along, across, length, rise, radius, corner, cone)
            part = 1.0
            if squared > nearest:
                part = 0.5 + (radius - sqrt(squared)) * per_cell
            z = float(np.float32(p0w + height))
            if z < top:
                k, lowered = min(part, 1.0), max(z, grid[j, column, BOTTOM])
                deep, c = grid[j, column, LOW], grid[j, column, SHARE]
                if number:
                    base = lowered - p1w
                    while n > 0 and bands[n - 1, 1] > base:
                        n -= 1
                    while n < number and bands[n, 1] <= base:
                        n += 1
                    m, upper, lower = n, top - p1w, deep - p1w
                    while m < number and bands[m, 0] < upper:
                        least = max(base, bands[m, 0])
                        removed = max(k - c, 0.0) * (min(upper, bands[m, 1]) - least)
                        bands[m, 2] += area * (removed + min(k, c) * max(min(lower, bands[m, 1]) - least, 0.0))
                        m += 1
                if k - c > SLIVER:
                    highest = max(highest, top)
                if k >= 1.0 and c <= 0.0:
                    grid[j, column, HIGH], grid[j, column, LOW], new = lowered, lowered, top - lowered
                else:
                    new_top, new_deep, new_c = _lower_cell(top, deep, c, lowered, k)
                    grid[j, column, HIGH], grid[j, column, LOW], grid[j, column, SHARE] = new_top, new_deep, new_c
                    new = (1.0 - c) * top + c * deep - (1.0 - new_c) * new_top - new_c * new_deep
                total += max(new, 0.0)
    peak[0] = max(peak[0], highest - p1w)
    return total * area
