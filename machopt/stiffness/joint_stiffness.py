"""Joint stiffness at a place: constant, or of the grid cells that the TCP touches."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from machopt.data_types.stiffness import ArmStiffness, StiffnessGrid
from machopt.numerics.array_types import Array

GRID_FACE_TOLERANCE_M = 1e-6  # m; a TCP this near to a face, edge or corner of the grid belongs to all its cells


@dataclass(frozen=True)
class JointStiffness:
    """Joint stiffness at given TCP positions."""

    k: Array  # (..., 6) N·m/rad
    is_in_grid: NDArray[np.bool_]  # (...,) False: outside the identified grid, constant values used


def compute_joint_stiffness(stiffness: ArmStiffness, position: Array) -> JointStiffness:
    """Return K_θ(j) of jiao2022 section 2.3: the cell's values, averaged on shared faces, edges and corners.

    Args:
        stiffness: stiffness model of the arm.
        position: (..., 3) TCP position in base_link, m.
    """
    position = np.asarray(position, float)
    lead = position.shape[:-1]
    grid = stiffness.grid
    if grid is None:
        return JointStiffness(np.broadcast_to(stiffness.joints, (*lead, len(stiffness.joints))), np.ones(lead, bool))
    flat = position.reshape(-1, 3)
    rows, cells = find_grid_cells(grid, flat)
    total, count = np.zeros((len(flat), len(stiffness.joints))), np.bincount(rows, minlength=len(flat))
    np.add.at(total, rows, grid.joints[cells])
    found = count > 0
    k = np.where(found[:, None], total / np.maximum(count, 1)[:, None], stiffness.joints)
    return JointStiffness(k.reshape(*lead, len(stiffness.joints)), found.reshape(lead))


def find_grid_cells(grid: StiffnessGrid, position: Array) -> tuple[NDArray[np.int64], NDArray[np.int64]]:
    """Return the grid cells that positions lie in or touch, as pairs of rows (position, cell).

    Args:
        grid: stiffness grid.
        position: (M, 3) m in base_link.
    """
    shape = np.array(grid.shape)
    x = (position - grid.origin) / grid.cell
    eps = GRID_FACE_TOLERANCE_M / grid.cell
    low = np.floor(x - eps).astype(int)  # the cells touched along each axis: low … high (one or two)
    high = np.floor(x + eps).astype(int)
    rows, cells = [np.empty(0, np.int64)], [np.empty(0, np.int64)]
    for corner in np.ndindex(2, 2, 2):
        pick = np.where(np.array(corner) == 1, high, low)
        new = np.all((np.array(corner) == 0) | (high != low), axis=1)  # do not count a cell twice
        inside = np.flatnonzero(new & np.all((pick >= 0) & (pick < shape), axis=1))
        rows.append(inside)
        cells.append(pick[inside, 0] + shape[0] * (pick[inside, 1] + shape[1] * pick[inside, 2]))
    return np.concatenate(rows), np.concatenate(cells)
