"""Worst stiffness index along the cuts, also between the points, by the laws of :mod:`arm_compliance`.

On a long move the most compliant place may lie between two points of the CAM file. points.csv does not hold it.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from machopt.data_types.cell import Cell
from machopt.data_types.plan_options import PlanOptions
from machopt.data_types.toolpath import MoveKind, Toolpath
from machopt.numerics.array_types import Array
from machopt.verification.motion.checks.points_columns import BLOCK_ROWS, rotate_vectors
from machopt.verification.motion.kinematics.encoder_correction import compute_true_angles
from machopt.verification.motion.kinematics.urdf_kinematics import UrdfKinematics
from machopt.verification.motion.path_geometry import reference_direction
from machopt.verification.motion.path_geometry.axis_interpolation import interpolate_axis
from machopt.verification.motion.path_geometry.process_force import compute_sideways_directions
from machopt.verification.motion.stiffness import arm_compliance
from machopt.verification.tables.exported_tables import ExportedMotion

SAMPLE_SPACING_RAD = np.radians(0.5)  # rad of joints together (m of slides likewise) between two evaluated samples


def find_worst_index(cell: Cell, toolpath: Toolpath, motion: ExportedMotion, index: str, options: PlanOptions) -> float:
    """Return the worst index along the cuts of one tool, less is better: m (deflection) or m/N; NaN without cuts.

    Args:
        cell: The robot cell.
        toolpath: The toolpath, points in the workpiece frame, SI.
        motion: The exported motion (trajectory.csv), SI.
        index: Deflection, stiffness or jiao2022.
        options: The planning options in force.

    Raises:
        UnknownTermError: the stiffness file has a term without a law here.
    """
    rows = _select_samples(toolpath, motion)
    if cell.stiffness is None or not len(rows):
        return np.nan
    arm, at, first = UrdfKinematics(cell), motion.point[rows], np.arange(len(toolpath), dtype=float)
    dense, nth = _insert_points(toolpath, np.union1d(first, at)), np.searchsorted(np.union1d(first, at), at)
    law, o = arm_compliance.ComplianceModel(cell, arm, cell.stiffness), options.force
    axis, pull, travel = (
        dense.axis[nth],
        compute_sideways_directions(dense)[nth],
        reference_direction.compute_directions_at_points(dense).travel[nth],
    )
    drilling = np.array([p.kind == "point" for p in dense.operations])[dense.operation[nth]]
    q, external = compute_true_angles(cell.kinematics, motion.q[rows]), motion.external[rows]
    worst = -np.inf
    for a in range(0, len(rows), BLOCK_ROWS):
        some = slice(a, a + BLOCK_ROWS)
        T, e = arm.T_base_workpiece(external[some]), axis[some]
        soft = law.evaluate(
            arm.compute_configuration(q[some], external[some]),
            rotate_vectors(T, dense.position[nth[some]]) + T[:, :3, 3],
        )
        if index == "deflection":
            own = None if dense.force is None else dense.force[nth[some]]
            force = rotate_vectors(T, arm_compliance.compute_force(pull[some], e, *o.resolve_components(own)))
            cost = np.linalg.norm(soft.compute_displacement(force), axis=1)
        elif index == "jiao2022":
            cost = 1.0 / soft.compute_jiao_stiffness(rotate_vectors(T, e))
        else:
            axial = 1.0 / soft.compute_stiffness_along(rotate_vectors(T, e))
            across = 1.0 / soft.compute_stiffness_along(rotate_vectors(T, np.cross(e, travel[some])))
            cost = np.where(drilling[some], axial, 0.5 * (axial + across))
        worst = max(worst, float(cost.max()))
    return worst


def _select_samples(toolpath: Toolpath, motion: ExportedMotion) -> NDArray[np.intp]:
    """Samples on cuts, as far apart as :data:`SAMPLE_SPACING_RAD`."""
    known = np.isfinite(motion.point) & (motion.move == MoveKind.CUT)
    x = motion.joints
    way = np.r_[0.0, np.cumsum(np.abs(np.diff(x, axis=0)).sum(axis=1))]
    rows = np.flatnonzero(known)
    at = motion.point[rows]
    toward = np.clip(np.ceil(at - reference_direction.INDEX_TOLERANCE), 0, len(toolpath) - 1).astype(int)
    rows = rows[toolpath.cutting[toward] & (at >= 0.0) & (at <= len(toolpath) - 1)]
    apart = np.diff(np.floor(way[rows] / SAMPLE_SPACING_RAD), prepend=-1.0) > 0
    return np.asarray(rows[apart])


def _insert_points(toolpath: Toolpath, index: Array) -> Toolpath:
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
        force=None if toolpath.force is None else toolpath.force[high],
        events=(),
    )
