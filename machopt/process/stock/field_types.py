"""Constants and types of the stock as signed distances, which its compiled functions share."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from machopt.numerics.array_types import Array

Table = NDArray[np.int32]  # (bx, by, bz) place of each block in the pool, or AIR or SOLID
Pool = NDArray[np.int16]  # (n, CELLS) distances of stored blocks, in units of a cell / EDGE
FieldArrays = tuple[Table, Pool, NDArray[np.int32], NDArray[np.int64]]
# table, pool, free places of the pool, and the state: places used, number of free places, blocks without a place
Cutter = tuple[float, float, float, float]  # radius m, corner radius m, slope of the cone, height m
Step = tuple[float, float, float, float, float, float, float, float, float, float, float, float]
# of the cutter: x, y, z of the tip at the start m, of its change, of the tool axis at the start, and of its change
Frame = tuple[Array, float]  # corner of cell (0, 0, 0) in the CAM frame and side of a cell, m

SHIFT = 3
BLOCK = 1 << SHIFT  # cells along a side of a block
LAST = BLOCK - 1
CELLS = BLOCK * BLOCK * BLOCK
AIR, SOLID = -1, -2
LIMIT = 1.25  # cells; larger distances are stored as this
WIDE = 0.5**0.5  # cells, between lattice planes across (1 1 0)
KNOTS = (0.5 * (1.0 + WIDE), 0.5 * (1.0 - WIDE))  # cells; within ``LIMIT``
EDGE = 20_000  # stored value of a distance of one cell
MOST = int(LIMIT * EDGE)
