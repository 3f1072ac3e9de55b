"""Stock as signed distances on a grid, for tool axes that turn against the stock.

The grid has cubic cells and is rotated by a degree or two against the CAM frame: along its own axes a flat surface or
an edge would keep one place in its cells, and one error of the volume, over its whole length. A value is the signed
distance of the cell's centre from the surface, negative in the material, limited to ``LIMIT`` cells. Only blocks of
cells that the surface crosses are stored: memory grows with the surface and not with the volume. A cutter that covers
part of a cell changes its distance, so that boundaries and volumes are better than the cell size.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from machopt.data_types.stock import StockBody
from machopt.errors import CuttingInputError
from machopt.numerics.array_types import Array
from machopt.process.stock.field_mesh import fill_blocks
from machopt.process.stock.field_types import BLOCK, CELLS, EDGE, KNOTS, SOLID, WIDE, FieldArrays

MOST_BLOCKS = 420_000  # stored, 1 KiB each: 430 MB, and as much for the finished part
MOST_TABLE = 40_000_000  # blocks of the box around the stock, 4 bytes each
MOST_STRIP = 20_000_000  # cells of one row of blocks, 10 bytes each, while the mesh is read
LEAST_CELLS = 8  # along the shortest side of the stock
MARGIN = 2  # cells of air around the stock
GRID_ROTATION = (
    0.021,
    0.027,
    0.033,
)  # rad about the CAM axes: an edge of 15 mm passes through one cell of 0.25 mm and more


def _build_grid_axes() -> Array:
    """Return (3, 3) the axes of the grid as rows, CAM frame."""
    x, y, z = GRID_ROTATION
    first = np.array([1.0, -z, y]) / np.linalg.norm([1.0, -z, y])
    third = np.array([-y, x, 1.0]) - np.array([-y, x, 1.0]) @ first * first
    third /= np.linalg.norm(third)
    return np.array([first, np.cross(third, first), third], float)


GRID_AXES = _build_grid_axes()


@dataclass(frozen=True, kw_only=True, eq=False)
class DistanceField:
    """Stock on a grid of cubic cells. Its arrays change while moves remove material."""

    origin: Array  # (3,) m, corner of cell (0, 0, 0), along the axes of the grid
    cell: float  # m
    arrays: FieldArrays

    def convert_vectors(self, vector: Array) -> Array:
        """Return (N, 3) points or directions along the axes of the grid.

        Args:
            vector: (N, 3), CAM frame.
        """
        return np.ascontiguousarray(vector @ GRID_AXES.T)

    @property
    def size(self) -> float:
        """Side of a cell, m."""
        return self.cell

    @property
    def gap_volume(self) -> float:
        """Volume of gaps that count as filled, m³: none."""
        return 0.0

    @property
    def volume(self) -> float:
        """Volume of the material, m³."""
        table, pool = self.arrays[0], self.arrays[1]
        stored = table[table >= 0]
        parts = [pool[stored[n : n + 4096]] for n in range(0, len(stored), 4096)]
        cells = sum(float(compute_cover(part).sum()) for part in parts) + float((table == SOLID).sum()) * CELLS
        return cells * self.cell**3


def compute_cover(value: NDArray[np.int16]) -> Array:
    """Return the share of material of cells, 0 … 1, from their stored distances.

    Args:
        value: Stored distances.
    """
    t = np.abs(np.asarray(value, float)) / EDGE
    out: Array = (np.maximum(KNOTS[0] - t, 0.0) ** 2 - np.maximum(KNOTS[1] - t, 0.0) ** 2) / (2.0 * WIDE)
    return np.asarray(np.where(value > 0, out, 1.0 - out))


def build_distance_field(body: StockBody) -> DistanceField:
    """Return the stock before the first move.

    Args:
        body: The stock, a closed mesh in the CAM frame.

    Raises:
        CuttingInputError: the number of cells is too large or too small.
    """
    vertices = body.vertices @ GRID_AXES.T
    least, most = vertices.min(axis=0), vertices.max(axis=0)
    h = body.cell_size
    extent = body.vertices.max(axis=0) - body.vertices.min(axis=0)
    _check_size(most - least, h, _describe_extent(extent, h))
    _check_resolution(extent, h)
    blocks = np.ceil(((most - least) / h + 2 * MARGIN) / BLOCK - 1e-9).astype(int)
    return _fill_field(body, least - MARGIN * h, h, tuple(blocks.tolist()))


def build_field_on_grid(body: StockBody, grid: DistanceField) -> DistanceField:
    """Return another body on the grid of a stock; what lies outside is left out.

    Args:
        body: A closed mesh in the CAM frame.
        grid: The stock.

    Raises:
        CuttingInputError: the number of cells is too large.
    """
    return _fill_field(body, grid.origin, grid.cell, grid.arrays[0].shape)


def _fill_field(body: StockBody, origin: Array, cell: float, blocks: tuple[int, ...]) -> DistanceField:
    table = np.empty(blocks, np.int32)
    room = int(min(table.size, MOST_BLOCKS))
    pool = np.empty((room, CELLS), np.int16)  # the system provides memory when a block is written
    arrays = (table, pool, np.empty(room, np.int32), np.zeros(3, np.int64))
    corners = np.ascontiguousarray((body.vertices @ GRID_AXES.T)[body.faces] - origin) / cell
    order = np.argsort(corners[:, :, 1].min(axis=1))
    needed = fill_blocks(np.ascontiguousarray(corners[order]), arrays)
    if needed > room:
        raise build_memory_error(cell, needed / room)
    return DistanceField(origin=origin, cell=cell, arrays=arrays)


def build_memory_error(cell: float, ratio: float) -> CuttingInputError:
    """Return the error that the surface of the stock has too many cells.

    Args:
        cell: m, cell size.
        ratio: Needed blocks over those that memory allows.
    """
    least = 1e3 * cell * float(np.sqrt(ratio)) * 1.2
    return CuttingInputError(
        f"the surface of the stock at cell_mm: {1e3 * cell:g} needs more than {MOST_BLOCKS:.0e} blocks of cells; a "
        f"cell_mm of {least:.2g} or more would work (or a scale, where the mesh is not in metres)",
        key="cell_mm",
    )


def _describe_extent(extent: Array, cell: float) -> str:
    return " x ".join(f"{1e3 * e:.4g}" for e in extent.tolist()) + f" mm at cell_mm: {1e3 * cell:g}"


def _check_size(extent: Array, cell: float, shown: str) -> None:
    """Refuse a grid that is too large by its extent along its own axes; the message names that along the CAM axes."""
    blocks = np.ceil((extent / cell + 2 * MARGIN) / BLOCK)
    strip = float(blocks[0] * blocks[2]) * BLOCK**3
    ratio = max(float(blocks.prod() / MOST_TABLE) ** (1 / 3), (strip / MOST_STRIP) ** 0.5)
    if ratio > 1.0:
        raise CuttingInputError(
            f"{shown} gives {float(blocks.prod()) * CELLS:.3g} cells; a cell_mm of {1e3 * cell * ratio * 1.05:.2g} or "
            "more would work (or a scale, where the mesh is not in metres)",
            key="cell_mm",
        )


def _check_resolution(extent: Array, cell: float) -> None:
    least, shown = float(extent.min()), _describe_extent(extent, cell)
    if least / cell < LEAST_CELLS:
        raise CuttingInputError(
            f"{shown} gives {least / cell:.0f} cells across the stock; at least {LEAST_CELLS} are needed: a cell_mm of "
            f"{1e3 * least / LEAST_CELLS:.2g} or less would work (or a scale, where the mesh is not in metres)",
            key="cell_mm",
        )
