"""Triangle meshes of common cell geometry: binary STL, boxes and cylinders, without importing trimesh.

The import takes 0.14 s, a tenth of a short command's start. Vertices and triangles are in trimesh's
own order, bit by bit: a test compares them.
"""

from __future__ import annotations

import struct
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from machopt.numerics.array_types import Array

SAME = 1e8  # per unit of the file: resolution at which equal vertices are merged
MIXED = np.array([0x1F3D5B79A8C6E4B1, 0x2545F4914F6CDD1D, 0x369DEA0F31A53F85])  # odd, and of no simple ratio
HEAD = 84  # bytes before the triangles of binary STL
FACET = np.dtype([("normal", "<f4", 3), ("corners", "<f4", (3, 3)), ("attribute", "<u2")])
BOX = [[1, 3, 0], [4, 1, 0], [0, 3, 2], [2, 4, 0], [1, 7, 3], [5, 1, 4], [5, 7, 1], [3, 7, 2], [6, 4, 2], [2, 7, 6]]
BOX += [[6, 5, 4], [7, 5, 6]]  # of vertices counted in binary, x first


class TriangleMesh(NamedTuple):
    """Triangle mesh of a surface."""

    vertices: Array  # (V, 3)
    faces: NDArray[np.int64]  # (F, 3)


def parse_binary_stl(data: bytes) -> TriangleMesh | None:
    """Return the triangles of a binary STL, without shared vertices; None for other data or a wrong length.

    Args:
        data: content of the file.
    """
    if len(data) <= HEAD or len(data) != HEAD + FACET.itemsize * struct.unpack_from("<I", data, HEAD - 4)[0]:
        return None
    corners = np.frombuffer(data, FACET, offset=HEAD)["corners"]
    return TriangleMesh(corners.reshape(-1, 3).astype(float), np.arange(3 * len(corners)).reshape(-1, 3))


def merge_equal_vertices(surface: TriangleMesh) -> TriangleMesh:
    """Return the mesh with equal vertices merged, in the order of their first occurrence.

    Triangles with a vertex that is not finite, and vertices of no triangle, are left out.

    Args:
        surface: triangle mesh.
    """
    vertices, faces = surface
    finite = np.asarray(np.isfinite(vertices).all(axis=1))
    faces = faces[finite[faces].all(axis=1)]
    used = find_used_vertices(faces, len(vertices))
    level = np.round(vertices[used] * SAME).astype(np.int64)
    order, begins = _group_equal_rows(level)
    starts = np.flatnonzero(begins)
    firsts = np.minimum.reduceat(order, starts) if len(starts) else starts  # of each group of equal corners
    is_first = np.zeros(len(used), bool)
    is_first[firsts] = True
    rank = np.cumsum(is_first) - 1
    new = np.zeros(len(vertices), np.int64)
    new[used[order]] = rank[firsts][np.cumsum(begins) - 1]
    return TriangleMesh(vertices[used[is_first]], new[faces])


def find_used_vertices(faces: NDArray[np.int64], vertices: int) -> NDArray[np.intp]:
    """Return the vertices that triangles use, ascending; a hundredth of the time of ``np.unique``.

    Args:
        faces: (F, 3) vertex indices.
        vertices: number of vertices.
    """
    return np.flatnonzero(np.bincount(faces.ravel(), minlength=vertices))


def _group_equal_rows(level: NDArray[np.int64]) -> tuple[NDArray[np.intp], NDArray[np.bool_]]:
    """Return an order (n,) of rows (n, 3) that groups equal ones, and where a group begins in it.

    Sorted by one hash per row, whose overflow is harmless; if two different rows ever share it, by the rows.
    """
    key = level @ MIXED
    order = np.argsort(key)
    other = (np.diff(level[order], axis=0) != 0).any(axis=1)
    if not np.array_equal(other, np.diff(key[order]) != 0):
        order = np.lexsort(level.T)
        other = (np.diff(level[order], axis=0) != 0).any(axis=1)
    return order, np.append(np.ones(min(len(order), 1), bool), other)


def build_box(size: Array | tuple[float, ...]) -> TriangleMesh:
    """Return a box centred at the origin.

    Args:
        size: (3,) lengths of its sides.
    """
    corners = np.array([[k >> 2, k >> 1 & 1, k & 1] for k in range(8)], float) - 0.5
    return TriangleMesh(corners * np.asarray(size, float), np.array(BOX, np.int64))


def build_cylinder(radius: float, height: float, sides: int) -> TriangleMesh:
    """Return a prism about z centred at the origin, with its vertices on the radius.

    Args:
        radius: radius of the vertices.
        height: length along z.
        sides: number of sides.
    """
    angle = np.linspace(0.0, 2.0 * np.pi, sides + 1)[:-1]
    r, z = np.array([0.0, radius, radius, 0.0]), np.array([-1.0, -1.0, 1.0, 1.0]) * abs(height) / 2.0
    x, y = np.cos(angle)[:, None] * r, np.sin(angle)[:, None] * r
    vertices = np.stack([x, y, np.broadcast_to(z, x.shape)], axis=-1).reshape(-1, 3)
    slice_ = np.array([[1, 4, 5], [1, 5, 2], [2, 5, 6], [2, 6, 3]])
    faces = (slice_ + 4 * np.arange(sides)[:, None, None]).reshape(-1, 3) % (4 * sides)
    return merge_equal_vertices(TriangleMesh(vertices, faces))
