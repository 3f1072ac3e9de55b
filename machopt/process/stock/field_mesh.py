"""Signed distances of a closed mesh on a grid, row of blocks after row of blocks.

Lengths are in cells, from the corner of cell (0, 0, 0). The sign comes from the triangles that a line along the third
axis crosses, the distance from the nearest triangle.
"""

from __future__ import annotations

from math import ceil, floor, sqrt

import numpy as np
from numpy.typing import NDArray

from machopt.numerics.array_types import Array
from machopt.numerics.compiled_functions import jit_compile
from machopt.process.stock.field_types import AIR, BLOCK, EDGE, LIMIT, SOLID, FieldArrays

SAME = 1e-4  # cells; distances of triangles with an edge in common that differ by less are equal
ACUTE = 0.5**0.5  # distance from the planes of a right edge over that from the edge, at least
Distances = NDArray[np.float32]
Crossings = NDArray[np.int16]


@jit_compile
def fill_blocks(corners: Array, arrays: FieldArrays) -> int:
    """Fill the blocks of a field; returns the number of blocks that the surface crosses.

    Args:
        corners: (F, 3, 3) corners of the triangles in cells, sorted by their least second coordinate.
        arrays: The field, which is filled. Nothing more is stored where its pool is full.
    """
    table, pool, _, state = arrays
    nx, ny, nz = table.shape
    nearest = np.empty((BLOCK, nx * BLOCK, nz * BLOCK), np.float32)
    distance = np.empty((BLOCK, nx * BLOCK, nz * BLOCK), np.float32)
    crossing = np.empty((BLOCK, nx * BLOCK, nz * BLOCK + 1), np.int16)
    needed = 0
    for by in range(ny):
        nearest[:] = LIMIT
        distance[:] = LIMIT
        crossing[:] = 0
        first = by * BLOCK
        for n in range(len(corners)):
            corner = corners[n]
            if min(corner[0, 1], corner[1, 1], corner[2, 1]) - LIMIT > first + BLOCK:
                break
            if max(corner[0, 1], corner[1, 1], corner[2, 1]) + LIMIT < first:
                continue
            _add_crossings(corner, first, crossing)
            _add_distances(corner, first, nearest, distance)
        _sum_crossings(crossing)
        for bx in range(nx):
            for bz in range(nz):
                if needed < len(pool):
                    needed += _store_block(distance, crossing, bx, bz, pool[needed], table[bx, by], needed)
                else:
                    needed += _store_block(distance, crossing, bx, bz, pool[0], table[bx, by], 0)
    state[0] = min(needed, len(pool))
    state[1] = 0
    state[2] = 0
    return needed


@jit_compile
def _store_block(
    distance: Distances,
    crossing: Crossings,
    bx: int,
    bz: int,
    cells: NDArray[np.int16],
    row: NDArray[np.int32],
    place: int,
) -> int:
    """Write one block and its entry; returns 1 where the surface crosses it, else 0."""
    is_crossed = False
    for i in range(BLOCK):
        for j in range(BLOCK):
            for k in range(BLOCK):
                is_crossed = is_crossed or distance[j, bx * BLOCK + i, bz * BLOCK + k] < LIMIT
    if not is_crossed:
        row[bz] = SOLID if crossing[0, bx * BLOCK, bz * BLOCK] > 0 else AIR
        return 0
    for i in range(BLOCK):
        for j in range(BLOCK):
            for k in range(BLOCK):
                value = distance[j, bx * BLOCK + i, bz * BLOCK + k] * EDGE
                is_inside = crossing[j, bx * BLOCK + i, bz * BLOCK + k] > 0
                cells[(i * BLOCK + j) * BLOCK + k] = np.int16(np.rint(-value if is_inside else value))
    row[bz] = place
    return 1


@jit_compile
def _sum_crossings(crossing: Crossings) -> None:
    """Replace the changes along each line by their sums: more than 0 in the material."""
    for j in range(crossing.shape[0]):
        for i in range(crossing.shape[1]):
            inside = 0
            for k in range(crossing.shape[2]):
                inside += crossing[j, i, k]
                crossing[j, i, k] = inside


@jit_compile
def _add_crossings(corner: Array, first: int, crossing: Crossings) -> None:
    """Mark where lines along the third axis through the centres of cells enter (1) or leave (−1) the mesh."""
    a, b, c = corner[0], corner[1], corner[2]
    area = (b[0] - a[0]) * (c[1] - a[1]) - (c[0] - a[0]) * (b[1] - a[1])
    if area == 0.0:
        return
    gx = ((b[2] - a[2]) * (c[1] - a[1]) - (c[2] - a[2]) * (b[1] - a[1])) / area
    gy = ((b[0] - a[0]) * (c[2] - a[2]) - (c[0] - a[0]) * (b[2] - a[2])) / area
    sign = -1 if area > 0.0 else 1
    last = crossing.shape[2] - 1
    for j in range(BLOCK):
        y = first + j + 0.5
        left, right = 1e30, -1e30
        for n in range(3):
            p, q = corner[n], corner[(n + 1) % 3]
            if p[1] > q[1]:
                p, q = q, p
            if p[1] <= y < q[1]:
                x = p[0] + (y - p[1]) / (q[1] - p[1]) * (q[0] - p[0])
                left, right = min(left, x), max(right, x)
        if right < left:
            continue
        for i in range(max(ceil(left - 0.5), 0), min(ceil(right - 0.5), crossing.shape[1])):
            z = a[2] + gx * (i + 0.5 - a[0]) + gy * (y - a[1])
            crossing[j, i, min(max(ceil(z - 0.5), 0), last)] += sign


@jit_compile
def _add_distances(corner: Array, first: int, nearest: Distances, distance: Distances) -> None:
    """Lower the distances of the cells near a triangle, from it and from its plane.

    Beyond an edge the distance is that of the farther one of its two planes, as where a cutter leaves the edge: the
    volume of both edges is then the same. At an acute edge it is no less than at a right one, by ``ACUTE``.
    """
    normal = np.cross(corner[1] - corner[0], corner[2] - corner[0])
    size = sqrt(normal[0] * normal[0] + normal[1] * normal[1] + normal[2] * normal[2])
    if size > 0.0:
        normal = normal / size
    low, high = np.zeros(3), np.zeros(3)
    for n in range(3):
        low[n] = min(corner[0, n], corner[1, n], corner[2, n]) - LIMIT
        high[n] = max(corner[0, n], corner[1, n], corner[2, n]) + LIMIT
    place = np.zeros(3)
    for j in range(max(ceil(low[1] - 0.5) - first, 0), min(floor(high[1] - 0.5) - first + 1, BLOCK)):
        place[1] = first + j + 0.5
        for i in range(max(ceil(low[0] - 0.5), 0), min(floor(high[0] - 0.5) + 1, distance.shape[1])):
            place[0] = i + 0.5
            bottom, top = low[2], high[2]
            across = normal[0] * (place[0] - corner[0, 0]) + normal[1] * (place[1] - corner[0, 1])
            if abs(normal[2]) > 1e-6:
                middle, half = corner[0, 2] - across / normal[2], LIMIT / abs(normal[2])
                bottom, top = max(bottom, middle - half), min(top, middle + half)
            elif size > 0.0 and abs(across) > LIMIT + 1e-3:
                continue
            for k in range(max(ceil(bottom - 0.5), 0), min(floor(top - 0.5) + 1, distance.shape[2])):
                place[2] = k + 0.5
                found = _compute_distance(place, corner)
                before = nearest[j, i, k]
                if found > before + SAME:
                    continue
                plane = abs(across + normal[2] * (place[2] - corner[0, 2])) if size > 0.0 else found
                plane = max(plane, ACUTE * found)
                distance[j, i, k] = plane if found < before - SAME else max(distance[j, i, k], plane)
                nearest[j, i, k] = min(before, found)


@jit_compile
def _compute_distance(p: Array, corner: Array) -> float:
    """Distance of a place from a triangle (Ericson, Real-Time Collision Detection, 5.1.5)."""
    a0, a1, a2 = corner[0, 0], corner[0, 1], corner[0, 2]
    ab0, ab1, ab2 = corner[1, 0] - a0, corner[1, 1] - a1, corner[1, 2] - a2
    ac0, ac1, ac2 = corner[2, 0] - a0, corner[2, 1] - a1, corner[2, 2] - a2
    p0, p1, p2 = p[0] - a0, p[1] - a1, p[2] - a2
    d1, d2 = ab0 * p0 + ab1 * p1 + ab2 * p2, ac0 * p0 + ac1 * p1 + ac2 * p2
    bb, cc, bc = ab0 * ab0 + ab1 * ab1 + ab2 * ab2, ac0 * ac0 + ac1 * ac1 + ac2 * ac2, ab0 * ac0 + ab1 * ac1 + ab2 * ac2
    d3, d4, d5, d6 = d1 - bb, d2 - bc, d1 - bc, d2 - cc
    v, w = 0.0, 0.0
    if d1 <= 0.0 and d2 <= 0.0:
        pass
    elif d3 >= 0.0 and d4 <= d3:
        v = 1.0
    elif d6 >= 0.0 and d5 <= d6:
        w = 1.0
    else:
        va, vb, vc = d3 * d6 - d5 * d4, d5 * d2 - d1 * d6, d1 * d4 - d3 * d2
        if vc <= 0.0 and d1 >= 0.0 and d3 <= 0.0:
            v = d1 / bb if bb > 0.0 else 0.0
        elif vb <= 0.0 and d2 >= 0.0 and d6 <= 0.0:
            w = d2 / cc if cc > 0.0 else 0.0
        elif va <= 0.0 and d4 - d3 >= 0.0 and d5 - d6 >= 0.0:
            both = (d4 - d3) + (d5 - d6)
            w = (d4 - d3) / both if both > 0.0 else 0.0
            v = 1.0 - w
        else:
            total = va + vb + vc
            v, w = vb / total, vc / total
    e0, e1, e2 = p0 - v * ab0 - w * ac0, p1 - v * ab1 - w * ac1, p2 - v * ab2 - w * ac2
    return sqrt(e0 * e0 + e1 * e1 + e2 * e2)
