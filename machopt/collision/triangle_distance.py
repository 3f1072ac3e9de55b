"""Distance of two triangles, and lower bounds of it (compiled)."""

from __future__ import annotations

import numpy as np

from machopt.numerics.array_types import Array
from machopt.numerics.compiled_functions import jit_compile

TIE_TOLERANCE = 1e-12  # m, rounding difference of equal distances


@jit_compile
def _compute_segment_distance(p: Array, u: Array, q: Array, v: Array, best: float, apart: Array) -> float:
    """Return m² between the segments p … p + u and q … q + v (Ericson 2005, section 5.1.9), and their connecting
    vector,
    where that is less than ``best``.
    """
    rx, ry, rz = p[0] - q[0], p[1] - q[1], p[2] - q[2]
    a = u[0] * u[0] + u[1] * u[1] + u[2] * u[2]
    e = v[0] * v[0] + v[1] * v[1] + v[2] * v[2]
    f = v[0] * rx + v[1] * ry + v[2] * rz
    c = u[0] * rx + u[1] * ry + u[2] * rz
    b = u[0] * v[0] + u[1] * v[1] + u[2] * v[2]
    s = 0.0
    if a > 0.0:
        flat = a * e - b * b
        if flat > 1e-14 * a * e:
            s = min(max((b * f - c * e) / flat, 0.0), 1.0)
    if e > 0.0:
        t = (b * s + f) / e
    else:  # a point
        t = 0.0
        s = min(max(-c / a, 0.0), 1.0) if a > 0.0 else 0.0
    if t < 0.0:
        t = 0.0
        s = min(max(-c / a, 0.0), 1.0) if a > 0.0 else 0.0
    elif t > 1.0:
        t = 1.0
        s = min(max((b - c) / a, 0.0), 1.0) if a > 0.0 else 0.0
    dx, dy, dz = rx + s * u[0] - t * v[0], ry + s * u[1] - t * v[1], rz + s * u[2] - t * v[2]
    gap = dx * dx + dy * dy + dz * dz
    if gap >= best:
        return best
    apart[0], apart[1], apart[2] = -dx, -dy, -dz
    return float(gap)


@jit_compile
def _is_foot_inside(A: Array, n: Array, x: float, y: float, z: float) -> bool:
    """Return whether the foot of a point on the plane of the triangle A with normal n lies inside it."""
    for k in range(3):
        m = (k + 1) % 3
        ex, ey, ez = A[m, 0] - A[k, 0], A[m, 1] - A[k, 1], A[m, 2] - A[k, 2]
        wx, wy, wz = x - A[k, 0], y - A[k, 1], z - A[k, 2]
        if (ey * wz - ez * wy) * n[0] + (ez * wx - ex * wz) * n[1] + (ex * wy - ey * wx) * n[2] < 0.0:
            return False
    return True


@jit_compile
def _compute_plane_separation(A: Array, n: Array, B: Array) -> float:
    """Return a lower bound in m of the distance of triangle B from the plane of A with unit normal n; 0 if it
    crosses it.
    """
    c = A[0, 0] * n[0] + A[0, 1] * n[1] + A[0, 2] * n[2]
    x = B[0, 0] * n[0] + B[0, 1] * n[1] + B[0, 2] * n[2] - c
    y = B[1, 0] * n[0] + B[1, 1] * n[1] + B[1, 2] * n[2] - c
    z = B[2, 0] * n[0] + B[2, 1] * n[1] + B[2, 2] * n[2] - c
    return float(max(min(x, y, z), -max(x, y, z), 0.0))


@jit_compile
def _compute_corner_distance(A: Array, n: Array, B: Array, sign: float, best: float, apart: Array) -> float:
    """Return m² of the corners of B over the inside of A, and ``sign`` times the connecting vector, where less than
    ``best``.
    """
    if n[0] == 0.0 and n[1] == 0.0 and n[2] == 0.0:
        return best
    for k in range(3):
        h = (B[k, 0] - A[0, 0]) * n[0] + (B[k, 1] - A[0, 1]) * n[1] + (B[k, 2] - A[0, 2]) * n[2]
        if h * h < best and _is_foot_inside(A, n, B[k, 0], B[k, 1], B[k, 2]):
            best = h * h
            apart[0], apart[1], apart[2] = sign * h * n[0], sign * h * n[1], sign * h * n[2]
    return best


@jit_compile
def _is_edge_crossing(A: Array, n: Array, B: Array) -> bool:
    """Return whether an edge of B passes through A."""
    for k in range(3):
        m = (k + 1) % 3
        x = (B[k, 0] - A[0, 0]) * n[0] + (B[k, 1] - A[0, 1]) * n[1] + (B[k, 2] - A[0, 2]) * n[2]
        y = (B[m, 0] - A[0, 0]) * n[0] + (B[m, 1] - A[0, 1]) * n[1] + (B[m, 2] - A[0, 2]) * n[2]
        if x * y < 0.0:
            f = x / (x - y)
            if _is_foot_inside(
                A,
                n,
                B[k, 0] + f * (B[m, 0] - B[k, 0]),
                B[k, 1] + f * (B[m, 1] - B[k, 1]),
                B[k, 2] + f * (B[m, 2] - B[k, 2]),
            ):
                return True
    return False


@jit_compile
def compute_triangle_distance(A: Array, na: Array, B: Array, nb: Array, most: float, work: Array) -> tuple[float, bool]:
    """Return the distance in m between two triangles; 0 where they cross.

    The least distance is that of two edges, or of a corner of one over the inside of the other. The planes of both
    bound it from below, which is sufficient for faces that are parallel over each other.

    Args:
        A: (3, 3) m, first triangle.
        na: (3,) its unit normal.
        B: (3, 3) m, second triangle.
        nb: (3,) its unit normal.
        most: m; where the planes show that the distance is not below it, their bound is returned.
        work: (7, 3) overwritten; its last row becomes the shortest vector from A to B where True is returned.

    Returns:
        The distance and True, or a lower bound and False.
    """
    bound = max(_compute_plane_separation(A, na, B), _compute_plane_separation(B, nb, A))
    if bound >= most - TIE_TOLERANCE:
        return bound, False
    if bound == 0.0 and (_is_edge_crossing(A, na, B) or _is_edge_crossing(B, nb, A)):
        work[6] = 0.0
        return 0.0, True
    best = _compute_corner_distance(B, nb, A, -1.0, _compute_corner_distance(A, na, B, 1.0, np.inf, work[6]), work[6])
    for k in range(3):
        for c in range(3):
            work[k, c] = A[(k + 1) % 3, c] - A[k, c]
            work[3 + k, c] = B[(k + 1) % 3, c] - B[k, c]
    for k in range(3):
        for m in range(3):
            best = _compute_segment_distance(A[k], work[k], B[m], work[3 + m], best, work[6])
    return float(np.sqrt(best)), True


@jit_compile
def compute_separation_along(A: Array, B: Array, u: Array) -> float:
    """Return a lower bound in m of the distance of triangle B from A, along a direction.

    Args:
        A: (3, 3) m, first triangle.
        B: (3, 3) m, second triangle.
        u: (3,) unit vector.
    """
    a_end, b_start = -np.inf, np.inf
    for k in range(3):
        a_end = max(a_end, A[k, 0] * u[0] + A[k, 1] * u[1] + A[k, 2] * u[2])
        b_start = min(b_start, B[k, 0] * u[0] + B[k, 1] * u[1] + B[k, 2] * u[2])
    return float(b_start - a_end)
