"""Holes of a toolpath: cut points of one drilling operation on one axis, with surface and depth.

The axis n points from the tip to the shank. A point p lies at the height h = (p − p₀)·n over the deepest tip p₀. The
surface is at h = depth. A cut point is in the material where it is the deepest so far and below the surface: the
retraction, and a peck down to a depth already drilled, cut nothing.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from machopt.data_types.process import CuttingProcess
from machopt.data_types.toolpath import Toolpath
from machopt.errors import ConfigurationKeyError
from machopt.numerics.array_types import Array

SAME_AXIS = 0.05e-3  # m, distance of two points from one axis (contracts: holes)
SAME_DIRECTION = np.cos(np.radians(0.05))
DEEPER = 1e-6  # m, a cut that goes less deep than this cuts nothing


@dataclass(frozen=True, kw_only=True)
class DrilledHole:
    """One hole of a toolpath."""

    operation: int  # index into the operations of the process
    rows: NDArray[np.intp]  # (k,) cut points, in order
    deepest: int  # the point with the deepest tip
    depth: float  # m, surface to the deepest tip
    start_depth: Array  # (k,) m, depth of the tip below the surface where the move begins; negative above it
    cut_depth: Array  # (k,) m, where its cut begins: at the surface, or where an earlier peck has ended
    end_depth: Array  # (k,) m, where it ends
    is_cutting: NDArray[np.bool_]  # (k,) the move removes material


def find_holes(process: CuttingProcess, toolpath: Toolpath) -> tuple[DrilledHole, ...]:
    """Return the holes of all drilling operations, in order.

    Args:
        process: Content of process.yaml.
        toolpath: A toolpath with its process operations.

    Raises:
        ConfigurationKeyError: the depth of an operation's holes is not stated.
    """
    if toolpath.process_operation is None:
        return ()
    is_hole = np.array([*(one.is_hole for one in process.operations), False])
    rows = np.flatnonzero(toolpath.cutting & is_hole[toolpath.process_operation])
    out = []
    for group in _split_by_axis(toolpath, rows):
        out.append(_build_hole(process, toolpath, group))
    return tuple(out)


def _split_by_axis(toolpath: Toolpath, rows: NDArray[np.intp]) -> list[NDArray[np.intp]]:
    """Return consecutive cut points that share operation and axis."""
    if not len(rows):
        return []
    assert toolpath.process_operation is not None
    operation = toolpath.process_operation[rows]
    label = toolpath.operation[rows]
    position, axis = toolpath.position[rows], toolpath.axis[rows]
    step = np.diff(position, axis=0)
    across = step - np.sum(step * axis[1:], axis=1, keepdims=True) * axis[1:]
    same = (np.linalg.norm(across, axis=1) <= SAME_AXIS) & (np.sum(axis[1:] * axis[:-1], axis=1) >= SAME_DIRECTION)
    same &= (operation[1:] == operation[:-1]) & (label[1:] == label[:-1])
    return np.split(rows, 1 + np.flatnonzero(~same))


def _build_hole(process: CuttingProcess, toolpath: Toolpath, rows: NDArray[np.intp]) -> DrilledHole:
    assert toolpath.process_operation is not None
    k = int(toolpath.process_operation[rows[0]])
    one = process.operations[k]
    axis = toolpath.axis[rows[0]]
    height = toolpath.position[rows] @ axis
    deepest = int(np.argmin(height))
    depth = one.depth
    if depth is None and toolpath.hole_depth is not None:
        stated = float(toolpath.hole_depth[rows[deepest]])
        depth = stated if np.isfinite(stated) else None
    if depth is None:
        raise ConfigurationKeyError(
            f"depth_mm is missing, and the toolpath does not state the depth of the hole at point {rows[deepest]}; "
            "the distance from the surface to the deepest tip in mm would work",
            file=process.file,
            where=f"operations.{one.label}",
            key="depth_mm",
        )
    end = depth - (height - height[deepest])
    before = np.maximum(rows - 1, 0)
    start = depth - (toolpath.position[before] @ axis - height[deepest])
    across = toolpath.position[before] - toolpath.position[rows]
    across -= (across @ axis)[:, None] * axis
    start = np.where(np.linalg.norm(across, axis=1) <= SAME_AXIS, start, end)  # a move from elsewhere cuts no depth
    reached = np.maximum.accumulate(np.r_[0.0, end])[:-1]
    return DrilledHole(
        operation=k,
        rows=rows,
        deepest=int(rows[deepest]),
        depth=depth,
        start_depth=start,
        cut_depth=np.maximum(start, reached),
        end_depth=end,
        is_cutting=end > reached + DEEPER,
    )
