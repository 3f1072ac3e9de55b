"""Position of each motion sample relative to the CAM file: on a feed move, lifted off a point, or free.

No label is read here. A sample is *fed* where the tool is on a move that the CAM file makes at a feed, with point and
axis within the tolerances. It is *lifted* where it lies straight above a point along that point's tool axis. Else it
is free. A free tool must not be in the workpiece.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from machopt.data_types.plan_options import PlanOptions
from machopt.data_types.toolpath import MoveKind, Toolpath
from machopt.numerics.array_types import Array, Bools
from machopt.verification.motion.path_geometry.axis_interpolation import interpolate_axis
from machopt.verification.motion.path_geometry.reference_direction import INDEX_TOLERANCE
from machopt.verification.motion.path_geometry.tool_tilt import ToolTilt
from machopt.verification.tables.exported_tables import ExportedMotion

PATH_MM, AXIS_DEG = 0.02, 0.05  # how far the TCP may leave the toolpath at a feed
AXIS_LEVER_M = float(1e-3 * PATH_MM / np.radians(AXIS_DEG))  # m/rad: both tolerances of the path count alike
BLOCK_ROWS = 10_000  # samples compared at a time: intermediate arrays are many times larger than the result
MAX_RETRACT_M = 0.5  # m, to which the tool is lifted along its axis


@dataclass(frozen=True, kw_only=True)
class SampleLocations:
    """Position of S samples relative to the toolpath; what does not exist is inf or False."""

    tcp: Array  # (S, 3, 4) in workpiece; of a tilted tool turned back to the axes of the CAM file
    tool: Array  # (S, 3, 4) in workpiece, where the tool is
    next_point: NDArray[np.int64]  # (S,) point that the move of the file at the sample's index leads to
    off_path: Array  # (S,) m from the polyline near the sample's index
    off_index: Array  # (S,) m from the place that the index names
    off_axis: Array  # (S,) rad between the tool and the file's axis at the index
    on_feed_move: Bools  # (S,)
    on_retract_move: Bools  # (S,)
    path_limit: float  # m
    axis_limit: float  # rad

    def is_on_retract(self, point: Array) -> Bools:
        """Return (S,) rows of a retract or approach move: lifted off a point, or on it just before or after.

        The first rows of such a move are still within the tolerance of the point itself.

        Args:
            point: (S,) toolpath index of the rows.
        """
        out = self.on_retract_move.copy()
        with np.errstate(invalid="ignore"):
            same = np.abs(np.diff(point)) <= INDEX_TOLERANCE
        every = range(len(out))
        for order, step in ((every[1:], -1), (every[-2::-1], 1)):
            for n in order:
                if out[n + step] and self.on_feed_move[n] and same[min(n, n + step)]:
                    out[n] = True
        return out

    @property
    def is_free(self) -> Bools:
        """(S,) on no feed move of the file, and not lifted off it."""
        return np.asarray(~(self.on_feed_move | self.on_retract_move))


def locate_samples(
    motion: ExportedMotion,
    toolpath: Toolpath,
    corners: Array,
    position: Array,
    tool: Array,
    options: PlanOptions,
    tilt: ToolTilt | None = None,
) -> SampleLocations:
    """Return the position of each motion sample relative to the CAM file.

    Args:
        motion: The exported motion (trajectory.csv), SI.
        toolpath: The toolpath, points in the workpiece frame, SI.
        corners: (P,) fractional index of the commanded polyline's corners: the toolpath's points, or those of the
            shifted path.
        position: (P, 3) position of these corners, m.
        tool: (S, 3, 4) poses of the TCP in the workpiece frame.
        options: The planning options, whose tolerances count where they are wider than the defaults.
        tilt: Tilt of the tool against the axes of the CAM file; None: there is none.
    """
    tcp = tool if tilt is None else tilt.turn_back(tool, motion.point)
    path_limit = max(PATH_MM / 1e3, options.path_tolerance)
    axis_limit = max(np.radians(AXIS_DEG), options.axis_tolerance)
    last, x = len(toolpath) - 1, tcp[:, :3, 3]
    known = np.isfinite(motion.point)
    s = np.clip(np.nan_to_num(motion.point), 0.0, last)
    toward = np.clip(np.ceil(s - INDEX_TOLERANCE), 0, last).astype(int)
    fed_moves = toolpath.move[np.clip(np.ceil(corners[1:] - INDEX_TOLERANCE).astype(int), 0, last)] != MoveKind.RAPID
    angle, off_index, off_path, height, aside = (np.empty(len(s)) for _ in range(5))
    for start in range(0, len(s), BLOCK_ROWS):
        some = slice(start, start + BLOCK_ROWS)
        low = np.minimum(s[some].astype(int), max(last - 1, 0))
        axis = interpolate_axis(toolpath.axis[low], toolpath.axis[np.minimum(low + 1, last)], s[some] - low)
        shank = -tcp[some, :3, 2]
        angle[some] = np.arctan2(np.linalg.norm(np.cross(shank, axis), axis=1), np.einsum("ij,ij->i", shank, axis))
        up = x[some] - np.column_stack([np.interp(s[some], corners, position[:, c]) for c in range(3)])
        off_index[some] = np.linalg.norm(up, axis=1)
        height[some] = np.einsum("ij,ij->i", up, axis)
        aside[some] = np.linalg.norm(up - height[some, None] * axis, axis=1)
        off_path[some] = _compute_path_distance(x[some], s[some], corners, position, fed_moves)
    off_index, off_path = (np.where(known, off, np.inf) for off in (off_index, off_path))
    straight = known & (angle <= axis_limit)
    fed = straight & (off_path <= path_limit) & (toolpath.move[toward] != MoveKind.RAPID) & (toward > 0)
    whole = np.abs(s - np.round(s)) <= INDEX_TOLERANCE
    away = ~fed | (off_index > path_limit)  # drawn out along the very line it came in on: the index stays at the point
    lifted = straight & whole & away & (aside <= path_limit) & (height >= -path_limit) & (height <= MAX_RETRACT_M)
    fed &= ~lifted
    return SampleLocations(
        tcp=tcp,
        tool=tool,
        next_point=toward,
        off_path=off_path,
        off_index=off_index,
        off_axis=np.where(known, angle, np.inf),
        on_feed_move=fed,
        on_retract_move=lifted,
        path_limit=path_limit,
        axis_limit=float(axis_limit),
    )


def _compute_path_distance(x: Array, s: Array, corners: Array, position: Array, fed: Bools) -> Array:
    """(S,) m from the segment that index s lies on, the one before or the one after.

    ``fed``: (P − 1,) segments that the file drives at a feed. A rapid one counts as its own end only: a tool that is
    drawn out of a point along the very line on which the rapid move leaves it is lifted, not fed.
    """
    ends = len(corners) - 1
    on = np.clip(np.searchsorted(corners, s, side="right") - 1, 0, max(ends - 1, 0))
    away = np.full(len(x), np.inf)
    for near in (on - 1, on, on + 1):
        a = np.clip(near, 0, ends)
        b = np.clip(near + 1, 0, ends)
        end = position[b]
        driven = fed[np.clip(a, 0, ends - 1)] if ends else np.zeros(len(x), bool)
        start = np.where(driven[:, None], position[a], end)
        along = end - start
        length = np.einsum("ij,ij->i", along, along)
        share = np.einsum("ij,ij->i", x - start, along) / np.where(length > 0, length, 1.0)
        foot = start + np.clip(share, 0.0, 1.0)[:, None] * along
        away = np.minimum(away, np.linalg.norm(x - foot, axis=1))
    return away
