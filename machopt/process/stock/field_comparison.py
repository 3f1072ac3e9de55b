"""Stock of signed distances after a job compared with the finished part.

Depths are read at places on the surface of the part, along its normal: into the part up to the first material for a
gouge, out of it up to the first air for material left. Places near an edge of the part are left out, because a field
rounds edges within a cell. Volumes count every cell.
"""

from __future__ import annotations

import numpy as np
from scipy.spatial import cKDTree

from machopt.data_types.stock import StockBody, StockComparison
from machopt.numerics.array_types import Array
from machopt.process.stock.distance_field import DistanceField, build_field_on_grid
from machopt.process.stock.field_differences import compare_volumes, measure_depths
from machopt.process.stock.field_types import BLOCK

NOTICED = 0.04  # of a cell; smaller depths are rounding
SPACING = 2.0  # cells between places on the surface
MOST_PLACES = 200_000
SHARP = np.cos(np.radians(15.0))  # of the angle between the normals of two triangles at an edge
CLEAR = 2.5  # cells from an edge


def compare_field_with_part(stock: DistanceField, part: StockBody) -> StockComparison:
    """Return gouges and material left after a job.

    Args:
        stock: The stock after the job.
        part: The finished part, in the CAM frame.

    Raises:
        CuttingInputError: the surface of the part has more cells than memory allows.
    """
    wanted = build_field_on_grid(part, stock)
    gouged, left = compare_volumes(stock.arrays, wanted.arrays)
    place, normal = _list_places(part, stock)
    frame = (stock.origin, stock.cell)
    depth = measure_depths(stock.arrays, frame, stock.convert_vectors(place), stock.convert_vectors(normal))
    gouge, gouge_at = _find_largest(depth, place, stock.cell)
    rest, rest_at = _find_largest(-depth, place, stock.cell)
    return StockComparison(
        gouge_depth=gouge,
        gouge_place=gouge_at,
        gouge_volume=gouged * stock.cell**3,
        left_depth=rest,
        left_place=rest_at,
        left_volume=left * stock.cell**3,
    )


def _find_largest(depth: Array, place: Array, cell: float) -> tuple[float, tuple[float, float, float] | None]:
    """Return the largest depth, and its place in the CAM frame; 0 and None where there is none."""
    n = int(np.argmax(depth)) if len(depth) else -1
    if n < 0 or depth[n] <= NOTICED * cell:
        return 0.0, None
    x, y, z = place[n].tolist()
    return float(depth[n]), (x, y, z)


def _list_places(part: StockBody, stock: DistanceField) -> tuple[Array, Array]:
    """Return (N, 3) places on the part within the box of the stock and away from edges, and the normals there."""
    corners = part.vertices[part.faces]
    across = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
    size = np.linalg.norm(across, axis=1)
    has_area = size > 0.0
    corners, normal, area = corners[has_area], across[has_area] / size[has_area, None], 0.5 * size[has_area]
    spacing = max(SPACING * stock.cell, float(np.sqrt(area.sum() / MOST_PLACES)))
    count = np.ceil(area / spacing**2).astype(int)
    face = np.repeat(np.arange(len(area)), count)
    rank = np.arange(len(face)) - np.repeat(np.cumsum(count) - count, count)
    # an even spread of points over a triangle: the R2 sequence (Roberts 2018), folded at the diagonal
    u, v = np.mod(0.5 + 0.7548776662466927 * (rank + 1), 1.0), np.mod(0.5 + 0.5698402909980532 * (rank + 1), 1.0)
    fold = u + v > 1.0
    u, v = np.where(fold, 1.0 - u, u), np.where(fold, 1.0 - v, v)
    a, b, c = corners[face].transpose(1, 0, 2)
    place = a + u[:, None] * (b - a) + v[:, None] * (c - a)
    low = stock.origin + 1.5 * stock.cell
    high = stock.origin + BLOCK * np.array(stock.arrays[0].shape) * stock.cell - 1.5 * stock.cell
    inside = stock.convert_vectors(place)
    keep = np.asarray(((inside > low) & (inside < high)).all(axis=1))
    edges = _list_edge_places(part, across / np.where(has_area, size, 1.0)[:, None], stock.cell)
    if len(edges) and keep.any():
        near = cKDTree(edges).query(place[keep], distance_upper_bound=CLEAR * stock.cell)[0]
        keep[np.flatnonzero(keep)[np.isfinite(near)]] = False
    return place[keep], normal[face[keep]]


def _list_edge_places(part: StockBody, normal: Array, cell: float) -> Array:
    """Return (N, 3) places along the sharp edges of a mesh, one cell apart or a little more where there are many."""
    pairs = np.sort(part.faces[:, [[0, 1], [1, 2], [2, 0]]].reshape(-1, 2), axis=1)
    owner = np.repeat(np.arange(len(part.faces)), 3)
    order = np.lexsort((pairs[:, 1], pairs[:, 0]))
    same = (pairs[order][1:] == pairs[order][:-1]).all(axis=1)
    first, second = order[:-1][same], order[1:][same]
    sharp = first[np.sum(normal[owner[first]] * normal[owner[second]], axis=1) < SHARP]
    if not len(sharp):
        return np.zeros((0, 3))
    a, b = part.vertices[pairs[sharp, 0]], part.vertices[pairs[sharp, 1]]
    length = np.linalg.norm(b - a, axis=1)
    count = np.maximum(np.ceil(length / max(cell, float(length.sum()) / MOST_PLACES)), 1).astype(int) + 1
    which = np.repeat(np.arange(len(a)), count)
    share = (np.arange(len(which)) - np.repeat(np.cumsum(count) - count, count)) / np.repeat(count - 1, count)
    return np.asarray(a[which] + share[:, None] * (b - a)[which])
