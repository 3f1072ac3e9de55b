"""Geometry of a grid of cubes: its position, the cells that a position touches, and interpolation to unmeasured
cells.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from scipy.sparse import csr_matrix

from machopt.errors import RecordingError
from machopt.numerics.array_types import Array, Bools, Ints

SITE = 0.05  # of a cell's edge; positions equal after rounding to it form one site

MOST_CELLS_IN_ALL = 8000  # most cells: each has a row in stiffness.yaml and in the report


@dataclass(frozen=True)
class GridRegion:
    """Grid of equal cubes, numbered with x fastest (as :class:`machopt.data_types.stiffness.StiffnessGrid`)."""

    origin: Array  # (3,) m, lowest corner in base_link
    cell: float  # m
    shape: tuple[int, int, int]

    def __len__(self) -> int:
        return int(np.prod(self.shape))

    def centres(self) -> Array:
        """Return the cell centres (G, 3) m."""
        index = np.stack(np.unravel_index(np.arange(len(self)), self.shape, order="F"), axis=1)
        return np.asarray(self.origin + self.cell * (index + 0.5))

    def corners(self) -> Array:
        """Return the cell corners (G, 8, 3) m."""
        offset = np.array(list(np.ndindex(2, 2, 2))) - 0.5
        return np.asarray(self.centres()[:, None] + self.cell * offset)

    def contains(self, position: Array, on_face: float) -> Bools:
        """Return which positions are inside of the grid or on its outer faces.

        Args:
            position: (M, 3) positions, m, base_link.
            on_face: Tolerance within which a position counts as on a face, m.

        Returns:
            (M,) True inside.
        """
        x = position - self.origin
        return np.asarray(((x >= -on_face) & (x <= self.cell * np.array(self.shape) + on_face)).all(axis=1))

    def cells(self, position: Array, on_face: float) -> Ints:
        """Return the cells that positions touch. A position on a face touches the cells on both sides.

        Args:
            position: (M, 3) positions, m, base_link.
            on_face: Tolerance within which a position counts as on a face, m.

        Returns:
            (M, 8) cell indices, −1 for none.
        """
        x = (position - self.origin) / self.cell
        eps = on_face / self.cell
        low, high = np.floor(x - eps).astype(int), np.floor(x + eps).astype(int)
        shape = np.array(self.shape)
        out = np.full((len(x), 8), -1, np.int64)
        for n, corner in enumerate(np.ndindex(2, 2, 2)):
            upper = np.array(corner) == 1
            pick = np.where(upper, high, low)
            there = np.all(~upper | (high != low), axis=1) & np.all((pick >= 0) & (pick < shape), axis=1)
            out[there, n] = (pick @ np.array([1, shape[0], shape[0] * shape[1]]))[there]
        return out


def build_grid_region(
    position: Array, cell: float, origin: Array | None, shape: tuple[int, int, int] | None, on_face: float, source: str
) -> GridRegion:
    """Build the requested grid; without origin or shape, whole cells around the positions.

    Args:
        position: (M, 3) positions, m, base_link.
        cell: Edge length of a cell, m.
        origin: (3,) lowest corner in base_link, m; None: centred on the positions.
        shape: Number of cells along x, y, z; None: as many as needed.
        on_face: Tolerance within which a position counts as on a face, m.
        source: Source of the recording, for error messages.

    Returns:
        The grid.

    Raises:
        InputError: The sizes do not define a valid grid.
    """
    if not (np.isfinite(cell) and cell > 2 * on_face):
        raise RecordingError(
            f"a grid cell of {cell * 1e3:g} mm is no larger than twice the {on_face * 1e3:g} mm within which a pose "
            "counts as on a face; a larger cell would work",
            file=source,
        )
    low, high = position.min(axis=0), position.max(axis=0)
    if origin is not None:
        low = np.asarray(origin, float)
    if shape is None:
        shape = tuple(int(n) for n in np.maximum(np.ceil((high - low - 2 * on_face) / cell), 1))  # type: ignore[assignment]
    assert shape is not None
    if len(shape) != 3 or min(shape) < 1 or low.shape != (3,) or not np.isfinite(low).all():
        raise RecordingError(
            f"a grid of {shape} cells from {low.tolist()} m is none; three whole numbers of at least 1 and three "
            "coordinates would work",
            file=source,
        )
    if np.prod([float(n) for n in shape]) > MOST_CELLS_IN_ALL:
        raise RecordingError(
            f"{' × '.join(map(str, shape))} cells of {cell * 1e3:g} mm are more than the {MOST_CELLS_IN_ALL} that a "
            "grid may have; larger cells, or a smaller part of the space, would work",
            file=source,
        )
    if origin is None:
        low = (low + high) / 2 - cell * np.array(shape) / 2
    return GridRegion(low, float(cell), shape)


@dataclass(frozen=True)
class MeasuredCells:
    """Cells with readings. A site is a position; a place is the set of cells that a site touches."""

    cells: Ints  # (C,) ascending cell indices
    site: Ints  # (M,) site of each position
    place: Ints  # (S,) place of each site
    members: Ints  # (L, 8) cells of each place as indices into ``cells``, −1 for none
    distance: Array  # (C, C) distance between cell centres, in cell lengths

    @property
    def share(self) -> Array:
        """Weights (L, C): 1/m for each of the m cells of a place."""
        out = np.zeros((len(self.members), len(self.cells)))
        row, slot = np.nonzero(self.members >= 0)
        out[row, self.members[row, slot]] = 1.0
        return np.asarray(out / out.sum(axis=1, keepdims=True))

    def linear(self, z: Array, extra: int) -> tuple[csr_matrix, Array]:
        """Linearise the relative compliance ρ = m / Σ_g exp(−z_g) of each place about z; ``extra`` unknowns are
        passed through.

        Args:
            z: (C, F) log relative compliances of the cells.
            extra: Number of further unknowns.

        Returns:
            E (L·R, C·F + extra) and u (L, R), R = F + extra: ρ ≈ u + E β with ∂ρ/∂z_g = ρ² exp(−z_g) / m.
        """
        share, (C, F), L = self.share, z.shape, len(self.members)
        rho = 1.0 / (share @ np.exp(-z))  # (L, F)
        place, cell = np.nonzero(share)
        slope = rho[place] ** 2 * np.exp(-z[cell]) * share[place, cell][:, None]
        R, joint = F + extra, np.arange(F)
        rows, columns = (place[:, None] * R + joint).ravel(), (cell[:, None] * F + joint).ravel()
        values = slope.ravel()
        if extra:
            more = np.arange(extra)
            rows = np.concatenate([rows, (np.arange(L)[:, None] * R + F + more).ravel()])
            columns = np.concatenate([columns, np.tile(C * F + more, L)])
            values = np.concatenate([values, np.ones(L * extra)])
        u = np.zeros((L, R))
        u[:, :F] = rho
        np.subtract.at(u[:, :F], place, slope * z[cell])
        return csr_matrix((values, (rows, columns)), shape=(L * R, C * F + extra)), u


def find_measured_cells(region: GridRegion, position: Array, on_face: float) -> MeasuredCells:
    """Find the cells, sites and places of positions inside the grid.

    Args:
        region: The grid.
        position: (M, 3) positions, m, base_link.
        on_face: Tolerance within which a position counts as on a face, m.

    Returns:
        The cells with readings.
    """
    cells = np.sort(region.cells(position, on_face), axis=1)
    near = np.round((position - region.origin) / max(2 * on_face, SITE * region.cell)).astype(np.int64)
    found, site = np.unique(np.concatenate([cells, near], axis=1), axis=0, return_inverse=True)
    members, place = np.unique(found[:, :8], axis=0, return_inverse=True)
    used = np.unique(members[members >= 0])
    index = np.where(members >= 0, np.searchsorted(used, members), -1)
    centre = region.centres()[used] / region.cell
    distance = np.linalg.norm(centre[:, None] - centre[None], axis=-1)
    return MeasuredCells(
        used, site.reshape(-1).astype(np.int64), place.reshape(-1).astype(np.int64), index.astype(np.int64), distance
    )


def interpolate_by_kriging(region: GridRegion, used: Ints, range_: float) -> tuple[Array, Array, Array, float]:
    """Compute the weights that predict all cells from those with readings (universal kriging with an estimated mean).

    Args:
        region: Grid with G cells.
        used: (C,) cells with readings.
        range_: Range ℓ of the correlation exp(−d/ℓ), in cell lengths; 0 for none.

    Returns:
        Weights (G, C), remaining variance (G,) in units of s², weights of the mean (C,), its variance in s².
    """
    every = region.centres() / region.cell
    d = np.linalg.norm(every[:, None] - every[used][None], axis=-1)
    K = np.exp(-d / range_) if range_ > 0 else (d == 0).astype(float)
    inverse = np.linalg.inv(K[used])
    total = float(inverse.sum())
    mean = inverse.sum(axis=0) / total
    gain = K @ inverse
    rest = 1.0 - gain.sum(axis=1)
    left = np.maximum(1.0 - np.sum(gain * K, axis=1) + rest**2 / total, 0.0)
    left[used] = 0.0
    return gain + rest[:, None] * mean, left, mean, 1.0 / total
