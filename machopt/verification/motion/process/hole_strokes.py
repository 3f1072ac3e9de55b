"""Moves of a toolpath into holes: depth below the surface at both ends of each move, in order of the file."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np

from machopt.data_types.process import CuttingProcess
from machopt.data_types.toolpath import MoveKind, Toolpath

MAX_OFF_AXIS_M = 0.05e-3
MAX_TILT_RAD = np.radians(0.05)


@dataclass(frozen=True)
class HoleStroke:
    """One move into the material of a hole."""

    point: int
    operation: int
    start: float  # m below the surface
    end: float


@dataclass(frozen=True)
class HoleVisit:
    """All cut moves of one hole."""

    operation: int
    deepest: int
    depth: float  # m
    strokes: tuple[HoleStroke, ...]  # those that cut


def list_holes(process: CuttingProcess, toolpath: Toolpath, operation: np.ndarray) -> list[HoleVisit]:
    """Return the holes of the drilling operations.

    Args:
        process: Content of process.yaml.
        toolpath: The toolpath.
        operation: (N,) operation of process.yaml of each point, −1 for none.
    """
    return [_measure_hole(process, toolpath, operation, group) for group in _group_points(process, toolpath, operation)]


def _group_points(process: CuttingProcess, toolpath: Toolpath, operation: np.ndarray) -> Iterator[list[int]]:
    group: list[int] = []
    is_hole = np.array([*(one.is_hole for one in process.operations), False])  # −1: no operation
    for point in np.flatnonzero((toolpath.move == MoveKind.CUT) & is_hole[operation]).tolist():
        if group and not _is_same_hole(toolpath, operation, group[-1], point):
            yield group
            group = []
        group.append(point)
    if group:
        yield group


def _is_same_hole(toolpath: Toolpath, operation: np.ndarray, before: int, after: int) -> bool:
    if operation[before] != operation[after] or toolpath.operation[before] != toolpath.operation[after]:
        return False
    axis = toolpath.axis[after]
    if np.arccos(np.clip(float(axis @ toolpath.axis[before]), -1.0, 1.0)) > MAX_TILT_RAD + 1e-9:
        return False
    step = toolpath.position[after] - toolpath.position[before]
    return bool(np.linalg.norm(np.cross(step, axis)) <= MAX_OFF_AXIS_M)


def _measure_hole(process: CuttingProcess, toolpath: Toolpath, operation: np.ndarray, group: list[int]) -> HoleVisit:
    k = int(operation[group[0]])
    axis = toolpath.axis[group[0]]
    heights = [float(toolpath.position[p] @ axis) for p in group]
    bottom = min(heights)
    deepest = group[heights.index(bottom)]
    depth = process.operations[k].depth
    if depth is None:
        assert toolpath.hole_depth is not None
        depth = float(toolpath.hole_depth[deepest])
    surface = bottom + depth
    strokes, reached = [], 0.0
    for point, height in zip(group, heights, strict=True):
        end = surface - height
        if end > reached + 1e-6:
            came = toolpath.position[max(point - 1, 0)]
            off = np.linalg.norm(np.cross(came - toolpath.position[point], axis))
            start = surface - float(came @ axis) if off <= MAX_OFF_AXIS_M else end
            strokes.append(HoleStroke(point, k, max(start, reached), end))  # reached: drilled by an earlier peck
            reached = end
    return HoleVisit(k, deepest, depth, tuple(strokes))
