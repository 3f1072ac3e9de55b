"""Removal of the swept cutter from a height map, one straight move at a time.

A cutter of radius R has the height f(r) above its tip at the distance r from its axis: 0 inside of R − r_c, the arc of
the corner radius r_c outside, plus c r for the cone of a drill. A move from p₀ to p₁ leaves over each cell

    z = min over the move of w(s) + f(d(s)),   d(s) the distance of the cell from the axis at s.

Closed forms hold for level moves (s nearest to the cell), for flat cutters (the ends of the chord) and for a sphere on
an inclined move; other cutters on inclined moves are searched by the derivative (the function is convex). A cell within
half a cell of the outline is covered in part, by its distance from the outline. Parts of one cell that several moves
cover count as nested, which holds for the moves of one pass.
"""

from __future__ import annotations

from math import ceil, floor, sqrt

import numpy as np

from machopt.numerics.array_types import Array
from machopt.numerics.compiled_functions import jit_compile, jit_compile_reordering
from machopt.process.stock.kernel_types import BOTTOM, HIGH, LOW, SHARE, Grid, Heights, Pair, Tip

SLIVER = (sqrt(0.5) - 0.5) ** 2  # 0.043 of a cell: largest error of the share that a line at 45° covers
LEVEL = 1e-6  # m, heights that are equal: the last digit of a CAM file; single precision is finer up to 8 m
LEVEL_MOVE = 1e-9  # m; a smaller rise is rounding: single precision states a height of 0.1 m to 4e-9 m
SHORT_ROW = 16  # cells; shorter rows are computed cell by cell, which only takes another time
_REACH = sqrt(0.5) + 1e-4  # half the diagonal of a cell, in cells, and rounding


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
    return _search_height(x, y, slope, first, last, radius, corner, cone)


@jit_compile
def _compute_slope(u: float, y: float, slope: float, radius: float, corner: float, cone: float) -> float:
    """Change of the height over the share of a move, per m of travel, at u along travel and y across from a place."""
    d, inner = sqrt(u * u + y * y), radius - corner
    if d <= 0.0:
        return slope
    steep = cone
    if d > inner and corner > 0.0:
        ring = d - inner
        steep += ring / sqrt(max(corner * corner - ring * ring, 1e-30))
    return slope + steep * u / d


@jit_compile
def _search_height(
    x: float, y: float, slope: float, first: float, last: float, radius: float, corner: float, cone: float
) -> float:
    """Least height between two places of an inclined move, from the root of its derivative.

    The height is convex: between a with a falling and b with a rising height, it is at most g'(a) (b − a) below that at
    a. The search ends where that is less than a tenth of ``LEVEL``, so that heights that are equal stay equal.
    """
    a, b = first, last
    at_a = _compute_slope(a - x, y, slope, radius, corner, cone)
    at_b = _compute_slope(b - x, y, slope, radius, corner, cone)
    if at_b <= 0.0:
        a = b
    turn = False
    while at_a < 0.0 < at_b and -at_a * (b - a) > 0.1 * LEVEL and b - a > 0.1 * LEVEL:
        s = (a * at_b - b * at_a) / (at_b - at_a) if turn else 0.5 * (a + b)
        turn = not turn
        at_s = _compute_slope(s - x, y, slope, radius, corner, cone)
        if at_s <= 0.0:
            a, at_a = s, at_s
        else:
            b, at_b = s, at_s
    return slope * a + compute_profile(sqrt(y * y + (x - a) * (x - a)), radius, corner, cone)


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
def find_ceiling(grid: Grid, origin: Pair, cell: Pair, position: Array, reach: float) -> float:
    """Largest height of the stock around some positions, m; −inf where there is none.

    Args:
        grid: (4, nv, nu) high, low, share, bottom.
        origin: u and v of the corner of cell (0, 0).
        cell: size of a cell.
        position: (n, 3) u, v, w.
        reach: m, distance from the positions.
    """
    first, last = np.zeros(2, np.int64), np.zeros(2, np.int64)
    for n in range(2):
        low, high = position[:, n].min() - reach, position[:, n].max() + reach
        first[n] = max(floor((low - origin[n]) / cell[n]), 0)
        last[n] = min(ceil((high - origin[n]) / cell[n]), grid.shape[2 - n])
    out = np.float32(-np.inf)
    for j in range(first[1], last[1]):
        for i in range(first[0], last[0]):
            out = max(out, grid[HIGH, j, i])
    return float(out)


@jit_compile_reordering
def remove_move(
    grid: Grid,
    origin: Pair,
    cell: Pair,
    p0: Array,
    p1: Array,
    cutter: Tip,
    is_first: bool,
    ceiling: float,
    bands: Array,
    peak: Array,
    work: Heights,
) -> float:
    """Remove the cutter swept from p0 to p1 from the map; returns the removed volume, m³.

    Args:
        grid: (4, nv, nu) high, low, share, bottom.
        origin: u and v of the corner of cell (0, 0).
        cell: size of a cell.
        p0: (3,) u, v, w of the tip at the start.
        p1: (3,) at the end.
        cutter: radius, corner radius, slope of the cone.
        is_first: Nothing was removed at p0 before: else cells that p0 covers are left out where they cannot change.
        ceiling: m, at least the height of the stock there.
        bands: (n, 4) lower and upper height above the tip at p1, the removed volume between them, which is added, and
            the volume that matters: from there on in all bands, none is added.
        peak: (1,) largest height above the tip at p1 of what is removed, which is raised.
        work: (2, nu) the numbers of columns, and work space.
    """
    radius, corner, cone = cutter
    nv, nu = grid.shape[1:]
    size = max(cell[0], cell[1])
    x, y, rise = p1[0] - p0[0], p1[1] - p0[1], p1[2] - p0[2]
    if abs(rise) < LEVEL_MOVE:
        rise = 0.0
    length = sqrt(x * x + y * y)
    cu, cv = (x / length, y / length) if length > 1e-12 else (1.0, 0.0)
    if length <= 1e-12:
        length = 0.0
    only_ahead = not is_first and rise >= 0.0
    p0u, p0v, p0w, p1u, p1w, per_cell = p0[0], p0[1], p0[2], p1[0], p1[2], 1.0 / size
    lowest = float(np.float32(p0w + min(rise, 0.0)))
    if (only_ahead and length == 0.0) or ceiling <= lowest:
        return 0.0
    reach, inner = radius + _REACH * size, radius - corner
    if ceiling - lowest < corner:
        reach = min(reach, inner + sqrt((ceiling - lowest) * (2.0 * corner - ceiling + lowest)) + size)
    j0 = max(int((min(p0[1], p1[1]) - reach - origin[1]) / cell[1]), 0)
    j1 = min(int((max(p0[1], p1[1]) + reach - origin[1]) / cell[1]) + 1, nv)
    middle = min(max(int((p1[1] - origin[1]) / cell[1]), j0), j1)
    area = cell[0] * cell[1]
    end = inner - _REACH * size if cone == 0.0 and only_ahead else 0.0
    rim, farthest = radius - 0.5 * size, (radius + 0.5 * size) ** 2
    offset = origin[0] + 0.5 * cell[0] - p0u
    total, highest, n, number = 0.0, -1e30, 0, len(bands)
    zero, big, huge, summit = np.float32(0.0), np.float32(1e20), np.float32(1e37), np.int32(-2000000000)
    tip, two, nano = np.float32(p1w), np.float32(2.0), np.float32(1e9)
    step, least = (np.float32(cell[0] * cu), np.float32(-cell[0] * cv)), 0.0 if only_ahead else -1e20
    tool = (
        *(np.float32(length), np.float32(inner), np.float32(lowest), np.float32(cone), np.float32(corner)),
        *(np.float32(corner * corner), np.float32(farthest), np.float32(least)),
        np.float32(max(rim, 0.0) ** 2),
    )
    count, waiting = work[0], work[1]
    for row in range(j1 - j0):  # from the middle on, where all bands may fill
        j = middle + row if row < j1 - middle else j1 - 1 - row
        z0 = origin[1] + (j + 0.5) * cell[1] - p0v
        first, last, skip_first, skip_last = _find_columns(p0u, p1u, z0, cu, cv, length, reach, end, only_ahead)
        if first > last:
            continue
        i0 = max(int((first - origin[0]) / cell[0] - 0.5), 0)
        i1 = min(int((last - origin[0]) / cell[0] + 0.5) + 1, nu)
        skip, resume = i1, i1
        if skip_first < skip_last:
            skip = min(max(ceil((skip_first - origin[0]) / cell[0] - 0.5), i0), i1)
            resume = min(max(floor((skip_last - origin[0]) / cell[0] - 0.5), skip), i1)
        for begin, stop in ((i0, skip), (resume, i1)):
            if begin >= stop:
                continue
            d0 = offset + begin * cell[0]
            is_short = stop - begin < SHORT_ROW
            if not is_short:
                along0, across0 = np.float32(d0 * cu + z0 * cv), np.float32(z0 * cu - d0 * cv)
                high, share = grid[HIGH, j, begin:stop], grid[SHARE, j, begin:stop]
                bottom, hold = grid[BOTTOM, j, begin:stop], zero if rise == 0.0 and number == 0 else big
                fallen, candidates = zero, zero
                for m in range(stop - begin):  # in single precision and without branches: several cells at once
                    along, across = along0 + count[m] * step[0], across0 + count[m] * step[1]
                    beyond = along - min(max(along, zero), tool[0])
                    squared = across * across + beyond * beyond
                    r = sqrt(squared)
                    ring = max(r - tool[1], zero)
                    top = high[m]
                    z = tool[2] + (tool[3] * r + tool[4] - sqrt(max(tool[5] - ring * ring, zero)))
                    z = z if squared < tool[6] else top
                    z = min(z if along >= tool[7] else top, top)
                    waits = max(max(share[m], squared - tool[8]) * big, hold)
                    lowered = min(top, max(z, bottom[m]) + max(waits, zero))
                    high[m] = lowered
                    fallen += top - lowered
                    summit = max(summit, np.int32(max(min(top - tip, two, (top - lowered) * huge - two), -two) * nano))
                    waiting[m] = min(waits, top - z)
                    candidates += max(waiting[m], zero)
                total += float(fallen)
                if candidates <= zero:
                    continue
            for m in range(stop - begin):
                if not is_short and waiting[m] <= zero:
                    continue
                column = begin + m
                top, d = grid[HIGH, j, column], d0 + m * cell[0]
                if top <= lowest:
                    continue
                along, across = d * cu + z0 * cv, z0 * cu - d * cv
                beyond = along - min(max(along, 0.0), length)
                squared = across * across + beyond * beyond
                if squared >= farthest or along < least:
                    continue
                distance = sqrt(squared)
                if rise == 0.0:
                    height = compute_profile(distance, radius, corner, cone)
                else:
                    height = _compute_height(along, across, length, rise, radius, corner, cone)
                reached = float(np.float32(p0w + height))
                if reached >= top:
                    continue
                k = 1.0 if distance <= rim else min(0.5 + (radius - distance) * per_cell, 1.0)
                lowered = max(reached, grid[BOTTOM, j, column])
                deep, c = grid[LOW, j, column], grid[SHARE, j, column]
                if number:
                    base = lowered - p1w
                    while n > 0 and bands[n - 1, 1] > base:
                        n -= 1
                    while n < number and bands[n, 1] <= base:
                        n += 1
                    band, upper, under = n, top - p1w, deep - p1w
                    while band < number and bands[band, 0] < upper:
                        low = max(base, bands[band, 0])
                        removed = max(k - c, 0.0) * (min(upper, bands[band, 1]) - low)
                        removed += min(k, c) * max(min(under, bands[band, 1]) - low, 0.0)
                        bands[band, 2] += area * removed
                        band += 1
                if k - c > SLIVER:
                    highest = max(highest, top)
                if k >= 1.0 and c <= 0.0:
                    grid[HIGH, j, column], new = lowered, top - lowered
                else:
                    new_top, new_deep, new_c = _lower_cell(top, deep, c, lowered, k)
                    grid[HIGH, j, column], grid[LOW, j, column], grid[SHARE, j, column] = new_top, new_deep, new_c
                    new = (1.0 - c) * top + c * deep - (1.0 - new_c) * new_top - new_c * new_deep
                total += max(new, 0.0)
        is_full = number > 0
        for m in range(number):
            is_full = is_full and bands[m, 2] > bands[m, 3]
        if is_full:
            number = 0
    peak[0] = max(peak[0], highest - p1w, summit * 1e-9)
    return total * area
