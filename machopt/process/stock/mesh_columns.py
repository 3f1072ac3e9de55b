"""Top, bottom and thickness of a closed mesh over the cells of a grid, by samples within each cell."""

from __future__ import annotations

import numpy as np

from machopt.numerics.array_types import Array
from machopt.numerics.compiled_functions import jit_compile
from machopt.process.stock.kernel_types import Heights

SAMPLES = 4  # along each side of a cell
STRIP = 32  # rows of cells at a time
_FAR = 1e30

Columns = tuple[Heights, Heights, Heights, float]


def compute_columns(corners: Array, origin: Array, cell: Array, nu: int, nv: int) -> Columns:
    """Return the columns of a mesh over a grid.

    Args:
        corners: (F, 3, 3) m, corners of the triangles as u, v, w.
        origin: (2,) m, corner of cell (0, 0).
        cell: (2,) m, size of a cell.
        nu: Cells along u.
        nv: Cells along v.

    Returns:
        top (nv, nu) m, bottom (nv, nu) m (both 0 where the column is empty), share (nv, nu) of a cell without
        material, and the sum over cells of the thickness of material, m.
    """
    order = np.argsort(corners[:, :, 1].min(axis=1))
    top = np.zeros((nv, nu), np.float32)
    bottom, share = np.zeros_like(top), np.ones_like(top)
    thickness = _fill_columns(np.ascontiguousarray(corners[order]), origin, cell, top, bottom, share)
    return top, bottom, share, float(thickness)


@jit_compile
def _fill_columns(corners: Array, origin: Array, cell: Array, top: Heights, bottom: Heights, share: Heights) -> float:
    """Fill the columns strip after strip; returns the sum of the thickness of all cells."""
    nv, nu = top.shape
    du, dv = cell[0] / SAMPLES, cell[1] / SAMPLES
    total = 0.0
    upper = np.empty((STRIP * SAMPLES, nu * SAMPLES), np.float32)
    lower = np.empty_like(upper)
    signed = np.empty_like(upper)
    for first in range(0, nv, STRIP):
        rows = min(STRIP, nv - first)
        upper[:] = -_FAR
        lower[:] = _FAR
        signed[:] = 0.0
        v0 = origin[1] + first * cell[1]
        for n in range(len(corners)):
            _add_triangle(corners[n], origin[0], v0, du, dv, rows * SAMPLES, upper, lower, signed)
        for j in range(rows):
            for i in range(nu):
                high, deep, count = -_FAR, _FAR, 0
                mean = 0.0
                for b in range(j * SAMPLES, (j + 1) * SAMPLES):
                    for a in range(i * SAMPLES, (i + 1) * SAMPLES):
                        if upper[b, a] > lower[b, a]:
                            count += 1
                            mean += upper[b, a]
                            deep = min(deep, lower[b, a])
                            total += signed[b, a] / (SAMPLES * SAMPLES)
                if count:
                    high = mean / count
                    top[first + j, i] = high
                    bottom[first + j, i] = deep
                    share[first + j, i] = 1.0 - count / (SAMPLES * SAMPLES)
    return total


@jit_compile
def _add_triangle(
    corner: Array,
    u0: float,
    v0: float,
    du: float,
    dv: float,
    rows: int,
    upper: Heights,
    lower: Heights,
    signed: Heights,
) -> None:
    """Add one triangle to the samples of a strip: each sample point lies in one of the triangles that share an edge."""
    a, b, c = corner[0], corner[1], corner[2]
    area = (b[0] - a[0]) * (c[1] - a[1]) - (c[0] - a[0]) * (b[1] - a[1])
    if area == 0.0:
        return
    least, most = min(a[1], b[1], c[1]), max(a[1], b[1], c[1])
    j0 = max(int(np.ceil((least - v0) / dv - 0.5)), 0)
    j1 = min(int(np.ceil((most - v0) / dv - 0.5)), rows)
    gu = ((b[2] - a[2]) * (c[1] - a[1]) - (c[2] - a[2]) * (b[1] - a[1])) / area
    gv = ((b[0] - a[0]) * (c[2] - a[2]) - (c[0] - a[0]) * (b[2] - a[2])) / area
    sign = 1.0 if area > 0.0 else -1.0
    for j in range(j0, j1):
        v = v0 + (j + 0.5) * dv
        left, right = _FAR, -_FAR
        for k in range(3):
            p, q = corner[k], corner[(k + 1) % 3]
            if p[1] > q[1]:
                p, q = q, p
            if p[1] <= v < q[1]:
                u = p[0] + (v - p[1]) / (q[1] - p[1]) * (q[0] - p[0])
                left, right = min(left, u), max(right, u)
        if right < left:
            continue
        i0 = max(int(np.ceil((left - u0) / du - 0.5)), 0)
        i1 = min(int(np.ceil((right - u0) / du - 0.5)), upper.shape[1])
        for i in range(i0, i1):
            w = a[2] + gu * (u0 + (i + 0.5) * du - a[0]) + gv * (v - a[1])
            upper[j, i] = max(upper[j, i], w)
            lower[j, i] = min(lower[j, i], w)
            signed[j, i] += sign * w
