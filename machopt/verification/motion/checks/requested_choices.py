"""Check that points.csv keeps the user's choices: rotations, joint margins, clearance.

A plan that breaks one of these is a valid motion, but not the requested one. A manifest whose options were edited
shows here, too.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from machopt.data_types.cell import Cell
from machopt.data_types.plan_options import PlanOptions
from machopt.data_types.steering_rules import resolve_steering, select_steered_rows
from machopt.data_types.toolpath import MoveKind, Toolpath
from machopt.numerics.array_types import Array
from machopt.verification.check_results import VerificationCheck, build_worst_value_check
from machopt.verification.motion.checks.external_joint_positions import check_external_joint_positions
from machopt.verification.tables.exported_tables import ExportedMotion, ExportedPoints

ROTATION_TOLERANCE_DEG = 0.25  # rotations are rounded at corners, as the path is
MARGIN_TOLERANCE_DEG = 2e-5  # five decimals
CLEARANCE_TOLERANCE_MM = 0.05  # the planner keeps it before corners are rounded (path_tolerance_mm)


def check_requested_choices(
    cell: Cell,
    toolpath: Toolpath,
    points: ExportedPoints,
    rows: NDArray[np.intp],
    options: PlanOptions,
    motion: ExportedMotion,
) -> list[VerificationCheck]:
    """Return by how much the rows violate the user's choices, one check for each rule.

    Args:
        cell: The robot cell.
        toolpath: The toolpath, points in the workpiece frame, SI.
        points: The exported points (points.csv), SI.
        rows: Rows of the points that are driven (status ``ok``).
        options: The planning options; their rotations apply where the method chooses them.
        motion: The exported motion, for external joints between the points.
    """
    if not len(rows):
        return []
    at = points.point[rows]

    def where(n: int) -> str:
        return f"point {at[n]}"

    margin = np.degrees(options.limit_margin) - points.numbers["limit_margin_deg"][rows]
    out = [
        build_worst_value_check(
            "requested: limit_margin_deg", "deg too near", np.maximum(margin, 0.0), MARGIN_TOLERANCE_DEG, where
        )
    ]
    if options.collision:
        short = 1e3 * options.clearance - points.numbers["clearance_mm"][rows]
        out.append(
            build_worst_value_check(
                "requested: clearance_mm", "mm too near", np.maximum(short, 0.0), CLEARANCE_TOLERANCE_MM, where
            )
        )
    out += check_external_joint_positions(cell, toolpath, points, rows, options, motion)
    if options.is_searched:
        laid = resolve_steering(options, toolpath)
        out += _check_rotations(toolpath, points, rows, laid) + _check_steering(points, rows, laid)
    return out


def _check_rotations(
    toolpath: Toolpath, points: ExportedPoints, rows: NDArray[np.intp], options: PlanOptions
) -> list[VerificationCheck]:
    """The range where it cuts, and the points at which the user fixed the rotation."""
    at = points.point[rows]
    gamma = points.numbers["gamma_deg"][rows]
    out = []
    low, high = np.degrees(options.rotation_range)
    cut = toolpath.move[np.clip(at, 0, len(toolpath) - 1)] == MoveKind.CUT
    if high - low < 360.0 - ROTATION_TOLERANCE_DEG and cut.any():
        off = np.maximum(_wrap_degrees(gamma[cut] - 0.5 * (low + high)) - 0.5 * (high - low), 0.0)
        where = [f"point {n}" for n in at[cut]]
        out.append(
            build_worst_value_check("requested: rotation_range_deg", "deg outside", off, ROTATION_TOLERANCE_DEG, where)
        )
    wished = [(f, n) for f in options.fixed for n in np.flatnonzero(at == f.point)]
    if wished:
        off = _wrap_degrees(np.array([gamma[n] - np.degrees(f.gamma) for f, n in wished]))
        where = [f"point {f.point}" for f, _ in wished]
        out.append(build_worst_value_check("requested: fixed rotations", "deg off", off, ROTATION_TOLERANCE_DEG, where))
    return out


def _check_steering(points: ExportedPoints, rows: NDArray[np.intp], options: PlanOptions) -> list[VerificationCheck]:
    """The zones that no rotation may lie in, and the branches to use."""
    at, gamma = points.point[rows], points.numbers["gamma_deg"][rows]
    out = []
    zones = [(w, n) for w in options.steer if w.forbid is not None for n in select_steered_rows(w, at)]
    if zones:
        deep = np.array([_compute_zone_depth(gamma[n], np.degrees(w.forbid)) for w, n in zones if w.forbid is not None])
        where = [f"point {at[n]}" for _, n in zones]
        out.append(
            build_worst_value_check("requested: forbidden rotations", "deg inside", deep, ROTATION_TOLERANCE_DEG, where)
        )
    steered = [(w, n) for w in options.steer if w.branch is not None for n in select_steered_rows(w, at)]
    if steered:
        branch = points.numbers["branch"][rows]
        off = np.array([float(branch[n] != w.branch) for w, n in steered])
        out.append(
            build_worst_value_check("requested: branch", "of another", off, 0.5, [f"point {at[n]}" for _, n in steered])
        )
    return out


def _compute_zone_depth(gamma: float, zone: Array) -> float:
    """By how much a rotation lies inside a zone, degrees: to the nearer of its ends, 0 outside."""
    beyond, width = (gamma - zone[0]) % 360.0, (zone[1] - zone[0]) % 360.0
    return float(max(min(beyond, width - beyond), 0.0))


def _wrap_degrees(degrees: Array) -> Array:
    """The least turn there, 0 to 180."""
    return np.abs((degrees + 180.0) % 360.0 - 180.0)
