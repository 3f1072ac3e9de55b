"""Exported motion: one row for each control sample."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from machopt.data_types.rapid_corners import RapidCorners
from machopt.data_types.toolpath import MoveKind
from machopt.numerics.array_types import Array


@dataclass(frozen=True, kw_only=True)
class Trajectory:
    """Uniformly sampled joint motion from home through the toolpath and back home."""

    time: Array  # (S,) s, uniform
    q: Array  # (S, 6) rad, encoder angles: kinematic corrections of the cell are in them
    external: Array  # (S, E) rad or m
    point: Array  # (S,) fractional index along the toolpath's points; NaN before the first and after the last
    move: NDArray[np.int8]  # (S,) Move codes
    operation: NDArray[np.int32]  # (S,) index into the toolpath's operations, −1 outside
    gamma: Array  # (S,) rad; NaN where no toolpath point is near (rapid moves)
    feed: Array  # (S,) m/s, actual speed of the TCP relative to the workpiece
    tool: NDArray[np.int32] | None = None  # (S,) which segment of the job, where it changes tools
    lead: Array | None = None  # (S,) rad, tilt of the tool against the CAM axis; NaN in rapid moves; None: no tilt
    side: Array | None = None  # (S,) rad
    corners: RapidCorners | None = None  # between rapid moves, where the motion does not stop; None: it has none

    def find_links(self) -> NDArray[np.bool_]:
        """Return (S,) rapid moves of re-entries: after a retract and before an approach at one and the same point."""
        rapid = (self.move == MoveKind.RAPID) & np.isfinite(self.point)
        edges = np.flatnonzero(np.diff(np.r_[False, rapid, False].astype(int))).reshape(-1, 2)
        out = np.zeros(len(rapid), bool)
        for first, stop in edges.tolist():
            if first > 0 and stop < len(rapid) and np.ptp(self.point[first - 1 : stop + 1]) == 0.0:
                before, after = self.move[first - 1], self.move[stop]
                out[first:stop] = before == MoveKind.RETRACT and after == MoveKind.APPROACH
        return out
