"""What the cuts of a robot program are expected to be, by the CAM file and the planned motion."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from machopt.data_types.toolpath import Toolpath
from machopt.numerics.array_types import Array
from machopt.verification.motion.path_geometry.motion_polyline import MotionPolyline

INDEX_TOLERANCE = 5e-5  # of a toolpath index: rounding of trajectory.csv's point column


@dataclass(frozen=True, kw_only=True)
class ExpectedCuts:
    """Cuts and events that the CAM file requires of the program."""

    toolpath: Toolpath
    position: Array  # (N, 3) m, its points; shifted where the path is commanded against a deflection
    corners: tuple[Array, Array]  # (P,) toolpath index and (P, 3) m of the commanded path's corners
    wanted: NDArray[np.bool_]  # (N,) cutting points that the program must reach
    corner: float  # m, beyond 0.02 mm, that the user allowed
    axis_corner: float  # rad, beyond 0.05°, the same of the tool axis
    approach_feed: float  # m/s where the CAM file has none
    offset: Array  # (M, 3) m from where a controller's nominal kinematics put the tool to where it truly is
    tilt: Array  # (M, 3) what is to be added to the tool axis (tip to shank) for the same reason
    reentries: tuple[int, ...] = ()  # points at which the tool is lifted inside of a cut
    line: MotionPolyline | None = None  # of a streamed program: its samples, with the path's corners between them
