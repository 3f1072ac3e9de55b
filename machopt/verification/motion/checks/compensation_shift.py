"""Compensation: the shift of the path, the force it is computed for, and whether it cancels the deflection.

The deflection is computed again by :mod:`machopt.verification.motion.stiffness.arm_compliance`.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from machopt.data_types.cell import Cell
from machopt.data_types.plan_options import PlanOptions
from machopt.data_types.toolpath import MoveKind, Toolpath
from machopt.numerics.array_types import Array
from machopt.verification.motion.kinematics.urdf_kinematics import UrdfKinematics
from machopt.verification.motion.path_geometry.process_force import (
    compute_engaged_share,
    compute_mean_force,
    list_runs,
)
from machopt.verification.motion.stiffness.arm_compliance import ComplianceModel
from machopt.verification.motion.stiffness.spring_terms import UnknownTermError
from machopt.verification.tables.exported_tables import ExportedMotion, ExportedPoints, ExportedShift

RELATIVE, ABSOLUTE_MM = 0.02, 0.002  # of the deflection, which the last smoothing of the rotation changes a little
FORCE_TOLERANCE = 0.02  # of the force: the mean over a window is taken at other places than in the plan
WINDOW_LENGTHS_M = (0.005, 0.010, 0.020, 0.040)  # m, over which the force may turn, and over which it may come and go
MAX_SHIFT_SLOPE = 0.1 * 1.001  # m/m; six decimals of a millimetre over a short step
ROTATION_LEVER_M = 0.15  # m/rad: a turn of the tool axis on the spot is a way too, on which the compliance changes
SHIFT_TOLERANCE_M = 2e-9  # m, the last decimal
TABLE_TOLERANCE_MM = 1e-5  # the same number in both files


@dataclass(frozen=True, kw_only=True)
class ShiftComparison:
    """One comparison with a value for each place; no values and a reason where it could not be made."""

    name: str
    unit: str
    limit: float
    values: Array  # (n,)
    where: tuple[str, ...]  # (n,)
    not_run: str = ""
    file: str = ""  # where it is about one other than the trajectory


def compute_commanded_corners(toolpath: Toolpath, shift: ExportedShift) -> tuple[Array, Array]:
    """Return index (P,) and position (P, 3) m of the commanded polyline's corners in the workpiece frame.

    Args:
        toolpath: The toolpath, points in the workpiece frame, SI.
        shift: The exported compensation shift (compensation.csv).
    """
    every = np.arange(len(toolpath), dtype=float)
    line = np.column_stack([np.interp(shift.index, every, toolpath.position[:, c]) for c in range(3)])
    return shift.index, line + shift.offset


def compare_compensation_shift(
    cell: Cell,
    toolpath: Toolpath,
    motion: ExportedMotion,
    points: ExportedPoints,
    shift: ExportedShift,
    arm: UrdfKinematics,
    options: PlanOptions,
) -> list[ShiftComparison]:
    """Compare the shift with minus the recomputed deflection, the force with the stated one, and both tables.

    Args:
        cell: The robot cell.
        toolpath: The toolpath, points in the workpiece frame, SI.
        motion: The exported motion (trajectory.csv), SI.
        points: The exported points (points.csv), SI.
        shift: The exported compensation shift (compensation.csv).
        arm: Kinematics of the URDF with the cell's tool.
        options: The planning options in force.
    """
    number = np.round(shift.index).astype(int)
    whole = np.abs(shift.index - number) < 1e-6
    row_of = dict(zip(number[whole].tolist(), np.flatnonzero(whole).tolist(), strict=True))
    run = _assign_runs(toolpath, shift.index)
    return [
        _compare_tables(toolpath, points, shift, row_of),
        _compare_force(toolpath, shift, options),
        _compare_deflection(
            cell, toolpath, _find_cutting_joints(motion, points, shift, np.arange(len(run))), shift, arm
        ),
        _check_smoothness(toolpath, shift, run),
        _check_bound(shift, options),
    ]


def _assign_runs(toolpath: Toolpath, index: Array) -> NDArray[np.int64]:
    """(P,) which run each corner lies on: a new one begins where a rapid move ends."""
    begins = np.array([first for first, _ in list_runs(toolpath)], float)
    return np.searchsorted(begins, index + 1e-9, side="right")


def _check_smoothness(toolpath: Toolpath, shift: ExportedShift, run: NDArray[np.int64]) -> ShiftComparison:
    """Change of the shift over the length of path it happens on; what changes on no length at all jumps."""
    every = np.arange(len(toolpath), dtype=float)
    line, axis = (
        np.column_stack([np.interp(shift.index, every, of[:, c]) for c in range(3)])
        for of in (toolpath.position, toolpath.axis)
    )
    change = np.linalg.norm(np.diff(shift.offset, axis=0), axis=1)
    way = np.hypot(*(np.linalg.norm(np.diff(of, axis=0), axis=1) for of in (line, ROTATION_LEVER_M * axis)))
    inside = run[1:] == run[:-1]
    with np.errstate(divide="ignore", invalid="ignore"):
        steep = np.where(change > SHIFT_TOLERANCE_M, change / way, 0.0)
    where = [f"from point {a:g} to {b:g}" for a, b in zip(shift.index[:-1], shift.index[1:], strict=True)]
    return ShiftComparison(
        name="compensation smooth",
        unit="mm per mm of path",
        limit=MAX_SHIFT_SLOPE,
        values=np.append(steep[inside], 0.0),
        where=(*(w for w, use in zip(where, inside, strict=True) if use), "nowhere"),
    )


def _check_bound(shift: ExportedShift, options: PlanOptions) -> ShiftComparison:
    size = 1e3 * np.linalg.norm(shift.offset, axis=1)
    return ShiftComparison(
        name="compensation bounded",
        unit="mm",
        limit=1e3 * options.compensation_max + TABLE_TOLERANCE_MM,
        values=size,
        where=tuple(f"point {k:g}" for k in shift.index),
    )


def _compare_tables(
    toolpath: Toolpath, points: ExportedPoints, shift: ExportedShift, row_of: dict[int, int]
) -> ShiftComparison:
    """The shift of points.csv is that of compensation.csv, which knows every point."""
    name = "points.csv and compensation.csv"
    lacking = sorted(set(range(len(toolpath))) - set(row_of))
    if lacking or points.shift is None:
        stated = (f"compensation.csv lacks point {lacking[:1]}",)
        return ShiftComparison(
            name=name,
            unit="mm",
            limit=TABLE_TOLERANCE_MM,
            values=np.array([np.inf]),
            where=stated,
            file="compensation.csv",
        )
    known = [n for n, k in enumerate(points.point.tolist()) if k in row_of]
    at = [row_of[int(points.point[n])] for n in known]
    apart = 1e3 * np.linalg.norm(points.shift[known] - shift.offset[at], axis=1)
    return ShiftComparison(
        name=name,
        unit="mm",
        limit=TABLE_TOLERANCE_MM,
        values=apart,
        where=tuple(f"point {points.point[n]}" for n in known),
        file="points.csv",
    )


def _find_cutting_joints(
    motion: ExportedMotion, points: ExportedPoints, shift: ExportedShift, rows: NDArray[np.int64]
) -> dict[int, Array]:
    """Joints (6 + E,), arm joints first, with which each of these corners is cut: between two samples of the motion,
    else of points.csv."""
    driven, planned = (np.hstack([of.q, of.external]) for of in (motion, points))
    cuts = np.flatnonzero((motion.move != MoveKind.RAPID) & np.isfinite(motion.point))
    s = np.maximum.accumulate(motion.point[cuts]) if len(cuts) else np.empty(0)
    stated = {
        k: q for k, q, status in zip(points.point.tolist(), planned, points.status, strict=True) if status == "ok"
    }
    out: dict[int, Array] = {}
    for row in rows.tolist():
        x = float(shift.index[row])
        b = min(int(np.searchsorted(s, x)), len(s) - 1)
        a = max(b - 1, 0)
        if s[a] <= x <= s[b] and cuts[b] - cuts[a] <= 1:
            f = (x - s[a]) / (s[b] - s[a]) if s[b] > s[a] else 1.0
            out[row] = driven[cuts[a]] + f * (driven[cuts[b]] - driven[cuts[a]])
        elif round(x) in stated and abs(x - round(x)) < 1e-6 and np.isfinite(stated[round(x)]).all():
            out[row] = stated[round(x)]
    return out


def _compare_force(toolpath: Toolpath, shift: ExportedShift, options: PlanOptions) -> ShiftComparison:
    """Force of the file against the options' along the toolpath, at the lengths of the list that fit it best."""
    name, o = "process force", options.force
    if not o.given:
        return ShiftComparison(
            name=name,
            unit="N",
            limit=FORCE_TOLERANCE,
            values=np.empty(0),
            where=(),
            not_run="no force is given here; --set force_N={…} as in the run would",
        )
    off = compute_force_errors(toolpath, shift.index, shift.force, options)
    best, limit = min(off.values(), key=lambda values: float(values.max())), compute_force_tolerance(toolpath, options)
    return ShiftComparison(
        name=name, unit="N", limit=limit, values=best, where=tuple(f"point {k:g}" for k in shift.index)
    )


def compute_force_tolerance(toolpath: Toolpath, options: PlanOptions) -> float:
    """Return by how much a stated force may miss the recomputed one, N.

    Args:
        toolpath: The toolpath, points in the workpiece frame, SI.
        options: The planning options in force.
    """
    o = options.force
    size = float(np.sqrt(o.travel**2 + o.normal**2 + o.axial**2))
    if toolpath.force is not None:
        size = max(size, float(np.nan_to_num(np.linalg.norm(toolpath.force, axis=1)).max()))
    return FORCE_TOLERANCE * size


def compute_force_errors(
    toolpath: Toolpath, index: Array, force: Array, options: PlanOptions
) -> dict[tuple[float, float], Array]:
    """Return by how much a stated force misses the recomputed one, (P,) N, for each pair of lengths to turn and fade.

    Args:
        toolpath: The toolpath, points in the workpiece frame, SI.
        index: (P,) fractional toolpath indices.
        force: (P, 3) N in workpiece, the stated force.
        options: The planning options in force.
    """
    shares = {fade: compute_engaged_share(toolpath, index, fade) for fade in WINDOW_LENGTHS_M}
    means = {turn: compute_mean_force(toolpath, index, options.force, turn) for turn in WINDOW_LENGTHS_M}
    return {
        (turn, fade): np.linalg.norm(force - share[:, None] * mean, axis=1)
        for turn, mean in means.items()
        for fade, share in shares.items()
    }


def _compare_deflection(
    cell: Cell, toolpath: Toolpath, joints: dict[int, Array], shift: ExportedShift, arm: UrdfKinematics
) -> ShiftComparison:
    name, limit = "compensation", 1.0
    unit = f"of {100 * RELATIVE:g} % and {1e3 * ABSOLUTE_MM:g} µm"
    if cell.stiffness is None:
        return ShiftComparison(
            name=name, unit=unit, limit=limit, values=np.empty(0), where=(), not_run="the cell names no stiffness"
        )
    if not joints:
        return ShiftComparison(
            name=name, unit=unit, limit=limit, values=np.empty(0), where=(), not_run="no corner of the path is cut"
        )
    try:
        law = ComplianceModel(cell, arm, cell.stiffness)
    except UnknownTermError as error:
        return ShiftComparison(
            name=name,
            unit=unit,
            limit=limit,
            values=np.empty(0),
            where=(),
            not_run=f"no second law is written for {error}",
        )
    index, commanded = compute_commanded_corners(toolpath, shift)
    rows, x = np.array(list(joints)), np.array(list(joints.values()))
    stance, T = arm.compute_configuration(x[:, :6], x[:, 6:]), arm.T_base_workpiece(x[:, 6:])
    R = T[:, :3, :3]
    programmed = np.einsum("nij,nj->ni", R, commanded[rows] - shift.offset[rows]) + T[:, :3, 3]
    d = law.evaluate(stance, programmed).compute_displacement(np.einsum("nij,nj->ni", R, shift.force[rows]))
    d = np.einsum("nji,nj->ni", R, d)
    size = np.linalg.norm(d, axis=1)
    off = np.linalg.norm(shift.offset[rows] + d, axis=1) / (RELATIVE * size + ABSOLUTE_MM * 1e-3)
    return ShiftComparison(
        name=name, unit=unit, limit=limit, values=off, where=tuple(f"point {index[row]:g}" for row in joints)
    )
