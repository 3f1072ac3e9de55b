"""A path shifted against the predicted deflection: what was shifted, against which force, and whether that is right.

The deflection is computed again by :mod:`machopt.verify.elastic`.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from machopt.domain.cell import Cell
from machopt.domain.options import PlanOptions
from machopt.domain.toolpath import Move, Toolpath
from machopt.verify.arm import Arm
from machopt.verify.elastic import Elasticity
from machopt.verify.springs import UnknownTermError
from machopt.verify.table import Motion, Points, Shift

Array = NDArray[np.float64]
RELATIVE, ABSOLUTE_MM = 0.02, 0.002  # of the deflection, which the last smoothing of the rotation changes a little
FORCE_N = 0.01  # the file has six decimals; the rest is the direction of travel at short steps
SAME_MM = 1e-5  # the same number in both files
ALONG = np.cos(np.radians(1.0))  # a step this near the tool axis is a plunge


@dataclass(frozen=True)
class Found:
    """One comparison: a value per place; none where it could not be made, with the reason."""

    name: str
    unit: str
    limit: float
    values: Array  # (n,)
    where: tuple[str, ...]  # (n,)
    not_run: str = ""


def corners(toolpath: Toolpath, shift: Shift) -> tuple[Array, Array]:
    """Index (P,) and position (P, 3) m of the commanded polyline's corners in the workpiece frame."""
    every = np.arange(len(toolpath), dtype=float)
    line = np.column_stack([np.interp(shift.index, every, toolpath.position[:, c]) for c in range(3)])
    return shift.index, line + shift.offset


def compare_shift(
    cell: Cell, toolpath: Toolpath, motion: Motion, points: Points, shift: Shift, arm: Arm, options: PlanOptions
) -> list[Found]:
    """Both files agree, the force is the stated one, and the shift is minus the deflection that force causes."""
    number = np.round(shift.index).astype(int)
    whole = np.abs(shift.index - number) < 1e-6
    row_of = dict(zip(number[whole].tolist(), np.flatnonzero(whole).tolist(), strict=True))
    cut = toolpath.cutting[np.clip(np.ceil(shift.index - 1e-9).astype(int), 0, len(toolpath) - 1)]
    return [
        _same(toolpath, points, shift, row_of),
        _force(toolpath, number[whole & cut], shift.force[whole & cut], options),
        _deflection(cell, toolpath, _joints(motion, points, shift, np.flatnonzero(cut)), shift, arm),
    ]


def _same(toolpath: Toolpath, points: Points, shift: Shift, row_of: dict[int, int]) -> Found:
    """The shift of points.csv is that of compensation.csv, which knows every point."""
    name = "points.csv and compensation.csv"
    lacking = sorted(set(range(len(toolpath))) - set(row_of))
    if lacking or points.shift is None:
        return Found(name, "mm", SAME_MM, np.array([np.inf]), (f"compensation.csv lacks point {lacking[:1]}",))
    known = [n for n, k in enumerate(points.point.tolist()) if k in row_of]
    at = [row_of[int(points.point[n])] for n in known]
    apart = 1e3 * np.linalg.norm(points.shift[known] - shift.offset[at], axis=1)
    return Found(name, "mm", SAME_MM, apart, tuple(f"point {points.point[n]}" for n in known))


def _joints(motion: Motion, points: Points, shift: Shift, rows: NDArray[np.int64]) -> dict[int, Array]:
    """Joints (6,) with which each of these corners is cut: between two samples of the motion, else of points.csv."""
    cuts = np.flatnonzero(motion.move == Move.CUT)
    s = motion.point[cuts]
    told = dict(zip(points.point.tolist(), points.q, strict=True))
    out: dict[int, Array] = {}
    for row in rows.tolist():
        x = float(shift.index[row])
        b = min(int(np.searchsorted(s, x)), len(s) - 1)
        a = max(b - 1, 0)
        if s[a] <= x <= s[b] and cuts[b] - cuts[a] <= 1:
            f = (x - s[a]) / (s[b] - s[a]) if s[b] > s[a] else 1.0
            out[row] = motion.q[cuts[a]] + f * (motion.q[cuts[b]] - motion.q[cuts[a]])
        elif round(x) in told and abs(x - round(x)) < 1e-6 and np.isfinite(told[round(x)]).all():
            out[row] = told[round(x)]
    return out


def _force(toolpath: Toolpath, point: NDArray[np.int64], force: Array, options: PlanOptions) -> Found:
    """Force of the file against the options': its size and axial part everywhere, its direction where the path has one.

    The direction of travel is that of the cut that leaves the point, where one does that is no plunge.
    """
    name = "process force"
    if not options.force.given:
        return Found(
            name, "N", FORCE_N, np.empty(0), (), "no force is given here; --set force_N={…} as in the run would"
        )
    p, n = toolpath.position, toolpath.axis[point]
    axial = np.einsum("ij,ij->i", force, n)
    across = force - axial[:, None] * n
    o = options.force
    off = np.hypot(axial - o.axial, np.linalg.norm(across, axis=1) - np.hypot(o.travel, o.normal))
    after = np.minimum(point + 1, len(p) - 1)
    step = p[after] - p[point]
    size = np.linalg.norm(step, axis=1)
    level = step - np.einsum("ij,ij->i", step, n)[:, None] * n
    width = np.linalg.norm(level, axis=1)
    known = (
        (after > point) & (toolpath.move[after] == Move.CUT) & (size > 1e-5) & (width > np.sqrt(1 - ALONG**2) * size)
    )
    t = level[known] / width[known, None]
    wanted = o.travel * t + o.normal * np.cross(n[known], t)
    off[known] = np.maximum(off[known], np.linalg.norm(across[known] - wanted, axis=1))
    return Found(name, "N", FORCE_N, off, tuple(f"point {k}" for k in point))


def _deflection(cell: Cell, toolpath: Toolpath, joints: dict[int, Array], shift: Shift, arm: Arm) -> Found:
    name, limit = "compensation", 1.0
    unit = f"of {100 * RELATIVE:g} % and {1e3 * ABSOLUTE_MM:g} µm"
    if cell.stiffness is None:
        return Found(name, unit, limit, np.empty(0), (), "the cell names no stiffness")
    if not joints:
        return Found(name, unit, limit, np.empty(0), (), "no corner of the path is cut")
    try:
        law = Elasticity(cell, arm, cell.stiffness)
    except UnknownTermError as error:
        return Found(name, unit, limit, np.empty(0), (), f"no second law is written for {error}")
    index, commanded = corners(toolpath, shift)
    rows, T = np.array(list(joints)), arm.T_base_workpiece
    R = T[:3, :3]
    programmed = (commanded[rows] - shift.offset[rows]) @ R.T + T[:3, 3]
    d = law.at(arm.stance(np.array(list(joints.values()))), programmed).displacement(shift.force[rows] @ R.T) @ R
    size = np.linalg.norm(d, axis=1)
    off = np.linalg.norm(shift.offset[rows] + d, axis=1) / (RELATIVE * size + ABSOLUTE_MM * 1e-3)
    return Found(name, unit, limit, off, tuple(f"point {index[row]:g}" for row in joints))
