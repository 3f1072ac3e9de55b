"""Check that external joints are where the user wants them: at the points of points.csv and in between.

Between two points of one steering rule, the samples of trajectory.csv are checked where the tool is not in rapid
motion.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from machopt.data_types.cell import Cell
from machopt.data_types.plan_options import ExternalJointOptions, PlanOptions, SteeringRule
from machopt.data_types.steering_rules import (
    find_external_joint,
    list_steered_stretches,
    resolve_steering,
    select_steered_rows,
)
from machopt.data_types.toolpath import MoveKind, Toolpath
from machopt.numerics.array_types import Array
from machopt.verification.check_results import VerificationCheck, build_worst_value_check
from machopt.verification.tables.exported_tables import ExportedMotion, ExportedPoints

POSITION_TOLERANCE = {
    "mm": 0.05,
    "deg": 0.005,
}  # as near as this: a joint that moves follows a curve through the points


@dataclass(frozen=True)
class _PositionErrors:
    """Deviations of joints from the requested positions, with their places."""

    off: list[float]
    where: list[str]


def check_external_joint_positions(
    cell: Cell,
    toolpath: Toolpath,
    points: ExportedPoints,
    rows: NDArray[np.intp],
    options: PlanOptions,
    motion: ExportedMotion,
) -> list[VerificationCheck]:
    """Return one check for each unit of the requested positions; none without requests.

    Args:
        cell: The robot cell.
        toolpath: The toolpath, points in the workpiece frame, SI.
        points: The exported points (points.csv), SI.
        rows: Rows of the points that are driven.
        options: The planning options in force.
        motion: The exported motion (trajectory.csv), SI.
    """
    wishes = [w for w in resolve_steering(options, toolpath).steer if w.joint]
    pinned = {find_external_joint(w.joint, cell.external_joints) for w in wishes if w.at is not None}
    for axis in options.external:
        locked = find_external_joint(axis.joint, cell.external_joints) not in pinned
        wishes += _list_joint_wishes(axis, toolpath, locked=locked)
    seen = {unit: _PositionErrors([], []) for unit in POSITION_TOLERANCE}
    for wish in wishes:
        k = find_external_joint(wish.joint, cell.external_joints)
        if k is not None:
            _collect_errors(wish, k, points, rows, motion, seen["mm" if cell.external_prismatic[k] else "deg"])
    return [
        build_worst_value_check(
            f"requested: external joints, {unit}", f"{unit} off", np.array(s.off), POSITION_TOLERANCE[unit], s.where
        )
        for unit, s in seen.items()
        if s.off
    ]


def _list_joint_wishes(axis: ExternalJointOptions, toolpath: Toolpath, *, locked: bool) -> list[SteeringRule]:
    """What the options of a joint say of its place, laid down at points."""
    out = []
    for label, value in axis.at_operations:
        wish = SteeringRule(operation=label, joint=axis.joint, at=value, unit=axis.unit)
        out += [replace(wish, operation="", points=ends) for ends in list_steered_stretches(wish, toolpath)]
    if locked and axis.mode == "locked" and axis.at is not None and not axis.operations and not axis.at_operations:
        out.append(SteeringRule(points=(0, len(toolpath) - 1), joint=axis.joint, at=axis.at, unit=axis.unit))
    return out


def _collect_errors(
    wish: SteeringRule,
    k: int,
    points: ExportedPoints,
    rows: NDArray[np.intp],
    motion: ExportedMotion,
    position_errors: _PositionErrors,
) -> None:
    """The points of a wish, and the samples between the first and the last of them."""
    here = rows[select_steered_rows(wish, points.point[rows])]
    between = select_steered_rows(wish, motion.point)
    between = between[motion.move[between] != MoveKind.RAPID]
    for off, stated in (
        (_compute_deviation(wish, points.external[here, k]), [f"point {points.point[n]}" for n in here]),
        (_compute_deviation(wish, motion.external[between, k]), [motion.describe_row(n) for n in between]),
    ):
        if len(off):
            n = int(np.argmax(np.where(np.isnan(off), np.inf, off)))
            position_errors.off.append(float(off[n]))
            position_errors.where.append(stated[n])


def _compute_deviation(wish: SteeringRule, value: Array) -> Array:
    """mm or degrees from the place, or into the zone."""
    off = np.zeros(len(value))
    if wish.at is not None:
        off = np.abs(value - wish.at)
    if wish.away is not None:
        off = np.maximum(np.minimum(value - wish.away[0], wish.away[1] - value), 0.0)
    return off * 1e3 if wish.unit == "mm" else np.degrees(off)
