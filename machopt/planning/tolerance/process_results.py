"""Process columns and summary of one tool's plan, at the feed that the motion reaches."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from machopt.data_types.plan_points_table import PointsTable
from machopt.data_types.process import CuttingProcess, ProcessOperation
from machopt.data_types.process_columns import ProcessColumns, ProcessSummary, ToleranceSummary
from machopt.data_types.toolpath import MoveKind, Toolpath
from machopt.numerics.array_types import Array
from machopt.planning.error_probability.random_draws import HOLE_DRAWS, has_unknown_chisel_edge
from machopt.planning.motion.trajectory_builder import MotionTimeline
from machopt.planning.pipeline.plan_data_types import Plan
from machopt.planning.pipeline.planning_setup import fix_external_axes
from machopt.planning.plan_output.point_table import PointResults
from machopt.planning.tolerance.cutting_dynamics import CuttingDynamics, compute_cutting_dynamics
from machopt.planning.tolerance.foot_skid import list_skid_notes
from machopt.planning.tolerance.point_errors import PointErrors, compute_point_errors, list_tolerance_rows
from machopt.process.binding.job_binding import compute_loads
from machopt.process.binding.point_loads import PointLoads

MM, DEG = 1e3, 180.0 / np.pi


def add_process_results(
    points: PointResults, plan: Plan, toolpath: Toolpath, timeline: MotionTimeline | None
) -> PointResults:
    """Return the results of a plan's points with forces, errors and outcomes; unchanged where there is no process.

    Args:
        points: Results of the points.
        plan: Plan of one tool, as driven.
        toolpath: Its toolpath.
        timeline: Its motion; None: the programmed feed counts.
    """
    process = plan.setup.cell.process
    loads = compute_loads(plan.setup.cell, toolpath, find_driven_feed(toolpath, timeline))
    if process is None or loads is None:
        return points
    dynamics = compute_cutting_dynamics(plan, toolpath, loads)
    found = compute_point_errors(plan, toolpath, loads, wall_force=dynamics.wall_force, is_full=True)
    columns = _build_columns(loads, found, dynamics)
    summary = _summarise(process, plan, toolpath, loads, found, dynamics)
    table = _leave_out_deflections(points.table, loads)
    return replace(points, table=replace(table, process=columns), process=(summary,))


def _leave_out_deflections(table: PointsTable, loads: PointLoads) -> PointsTable:
    """Return the points without a deflection where the force is unknown."""
    unknown, std = loads.is_unknown, table.deflection_std
    return replace(
        table,
        deflection=np.where(unknown, np.nan, table.deflection),
        deflection_std=None if std is None else np.where(unknown, np.nan, std),
    )


def summarise_tolerances(
    plan: Plan, toolpath: Toolpath, timeline: MotionTimeline | None
) -> tuple[ToleranceSummary, ...]:
    """Return the outcomes of a plan by operation, as in result.json but without causes.

    Args:
        plan: Plan of one tool, as driven.
        toolpath: Its toolpath.
        timeline: Its motion; None: the programmed feed counts.
    """
    process = plan.setup.cell.process
    loads = compute_loads(plan.setup.cell, toolpath, find_driven_feed(toolpath, timeline))
    if process is None or loads is None:
        return ()
    wall_force = compute_cutting_dynamics(plan, toolpath, loads).wall_force
    found = compute_point_errors(plan, toolpath, loads, wall_force=wall_force, hole_draws=HOLE_DRAWS)
    return _summarise_operations(process, toolpath, found)


def find_driven_feed(toolpath: Toolpath, timeline: MotionTimeline | None) -> Array:
    """Return (N,) the largest feed of the cut that ends at each point, m/s; the programmed one without a motion.

    The retract move that leaves a point does not count.

    Args:
        toolpath: Toolpath of one tool.
        timeline: Its motion.
    """
    if timeline is None or timeline.trajectory is None:
        return toolpath.feed
    trajectory = timeline.trajectory
    known = np.isfinite(trajectory.point) & np.isfinite(trajectory.feed) & (trajectory.move == MoveKind.CUT)
    end = np.ceil(trajectory.point[known] - 1e-9).astype(int)
    largest = np.full(len(toolpath), -np.inf)
    np.maximum.at(largest, np.clip(end, 0, len(toolpath) - 1), trajectory.feed[known])
    reached = np.where(np.isfinite(largest) & (largest > 0), largest, toolpath.feed)
    return np.where(np.isnan(toolpath.feed), np.nan, np.fmin(reached, toolpath.feed))


def _build_columns(loads: PointLoads, point_errors: PointErrors, dynamics: CuttingDynamics) -> ProcessColumns:
    unknown = loads.is_unknown
    return ProcessColumns(
        force=np.where(unknown[:, None], np.nan, loads.force),
        moment=np.where(unknown, np.nan, loads.moment),
        peak_force=np.where(unknown, np.nan, dynamics.peak_force),
        ae=loads.ae,
        ap=loads.ap,
        entry_angle=loads.entry_angle,
        exit_angle=loads.exit_angle,
        errors=point_errors.errors,
        lower=point_errors.lower,
        upper=point_errors.upper,
        tolerance=point_errors.tolerance,
        p_in=point_errors.p_in,
        p_in_deflection_only=point_errors.p_in_deflection_only,
        outcome=point_errors.outcome,
        cause=point_errors.cause,
        f1=dynamics.f1,
        depth_limit=dynamics.depth_limit,
        chatter=dynamics.chatter,
        feed_max=point_errors.feed_max,
    )


def _summarise(
    process: CuttingProcess,
    plan: Plan,
    toolpath: Toolpath,
    loads: PointLoads,
    point_errors: PointErrors,
    dynamics: CuttingDynamics,
) -> ProcessSummary:
    return ProcessSummary(
        before=_count_before(plan, toolpath, loads, dynamics.wall_force),
        after=point_errors.count_outcomes(),
        tolerances=_summarise_operations(process, toolpath, point_errors),
        variance_shares=_compute_variance_shares(point_errors),
        sources=_list_sources(process, plan, toolpath),
        validity=(
            *_note_unused_stock(process),
            *loads.notes,
            *list_skid_notes(process, plan, loads),
            *dynamics.notes,
            *_list_limits_of_validity(process, plan, toolpath, point_errors),
        ),
    )


def _note_unused_stock(process: CuttingProcess) -> list[str]:
    if not process.has_unused_stock:
        return []
    return ["stock is not used: the depths of cut are those of the operations"]


def _count_before(plan: Plan, toolpath: Toolpath, loads: PointLoads, wall_force: Array) -> dict[str, dict[str, int]]:
    """Return the outcomes of the baselines, whose external joints are at home."""
    home = plan.setup.cell.external_home
    path = plan.path if not len(home) else fix_external_axes(plan.path, home)
    bare = replace(plan, path=path.without_shift, compensation=None)
    pairs = (("cam_default", plan.cam_default), ("jiao2022", plan.jiao2022))
    return {
        name: compute_point_errors(bare, toolpath, loads, chosen, wall_force=wall_force).count_outcomes()
        for name, chosen in pairs
    }


def _summarise_operations(
    process: CuttingProcess, toolpath: Toolpath, point_errors: PointErrors
) -> tuple[ToleranceSummary, ...]:
    rows = list_tolerance_rows(point_errors)
    assert toolpath.process_operation is not None
    operation = toolpath.process_operation[rows]
    out = []
    is_hole = np.array([one.is_hole for one in process.operations])[operation]
    for k, one in enumerate(process.operations):
        mine = rows[operation == k]
        if len(mine):
            out.append(_summarise_operation(one, mine, rows[is_hole == one.is_hole], point_errors))
    return tuple(out)


def _summarise_operation(
    one: ProcessOperation, mine: NDArray[np.intp], rows: NDArray[np.intp], point_errors: PointErrors
) -> ToleranceSummary:
    limits = one.tolerance
    shown = {
        "position_mm": limits.position * MM,
        "axis_deg": limits.axis * DEG,
        "depth_mm": limits.depth * MM,
        "surface_mm": limits.surface * MM,
    }
    name = _choose_shown_error(one)
    error = np.abs(point_errors.errors[name][mine])
    probability = np.where(
        np.isfinite(point_errors.p_in[mine]), point_errors.p_in[mine], point_errors.p_in_deflection_only[mine]
    )
    order = np.lexsort((-np.nan_to_num(error), np.nan_to_num(probability, nan=1.0)))
    worst = int(order[0])
    words = [point_errors.outcome[row] for row in mine]
    return ToleranceSummary(
        operation=one.label,
        is_hole=one.is_hole,
        limits={key: float(value) for key, value in shown.items() if np.isfinite(value)},
        reference=limits.reference,
        counts={word: words.count(word) for word in ("pass", "marginal", "fail", "unknown")},
        worst_point=int(mine[worst]),
        worst_number=1 + int(np.searchsorted(rows, mine[worst])),
        worst_error=float(error[worst]),
        is_angle=name == "axis",
        worst_p_in=float(probability[worst]),
        worst_cause=point_errors.cause[mine[worst]],
    )


def _choose_shown_error(one: ProcessOperation) -> str:
    """Return the error that the headline states: the first that has a limit."""
    limits = one.tolerance
    pairs = (("across", limits.position), ("along", limits.depth), ("axis", limits.axis), ("normal", limits.surface))
    return next((name for name, limit in pairs if np.isfinite(limit)), "normal")


def _compute_variance_shares(point_errors: PointErrors) -> dict[str, float]:
    parts = {name: values[np.isfinite(values)] for name, values in point_errors.variance.items()}
    if not parts or not all(len(values) for values in parts.values()):
        return {}
    total = np.sum(list(parts.values()), axis=0)
    known = np.asarray(total > 0)
    if not known.any():
        return {}
    return {name: float(np.mean(values[known] / total[known])) for name, values in parts.items()}


def _list_sources(process: CuttingProcess, plan: Plan, toolpath: Toolpath) -> dict[str, str]:
    """Return the source of each number that the result rests on."""
    out: dict[str, str] = {}
    for one in _list_used_operations(process, toolpath):
        for name in {one.material, *(layer.material for layer in one.layers)} - {""}:
            material = process.materials[name]
            part = material.milling if one.kind == "milling" else material.drilling
            if part is not None:
                out[f"materials.{name}.{'milling' if one.kind == 'milling' else 'drilling'}"] = part.source
    cell, stiffness = plan.setup.cell, plan.setup.elasticity.stiffness
    if stiffness.source:
        out["stiffness"] = stiffness.source
    if cell.accuracy is not None and cell.accuracy.source:
        out["accuracy"] = cell.accuracy.source
    return out


def _list_used_operations(process: CuttingProcess, toolpath: Toolpath) -> list[ProcessOperation]:
    assert toolpath.process_operation is not None
    used = sorted(set(toolpath.process_operation.tolist()) - {-1})
    return [process.operations[k] for k in used]


def _list_limits_of_validity(
    process: CuttingProcess, plan: Plan, toolpath: Toolpath, point_errors: PointErrors
) -> list[str]:
    cell = plan.setup.cell
    used = _list_used_operations(process, toolpath)
    out = [
        f"{one.label}: the thrust of the chisel edge is not counted, and the spread upwards is doubled: "
        "chisel_N_mm2 is not stated"
        for one in used
        if has_unknown_chisel_edge(process, one)
    ]
    if not any(one.tolerance.is_given for one in used):
        return out
    if cell.workpiece.stiffness is None:
        out.append("the part counts as rigid: workpiece.stiffness_N_mm is not stated")
    wants_axis = any(np.isfinite(one.tolerance.axis) for one in used)
    if wants_axis and (cell.accuracy is None or not np.isfinite(cell.accuracy.absolute_angle)):
        out.append("the orientation of the arm counts as exact: accuracy.absolute_deg is not stated")
    if any(one.tolerance.reference == "absolute" for one in used) and cell.workpiece.pose_covariance is None:
        out.append("the pose of the part counts as exact: workpiece.pose_covariance is not stated")
    for text in dict.fromkeys(point_errors.unknown_because.values()):
        count = sum(1 for why in point_errors.unknown_because.values() if why == text)
        out.append(f"{count} outcome{'s' if count != 1 else ''} unknown: {text}")
    return out
