"""Whether external joints stand where the user wants them: at the points of points.csv and in between.

Between two points of one wish the samples of trajectory.csv are looked at, where the tool is not in rapid motion.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from machopt.arrays import Array
from machopt.domain.cell import Cell
from machopt.domain.options import ExternalAxis, PlanOptions, Steer
from machopt.domain.steering import among, numbered, steered, stretches
from machopt.domain.toolpath import Move, Toolpath
from machopt.verify.check import Check, worst
from machopt.verify.table import Motion, Points

PLACE = {"mm": 0.05, "deg": 0.005}  # as near as this: a joint that moves follows a curve through the points


@dataclass(frozen=True)
class _Seen:
    """How far joints stand from what was asked, and where."""

    off: list[float]
    where: list[str]


def check_stands(
    cell: Cell, toolpath: Toolpath, points: Points, rows: NDArray[np.intp], options: PlanOptions, motion: Motion
) -> list[Check]:
    """One check for each unit of the places asked for; none where none were.

    Args:
        rows: of the points, those that are driven.
    """
    wishes = [w for w in steered(options, toolpath).steer if w.joint]
    pinned = {numbered(w.joint, cell.external_joints) for w in wishes if w.at is not None}
    for axis in options.external:
        locked = numbered(axis.joint, cell.external_joints) not in pinned
        wishes += _of_axis(axis, toolpath, locked=locked)
    seen = {unit: _Seen([], []) for unit in PLACE}
    for wish in wishes:
        k = numbered(wish.joint, cell.external_joints)
        if k is not None:
            _look(wish, k, points, rows, motion, seen["mm" if cell.external_prismatic[k] else "deg"])
    return [
        worst(f"as asked: external joints, {unit}", f"{unit} off", np.array(s.off), PLACE[unit], s.where)
        for unit, s in seen.items()
        if s.off
    ]


def _of_axis(axis: ExternalAxis, toolpath: Toolpath, *, locked: bool) -> list[Steer]:
    """What the options of a joint say of its place, laid down at points."""
    out = []
    for label, value in axis.at_operations:
        wish = Steer(operation=label, joint=axis.joint, at=value, unit=axis.unit)
        out += [replace(wish, operation="", points=ends) for ends in stretches(wish, toolpath)]
    if locked and axis.mode == "locked" and axis.at is not None and not axis.operations and not axis.at_operations:
        out.append(Steer(points=(0, len(toolpath) - 1), joint=axis.joint, at=axis.at, unit=axis.unit))
    return out


def _look(wish: Steer, k: int, points: Points, rows: NDArray[np.intp], motion: Motion, seen: _Seen) -> None:
    """The points of a wish, and the samples between the first and the last of them."""
    here = rows[among(wish, points.point[rows])]
    between = among(wish, motion.point)
    between = between[motion.move[between] != Move.RAPID]
    for off, told in (
        (_off(wish, points.external[here, k]), [f"point {points.point[n]}" for n in here]),
        (_off(wish, motion.external[between, k]), [motion.at(n) for n in between]),
    ):
        if len(off):
            n = int(np.argmax(np.where(np.isnan(off), np.inf, off)))
            seen.off.append(float(off[n]))
            seen.where.append(told[n])


def _off(wish: Steer, value: Array) -> Array:
    """mm or degrees from the place, or into the zone."""
    off = np.zeros(len(value))
    if wish.at is not None:
        off = np.abs(value - wish.at)
    if wish.away is not None:
        off = np.maximum(np.minimum(value - wish.away[0], wish.away[1] - value), 0.0)
    return off * 1e3 if wish.unit == "mm" else np.degrees(off)
