"""Least distance between two moving triangle surfaces, row after row (compiled).

Both surfaces have a tree of boxes along common axes. The smaller one is moved into the other's frame and its boxes are
recomputed, so that boxes are compared by six subtractions (van den Bergen 1997). The two trees are traversed together,
the nearer boxes first; boxes farther apart than the least distance found are skipped. The initial value is the
distance of the two triangles that were nearest in the previous row: along a path they usually still are, or nearly.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from machopt.collision.bounding_box_tree import BoxTreeMesh
from machopt.collision.triangle_distance import TIE_TOLERANCE, compute_separation_along, compute_triangle_distance
from machopt.numerics.array_types import Array, Ints
from machopt.numerics.compiled_functions import jit_compile

MAX_STACK_SIZE = 512  # stack size of the tree traversal
ROUNDING_M = 1e-9  # m, rounding error of sums of motions


@jit_compile
def _move_triangles(T: Array, corners: Array, normals: Array, out: Array, turned: Array) -> None:
    """Move all triangles and their normals by T (4, 4)."""
    for f in range(len(corners)):
        for v in range(3):
            x, y, z = corners[f, v, 0], corners[f, v, 1], corners[f, v, 2]
            for c in range(3):
                out[f, v, c] = T[c, 0] * x + T[c, 1] * y + T[c, 2] * z + T[c, 3]
        x, y, z = normals[f, 0], normals[f, 1], normals[f, 2]
        for c in range(3):
            turned[f, c] = T[c, 0] * x + T[c, 1] * y + T[c, 2] * z


@jit_compile
def _update_boxes(corners: Array, child: Ints, first: Ints, count: Ints, order: Ints, low: Array, high: Array) -> None:
    """Recompute the boxes around moved triangles; inner boxes come after their outer one."""
    for box in range(len(child) - 1, -1, -1):
        k = child[box]
        for c in range(3):
            if k >= 0:
                low[box, c], high[box, c] = min(low[k, c], low[k + 1, c]), max(high[k, c], high[k + 1, c])
                continue
            lo, hi = np.inf, -np.inf
            for m in range(first[box], first[box] + count[box]):
                for v in range(3):
                    lo, hi = min(lo, corners[order[m], v, c]), max(hi, corners[order[m], v, c])
            low[box, c], high[box, c] = lo, hi


@jit_compile
def _compute_box_distance(low: Array, high: Array, k: int, lo: Array, hi: Array, m: int) -> float:
    """m² between the boxes k of one tree and m of the other."""
    gap = 0.0
    for c in range(3):
        way = max(low[k, c] - hi[m, c], lo[m, c] - high[k, c], 0.0)
        gap += way * way
    return gap


@jit_compile
def _take_direction(work: Array, distance: float, u: Array) -> None:
    """Fill u (3,) with the unit direction between the nearest points of two triangles; 0 where they touch."""
    for c in range(3):
        u[c] = work[6, c] / distance if distance > 0.0 else 0.0


@jit_compile
def _find_nearest_triangles(
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
    i: int,
    j: int,
    waiting: Ints,
    gaps: Array,
    work: Array,
    u: Array,
) -> tuple[float, int, int]:
    """Return the distance in m between two surfaces with boxes in one frame, and the two triangles; i and j are a
    first guess.
    """
    best, _ = compute_triangle_distance(a[i], na[i], b[j], nb[j], np.inf, work)
    _take_direction(work, best, u)
    waiting[0, 0], waiting[0, 1], gaps[0], depth = 0, 0, 0.0, 1
    while depth:
        depth -= 1
        k, m = waiting[depth, 0], waiting[depth, 1]
        if best <= TIE_TOLERANCE or gaps[depth] >= (best - TIE_TOLERANCE) ** 2:
            continue
        if child[k] < 0 and inner[m] < 0:
            for s in range(first[k], first[k] + count[k]):
                for t in range(begin[m], begin[m] + number[m]):
                    v, w = order[s], sequence[t]
                    if (
                        compute_separation_along(a[v], b[w], u) >= best - TIE_TOLERANCE
                    ):  # the nearest pair gives the direction in which others are farther
                        continue
                    d, exact = compute_triangle_distance(a[v], na[v], b[w], nb[w], best, work)
                    if exact and d < best:
                        best, i, j = d, v, w
                        _take_direction(work, best, u)
            continue
        # the box with more triangles is divided
        if inner[m] < 0 or (child[k] >= 0 and count[k] >= number[m]):
            k1, k2, m1, m2 = child[k], child[k] + 1, m, m
        else:
            k1, k2, m1, m2 = k, k, inner[m], inner[m] + 1
        g1, g2 = _compute_box_distance(low, high, k1, lo, hi, m1), _compute_box_distance(low, high, k2, lo, hi, m2)
        if g1 < g2:  # the nearer one is examined first
            k1, k2, m1, m2, g1, g2 = k2, k1, m2, m1, g2, g1
        waiting[depth, 0], waiting[depth, 1], gaps[depth] = k1, m1, g1
        waiting[depth + 1, 0], waiting[depth + 1, 1], gaps[depth + 1] = k2, m2, g2
        depth += 2
    return best, i, j


@jit_compile
def compute_distances_along_rows(
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
    inner: Ints,
    begin: Ints,
    number: Ints,
    sequence: Ints,
    rows: Ints,
    T: Array,
    way: Array,
    bound: Array,
    most: Array,
) -> tuple[Array, NDArray[np.bool_]]:
    """Return the distances of two surfaces at some rows, where they can be below ``most``.

    The first eight arguments are the fixed surface, the next seven the moving one, see :class:`BoxTreeMesh`. It is
    fastest
    if the moving one has fewer triangles, and if successive rows are near each other.

    Args:
        a: (F, 3, 3) m, triangles of the fixed surface.
        na: (F, 3) their normals.
        low: (B, 3) m, boxes of the fixed surface.
        high: (B, 3) m.
        child: (B,) first inner box, −1 for none.
        first: (B,) first triangle in ``order``.
        count: (B,) number of triangles.
        order: (F,) triangles.
        b: (G, 3, 3) m, triangles of the moving surface.
        nb: (G, 3) their normals.
        inner: ``child`` of the moving surface.
        begin: ``first`` of the moving surface.
        number: ``count`` of the moving surface.
        sequence: ``order`` of the moving surface.
        rows: (K,) rows to measure.
        T: (S, 4, 4) motion of b relative to a.
        way: (S,) m: no point of b moves relative to a by more than the difference of two of them.
        bound: (S,) m, known lower bound of the distance.
        most: (S,) m, larger distances are not needed.

    Returns:
        (S,) m, infinite where not measured; (S,) whether b might have passed through a since the previously measured
        row.
    """
    out, fresh = np.full(len(T), np.inf), np.zeros(len(T), np.bool_)
    moved, turned = np.empty_like(b), np.empty_like(nb)
    lo, hi = np.empty((len(inner), 3)), np.empty((len(inner), 3))
    waiting, gaps, work = np.empty((MAX_STACK_SIZE, 2), np.int64), np.empty(MAX_STACK_SIZE), np.empty((7, 3))
    u = np.empty(3)
    known, last, i, j = 0.0, -1, order[0], sequence[0]
    for n in rows:
        motion = abs(way[n] - way[last]) + ROUNDING_M if last >= 0 else np.inf
        if bound[n] >= most[n] or (last >= 0 and known - motion >= most[n]):
            continue
        _move_triangles(T[n], b, nb, moved, turned)
        _update_boxes(moved, inner, begin, number, sequence, lo, hi)
        d, i, j = _find_nearest_triangles(
            a,
            na,
            low,
            high,
            child,
            first,
            count,
            order,
            moved,
            turned,
            lo,
            hi,
            inner,
            begin,
            number,
            sequence,
            i,
            j,
            waiting,
            gaps,
            work,
            u,
        )
        fresh[n] = last < 0 or max(d, known) <= motion
        out[n], known, last = d, d, n
    return out, fresh


def compute_distance(a: BoxTreeMesh, b: BoxTreeMesh, T: Array, guess: tuple[int, int]) -> tuple[float, tuple[int, int]]:
    """Return the distance in m between two surfaces, 0 where they cross, and the two nearest triangles.

    Args:
        a: fixed surface.
        b: moving surface.
        T: (4, 4) motion of b relative to a.
        guess: one triangle of each that may be near the other, e.g. the result of the previous call.
    """
    turn = len(a.corners) < len(b.corners)  # the smaller one is moved
    x, y, k, m = (b, a, guess[1], guess[0]) if turn else (a, b, *guess)
    d, k, m = _compute_placed_distance(
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
        y.child,
        y.first,
        y.count,
        y.order,
        np.ascontiguousarray(T),
        turn,
        k,
        m,
    )
    return d, (m, k) if turn else (k, m)


@jit_compile
def _invert_motion(T: Array) -> Array:
    """Return the inverse of a rigid motion (4, 4)."""
    out = np.zeros((4, 4))
    out[3, 3] = 1.0
    for c in range(3):
        for k in range(3):
            out[c, k] = T[k, c]
            out[c, 3] -= T[k, c] * T[k, 3]
    return out


@jit_compile
def _compute_placed_distance(
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
    inner: Ints,
    begin: Ints,
    number: Ints,
    sequence: Ints,
    T: Array,
    is_inverse: bool,
    i: int,
    j: int,
) -> tuple[float, int, int]:
    """Return the result of :func:`compute_distance`; a … sequence as for :func:`compute_distances_along_rows`."""
    if is_inverse:
        T = _invert_motion(T)
    moved, turned = np.empty_like(b), np.empty_like(nb)
    lo, hi = np.empty((len(inner), 3)), np.empty((len(inner), 3))
    _move_triangles(T, b, nb, moved, turned)
    _update_boxes(moved, inner, begin, number, sequence, lo, hi)
    waiting, gaps, work = np.empty((MAX_STACK_SIZE, 2), np.int64), np.empty(MAX_STACK_SIZE), np.empty((7, 3))
    return _find_nearest_triangles(
        a,
        na,
        low,
        high,
        child,
        first,
        count,
        order,
        moved,
        turned,
        lo,
        hi,
        inner,
        begin,
        number,
        sequence,
        i,
        j,
        waiting,
        gaps,
        work,
        np.empty(3),
    )
