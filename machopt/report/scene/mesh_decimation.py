"""Mesh decimation by vertex clustering: vertices in a cell of a cubic grid become one (Rossignac & Borrel 1993).

It is fast and accepts open, doubled and badly joined meshes. No corner moves farther than the diagonal of a cell.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from machopt.numerics.array_types import Array

Faces = NDArray[np.int64]
FIRST_CELL_FACTOR = 2.2  # cells across a triangle of the size that is wanted, at the first try
COARSENING_FACTOR = 1.25  # by which the cells grow where that left too many
MAX_ATTEMPTS = 12


def decimate_mesh(vertices: Array, faces: Faces, most: int) -> tuple[Array, Faces]:
    """A surface of at most ``most`` triangles, as far as twelve coarser grids get there.

    Args:
        vertices: (V, 3) m.
        faces: (F, 3) rows of ``vertices``.
        most: triangles wanted; a surface that has no more is returned as it is.

    Returns:
        vertices (V', 3) m: means of those that fell together, and faces (F', 3).
    """
    if len(faces) <= most or len(faces) == 0:
        return vertices, faces
    corners = vertices[faces]
    across = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
    area = 0.5 * float(np.linalg.norm(across, axis=1).sum())
    size = float(np.sqrt(area / most)) * FIRST_CELL_FACTOR / 2.0 or 1.0
    low = vertices.min(axis=0)
    for _ in range(MAX_ATTEMPTS):
        merged, found = _cluster_vertices(vertices, faces, low, size)
        if len(found) <= most:
            break
        size *= COARSENING_FACTOR
    return merged, found


def _cluster_vertices(vertices: Array, faces: Faces, low: Array, size: float) -> tuple[Array, Faces]:
    cell = np.floor((vertices - low) / size + 0.5).astype(np.int64)
    span = cell.max(axis=0) + 1
    key = (cell[:, 0] * span[1] + cell[:, 1]) * span[2] + cell[:, 2]
    _, which = np.unique(key, return_inverse=True)
    count = np.bincount(which)
    mean = np.column_stack([np.bincount(which, vertices[:, c]) for c in range(3)]) / count[:, None]
    new = which[faces]
    new = new[(new[:, 0] != new[:, 1]) & (new[:, 1] != new[:, 2]) & (new[:, 2] != new[:, 0])]
    if not len(new):
        return mean, new
    n = len(mean)
    rolled = np.take_along_axis(
        new, (new.argmin(axis=1)[:, None] + np.arange(3)) % 3, axis=1
    )  # same triangle, same row
    _, first = np.unique((rolled[:, 0] * n + rolled[:, 1]) * n + rolled[:, 2], return_index=True)
    new_vertices = new[np.sort(first)]
    used, inverse = np.unique(new_vertices, return_inverse=True)
    return mean[used], inverse.reshape(new_vertices.shape)
