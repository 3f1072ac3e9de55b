"""Points with a tolerance, and the poses at which their errors are evaluated.

A hole has two poses: *entry*, with the tip one point length below the first surface, where the drill has its full
diameter, and *exit*, at its deepest point. A milled point has one pose.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from machopt.data_types.cell import CutterGeometry
from machopt.data_types.process import CuttingProcess, MachinedSurface, ProcessOperation
from machopt.data_types.toolpath import Toolpath
from machopt.numerics.array_types import Array
from machopt.process.binding.holes import DrilledHole
from machopt.process.binding.point_loads import PointLoads

_UP = {"cw": 1.0, "ccw": -1.0}


@dataclass(frozen=True, kw_only=True)
class HoleTargets:
    """H holes with a tolerance."""

    operation: NDArray[np.intp]  # (H,) operation of the process
    row: NDArray[np.intp]  # (H,) toolpath point that carries errors and outcome
    entry: Array  # (H,) fractional toolpath index of the entry pose
    exit: Array  # (H,) of the exit pose
    thrust: Array  # (H,) N, nominal: largest of its strokes
    torque: Array  # (H,) N·m
    force: Array  # (H, 2) N, nominal along travel and normal: of a hole with a given force
    clamp: Array  # (H,) N, least axial load of the arm; −inf without a pressure foot


@dataclass(frozen=True)
class SurfaceTargets:
    """S milled points with a tolerance."""

    operation: NDArray[np.intp]  # (S,)
    row: NDArray[np.intp]  # (S,) toolpath point
    normal_sign: Array  # (S,) the wall's normal is this times (axis × travel); 0: the floor, whose normal is the axis
    is_known: NDArray[np.bool_]  # (S,) False: no surface normal is known, or the force is unknown
    stated_normal: Array  # (S, 3) unit in the CAM frame, of the toolpath's own columns; NaN where it has none

    def choose_normal(self, rows: NDArray[np.intp] | slice, cam_axes: Array, axis: Array, normal: Array) -> Array:
        """Return (n, 3) the surface normals away from the material, in base_link.

        Args:
            rows: (n,) which of the points.
            cam_axes: (n, 3, 3) CAM axes as columns.
            axis: (n, 3) tool axes.
            normal: (n, 3) axis × travel.
        """
        sign = self.normal_sign[rows][:, None]
        by_side = np.where(sign == 0, axis, sign * normal)
        stated = self.stated_normal[rows]
        own = np.einsum("mij,mj->mi", cam_axes, np.nan_to_num(stated))
        return np.where(np.isfinite(stated).all(axis=1, keepdims=True), own, by_side)


def list_hole_targets(process: CuttingProcess, toolpath: Toolpath, loads: PointLoads, tip: float) -> HoleTargets:
    """Return the holes whose operation states a tolerance.

    Args:
        process: Content of process.yaml.
        toolpath: Toolpath of one tool.
        loads: Its loads.
        tip: m, point length of the drill.
    """
    holes = [h for h in loads.holes if process.operations[h.operation].tolerance.is_given]
    at = np.array([_find_strongest(h, loads) for h in holes], np.intp)
    return HoleTargets(
        operation=np.array([h.operation for h in holes], np.intp),
        row=np.array([h.deepest for h in holes], np.intp),
        entry=np.array([_find_index(h, min(tip, h.depth)) for h in holes], float),
        exit=np.array([h.deepest for h in holes], float),
        thrust=loads.force[at, 2],
        torque=loads.moment[at],
        force=loads.force[at, :2],
        clamp=np.array([process.operations[h.operation].clamp or -np.inf for h in holes], float),
    )


def compute_tip_length(cutter: CutterGeometry | None) -> float:
    """Return the point length of a drill in m; 0 where its point angle is not stated.

    Args:
        cutter: The cutter.
    """
    if cutter is None or cutter.point_angle is None:
        return 0.0
    return 0.5 * cutter.diameter / float(np.tan(0.5 * cutter.point_angle))


def _find_strongest(hole: DrilledHole, loads: PointLoads) -> int:
    """Return the toolpath point of the stroke with the largest thrust."""
    rows = hole.rows[hole.is_cutting]
    return int(rows[np.argmax(loads.force[rows, 2])]) if len(rows) else hole.deepest


def _find_index(hole: DrilledHole, depth: float) -> float:
    """Return the fractional toolpath index where the tip first reaches a depth."""
    for n in np.flatnonzero(hole.is_cutting):
        start, end = float(hole.start_depth[n]), float(hole.end_depth[n])
        if end >= depth - 1e-12:
            share = 1.0 if end <= start else float(np.clip((depth - start) / (end - start), 0.0, 1.0))
            return float(hole.rows[n]) - 1.0 + share
    return float(hole.deepest)


def list_surface_targets(
    process: CuttingProcess, toolpath: Toolpath, loads: PointLoads, cutter: CutterGeometry | None
) -> SurfaceTargets:
    """Return the milled points whose operation states a tolerance of the surface.

    Args:
        process: Content of process.yaml.
        toolpath: Toolpath of one tool.
        loads: Its loads.
        cutter: The cutter; one with a rounded corner has no surface normal of its own.
    """
    assert toolpath.process_operation is not None
    operation = toolpath.process_operation
    wanted = np.array([*(np.isfinite(one.tolerance.surface) for one in process.operations), False])
    rows = np.flatnonzero(toolpath.cutting & wanted[operation])
    kinds: list[MachinedSurface] = [one.surface for one in process.operations]
    sides = np.array([_get_stated_side(one) for one in process.operations], float)
    spindle = np.array([_UP[one.spindle] for one in process.operations])
    mine = operation[rows]
    up = np.where(loads.side[rows] != 0, loads.side[rows], sides[mine]) * spindle[mine] if len(rows) else np.zeros(0)
    is_floor = np.array([kinds[k] == "floor" for k in mine], bool)
    rounded = cutter is not None and cutter.corner > 0
    stated = np.full((len(rows), 3), np.nan)
    if toolpath.surface_normal is not None:
        stated = toolpath.surface_normal[rows]
    known = np.array([kinds[k] != "table" for k in mine], bool) & (not rounded)
    known |= np.isfinite(stated).all(axis=1)
    known &= ~loads.is_unknown[rows]
    # up milling with M3: the material is left of travel, at axis × travel; the wall's normal points away from it
    sign = np.where(is_floor, 0.0, np.where(up == 0, 1.0, -up))
    return SurfaceTargets(
        operation=mine.astype(np.intp), row=rows, normal_sign=sign, is_known=known, stated_normal=stated
    )


def _get_stated_side(one: ProcessOperation) -> float:
    """Return 1 for an up cut, −1 for a down cut, 0 for a slot or where none is stated."""
    return {"up": 1.0, "down": -1.0}.get(one.cut or "", 0.0)
