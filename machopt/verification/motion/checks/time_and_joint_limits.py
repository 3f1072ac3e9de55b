"""Checks of the time column, joint limits by differences of samples, and the first and last position."""

from __future__ import annotations

import numpy as np

from machopt.data_types.cell import Cell
from machopt.data_types.plan_options import PlanOptions
from machopt.numerics.array_types import Array
from machopt.verification.check_results import CheckName, VerificationCheck, build_worst_value_check
from machopt.verification.tables.exported_tables import ExportedMotion

VELOCITY, ACCELERATION, JERK = 1.01, 1.03, 1.10  # differences over the limits: rounding grows with the order
TIME_TOLERANCE_S = 5e-6  # of the control cycle: the time column is rounded
ARM_AXES = 6  # axes of the arm, before the external ones
HOME_TOLERANCE_DEG = 1e-6  # joints are printed with nine decimals


def check_limits(
    motion: ExportedMotion, cell: Cell, options: PlanOptions, ends: tuple[Array, Array]
) -> list[VerificationCheck]:
    """Check joint limits, and rest before the first and after the last sample; columns and limits are encoder angles.

    Args:
        motion: The exported motion (trajectory.csv), SI.
        cell: The robot cell.
        options: The planning options in force.
        ends: (6 + E,) first and last position of the motion, rad or m.
    """
    return [*_check_time(motion, options), _check_home(motion, ends), *_check_joint_limits(motion, cell)]


def _check_time(motion: ExportedMotion, options: PlanOptions) -> list[VerificationCheck]:
    step = np.diff(motion.time)
    off = np.abs(step - motion.sample_time)
    n = int(np.argmax(off))
    even = VerificationCheck(
        name="uniform time",
        passed=bool(off[n] <= TIME_TOLERANCE_S),
        value=float(off[n]),
        limit=TIME_TOLERANCE_S,
        unit="s",
        where=motion.describe_row(n + 1),
    )
    wrong = np.array([abs(motion.sample_time - options.sample), abs(motion.time[0])])
    stated = (f"{1e3 * motion.sample_time:g} ms from row to row, {1e3 * options.sample:g} requested", "the first row")
    return [even, build_worst_value_check("control cycle and start", "s", wrong, TIME_TOLERANCE_S, stated)]


def _check_home(motion: ExportedMotion, wanted: tuple[Array, Array]) -> VerificationCheck:
    ends = motion.joints[[0, -1]]
    off = np.degrees(np.abs(ends - np.array(wanted)).max(axis=1))  # a metre of a slide counts as a radian
    return build_worst_value_check(
        "from home to home", "deg", off, HOME_TOLERANCE_DEG, ("the first row", "the last row")
    )


def _check_joint_limits(motion: ExportedMotion, cell: Cell) -> list[VerificationCheck]:
    q = motion.joints
    limits = cell.limits
    beyond = np.maximum(limits.lower - q, q - limits.upper)
    n, j = np.unravel_index(np.argmax(beyond), beyond.shape)
    slides = j >= len(cell.home) and cell.external_prismatic[j - len(cell.home)]
    far = float(1e3 * beyond[n, j] if slides else np.degrees(beyond[n, j]))
    unit = "mm" if slides else "deg"
    out = [
        VerificationCheck(
            name="joint positions",
            passed=bool(beyond[n, j] <= 1e-8),
            value=far,
            limit=0.0,
            unit=f"{unit} beyond the limit",
            where=f"{format_axis_name(int(j))}, {motion.describe_row(int(n))}",
            beyond=unit,
        )
    ]
    x = np.vstack([np.repeat(q[:1], 3, axis=0), q, np.repeat(q[-1:], 3, axis=0)])
    orders = (
        (CheckName.VELOCITY, limits.velocity, VELOCITY),
        (CheckName.ACCELERATION, limits.acceleration, ACCELERATION),
        (CheckName.JERK, limits.jerk, JERK),
    )
    for name, limit, most in orders:
        x = np.diff(x, axis=0) / motion.sample_time
        ratio = np.abs(x) / limit
        n, j = np.unravel_index(np.argmax(ratio), ratio.shape)
        where = f"{format_axis_name(int(j))}, {motion.describe_row(int(np.clip(n - 2, 0, len(q) - 1)))}"
        out.append(
            VerificationCheck(
                name=name,
                passed=bool(ratio[n, j] <= most),
                value=float(ratio[n, j]),
                limit=most,
                unit="of the limit",
                where=where,
            )
        )
    return out


def format_axis_name(j: int) -> str:
    """Return the name of an axis as reports print it.

    Args:
        j: Number of the axis from 0: arm axes first, then external joints.
    """
    return f"axis {j + 1}" if j < ARM_AXES else f"external axis e{j + 1 - ARM_AXES}"
