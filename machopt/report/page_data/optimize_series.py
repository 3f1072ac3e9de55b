"""Series of the optimize report: values along the path and over the motion."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from machopt.data_types.toolpath import MoveKind, Toolpath
from machopt.numerics.array_types import Array
from machopt.numerics.rigid_transforms import wrap_angle
from machopt.planning.motion.trajectory_builder import MotionTimeline
from machopt.planning.pipeline.plan_data_types import Plan
from machopt.planning.plan_output.point_table import PointResults
from machopt.report.page_types import optimize_page_data as page


def build_path_series(
    plan: Plan, toolpath: Toolpath, points: PointResults, series: dict[str, Array]
) -> page.PathSeries:
    """Return the values along the path.

    Args:
        plan: The plan.
        toolpath: The toolpath, points in the workpiece frame, SI.
        points: Results at the toolpath's points.
        series: Series along the path by name, (N,) each.
    """
    t, counted = points.table, plan.path.counted[points.rows]

    def only_cut(values: Array) -> Array:
        return np.where(counted, values, np.nan)

    return page.PathSeries(
        s=compute_cut_length(toolpath, counted),
        operation=toolpath.operation,
        cutting=counted,
        index_default=only_cut(series["default"]),
        index_jiao2022=only_cut(series["jiao2022"]),
        index_chosen=only_cut(series["chosen"]),
        k_axial=only_cut(t.k_axial),
        k_normal=only_cut(t.k_normal),
        k_jiao2022=only_cut(t.k_jiao_x),
        deflection=only_cut(t.deflection),
        tolerance=toolpath.tolerance,
        clearance=t.clearance,
        nearest_pair=points.nearest_pair,
        singularity=t.singularity,
        limit_margin=t.limit_margin,
        shift=t.compensation,
        phi=np.asarray(wrap_angle(plan.chosen.assignment.phi[points.rows])),
        gamma=t.gamma,
    )


def compute_cut_length(toolpath: Toolpath, counted: NDArray[np.bool_]) -> Array:
    """Return (N,) the cut length up to each toolpath point, m. Rapid and linking moves add nothing.

    Args:
        toolpath: The toolpath, points in the workpiece frame, SI.
        counted: (N,) points that are cut to.
    """
    step = np.r_[0.0, np.linalg.norm(np.diff(toolpath.position, axis=0), axis=1)]
    return np.asarray(np.cumsum(step * counted))


def interpolate_path_length(s: Array, point: Array) -> Array:
    """Return the path length at fractional toolpath points, m; NaN where there is none.

    Args:
        s: (N,) path length at the toolpath's points, m.
        point: (S,) fractional toolpath points, NaN where there is none.
    """
    known = np.isfinite(point)
    return np.asarray(np.where(known, np.interp(np.where(known, point, 0.0), np.arange(len(s)), s), np.nan))


def build_motion_series(
    plan: Plan, toolpath: Toolpath, points: PointResults, timeline: MotionTimeline | None
) -> page.MotionSeries | None:
    """Return the values over the motion; None without a motion.

    Args:
        plan: The plan.
        toolpath: The toolpath, points in the workpiece frame, SI.
        points: Results at the toolpath's points.
        timeline: The motion over time; None where there is no motion.
    """
    t = timeline.trajectory if timeline else None
    if t is None:
        return None
    limits, dt = plan.setup.cell.limits, plan.options.sample
    v = np.diff(t.q, axis=0, prepend=t.q[:1]) / dt
    a = np.diff(v, axis=0, prepend=v[:1]) / dt
    j = np.diff(a, axis=0, append=a[-1:]) / dt
    for table, limit in ((v, limits.velocity), (a, limits.acceleration), (j, limits.jerk)):  # in place: each is long
        np.abs(table, out=table)
        np.divide(table, limit[:6], out=table)
    known = np.isfinite(t.point)
    ends = np.where(known, np.ceil(np.where(known, t.point, 0) - 1e-9), 0).astype(int)
    programmed = np.where(known & (t.move != MoveKind.RAPID), toolpath.feed[ends], np.nan)
    return page.MotionSeries(
        time=t.time,
        s=interpolate_path_length(compute_cut_length(toolpath, plan.path.counted[points.rows]), t.point),
        q=t.q,
        velocity_ratio=v,
        joint_names=plan.setup.cell.arm_joints,
        prismatic=(False,) * 6,
        lower=limits.lower[:6],
        upper=limits.upper[:6],
        feed_programmed=programmed,
        feed_actual=t.feed,
        cutting=np.asarray(t.move == MoveKind.CUT),
        acceleration_ratio=a,
        jerk_ratio=j,
    )
