"""The index along the cuts, between the points too: by the laws of :mod:`elastic`, where trajectory.csv has the arm.

On a long move the softest place may lie between two points of the CAM file, which points.csv does not hold.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from machopt.arrays import Array
from machopt.domain.cell import Cell
from machopt.domain.options import PlanOptions
from machopt.domain.toolpath import Move, Toolpath
from machopt.verify import elastic, reference
from machopt.verify.arm import Arm
from machopt.verify.axis_interpolation import interpolate_axis
from machopt.verify.encoder import true_angles
from machopt.verify.engage import sideways
from machopt.verify.points import ROWS, turned
from machopt.verify.table import Motion

APART = np.radians(0.5)  # rad of joints together (m of slides likewise) between two samples that are looked at


def softest(cell: Cell, toolpath: Toolpath, motion: Motion, index: str, options: PlanOptions) -> float:
    """The worst index along the cuts of one tool, less is better: m (deflection) or m/N; NaN: nothing is cut or known.

    Args:
        index: deflection, stiffness or jiao2022.

    Raises:
        UnknownTermError: a term that nothing here has a law for.
    """
    rows = _looked_at(toolpath, motion)
    if cell.stiffness is None or not len(rows):
        return np.nan
    arm, at, first = Arm(cell), motion.point[rows], np.arange(len(toolpath), dtype=float)
    dense, nth = _with_places(toolpath, np.union1d(first, at)), np.searchsorted(np.union1d(first, at), at)
    law, o = elastic.Elasticity(cell, arm, cell.stiffness), options.force
    axis, pull, travel = dense.axis[nth], sideways(dense)[nth], reference.at_points(dense).travel[nth]
    drilling = np.array([p.kind == "point" for p in dense.operations])[dense.operation[nth]]
    q, external = true_angles(cell.kinematics, motion.q[rows]), motion.external[rows]
    worst = -np.inf
    for a in range(0, len(rows), ROWS):
        some = slice(a, a + ROWS)
        T, e = arm.T_base_workpiece(external[some]), axis[some]
        soft = law.at(arm.stance(q[some], external[some]), turned(T, dense.position[nth[some]]) + T[:, :3, 3])
        if index == "deflection":
            force = turned(T, elastic.force_at(pull[some], e, o.travel, o.normal, o.axial))
            cost = np.linalg.norm(soft.displacement(force), axis=1)
        elif index == "jiao2022":
            cost = 1.0 / soft.held(turned(T, e))
        else:
            axial = 1.0 / soft.along(turned(T, e))
            across = 1.0 / soft.along(turned(T, np.cross(e, travel[some])))
            cost = np.where(drilling[some], axial, 0.5 * (axial + across))
        worst = max(worst, float(cost.max()))
    return worst


def _looked_at(toolpath: Toolpath, motion: Motion) -> NDArray[np.intp]:
    """Samples on cuts, as far apart as :data:`APART`."""
    known = np.isfinite(motion.point) & (motion.move == Move.CUT)
    x = np.hstack([motion.q, motion.external])
    way = np.r_[0.0, np.cumsum(np.abs(np.diff(x, axis=0)).sum(axis=1))]
    rows = np.flatnonzero(known)
    at = motion.point[rows]
    toward = np.clip(np.ceil(at - reference.SAME), 0, len(toolpath) - 1).astype(int)
    rows = rows[toolpath.cutting[toward] & (at >= 0.0) & (at <= len(toolpath) - 1)]
    apart = np.diff(np.floor(way[rows] / APART), prepend=-1.0) > 0
    return np.asarray(rows[apart])


def _with_places(toolpath: Toolpath, index: Array) -> Toolpath:
    """The same path with points at fractional indices (M,), which hold all whole ones."""
    high = np.ceil(index).astype(int)
    low = np.maximum(high - 1, 0)
    f = np.where(high > low, index - low, 1.0)[:, None]
    return replace(
        toolpath,
        position=(1.0 - f) * toolpath.position[low] + f * toolpath.position[high],
        axis=interpolate_axis(toolpath.axis[low], toolpath.axis[high], f[:, 0]),
        move=toolpath.move[high],
        feed=toolpath.feed[high],
        operation=toolpath.operation[high],
        reference=toolpath.reference[np.floor(index).astype(int)],
        tolerance=toolpath.tolerance[high],
        line=toolpath.line[high],
        events=(),
    )
