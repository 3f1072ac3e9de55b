"""Compiled search for the deepest of many points inside a triangle mesh, row by row."""

from __future__ import annotations

import numpy as np

from machopt.numerics.array_types import Array, Ints
from machopt.numerics.compiled_functions import jit_compile

MAX_TREE_DEPTH = 128  # stack size of the tree traversal

ROUNDING_M = 1e-12  # m


@jit_compile
def _place_point(T: Array, point: Array, last: Array, x: Array) -> float:
    """Write a point in the system of the part to ``x``; returns the square of its motion since ``last``, m²."""
    square = 0.0
    for c in range(3):
        x[c] = T[c, 0] * point[0] + T[c, 1] * point[1] + T[c, 2] * point[2] + T[c, 3]
        square += (x[c] - last[c]) ** 2
    return square


@jit_compile
def _compare_known_depth(
    x: Array, moved: float, deep: float, triangle: Array, deepest: float, is_later: bool
) -> tuple[bool, bool]:
    """Return whether a point that was inside at the depth ``deep`` cannot be the deepest, and whether it still is
    inside.

    Its motion bounds the depth, and so does the triangle that was nearest.
    """
    if deep + moved < deepest - ROUNDING_M:
        return True, False
    most = np.sqrt(_compute_triangle_distance(x, triangle))
    if most < deepest or (most == deepest and is_later):
        return True, False
    return False, moved < deep - ROUNDING_M


@jit_compile
def _is_inside_mesh(
    x: Array,
    rays: Array,
    corners: Array,
    low: Array,
    high: Array,
    child: Ints,
    first: Ints,
    count: Ints,
    order: Ints,
    waiting: Ints,
) -> bool:
    """Return whether most of three rays cross the mesh an odd number of times."""
    votes = 0
    for r in range(3):
        votes += _count_ray_crossings(x, rays[r], corners, low, high, child, first, count, order, waiting) % 2
    return votes >= 2


@jit_compile
def compute_row_depths(
    points: Array,
    leader: Ints,
    leader_distance: Array,
    T: Array,
    corners: Array,
    low: Array,
    high: Array,
    child: Ints,
    first: Ints,
    count: Ints,
    order: Ints,
    rays: Array,
    limit: float,
) -> tuple[Array, Ints]:
    """Compute the greatest depth of many points in a mesh, for each pose of the points.

    Args:
        points: (K, 3) m, leading points first.
        leader: (K,) leading point, −1 for none.
        leader_distance: (K,) m, how far the leader is.
        T: (M, 4, 4) poses of the points in the system of the mesh.
        corners: (F, 3, 3) m, triangles of the mesh.
        low: (B, 3) m, lowest corner of each box of the tree.
        high: (B, 3) m, highest corner of each box.
        child: (B,) first child of each box.
        first: (B,) first triangle of each box in ``order``.
        count: (B,) number of triangles of each box.
        order: (F,) triangles in the order of the tree.
        rays: (3, 3) directions that decide whether a point is inside.
        limit: m, depths below it are not looked for.

    Returns:
        (M,) greatest depth in m above ``limit``, else 0, and (M,) its point.
    """
    depth, which = np.zeros(len(T)), np.zeros(len(T), np.int64)
    # m, motion of a point before it must be checked again, and its place then
    room, last = np.zeros(len(points)), np.zeros((len(points), 3))
    left = np.zeros(len(points))  # m, distance from the part in this row
    deep = np.full(len(points), -1.0)  # m, last known depth; negative outside
    near = np.full(len(points), order[0])  # nearest triangle at that time
    waiting, gaps, x = np.empty(MAX_TREE_DEPTH, np.int64), np.empty(MAX_TREE_DEPTH), np.empty(3)
    for m in range(len(T)):
        begin = -1 if m > 0 and depth[m - 1] > 0.0 else 0
        for n in range(begin, len(points)):
            # the deepest point of the previous row first: most others are known to be less deep
            k = which[m - 1] if n < 0 else n
            if begin < 0 and n == which[m - 1]:
                continue
            if leader[k] >= 0 and n >= 0 and left[leader[k]] > leader_distance[k]:
                continue
            square = _place_point(T[m], points[k], last[k], x)
            if m > 0 and square < room[k] * room[k]:
                left[k] = room[k] - np.sqrt(square) if left[k] > 0.0 else 0.0
                continue
            inside = False
            if deep[k] > 0.0:
                is_later, nearest = k > which[m], corners[near[k]]
                less, inside = _compare_known_depth(x, np.sqrt(square), deep[k], nearest, depth[m], is_later)
                if less:
                    continue
            square, near[k] = _find_nearest_triangle(
                x, corners, low, high, child, first, count, order, limit * limit, waiting, gaps, near[k]
            )
            d = np.sqrt(square)
            left[k], deep[k] = 0.0, -1.0
            for c in range(3):
                last[k, c] = x[c]
            if d <= limit:
                room[k] = max(limit - d - ROUNDING_M, 0.0)
                continue
            if not (inside or _is_inside_mesh(x, rays, corners, low, high, child, first, count, order, waiting)):
                room[k] = d + limit
                left[k] = room[k]
                continue
            room[k], deep[k] = 0.0, d
            if d > depth[m] or (d == depth[m] and k < which[m]):
                depth[m], which[m] = d, k
    return depth, which


@jit_compile
def _compute_box_distance(x: Array, low: Array, high: Array, k: int) -> float:
    """m² from a point to a box."""
    gap = 0.0
    for c in range(3):
        off = max(low[k, c] - x[c], x[c] - high[k, c], 0.0)
        gap += off * off
    return float(gap)


@jit_compile
def _find_nearest_triangle(
    x: Array,
    corners: Array,
    low: Array,
    high: Array,
    child: Ints,
    first: Ints,
    count: Ints,
    order: Ints,
    enough: float,
    waiting: Ints,
    gaps: Array,
    guess: int,
) -> tuple[float, int]:
    """Return m² to the nearest triangle and its index; any distance below ``enough`` suffices, ``guess`` is tried
    first.
    """
    best, found = _compute_triangle_distance(x, corners[guess]), guess
    if best <= enough:
        return best, found
    waiting[0], gaps[0], depth = 0, _compute_box_distance(x, low, high, 0), 1
    while depth:
        depth -= 1
        k = waiting[depth]
        if gaps[depth] >= best:
            continue
        if child[k] < 0:
            for s in range(first[k], first[k] + count[k]):
                square = _compute_triangle_distance(x, corners[order[s]])
                if square < best:
                    best, found = square, order[s]
            if best <= enough:
                return best, found
            continue
        k1, k2 = child[k], child[k] + 1
        g1, g2 = _compute_box_distance(x, low, high, k1), _compute_box_distance(x, low, high, k2)
        if g1 < g2:  # the nearer one is examined first
            k1, k2, g1, g2 = k2, k1, g2, g1
        waiting[depth], gaps[depth], waiting[depth + 1], gaps[depth + 1] = k1, g1, k2, g2
        depth += 2
    return best, found


@jit_compile
def _compute_triangle_distance(p: Array, A: Array) -> float:
    """m² from a point to a triangle (Ericson 2005, section 5.1.5)."""
    u0, u1, u2 = A[1, 0] - A[0, 0], A[1, 1] - A[0, 1], A[1, 2] - A[0, 2]
    v0, v1, v2 = A[2, 0] - A[0, 0], A[2, 1] - A[0, 1], A[2, 2] - A[0, 2]
    w0, w1, w2 = p[0] - A[0, 0], p[1] - A[0, 1], p[2] - A[0, 2]
    d1, d2 = u0 * w0 + u1 * w1 + u2 * w2, v0 * w0 + v1 * w1 + v2 * w2
    if d1 <= 0.0 and d2 <= 0.0:
        return float(w0 * w0 + w1 * w1 + w2 * w2)
    uu, uv, vv = u0 * u0 + u1 * u1 + u2 * u2, u0 * v0 + u1 * v1 + u2 * v2, v0 * v0 + v1 * v1 + v2 * v2
    d3, d4 = d1 - uu, d2 - uv
    d5, d6 = d1 - uv, d2 - vv
    s, t = 0.0, 0.0
    a, b, c = d3 * d6 - d5 * d4, d5 * d2 - d1 * d6, d1 * d4 - d3 * d2
    if d3 >= 0.0 and d4 <= d3:
        s = 1.0
    elif d6 >= 0.0 and d5 <= d6:
        t = 1.0
    elif c <= 0.0 and d1 >= 0.0 and d3 <= 0.0:
        s = d1 / (d1 - d3) if d1 > d3 else 0.0
    elif b <= 0.0 and d2 >= 0.0 and d6 <= 0.0:
        t = d2 / (d2 - d6) if d2 > d6 else 0.0
    elif a <= 0.0 and d4 - d3 >= 0.0 and d5 - d6 >= 0.0:
        size = (d4 - d3) + (d5 - d6)
        t = (d4 - d3) / size if size > 0.0 else 0.0
        s = 1.0 - t
    else:
        size = a + b + c
        s, t = (b / size, c / size) if size > 0.0 else (0.0, 0.0)
    x, y, z = w0 - s * u0 - t * v0, w1 - s * u1 - t * v1, w2 - s * u2 - t * v2
    return float(x * x + y * y + z * z)


@jit_compile
def _count_ray_crossings(
    x: Array,
    ray: Array,
    corners: Array,
    low: Array,
    high: Array,
    child: Ints,
    first: Ints,
    count: Ints,
    order: Ints,
    waiting: Ints,
) -> int:
    """Return how often a ray from a point crosses the surface (Möller and Trumbore 1997)."""
    hits = 0
    waiting[0], depth = 0, 1
    while depth:
        depth -= 1
        k = waiting[depth]
        entry_length, exit_length = 0.0, np.inf
        for c in range(3):
            a, b = (low[k, c] - x[c]) / ray[c], (high[k, c] - x[c]) / ray[c]
            entry_length, exit_length = max(entry_length, min(a, b)), min(exit_length, max(a, b))
        if entry_length > exit_length + 1e-9:
            continue
        if child[k] >= 0:
            waiting[depth], waiting[depth + 1] = child[k], child[k] + 1
            depth += 2
            continue
        for s in range(first[k], first[k] + count[k]):
            A = corners[order[s]]
            u0, u1, u2 = A[1, 0] - A[0, 0], A[1, 1] - A[0, 1], A[1, 2] - A[0, 2]
            v0, v1, v2 = A[2, 0] - A[0, 0], A[2, 1] - A[0, 1], A[2, 2] - A[0, 2]
            p0, p1, p2 = ray[1] * v2 - ray[2] * v1, ray[2] * v0 - ray[0] * v2, ray[0] * v1 - ray[1] * v0
            det = u0 * p0 + u1 * p1 + u2 * p2
            if det == 0.0:
                continue
            w0, w1, w2 = x[0] - A[0, 0], x[1] - A[0, 1], x[2] - A[0, 2]
            f = (w0 * p0 + w1 * p1 + w2 * p2) / det
            if f < 0.0 or f > 1.0:
                continue
            r0, r1, r2 = w1 * u2 - w2 * u1, w2 * u0 - w0 * u2, w0 * u1 - w1 * u0
            g = (ray[0] * r0 + ray[1] * r1 + ray[2] * r2) / det
            if g < 0.0 or f + g > 1.0:
                continue
            if (v0 * r0 + v1 * r1 + v2 * r2) / det > 0.0:
                hits += 1
    return hits
