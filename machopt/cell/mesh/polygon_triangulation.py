"""Triangulation of plane polygons: n − 2 triangles of n corners, all inside the polygon."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from machopt.numerics.array_types import Array

_TURN = 1e-9  # share of the area below which a corner is straight


def triangulate_polygons(points: Array, index: NDArray[np.int_], corners: NDArray[np.int_]) -> Array:
    """Return the triangles (n, 3, 3) of polygons.

    A polygon that its first corner sees wholly becomes a fan; any other one is divided by cutting ears.

    Args:
        points: (V, 3).
        index: corners of all polygons, one polygon after the other.
        corners: (P,) corners of each polygon.

    Source: G. H. Meisters, Polygons have ears, American Mathematical Monthly 82 (1975).
    """
    corners = corners.astype(int)
    begins = np.cumsum(corners) - corners
    fan, of, normal = _build_fans(points, index, corners)
    for polygon in _find_polygons_left_by_fan(fan, of, normal):
        own = points[index[begins[polygon] : begins[polygon] + corners[polygon]]]
        fan[of == polygon] = _cut_ears(own, normal[polygon])
    return fan


def _build_fans(
    points: Array, index: NDArray[np.int_], corners: NDArray[np.int_]
) -> tuple[Array, NDArray[np.int_], Array]:
    """Triangles (n, 3, 3), the polygon of each (n,), and twice the area vector of each polygon (P, 3)."""
    begins = np.cumsum(corners) - corners
    count = np.maximum(corners - 2, 0)
    of = np.repeat(np.arange(len(corners)), count)  # polygon of each triangle
    step = np.arange(len(of)) - np.repeat(np.cumsum(count) - count, count)
    first = begins[of]
    fan = (
        points[index[np.stack([first, first + step + 1, first + step + 2], axis=1)]] if len(of) else np.empty((0, 3, 3))
    )
    normal = np.zeros((len(corners), 3))
    np.add.at(normal, of, np.cross(fan[:, 1] - fan[:, 0], fan[:, 2] - fan[:, 0]))  # Newell's, of the whole polygon
    return fan, of, normal


def _find_polygons_left_by_fan(fan: Array, of: NDArray[np.int_], normal: Array) -> NDArray[np.int_]:
    area = np.cross(fan[:, 1] - fan[:, 0], fan[:, 2] - fan[:, 0])
    wrong = np.einsum("ij,ij->i", area, normal[of]) < -_TURN * (normal[of] ** 2).sum(axis=1)
    return np.unique(of[wrong])


def _cut_ears(polygon: Array, normal: Array) -> Array:
    """(n − 2, 3, 3) of a simple polygon (n, 3); a fan of what is left where no ear is found."""
    drop = int(np.argmax(np.abs(normal)))
    flat = np.delete(polygon, drop, axis=1)
    sign = np.sign(_compute_area(flat)) or 1.0
    left, out = list(range(len(polygon))), []
    while len(left) > 3:
        n = len(left)
        ear = next((k for k in range(n) if _is_ear(flat, left, k, sign)), 0)
        out.append((left[ear - 1], left[ear], left[(ear + 1) % n]))
        del left[ear]
    out.append((left[0], left[1], left[2]))
    return np.asarray(polygon[np.array(out)])


def _is_ear(flat: Array, left: list[int], k: int, sign: float) -> bool:
    a, b, c = (flat[left[m % len(left)]] for m in (k - 1, k, k + 1))
    if sign * _compute_cross(b - a, c - b) <= 0.0:
        return False
    others = [flat[m] for m in left if not any((flat[m] == p).all() for p in (a, b, c))]
    return not any(all(sign * _compute_cross(q - p, x - p) >= 0.0 for p, q in ((a, b), (b, c), (c, a))) for x in others)


def _compute_area(flat: Array) -> float:
    x, y = flat.T
    return float(np.dot(x, np.roll(y, -1)) - np.dot(y, np.roll(x, -1)))


def _compute_cross(a: Array, b: Array) -> float:
    return float(a[0] * b[1] - a[1] * b[0])
