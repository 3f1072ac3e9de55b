"""Tree of boxes around a surface's triangles, with long triangles subdivided (compiled).

It is built once per body and traversed by :mod:`machopt.collision.mesh_distance` and
:mod:`machopt.collision.proximity_test`.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from machopt.collision.bodies import CollisionBody
from machopt.numerics.array_types import Array, Ints
from machopt.numerics.compiled_functions import jit_compile

LEAF_TRIANGLES = 2  # maximum number of triangles of a leaf
EDGE_LENGTH_SHARE = 0.1  # share of a body's size: triangles with longer edges are subdivided
MAX_TRIANGLES = 20_000  # maximum number of triangles after subdivision
DEGENERATE_AREA = 1e-24  # m⁴, squared double area below which a triangle is a line


@dataclass(frozen=True, kw_only=True)
class BoxTreeMesh:
    """A body's triangles and the boxes around them."""

    corners: Array  # (F, 3, 3) m, in base_link at q = 0
    normals: Array  # (F, 3) of unit length, zero where a triangle is a line
    low: Array  # (B, 3) m, of each box
    high: Array  # (B, 3)
    child: Ints  # (B,) the first of two boxes inside, −1 for none
    first: Ints  # (B,) its triangles in ``order``
    count: Ints  # (B,)
    order: Ints  # (F,)


def build_box_tree(body: CollisionBody) -> BoxTreeMesh:
    """Return the tree of a body's triangles, with long ones subdivided: a box around a long triangle is mostly empty.

    Args:
        body: collision body.
    """
    return build_box_tree_of_triangles(body.vertices, body.faces)


def build_box_tree_of_triangles(vertices: Array, faces: Ints) -> BoxTreeMesh:
    """Return the tree of some triangles.

    Args:
        vertices: (V, 3) m.
        faces: (F, 3) vertex indices.
    """
    corners = _subdivide_long_triangles(
        vertices[faces], EDGE_LENGTH_SHARE * float(np.linalg.norm(np.ptp(vertices, axis=0)))
    )
    normals = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
    size = np.linalg.norm(normals, axis=1, keepdims=True)
    return _build_tree(corners, np.where(size**2 > DEGENERATE_AREA, normals / np.maximum(size, 1e-300), 0.0))


def _subdivide_long_triangles(corners: Array, longest: float) -> Array:
    """Return the same surface with no edge above ``longest`` m, up to MAX_TRIANGLES: triangles (F, 3, 3) are halved
    repeatedly.
    """
    done, count = [corners[:0]], 0
    while len(corners):
        edges = np.linalg.norm(corners - np.roll(corners, -1, axis=1), axis=2)  # from each corner to the next
        long = edges.max(axis=1) > longest
        count += int(long.sum())
        if count > MAX_TRIANGLES:
            break
        done.append(corners[~long])
        first = edges[long].argmax(axis=1)
        a, b, c = (corners[long][np.arange(len(first)), (first + k) % 3] for k in range(3))
        middle = 0.5 * (a + b)
        corners = np.concatenate([np.stack([a, middle, c], axis=1), np.stack([middle, b, c], axis=1)])
    return np.ascontiguousarray(np.concatenate([*done, corners]))


@jit_compile
def _partition_by_median(value: Array, order: Ints, low: int, high: int, at: int) -> None:
    """Move the least of value[low … high] before place ``at``, and ``order`` with them (Hoare 1961, Find)."""
    while low < high:
        pivot, i, j = value[(low + high) // 2], low, high
        while i <= j:
            while value[i] < pivot:
                i += 1
            while pivot < value[j]:
                j -= 1
            if i <= j:
                value[i], value[j] = value[j], value[i]
                order[i], order[j] = order[j], order[i]
                i += 1
                j -= 1
        if j < at:
            low = i
        if at < i:
            high = j


def _build_tree(corners: Array, normals: Array) -> BoxTreeMesh:
    """Build the tree of boxes, divided at the median along the longest side down to LEAF_TRIANGLES."""
    most = max(2 * len(corners), 1)  # divided boxes contain at least two triangles
    low, high = np.empty((most, 3)), np.empty((most, 3))
    child, first, count = (np.empty(most, np.int64) for _ in range(3))
    order = np.arange(len(corners))
    box_count = _fill_tree(corners, low, high, child, first, count, order, np.empty(len(corners)))
    return BoxTreeMesh(
        corners=corners,
        normals=normals,
        low=low[:box_count],
        high=high[:box_count],
        child=child[:box_count],
        first=first[:box_count],
        count=count[:box_count],
        order=order,
    )


@jit_compile
def _fill_tree(
    corners: Array, low: Array, high: Array, child: Ints, first: Ints, count: Ints, order: Ints, middle: Array
) -> int:
    """Fill the arrays of the boxes, level by level, and sort ``order``; return the number of boxes."""
    first[0], count[0], box_count, k = 0, len(corners), 1, 0
    while k < box_count:
        a, n = first[k], count[k]
        for c in range(3):
            low[k, c], high[k, c] = np.inf, -np.inf
        for m in range(a, a + n):
            for corner in range(3):
                for c in range(3):
                    x = corners[order[m], corner, c]
                    low[k, c], high[k, c] = min(low[k, c], x), max(high[k, c], x)
        child[k] = -1
        if n > LEAF_TRIANGLES:
            side = 0
            for c in range(1, 3):
                if high[k, c] - low[k, c] > high[k, side] - low[k, side]:
                    side = c
            for m in range(a, a + n):
                of = order[m]
                middle[m] = corners[of, 0, side] + corners[of, 1, side] + corners[of, 2, side]
            child[k], half = box_count, n // 2
            _partition_by_median(middle, order, a, a + n - 1, a + half)
            first[box_count], count[box_count] = a, half
            first[box_count + 1], count[box_count + 1] = a + half, n - half
            box_count += 2
        k += 1
    return box_count
