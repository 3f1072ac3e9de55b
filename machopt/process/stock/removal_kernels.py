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

from math import sqrt

from machopt.numerics.array_types import Array
from machopt.numerics.compiled_functions import jit_compile
from machopt.process.stock.kernel_types import Grid, Heights, Pair, Tip

SLIVER = 0.05  # of a cell; less is the rounding of an outline that was cut before
LEVEL = 1e-6  # m, heights that are equal
_GOLDEN = 0.6180339887498949
_STEPS = 30  # of the golden section: 1e-6 of the chord
_REACH = 0.7072  # half the diagonal of a cell, in cells


@jit_compile
def compute_profile(r: float, radius: float, corner: float, cone: float) -> float:
    """Height of the cutter's surface above its tip at a distance from its axis, m."""
    out = cone * r
    inner = radius - corner
    if corner > 0.0 and r > inner:
        x = min(r - inner, corner)
        out += corner - sqrt(max(corner * corner - x * x, 0.0))
    return out


@jit_compile
def lower_cell(
    high: Heights, low: Heights, share: Heights, bottom: Heights, j: int, i: int, z: float, k: float
) -> float:
    """Lower the part k of a cell to the height z; returns the mean height that is removed, m."""
    z = max(z, bottom[j, i])
    top, deep, c = high[j, i], low[j, i], share[j, i]
    before = (1.0 - c) * top + c * deep
    if k >= 1.0:
        top, deep = min(top, z), min(deep, z)
    elif c <= 0.0 or top - deep <= LEVEL:
        if z < top - LEVEL:
            deep, c = z, k
    elif z >= top:
        return 0.0
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
    high[j, i], low[j, i], share[j, i] = top, deep, c
    removed = before - ((1.0 - c) * top + c * deep)
    return removed if removed > 0.0 else 0.0


@jit_compile
def _compute_height(x: float, y: float, length: float, rise: float, radius: float, corner: float, cone: float) -> Pair:
    """Height above the start at a place x along and y across a move, and its distance from the axis."""
    s = min(max(x, 0.0), length)
    slope = rise / length if length > 0.0 else 0.0
    distance = sqrt(y * y + (x - s) * (x - s))
    if length == 0.0:
        return min(rise, 0.0) + compute_profile(distance, radius, corner, cone), distance
    if rise == 0.0:
        return compute_profile(distance, radius, corner, cone), distance
    rest = radius * radius - y * y
    if rest <= 0.0:
        return slope * s + compute_profile(radius, radius, corner, cone), distance
    half = sqrt(rest)
    first, last = max(x - half, 0.0), min(x + half, length)
    if first > last:
        return slope * s + compute_profile(radius, radius, corner, cone), distance
    if corner == 0.0 and cone == 0.0:
        return slope * (last if slope < 0.0 else first), distance
    if cone == 0.0 and radius - corner <= 1e-12:
        s = min(max(x - slope * half / sqrt(1.0 + slope * slope), first), last)
        d = sqrt(y * y + (x - s) * (x - s))
        return slope * s + compute_profile(d, radius, corner, cone), distance
    a, b = first, last
    for _ in range(_STEPS):
        e, f = b - _GOLDEN * (b - a), a + _GOLDEN * (b - a)
        at_e = slope * e + compute_profile(sqrt(y * y + (x - e) * (x - e)), radius, corner, cone)
        at_f = slope * f + compute_profile(sqrt(y * y + (x - f) * (x - f)), radius, corner, cone)
        if at_e < at_f:
            b = f
        else:
            a = e
    s = 0.5 * (a + b)
    return slope * s + compute_profile(sqrt(y * y + (x - s) * (x - s)), radius, corner, cone), distance


@jit_compile
def _find_row_range(v: float, p0: Array, p1: Array, cu: float, cv: float, length: float, reach: float) -> Pair:
    """Range of u in which a row meets the outline of a move widened to ``reach``; empty where first > last."""
    first, last = 1e30, -1e30
    for n in range(2):
        p = p0 if n == 0 else p1
        rest = reach * reach - (v - p[1]) * (v - p[1])
        if rest >= 0.0:
            half = sqrt(rest)
            first, last = min(first, p[0] - half), max(last, p[0] + half)
    if length > 0.0 and abs(cv) > 1e-9:
        for side in (-1.0, 1.0):
            u = p0[0] + ((v - p0[1]) * cu + side * reach) / cv
            along = (u - p0[0]) * cu + (v - p0[1]) * cv
            if 0.0 <= along <= length:
                first, last = min(first, u), max(last, u)
    return first, last


@jit_compile
def _add_to_bands(bands: Array, base: float, top: float, z: float, weight: float) -> None:
    """Add a removed column from ``top`` down to ``z`` to the bands of height above ``base`` that it crosses."""
    for n in range(len(bands)):  # in ascending order
        if base + bands[n, 0] >= top:
            break
        part = min(top, base + bands[n, 1]) - max(z, base + bands[n, 0])
        if part > 0.0:
            bands[n, 2] += weight * part


@jit_compile
def _find_columns(
    v: float, p0: Array, p1: Array, cu: float, cv: float, length: float, cutter: Tip, size: float, only_ahead: bool
) -> tuple[float, float, float, float]:
    """Range of u in which a move may remove material of a row, empty where first > last, and the range to skip in it.

    Behind the start nothing is left where ``only_ahead``; the flat end has also removed all below it there.
    """
    first, last = _find_row_range(v, p0, p1, cu, cv, length, cutter[0] + _REACH * size)
    skip_first, skip_last = 1e30, -1e30
    if first > last or not only_ahead:
        return first, last, skip_first, skip_last
    if abs(cu) > 1e-9:
        ahead = p0[0] - (v - p0[1]) * cv / cu
        if cu > 0.0:
            first = max(first, ahead)
        else:
            last = min(last, ahead)
    elif (v - p0[1]) * cv < 0.0:
        return 1e30, -1e30, skip_first, skip_last
    inner = cutter[0] - cutter[1] - _REACH * size
    rest = inner * inner - (v - p0[1]) * (v - p0[1])
    if cutter[2] == 0.0 and inner > 0.0 and rest > 0.0:
        skip_first, skip_last = p0[0] - sqrt(rest), p0[0] + sqrt(rest)
    return first, last, skip_first, skip_last


@jit_compile
def _record_removal(
    bands: Array, peak: Array, base: float, top: float, low: float, floor: float, share: float, part: float, area: float
) -> None:
    """Add a removed cell to the bands above ``base``, and raise the largest height where more than a sliver is new."""
    if len(bands):
        _add_to_bands(bands, base, top, floor, area * max(part - share, 0.0))
        _add_to_bands(bands, base, low, floor, area * min(part, share))
    if part - share > SLIVER:
        peak[0] = max(peak[0], top - base)


@jit_compile
def remove_move(
    grid: Grid, origin: Pair, cell: Pair, p0: Array, p1: Array, cutter: Tip, is_first: bool, bands: Array, peak: Array
) -> float:
    """Remove the cutter swept from p0 to p1 from the map; returns the removed volume, m³.

    Args:
        grid: high, low, share, bottom, each (nv, nu).
        origin: u and v of the corner of cell (0, 0).
        cell: size of a cell.
        p0: (3,) u, v, w of the tip at the start.
        p1: (3,) at the end.
        cutter: radius, corner radius, slope of the cone.
        is_first: Nothing was removed at p0 before: else cells that p0 covers are left out where they cannot change.
        bands: (n, 3) lower and upper height above the tip at p1, and the removed volume between them, which is added.
        peak: (1,) largest height above the tip at p1 of what is removed, which is raised.
    """
    high, low, share, bottom = grid
    radius, corner, cone = cutter
    nv, nu = high.shape
    size = max(cell[0], cell[1])
    reach = radius + _REACH * size
    x, y, rise = p1[0] - p0[0], p1[1] - p0[1], p1[2] - p0[2]
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
    total = 0.0
    for j in range(j0, j1):
        v = origin[1] + (j + 0.5) * cell[1]
        first, last, skip_first, skip_last = _find_columns(v, p0, p1, cu, cv, length, cutter, size, only_ahead)
        if first > last:
            continue
        i0 = max(int((first - origin[0]) / cell[0] - 0.5), 0)
        i1 = min(int((last - origin[0]) / cell[0] + 0.5) + 1, nu)
        i = i0
        while i < i1:
            u = origin[0] + (i + 0.5) * cell[0]
            if skip_first < u < skip_last:
                i = max(int((skip_last - origin[0]) / cell[0] - 0.5), i + 1)
                continue
            along = (u - p0[0]) * cu + (v - p0[1]) * cv
            across = (v - p0[1]) * cu - (u - p0[0]) * cv
            if not (only_ahead and along < 0.0):
                height, distance = _compute_height(along, across, length, rise, radius, corner, cone)
                part = 0.5 + (radius - distance) / size
                z = p0[2] + height
                if part > 0.0 and z < high[j, i]:
                    k, floor = min(part, 1.0), max(z, bottom[j, i])
                    _record_removal(bands, peak, p1[2], high[j, i], low[j, i], floor, share[j, i], k, area)
                    total += lower_cell(high, low, share, bottom, j, i, z, k)
            i += 1
    return total * area
