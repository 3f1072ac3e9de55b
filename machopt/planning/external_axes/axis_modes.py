"""Use of the external joints: the options of each, checked against the cell."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import fields, replace

import numpy as np

from machopt.data_types.cell import Cell
from machopt.data_types.plan_options import ExternalJointOptions, PlanOptions
from machopt.data_types.steering_rules import find_external_joint
from machopt.errors import CellError, suggest_nearest_word


def resolve_axis_options(cell: Cell, options: PlanOptions) -> tuple[ExternalJointOptions, ...]:
    """Return the options of each external joint, in the order of the cell.

    Args:
        cell: cell with the external joints.
        options: plan options with ``external``.

    Raises:
        InputError: an option names no external joint, has another joint's unit, or a value out of the joint's range.
    """
    names = list(cell.external_joints)
    by_name = {name: ExternalJointOptions(joint=name) for name in names}
    for axis in options.external:
        name = _name(axis, names)
        k = names.index(name)
        unit = "mm" if cell.external_prismatic[k] else "deg"
        if axis.unit not in ("", unit):
            raise CellError(
                f"{name!r} {'slides' if unit == 'mm' else 'turns'}: values in {unit} would work, found {axis.unit}",
                file="options",
                where=f"external.{axis.joint}",
            )
        # both "rail" (name in the cell) and "e1": the later option overrides the earlier one
        changed = {f.name: getattr(axis, f.name) for f in fields(axis) if getattr(axis, f.name) != f.default}
        by_name[name] = replace(by_name[name], **changed)
        now = by_name[name]
        if now.at is not None and not now.mode and not now.locks:
            raise CellError(
                f"at_{unit} is the position of a locked joint, and {name!r} may move; mode: locked would work",
                file="options",
                where=f"external.{axis.joint}.at_{unit}",
            )
        _check_within_range(cell, k, now)
    return tuple(by_name[name] for name in names)


def compute_axis_range(cell: Cell, k: int, axis: ExternalJointOptions, *, locked: bool) -> tuple[float, float]:
    """Return the permitted range of one external joint in m or rad; both ends are equal where it is locked.

    Args:
        cell: cell with limits and home of the joint.
        k: index of the external joint.
        axis: options of the joint.
        locked: whether the joint keeps ``axis.at``, or its home where that is not given.
    """
    if locked:
        at = float(cell.external_home[k]) if axis.at is None else axis.at
        return at, at
    low, high = _get_limits(cell, k)
    a, b = axis.range or (low, high)
    return max(a, low), min(b, high)


def _name(axis: ExternalJointOptions, names: Sequence[str]) -> str:
    """Return the joint's own name, which may also be given as e1, e2 …."""
    k = find_external_joint(axis.joint, names)
    if k is None:
        what = suggest_nearest_word(axis.joint, [*names, *(f"e{k + 1}" for k in range(len(names)))])
        raise CellError(
            f"{axis.joint!r} is no external joint of the cell; {what if names else 'it has none'}",
            file="options",
            where=f"external.{axis.joint}",
        )
    return names[k]


def _check_within_range(cell: Cell, k: int, axis: ExternalJointOptions) -> None:
    """Refuse values out of the joint's range."""
    unit, per = ("mm", 1e3) if cell.external_prismatic[k] else ("deg", float(np.degrees(1.0)))
    low, high = _get_limits(cell, k)
    joint, there = cell.external_joints[k], f"[{low * per:g}, {high * per:g}]"
    values = [("at", axis.at), ("preferred", axis.preferred), *(("at_operations", v) for _, v in axis.at_operations)]
    for key, value in values:
        if value is not None and not low - 1e-9 <= value <= high + 1e-9:  # m or rad; round-off of the file's numbers
            raise CellError(
                f"found {value * per:g} {unit}; the range of {joint!r} is {there}",
                file="options",
                where=f"external.{axis.joint}.{key}_{unit}",
            )
    if axis.range is not None and max(axis.range[0], low) > min(axis.range[1], high):
        a, b = axis.range
        raise CellError(
            f"found [{a * per:g}, {b * per:g}] {unit}, outside the range {there} of {joint!r}",
            file="options",
            where=f"external.{axis.joint}.range_{unit}",
        )


def _get_limits(cell: Cell, k: int) -> tuple[float, float]:
    return float(cell.limits.lower[6 + k]), float(cell.limits.upper[6 + k])
