"""Proximity test of two surfaces at many placements: nearer than a limit or not, without the distance (compiled).

Usually a plane between the boxes around the two separates them. It is searched along the shortest line
between them (Gilbert 1966), which a few steps approximate well enough. Otherwise the two trees of boxes
(:mod:`machopt.collision.mesh_distance`) are traversed. The second surface is not moved first: a box of it is placed
when it is needed, and compared along the axes of either; the same applies to triangles in boxes near each other.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from machopt.collision.bodies import CollisionBody
from machopt.collision.bounding_box_tree import BoxTreeMesh, build_box_tree
from machopt.collision.mesh_distance import MAX_STACK_SIZE
from machopt.collision.triangle_distance import compute_triangle_distance
from machopt.numerics.array_types import Array
from machopt.numerics.compiled_functions import jit_compile
from machopt.numerics.parallel_map import map_in_threads

Ints = NDArray[np.int64]
Bools = NDArray[np.bool_]
FEW, BLOCK = 64, 512  # minimum and maximum placements of one task, independent of the number of cores
CONTACT_TOLERANCE_M = 1e-9  # m, below which surfaces cross
MAX_GILBERT_STEPS = 10  # iterations towards the shortest line between two bodies
SEARCH_MARGIN_FACTOR = 8.0  # times the motion between two rows: search margin beyond the limit for a free row,
MIN_SEARCH_MARGIN_M = 2e-3  # m, where that is less than this
ROUNDING_M = 1e-9  # m, rounding error of motions


@dataclass(frozen=True)
class BodyOutline:
    """A body's triangles, and the corners (V, 3) m of a convex body around them, in base_link at q = 0."""

    mesh: BoxTreeMesh
    hull_corners: Array


def build_outline(body: CollisionBody) -> BodyOutline:
    """Return the box tree of a body's triangles, and the corners of its oriented bounding box.

    Its convex hull would separate no more pairs in the same time, because it has many corners.

    Args:
        body: collision body.
    """
    signs = np.array(np.meshgrid(*[[-1.0, 1.0]] * 3)).reshape(3, -1).T
    corners = body.box_centre + (signs * body.box_half) @ body.box_rotation.T
    return BodyOutline(build_box_tree(body), np.ascontiguousarray(corners))


def is_nearer_than(a: BodyOutline, b: BodyOutline, T: Array, limit: float) -> Bools:
    """Return (S,) whether the surfaces cross or are nearer than a limit; a body wholly inside the other is not near.

    Fastest where neighbouring rows are neighbouring placements.

    Args:
        a: first body.
        b: second body.
        T: (S, 4, 4) motion of b relative to a.
        limit: m.
    """
    T = np.ascontiguousarray(T, float)
    limit = max(limit, CONTACT_TOLERANCE_M)
    x, y = a.mesh, b.mesh
    size = min(max(len(T) // 4, FEW), BLOCK)

    def block(start: int) -> Bools:
        return _check_rows(
            a.hull_corners,
            b.hull_corners,
            x.corners,
            x.normals,
            x.low,
            x.high,
            x.child,
            x.first,
            x.count,
            x.order,
            y.corners,
            y.normals,
            y.low,
            y.high,
            y.child,
            y.first,
            y.count,
            y.order,
            T[start : start + size],
            limit,
        )

    return np.concatenate([np.zeros(0, bool), *map_in_threads(block, range(0, len(T), size))])


@jit_compile
def _find_extreme_points(a: Array, b: Array, M: Array, v: Array, turned: Array) -> tuple[float, int, int]:
    """Return the distance of the points a (V, 3) beyond b (W, 3), moved by M, along v, times its length; and the two
    nearest.
    """
    low, high, i, j = np.inf, -np.inf, 0, 0
    for k in range(len(a)):
        along = a[k, 0] * v[0] + a[k, 1] * v[1] + a[k, 2] * v[2]
        if along < low:
            low, i = along, k
    for c in range(3):
        turned[c] = M[0, c] * v[0] + M[1, c] * v[1] + M[2, c] * v[2]
    for k in range(len(b)):
        along = b[k, 0] * turned[0] + b[k, 1] * turned[1] + b[k, 2] * turned[2]
        if along > high:
            high, j = along, k
    return low - high - (M[0, 3] * v[0] + M[1, 3] * v[1] + M[2, 3] * v[2]), i, j


@jit_compile
def _find_separating_distance(a: Array, b: Array, M: Array, limit: float, v: Array, turned: Array) -> float:
    """Return the separation in m of the points a (V, 3) and b (W, 3), moved by M, by a plane, if it is at least
    ``limit``;
    else a negative value.

    Args:
        v: (3,) normal of such a plane; changed. The last row's is tried first.
    """
    length = np.sqrt(v[0] * v[0] + v[1] * v[1] + v[2] * v[2])
    if length > CONTACT_TOLERANCE_M:
        gap = _find_extreme_points(a, b, M, v, turned)[0]
        if gap >= limit * length:
            return float(gap / length)
    for c in range(3):  # from b to a, between a corner of each
        v[c] = a[0, c] - (M[c, 0] * b[0, 0] + M[c, 1] * b[0, 1] + M[c, 2] * b[0, 2] + M[c, 3])
    for _ in range(MAX_GILBERT_STEPS):
        length = np.sqrt(v[0] * v[0] + v[1] * v[1] + v[2] * v[2])
        if length < CONTACT_TOLERANCE_M:
            break
        gap, i, j = _find_extreme_points(a, b, M, v, turned)
        if gap >= limit * length:
            return float(gap / length)
        square, towards = 0.0, 0.0
        for c in range(3):  # the point nearest to zero between v and the difference of the two outermost points
            turned[c] = a[i, c] - (M[c, 0] * b[j, 0] + M[c, 1] * b[j, 1] + M[c, 2] * b[j, 2] + M[c, 3]) - v[c]
            square += turned[c] * turned[c]
            towards -= v[c] * turned[c]
        if towards <= 0.0:
            break
        share = min(towards / square, 1.0)
        for c in range(3):
            v[c] += share * turned[c]
    return -1.0


@jit_compile
def _place_triangle(T: Array, triangle: Array, normal: Array, out: Array, turned: Array) -> None:
    """A triangle (3, 3) and its normal, moved by T (4, 4)."""
    for c in range(3):
        turned[c] = T[c, 0] * normal[0] + T[c, 1] * normal[1] + T[c, 2] * normal[2]
        for v in range(3):
            out[v, c] = T[c, 0] * triangle[v, 0] + T[c, 1] * triangle[v, 1] + T[c, 2] * triangle[v, 2] + T[c, 3]


@jit_compile
def _compute_box_separation(low: Array, high: Array, k: int, lo: Array, hi: Array, m: int, T: Array) -> float:
    """Return m², a lower bound of the distance of box k from box m moved by T, along the axes of either.

    Where no axis separates them: the penetration in m, as a negative value.
    """
    x = 0.5 * (lo[m, 0] + hi[m, 0]), 0.5 * (lo[m, 1] + hi[m, 1]), 0.5 * (lo[m, 2] + hi[m, 2])
    h = 0.5 * (hi[m, 0] - lo[m, 0]), 0.5 * (hi[m, 1] - lo[m, 1]), 0.5 * (hi[m, 2] - lo[m, 2])
    dx = T[0, 0] * x[0] + T[0, 1] * x[1] + T[0, 2] * x[2] + T[0, 3] - 0.5 * (low[k, 0] + high[k, 0])
    dy = T[1, 0] * x[0] + T[1, 1] * x[1] + T[1, 2] * x[2] + T[1, 3] - 0.5 * (low[k, 1] + high[k, 1])
    dz = T[2, 0] * x[0] + T[2, 1] * x[1] + T[2, 2] * x[2] + T[2, 3] - 0.5 * (low[k, 2] + high[k, 2])
    u, v, w = 0.5 * (high[k, 0] - low[k, 0]), 0.5 * (high[k, 1] - low[k, 1]), 0.5 * (high[k, 2] - low[k, 2])
    ax = abs(dx) - u - abs(T[0, 0]) * h[0] - abs(T[0, 1]) * h[1] - abs(T[0, 2]) * h[2]
    ay = abs(dy) - v - abs(T[1, 0]) * h[0] - abs(T[1, 1]) * h[1] - abs(T[1, 2]) * h[2]
    az = abs(dz) - w - abs(T[2, 0]) * h[0] - abs(T[2, 1]) * h[1] - abs(T[2, 2]) * h[2]
    gap, least = 0.0, max(ax, ay, az)
    for off in (ax, ay, az):
        if off > 0.0:
            gap += off * off
    other = 0.0
    for c in range(3):
        off = abs(T[0, c] * dx + T[1, c] * dy + T[2, c] * dz)
        off -= h[c] + abs(T[0, c]) * u + abs(T[1, c]) * v + abs(T[2, c]) * w
        least = max(least, off)
        if off > 0.0:
            other += off * off
    return float(max(gap, other) if least > 0.0 else least)


@jit_compile
def _bound_box_motion(low: Array, high: Array, T: Array, S: Array) -> float:
    """Return an upper bound in m of the difference of the motions T and S over a box (3,), (3,): its value at the
    corners,
    because it is convex over the box.
    """
    most = 0.0
    for corner in range(8):
        x = high[0] if corner & 1 else low[0]
        y = high[1] if corner & 2 else low[1]
        z = high[2] if corner & 4 else low[2]
        square = 0.0
        for c in range(3):
            d = (T[c, 0] - S[c, 0]) * x + (T[c, 1] - S[c, 1]) * y + (T[c, 2] - S[c, 2]) * z + T[c, 3] - S[c, 3]
            square += d * d
        most = max(most, square)
    return float(np.sqrt(most))


@jit_compile
def _check_rows(
    around: Array,
    other: Array,
    a: Array,
    na: Array,
    low: Array,
    high: Array,
    child: Ints,
    first: Ints,
    count: Ints,
    order: Ints,
    b: Array,
    nb: Array,
    lo: Array,
    hi: Array,
    inner: Ints,
    begin: Ints,
    number: Ints,
    sequence: Ints,
    T: Array,
    limit: float,
) -> NDArray[np.bool_]:
    """Return the result of :func:`is_nearer_than`, ``limit`` at least CONTACT_TOLERANCE_M; a … order and b … sequence
    as in
    :class:`BoxTreeMesh`; around and other are the outline corners.

    A free row has a margin: that of the separating plane, or SEARCH_MARGIN_FACTOR times the motion. The following rows
    are
    free until the motion exceeds it; two triangles that are near stay near as long.
    """
    out = np.zeros(len(T), np.bool_)
    waiting, gaps, work = np.empty((MAX_STACK_SIZE, 2), np.int64), np.empty(MAX_STACK_SIZE), np.empty((7, 3))
    moved, turned = np.empty((3, 3)), np.empty(3)
    i, j = -1, -1  # the two triangles that were near in the row before
    hit, sure = -1, 0.0  # a row with contact, and m by which those two triangles are nearer than the limit
    free, room = -1, 0.0  # a row that is free, and m by which its distance is above the limit
    across = np.zeros(3)  # along which the two were apart last
    for n in range(len(T)):
        if free >= 0 and _bound_box_motion(lo[0], hi[0], T[n], T[free]) < room:
            continue
        if i >= 0:
            if _bound_box_motion(lo[0], hi[0], T[n], T[hit]) < sure:
                out[n] = True
                continue
            _place_triangle(T[n], b[j], nb[j], moved, turned)
            d, exact = compute_triangle_distance(a[i], na[i], moved, turned, limit, work)
            if exact and d < limit:
                out[n], hit, sure = True, n, limit - d - ROUNDING_M
                continue
        gap = _find_separating_distance(around, other, T[n], limit, across, turned)
        if gap > 0.0:
            free, room = n, gap - limit - ROUNDING_M
            continue
        best = limit  # larger distances are not needed
        if free == n - 1 >= 0:  # the next row is likely to be free too
            step = _bound_box_motion(lo[0], hi[0], T[n], T[n - 1])
            best += SEARCH_MARGIN_FACTOR * step if SEARCH_MARGIN_FACTOR * step < MIN_SEARCH_MARGIN_M else 0.0
        waiting[0, 0], waiting[0, 1], gaps[0], depth = 0, 0, 0.0, 1
        while depth and not out[n]:
            depth -= 1
            k, m = waiting[depth, 0], waiting[depth, 1]
            if gaps[depth] >= best * best:
                continue
            if child[k] < 0 and inner[m] < 0:
                for t in range(begin[m], begin[m] + number[m]):
                    w = sequence[t]
                    _place_triangle(T[n], b[w], nb[w], moved, turned)
                    for s in range(first[k], first[k] + count[k]):
                        v = order[s]
                        d, exact = compute_triangle_distance(a[v], na[v], moved, turned, best, work)
                        if exact and d < limit:
                            out[n], i, j = True, v, w
                            hit, sure = n, limit - d - ROUNDING_M
                            break
                        if exact:
                            best = min(best, d)
                    if out[n]:
                        break
                continue
            # the box with more triangles is divided, and the half deeper in the other one is examined first
            if inner[m] < 0 or (child[k] >= 0 and count[k] >= number[m]):
                k1, k2, m1, m2 = child[k], child[k] + 1, m, m
            else:
                k1, k2, m1, m2 = k, k, inner[m], inner[m] + 1
            g1, g2 = (
                _compute_box_separation(low, high, k1, lo, hi, m1, T[n]),
                _compute_box_separation(low, high, k2, lo, hi, m2, T[n]),
            )
            if g1 < g2:
                k1, k2, m1, m2, g1, g2 = k2, k1, m2, m1, g2, g1
            if g1 < best * best:
                waiting[depth, 0], waiting[depth, 1], gaps[depth] = k1, m1, g1
                depth += 1
            if g2 < best * best:
                waiting[depth, 0], waiting[depth, 1], gaps[depth] = k2, m2, g2
                depth += 1
        if not out[n]:
            free, room = n, best - limit - ROUNDING_M
    return out
