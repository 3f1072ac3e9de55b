"""Stock after a job compared with the finished part, on the cells of the height map.

Heights are compared cell by cell: material left where the stock is higher, a gouge where it is lower. Depths are read
in cells that neither a wall of the part nor one of the stock crosses; next to a wall, a shift of the wall by a part of
a cell would count as the whole height of the wall. Volumes count every cell.
"""

from __future__ import annotations

import numpy as np

from machopt.data_types.stock import StockBody, StockComparison
from machopt.numerics.array_types import Array, Bools
from machopt.process.stock.distance_field import DistanceField
from machopt.process.stock.field_comparison import compare_field_with_part
from machopt.process.stock.height_map import HeightMap
from machopt.process.stock.mesh_columns import compute_columns

NOTICED = 5e-6  # m; smaller differences are rounding of single precision


def compare_with_finished_part(stock: HeightMap | DistanceField, part: StockBody) -> StockComparison:
    """Return gouges and material left after a job.

    Args:
        stock: The stock after the job.
        part: The finished part, in the CAM frame.

    Raises:
        CuttingInputError: the part has more cells than memory allows.
    """
    if isinstance(stock, DistanceField):
        return compare_field_with_part(stock, part)
    corners = np.ascontiguousarray((part.vertices @ stock.rotation.T)[part.faces])
    nv, nu = stock.high.shape
    cell = np.array(stock.cell)
    top, bottom, share, _ = compute_columns(corners, np.array(stock.origin), cell, nu, nv)
    is_empty = share >= 1.0
    wanted = np.where(is_empty, stock.bottom, (1.0 - share) * top + share * np.maximum(bottom, stock.bottom))
    left = (1.0 - stock.share) * stock.high + stock.share * stock.low
    difference = np.asarray(left - wanted, float)
    plain = _find_plain_cells(wanted, stock.size) & _find_plain_cells(left, stock.size)
    area = float(cell.prod())
    u = stock.origin[0] + (np.arange(nu) + 0.5) * cell[0]
    v = stock.origin[1] + (np.arange(nv) + 0.5) * cell[1]
    gouge, gouge_at = _find_largest(np.where(plain, -difference, 0.0), left, (u, v), stock.rotation)
    rest, rest_at = _find_largest(np.where(plain, difference, 0.0), left, (u, v), stock.rotation)
    return StockComparison(
        gouge_depth=gouge,
        gouge_place=gouge_at,
        gouge_volume=area * float(-difference[difference < -NOTICED].sum()),
        left_depth=rest,
        left_place=rest_at,
        left_volume=area * float(difference[difference > NOTICED].sum()),
    )


def _find_plain_cells(height: Array, size: float) -> Bools:
    """Return the cells whose neighbours differ by less than a slope of 1: no wall crosses them."""
    plain = np.ones(height.shape, bool)
    for axis in (0, 1):
        steep = np.abs(np.diff(height, axis=axis)) > size
        before, after = [slice(None)] * 2, [slice(None)] * 2
        before[axis], after[axis] = slice(None, -1), slice(1, None)
        plain[tuple(before)] &= ~steep
        plain[tuple(after)] &= ~steep
    return plain


def _find_largest(
    depth: Array, height: Array, axes: tuple[Array, Array], rotation: Array
) -> tuple[float, tuple[float, float, float] | None]:
    """Return the largest depth, and its place in the CAM frame; 0 and None where there is none."""
    j, i = np.unravel_index(int(np.argmax(depth)), depth.shape)
    most = float(depth[j, i])
    if most <= NOTICED:
        return 0.0, None
    place = np.array([axes[0][i], axes[1][j], float(height[j, i])]) @ rotation
    return most, (float(place[0]), float(place[1]), float(place[2]))
