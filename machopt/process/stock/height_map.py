"""Stock as heights along the tool axis over a grid of cells across it.

A cell carries two heights: ``share`` of its area is at ``low``, the rest at ``high``. A cutter that covers a part of a
cell lowers that part alone, so that volumes and boundaries are better than the cell size.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from machopt.data_types.stock import StockBody
from machopt.errors import CuttingInputError
from machopt.numerics.array_types import Array
from machopt.process.stock.kernel_types import BOTTOM, HIGH, LOW, SHARE, Grid, Heights
from machopt.process.stock.mesh_columns import compute_columns

MOST_CELLS = 40_000_000  # 16 bytes each: 640 MB
LEAST_CELLS = 8  # across the stock: fewer do not show where it ends
GAP_SHARE = 1e-3  # of the volume; smaller gaps along the axis come from rounding


@dataclass(frozen=True, kw_only=True, eq=False)
class HeightMap:
    """Stock over a grid of cells. Coordinates u, v lie across the tool axis, w along it, from the CAM origin."""

    rotation: Array  # (3, 3) rows u, v, w in the CAM frame
    origin: tuple[float, float]  # m, u and v of the corner of cell (0, 0)
    cell: tuple[float, float]  # m, size of a cell along u and v
    grid: Grid  # (4, nv, nu) high, low, share and bottom of each cell
    gap_volume: float  # m³, of gaps along the axis, which count as filled

    @property
    def high(self) -> Heights:
        """(nv, nu) m, upper height."""
        return np.asarray(self.grid[HIGH])

    @property
    def low(self) -> Heights:
        """(nv, nu) m, height of the share that was cut deeper."""
        return np.asarray(self.grid[LOW])

    @property
    def share(self) -> Heights:
        """(nv, nu) 0 … 1 of the area at ``low``."""
        return np.asarray(self.grid[SHARE])

    @property
    def bottom(self) -> Heights:
        """(nv, nu) m, lower side."""
        return np.asarray(self.grid[BOTTOM])

    @property
    def size(self) -> float:
        """Larger side of a cell, m."""
        return max(self.cell)

    @property
    def volume(self) -> float:
        """Volume of the material, m³."""
        mean = (1.0 - self.share) * self.high + self.share * self.low - self.bottom
        return float(mean.sum(dtype=np.float64)) * self.cell[0] * self.cell[1]

    def convert_points(self, position: Array) -> Array:
        """Return (N, 3) u, v, w of points.

        Args:
            position: (N, 3) m, CAM frame.
        """
        return np.ascontiguousarray(position @ self.rotation.T)


def build_height_map(body: StockBody, axis: Array) -> HeightMap:
    """Return the stock before the first move.

    Args:
        body: The stock, a closed mesh in the CAM frame.
        axis: (3,) unit, tool axis from tip to shank, CAM frame.

    Raises:
        CuttingInputError: the number of cells is too large or too small.
    """
    rotation = build_axis_frame(axis)
    corners = np.ascontiguousarray(body.vertices @ rotation.T)[body.faces]
    least, most = corners.min(axis=(0, 1)), corners.max(axis=(0, 1))
    extent = (most - least)[:2]
    check_cell_count(extent, body.cell_size)
    count = np.ceil(extent / body.cell_size - 1e-9).astype(int)
    cell = extent / count  # the sides of a block lie on the sides of cells
    top, bottom, share, thickness = compute_columns(
        np.ascontiguousarray(corners), least[:2].copy(), cell, int(count[0]), int(count[1])
    )
    is_empty = share >= 1.0
    filled = float(((1.0 - share) * (top - bottom)).sum(dtype=np.float64) - thickness) * float(cell[0] * cell[1])
    whole = max(thickness * float(cell[0] * cell[1]), 1e-300)
    grid = np.empty((4, *top.shape), np.float32)
    grid[HIGH] = np.where(is_empty, bottom, top)
    grid[LOW] = np.where(share > 0, bottom, top)
    grid[SHARE] = np.where(is_empty, np.float32(0.0), share)
    grid[BOTTOM] = bottom
    return HeightMap(
        rotation=rotation,
        origin=(float(least[0]), float(least[1])),
        cell=(float(cell[0]), float(cell[1])),
        grid=grid,
        gap_volume=filled if filled > GAP_SHARE * whole else 0.0,
    )


def build_axis_frame(axis: Array) -> Array:
    """Return (3, 3) unit rows u, v, w with w along the axis; u along the CAM x axis where the axis is z.

    Args:
        axis: (3,) unit.
    """
    w = np.asarray(axis, float) / np.linalg.norm(axis)
    first = np.array([1.0, 0.0, 0.0]) if abs(w[0]) < 0.9 else np.array([0.0, 1.0, 0.0])
    u = first - first @ w * w
    u /= np.linalg.norm(u)
    return np.stack([u, np.cross(w, u), w])


def check_cell_count(extent: Array, cell: float) -> None:
    """Refuse a number of cells that does not fit into memory, or that does not resolve the stock.

    Args:
        extent: (2,) m, of the stock across the tool axis.
        cell: m, cell size.

    Raises:
        CuttingInputError: with the cell size that would work.
    """
    count = np.ceil(extent / cell)
    shown = f"{1e3 * extent[0]:.4g} x {1e3 * extent[1]:.4g} mm at cell_mm: {1e3 * cell:g}"
    if count.prod() > MOST_CELLS:
        least = 1e3 * float(np.sqrt(extent.prod() / MOST_CELLS))
        raise CuttingInputError(
            f"{shown} gives {count.prod():.3g} cells; at most {MOST_CELLS:.0e} are accepted: a cell_mm of "
            f"{least * 1.01:.2g} or more would work (or a scale, where the mesh is not in metres)",
            key="cell_mm",
        )
    if count.min() < LEAST_CELLS:
        raise CuttingInputError(
            f"{shown} gives {count.min():.0f} cells across the stock; at least {LEAST_CELLS} are needed: a cell_mm of "
            f"{1e3 * extent.min() / LEAST_CELLS:.2g} or less would work (or a scale, where the mesh is not in metres)",
            key="cell_mm",
        )
