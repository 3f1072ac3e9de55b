"""Tilt of a ball cutter by tilt.csv, and poses of the tilted tool turned back to the axes of the CAM file.

With a the axis of the CAM file and t the direction of travel normal to it, the axis of the tool is
a' = a + tan(lead) t + tan(side) (a × t), normalised. Between two rows of tilt.csv it turns evenly in the plane of
both. The ball turns about its centre: its tip is at p + r (a − a'). A pose turned back about that centre is compared
with the CAM file by the checks of an untilted tool. The rotation takes gamma = 0 of the tilted tool to gamma = 0 of the
CAM file.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from machopt.data_types.cell import Cell
from machopt.data_types.toolpath import MoveKind, Toolpath
from machopt.numerics.array_types import Array, Bools
from machopt.verification.motion.path_geometry.axis_interpolation import interpolate_axis
from machopt.verification.motion.path_geometry.reference_direction import (
    PathDirections,
    compute_directions_at_points,
    interpolate_directions,
)
from machopt.verification.tables.exported_tables import ExportedTilt

WHOLE = 2e-6  # of an index with six decimals


@dataclass(frozen=True, kw_only=True)
class ToolTilt:
    """Tilted axes along a toolpath."""

    toolpath: Toolpath
    known: PathDirections  # at the points of the toolpath
    index: Array  # (P,) fractional toolpath index, not falling
    axis: Array  # (P, 3) unit, tip to shank
    radius: float  # m, of the ball; 0 where the cutter is none
    corners: tuple[Array, Array]  # (Q,) index and (Q, 3) m, commanded path of an untilted tool

    @classmethod
    def build(cls, cell: Cell, toolpath: Toolpath, tilt: ExportedTilt, corners: tuple[Array, Array]) -> ToolTilt:
        """Return the tilt of a tool along its toolpath.

        Args:
            cell: The robot cell.
            toolpath: The toolpath, points in the workpiece frame, SI.
            tilt: The exported tilt (tilt.csv).
            corners: Index (Q,) and position (Q, 3) m of the commanded path: the toolpath's, or the compensated one.
        """
        known = compute_directions_at_points(toolpath)
        index = np.clip(tilt.index, 0.0, len(toolpath) - 1.0)
        axis, travel, _ = compute_leaving_directions(toolpath, known, index)
        return cls(
            toolpath=toolpath,
            known=known,
            index=index,
            axis=compute_tilted_axis(axis, travel, tilt.lead, tilt.side),
            radius=get_ball_radius(cell),
            corners=corners,
        )

    def compute_axes(self, index: Array) -> Array:
        """Return the (M, 3) axes of the tilted tool at fractional toolpath indices.

        Args:
            index: (M,) without NaN.
        """
        after = np.clip(np.searchsorted(self.index, index - WHOLE), 0, len(self.index) - 1)
        before = np.maximum(after - 1, 0)
        span = self.index[after] - self.index[before]
        share = np.clip((index - self.index[before]) / np.where(span > 0, span, 1.0), 0.0, 1.0)
        return interpolate_axis(self.axis[before], self.axis[after], np.where(span > 0, share, 1.0))

    def turn_back(self, T: Array, index: Array, whole: float = WHOLE) -> Array:
        """Return poses (M, 4, 4) or (M, 3, 4) turned about the ball's centre by the tilt, in the workpiece frame.

        Poses of rapid moves between two points, and without an index, are not changed.

        Args:
            T: (M, 4, 4) or (M, 3, 4) poses of the TCP in the workpiece frame.
            index: (M,) fractional toolpath index, NaN for none.
            whole: An index of a rapid move nearer than this to a whole one is that of the point.
        """
        last = len(self.toolpath) - 1
        s = np.clip(np.nan_to_num(index), 0.0, last)
        is_rapid = self.toolpath.move[np.clip(np.ceil(s - WHOLE), 0, last).astype(int)] == MoveKind.RAPID
        at_point = np.abs(s - np.round(s)) <= whole
        s = np.where(is_rapid & at_point, np.round(s), s)
        is_fed = ~is_rapid | at_point
        rows = np.flatnonzero(np.isfinite(index) & is_fed)
        out = T.copy()
        if not len(rows):
            return out
        place = np.column_stack([np.interp(s[rows], self.corners[0], self.corners[1][:, c]) for c in range(3)])
        axis, _, zero = compute_leaving_directions(self.toolpath, self.known, s[rows])
        tilted = self.compute_axes(s[rows])
        turn = _build_frames(axis, zero) @ np.swapaxes(_build_frames(tilted, zero), 1, 2)
        centre = place + self.radius * axis
        out[rows, :3, :3] = turn @ T[rows, :3, :3]
        out[rows, :3, 3] = centre + np.einsum("nij,nj->ni", turn, T[rows, :3, 3] - centre)
        return out

    def tilt_corners(self, index: Array, position: Array) -> tuple[Toolpath, Array, Array]:
        """Return the toolpath with the axes of the tilted tool, and the corners of its path.

        Args:
            index: (P,) fractional index of the corners of the untilted path.
            position: (P, 3) m, these corners.

        Returns:
            Toolpath, index (Q,) and position (Q, 3) of every corner and every row of tilt.csv.
        """
        whole = np.arange(len(self.toolpath), dtype=float)
        every = np.union1d(index, self.index)
        line = np.column_stack([np.interp(every, index, position[:, c]) for c in range(3)])
        cam, _, _ = compute_leaving_directions(self.toolpath, self.known, every)
        tips = line + self.radius * (cam - self.compute_axes(every))
        tilted = Toolpath(**{**vars(self.toolpath), "axis": self.compute_axes(whole)})
        return tilted, every, tips


def get_ball_radius(cell: Cell) -> float:
    """Return the radius of the cutter's ball, m; 0 where the cutter is no ball.

    Args:
        cell: The robot cell.
    """
    cutter = cell.tool.cutter
    if cutter is None or cutter.corner <= 0.0 or abs(cutter.diameter / 2.0 - cutter.corner) > 1e-9:
        return 0.0
    return cutter.corner


def compute_leaving_directions(toolpath: Toolpath, known: PathDirections, index: Array) -> tuple[Array, Array, Array]:
    """Return axis, direction of travel and reference of gamma, (M, 3) each, at places of the path.

    At a point they are those of :func:`compute_directions_at_points`, between points those of the move.

    Args:
        toolpath: The toolpath, points in the workpiece frame, SI.
        known: Directions at its points.
        index: (M,) fractional toolpath index.
    """
    there = interpolate_directions(toolpath, known, index, leaving=True)
    point = np.clip(np.round(index).astype(int), 0, len(toolpath) - 1)
    whole = (np.abs(index - point) <= WHOLE)[:, None]
    axis, travel, zero = (
        np.where(whole, at_points[point], between)
        for at_points, between in (
            (known.axis, there.axis),
            (known.travel, there.travel),
            (known.zero, there.zero),
        )
    )
    return axis, travel, zero


def compute_tilted_axis(axis: Array, travel: Array, lead: Array, side: Array) -> Array:
    """Return the (M, 3) unit axis of the tilted tool.

    Args:
        axis: (M, 3) unit axis of the CAM file, tip to shank.
        travel: (M, 3) unit direction of travel, normal to the axis.
        lead: (M,) rad.
        side: (M,) rad.
    """
    a = axis + np.tan(lead)[:, None] * travel + np.tan(side)[:, None] * np.cross(axis, travel)
    return np.asarray(a / np.linalg.norm(a, axis=1, keepdims=True))


def find_range_excess(lead: Array, side: Array, limits: Array) -> Array:
    """Return the (M,) rad by which lead or side leave their ranges.

    Args:
        lead: (M,) rad.
        side: (M,) rad.
        limits: (M, 2, 2) rad, lowest and highest lead, lowest and highest side.
    """
    both = np.column_stack([lead, side])
    return np.asarray(np.maximum(limits[:, :, 0] - both, both - limits[:, :, 1]).max(axis=1, initial=0.0).clip(0.0))


def is_cut_place(toolpath: Toolpath, index: Array) -> Bools:
    """Return (M,) whether the move that leaves a place or lies there cuts.

    Args:
        toolpath: The toolpath, points in the workpiece frame, SI.
        index: (M,) fractional toolpath index.
    """
    last = len(toolpath) - 1
    low = np.clip(np.floor(index + WHOLE), 0, last).astype(int)
    return np.asarray(toolpath.cutting[np.minimum(low + 1, last)] & (low < last))


def _build_frames(axis: Array, zero: Array) -> Array:
    """(M, 3, 3) rotations whose third column is the axis, and whose first is ``zero`` projected across it."""
    x = zero - np.einsum("ij,ij->i", zero, axis)[:, None] * axis
    x = x / np.linalg.norm(x, axis=1, keepdims=True)
    return np.stack([x, np.cross(axis, x), axis], axis=2)
