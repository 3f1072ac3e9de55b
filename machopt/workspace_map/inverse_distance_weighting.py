"""Interpolation of measured stiffness over the workspace by inverse distance weighting.

The method has narrow limits, which are flagged or stated. Between measured points it returns a weighted mean
of them (never more than the largest, never less than the least). Beyond them it has no information. It knows the
place but not the posture, so readings in different postures are averaged as if they were one arm.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from machopt.numerics.array_types import Array

FLATNESS_TOLERANCE = (
    1e-6  # of the extent: measured points this near to a plane (a line) span that plane (line), no volume
)
SAME_POINT_M = 1e-9  # m; a query this near to a measured point has its value
_PAIRS_AT_ONCE = 2_000_000


@dataclass(frozen=True)
class InterpolatedValues:
    """Values at Q places with their reliability."""

    value: Array  # (Q, F) in the units of the data
    inside: NDArray[np.bool_]  # (Q,) False: extrapolated outside the convex hull of the points
    nearest: Array  # (Q,) m to the nearest measured point


def interpolate_idw(
    points: Array, values: Array, query: Array, power: float = 2.0, neighbours: int | None = None
) -> InterpolatedValues:
    """Return inverse distance weighted values, v(x) = Σ w_i v_i / Σ w_i with w_i = |x − x_i|^(−p).

    Exact at the points; several readings at one point count as their mean there.

    Args:
        points: (P, 3) m.
        values: (P, F), each column interpolated by itself.
        query: (Q, 3) m.
        power: p > 0; a larger one increases the weight of the nearest points.
        neighbours: number of nearest points that count; None: all.

    Returns:
        Values, with places outside the convex hull flagged. Points on a plane (or line) have a flat hull: only
        places on that plane (line) are inside.

    Source: tian2025 section 4.5 (which states neither power nor neighbours).
    """
    points, values, query = np.asarray(points, float), np.asarray(values, float), np.asarray(query, float)
    count = len(points) if neighbours is None else min(neighbours, len(points))
    out, nearest = np.empty((len(query), values.shape[1])), np.empty(len(query))
    rows = max(_PAIRS_AT_ONCE // len(points), 1)
    for a in range(0, len(query), rows):
        part = slice(a, a + rows)
        distance = np.linalg.norm(query[part, None] - points, axis=-1)
        nearest[part] = distance.min(axis=1)
        use = distance
        if count < len(points):
            limit = np.partition(distance, count - 1, axis=1)[:, count - 1 : count]
            use = np.where(distance <= limit, distance, np.inf)
        at = distance <= SAME_POINT_M
        scale = np.maximum(nearest[part], SAME_POINT_M)[:, None]  # ratios of distances: no overflow near a point
        weight = np.where(at.any(axis=1)[:, None], at, (scale / np.maximum(use, SAME_POINT_M)) ** power)
        out[part] = weight @ values / weight.sum(axis=1, keepdims=True)
    return InterpolatedValues(out, is_inside_hull(points, query), nearest)


def predict_leave_one_out(points: Array, values: Array, power: float = 2.0, neighbours: int | None = None) -> Array:
    """Return each reading as predicted from the others, (P, F), a measure of the accuracy between points. P ≥ 2.

    Args:
        points: (P, 3) m.
        values: (P, F).
        power: p > 0.
        neighbours: number of nearest points that count; None: all.
    """
    out = np.empty(values.shape)
    for i in range(len(points)):
        others = np.arange(len(points)) != i
        out[i] = interpolate_idw(points[others], values[others], points[i : i + 1], power, neighbours).value[0]
    return out


def is_inside_hull(points: Array, query: Array) -> NDArray[np.bool_]:
    """Return (Q,) which of the places lie in the convex hull of the points, border included.

    Args:
        points: (P, 3) m.
        query: (Q, 3) m.
    """
    from scipy.spatial import Delaunay

    middle = points.mean(axis=0)
    _, s, axes = np.linalg.svd(points - middle, full_matrices=False)
    extent = float(s[0])
    rank = int((s > FLATNESS_TOLERANCE * extent).sum()) if extent > 0 else 0
    local, tolerance = (query - middle) @ axes.T, max(FLATNESS_TOLERANCE * extent, SAME_POINT_M)
    spanned = (points - middle) @ axes[:rank].T
    off = np.linalg.norm(query - middle - local[:, :rank] @ axes[:rank], axis=1)
    if rank == 0:
        return np.asarray(off <= tolerance)
    if rank == 1:
        along = local[:, 0]
        low, high = spanned[:, 0].min() - tolerance, spanned[:, 0].max() + tolerance
        return np.asarray((off <= tolerance) & (along >= low) & (along <= high))
    inside = Delaunay(spanned).find_simplex(local[:, :rank], tol=1e-9) >= 0
    return np.asarray((off <= tolerance) & inside)
