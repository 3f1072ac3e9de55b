"""Table of a plan's results at each point of its toolpath."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from machopt.data_types.process_columns import ProcessColumns
from machopt.numerics.array_types import Array


@dataclass(frozen=True, kw_only=True)
class PointsTable:
    """One row for each toolpath point, SI; NaN where a value does not exist, −1 where no branch was chosen."""

    position: Array  # (N, 3) m, tool tip in workpiece
    axis: Array  # (N, 3) unit, tip to shank
    move: NDArray[np.int8]  # (N,) Move codes
    operation: NDArray[np.int32]  # (N,) index into ``operations``, −1 for none
    operations: tuple[str, ...]  # labels
    gamma: Array  # (N,) rad
    branch: NDArray[np.int8]  # (N,)
    q: Array  # (N, 6) rad, encoder angles: kinematic corrections of the cell are in them
    external: Array  # (N, E) rad or m
    external_prismatic: tuple[bool, ...]  # (E,)
    k_axial: Array  # (N,) N/m, 1/(eᵀCe) along the tool axis
    k_normal: Array  # (N,) N/m, across it
    deflection: Array  # (N,) m under the process force
    clearance: Array  # (N,) m to the nearest body
    limit_margin: Array  # (N,) rad to the nearest joint limit
    singularity: Array  # (N,) rad, least angle from a singular configuration
    status: tuple[str, ...]  # (N,) "ok" or the reason's class
    reason: tuple[str, ...]  # (N,) a sentence: why not, or where ok that the feed of the move is not held; else empty
    feed: Array  # (N,) m/s programmed; NaN for rapid moves
    k_jiao_x: Array  # (N,) N/m, the paper's index along the tool axis
    nearest_pair: tuple[str, ...] = ()  # (N,) the two bodies that come nearest, empty where none is near
    in_grid: NDArray[np.bool_] | None = None  # (N,) False: outside the stiffness grid, the constant values were used
    deflection_std: Array | None = None  # (N,) m, 1 sigma of ``deflection`` from the stiffness's own uncertainty
    k_axial_std: Array | None = None  # (N,) N/m, the same of ``k_axial``
    dwell: Array | None = None  # (N,) s that the file waits at the point; None: it waits nowhere
    compensation: Array | None = None  # (N, 3) m in workpiece, added to the commanded path
    lead: Array | None = None  # (N,) rad, tilt of the tool against ``axis``; None: the tool axis is the CAM file's
    side: Array | None = None  # (N,) rad
    feed_advised: Array | None = (
        None  # (N,) m/s, feed of the program where it is that of the tolerance; None: no advice
    )
    process: ProcessColumns | None = None  # None: the cell has no process

    def __len__(self) -> int:
        return len(self.position)
