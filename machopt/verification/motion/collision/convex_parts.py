"""Convex parts of a body in a tree of boxes, for :mod:`machopt.verification.motion.collision.distance_bounds`.

A part is the hull of some points, grown by a disc across z and by a ball: a closed convex shell of a mesh or else
each of its triangles, a box, a cylinder (its axis and a disc), a capsule (its axis and a ball), a sphere. Parts are
sorted along a space-filling curve (Morton 1966). Two neighbours share a box, and two boxes the next larger one.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np

from machopt.numerics.array_types import Array, Ints

MAX_SHELL_CORNERS = 256  # corners above which a shell is not tried for convexity
PLANE_TOLERANCE_M = 1e-10  # m, by which corners of a convex shell may lie before one of its planes
MORTON_CELLS = 1024  # cells of the curve along each side


@dataclass(frozen=True, kw_only=True)
class ConvexParts:
    """P convex parts in the body's own frame, and boxes around them: box k holds boxes 2 k and 2 k + 1."""

    points: Array  # (V, 3) m, part after part
    first: Ints  # (P + 1,) where the points of each part begin
    disc: Array  # (P,) m, radius of the disc across z
    ball: Array  # (P,) m, radius of the ball
    box_centres: (
        Array  # (2 B, 3) m of the boxes, B the power of two from P on; box 1 holds all, the last B one part each
    )
    half_size: Array  # (2 B, 3) m, negative for a box that holds nothing


def build_convex_parts(shape: Any) -> ConvexParts | None:
    """Return the convex parts of a coal geometry; None for an unknown type.

    Args:
        shape: The coal geometry.
    """
    kind = type(shape).__name__
    if kind == "Box":
        signs = np.array([[x, y, z] for x in (-1, 1) for y in (-1, 1) for z in (-1, 1)], float)
        return _build_box_tree(signs * np.asarray(shape.halfSide), [8], 0.0, 0.0)
    if kind == "Sphere":
        return _build_box_tree(np.zeros((1, 3)), [1], 0.0, shape.radius)
    if kind in ("Cylinder", "Capsule"):
        ends = np.array([[0.0, 0.0, -shape.halfLength], [0.0, 0.0, shape.halfLength]])
        return _build_box_tree(ends, [2], *((shape.radius, 0.0) if kind == "Cylinder" else (0.0, shape.radius)))
    if kind.startswith("BVH"):
        count = int(shape.num_tris)  # one after another: as a list of objects they would take more than the mesh
        stated = (t[k] for t in map(shape.tri_indices, range(count)) for k in (0, 1, 2))
        corner = np.fromiter(stated, np.int64, 3 * count).reshape(-1, 3)
        return _build_box_tree(
            *split_convex_shells(np.asarray(shape.vertices(), float).reshape(-1, 3), corner), 0.0, 0.0
        )
    return None


def split_convex_shells(vertices: Array, corner: Ints) -> tuple[Array, list[int]]:
    """Convex parts of a mesh: its closed convex shells, and every other triangle by itself.

    Args:
        vertices: (V, 3) m.
        corner: (F, 3) of each triangle.

    Returns:
        Their points, part after part, and how many each has.
    """
    from scipy.sparse import coo_array
    from scipy.sparse.csgraph import connected_components

    if not len(corner):
        return np.empty((0, 3)), []
    places, same = np.unique(vertices, axis=0, return_inverse=True)  # a file may repeat its corners for each face
    faces = same.reshape(-1)[corner]
    ends = faces[:, [0, 1, 1, 2, 2, 0]].reshape(-1, 2)
    links = coo_array((np.ones(len(ends)), (ends[:, 0], ends[:, 1])), shape=(len(places), len(places)))
    of = connected_components(links, directed=False)[1][faces[:, 0]]
    order = np.argsort(of, kind="stable")
    hulls: list[Array] = []
    single = np.ones(len(faces), bool)
    for shell in np.split(order, 1 + np.flatnonzero(np.diff(of[order]))):
        points = np.unique(faces[shell])
        if len(points) <= MAX_SHELL_CORNERS and _is_convex(places, faces[shell], points):
            hulls.append(places[points])
            single[shell] = False
    hulls.append(places[faces[single]].reshape(-1, 3))
    return np.concatenate(hulls), [len(p) for p in hulls[:-1]] + [3] * int(single.sum())


def _is_convex(places: Array, faces: Ints, points: Ints) -> bool:
    """Every edge lies between two triangles, and no corner before any of their planes."""
    ends = np.sort(faces[:, [0, 1, 1, 2, 2, 0]].reshape(-1, 2), axis=1)
    if (np.unique(ends, axis=0, return_counts=True)[1] != 2).any():
        return False
    a, b, c = (places[faces[:, k]] for k in range(3))
    normal = np.cross(b - a, c - a)
    size = np.linalg.norm(normal, axis=1)
    real = size > 0.0
    normal = normal[real] / size[real, None]
    height = places[points] @ normal.T - np.einsum("ij,ij->i", a[real], normal)
    return bool(len(normal) and (np.minimum(height.max(axis=0), -height.min(axis=0)) <= PLANE_TOLERANCE_M).all())


def _build_box_tree(points: Array, sizes: list[int], disc: float, ball: float) -> ConvexParts | None:
    count = len(sizes)
    if not count:
        return None
    begin, grown = np.cumsum([0, *sizes]), np.array([disc, disc, 0.0]) + ball
    low, high = (edge.reduceat(points, begin[:-1], axis=0) for edge in (np.minimum, np.maximum))
    order = np.argsort(_compute_morton_order((low + high) / 2.0), kind="stable")
    wide = 1 << max(count - 1, 0).bit_length()
    least, most = np.full((2 * wide, 3), np.inf), np.full((2 * wide, 3), -np.inf)
    least[wide : wide + count], most[wide : wide + count] = low[order] - grown, high[order] + grown
    level = wide
    while level > 1:
        a, b = slice(level, 2 * level, 2), slice(level + 1, 2 * level, 2)
        least[level // 2 : level] = np.minimum(least[a], least[b])
        most[level // 2 : level] = np.maximum(most[a], most[b])
        level //= 2
    full = np.isfinite(least)
    size = np.diff(begin)[order]
    first = np.append(0, np.cumsum(size))
    place = np.repeat(begin[order] - first[:-1], size) + np.arange(len(points))
    return ConvexParts(
        points=np.ascontiguousarray(points[place]),
        first=first,
        disc=np.full(count, disc),
        ball=np.full(count, ball),
        box_centres=np.where(full, (np.where(full, least, 0.0) + np.where(full, most, 0.0)) / 2.0, 0.0),
        half_size=np.where(full, (np.where(full, most, 0.0) - np.where(full, least, 0.0)) / 2.0, -1.0),
    )


def _compute_morton_order(middle: Array) -> Ints:
    """(P,) place along Morton's curve: the bits of the three coordinates in turn."""
    low = middle.min(axis=0)
    size = max(float((middle.max(axis=0) - low).max()), 1e-12)
    cell = np.minimum((middle - low) / size * MORTON_CELLS, MORTON_CELLS - 1).astype(np.int64)
    out = np.zeros(len(middle), np.int64)
    for bit in range(MORTON_CELLS.bit_length() - 1):
        for c in range(3):
            out |= ((cell[:, c] >> bit) & 1) << (3 * bit + c)
    return out
