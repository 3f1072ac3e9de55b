"""Best plan of one toolpath, with or without external joints.

The modules that choose external joints are imported only where a cell has some.
"""

from __future__ import annotations

from machopt.data_types.cell import Cell
from machopt.data_types.plan_options import PlanOptions
from machopt.data_types.toolpath import Toolpath
from machopt.planning.external_axes.axis_modes import resolve_axis_options
from machopt.planning.external_axes.position_constraints import check_known_axes_and_places
from machopt.planning.pipeline.path_planner import plan_path
from machopt.planning.pipeline.plan_data_types import ExternalAxisBound, Plan
from machopt.planning.pipeline.planning_setup import StageTimings
from machopt.planning.tilt.tilt_planning import plan_with_tilt


def find_best_plan(
    cell: Cell,
    toolpath: Toolpath,
    options: PlanOptions,
    timings: StageTimings | None = None,
    before: Plan | None = None,
    *,
    scale: float | None = None,
) -> Plan:
    """Plan one toolpath, with the external joints chosen according to their modes.

    Args:
        cell: robot cell.
        toolpath: toolpath of one tool.
        options: plan options.
        timings: receives the duration of the stages.
        before: a plan that differs only in the user's requests
            (:func:`machopt.planning.pipeline.path_planner.plan_path`).
        scale: c₀ of a plan that this one belongs to; None: of its own.

    Raises:
        InputError: an option names no external joint or requests something that is not supported.
    """
    if cell.external_joints:
        from machopt.planning.external_axis_optimization import coarse_to_fine_search

        own = None if before is not None and before.path.untilted is not None else before
        found = coarse_to_fine_search.find_best_external_axis_plan(cell, toolpath, options, timings, own, scale=scale)
        return plan_with_tilt(found, toolpath, options, timings)
    resolve_axis_options(cell, options)
    check_known_axes_and_places(cell, options.steer)
    found = plan_path(cell, toolpath, options, timings, scale=scale, before=before)
    return plan_with_tilt(found, toolpath, options, timings)


def compute_external_axis_bound(plan: Plan, toolpath: Toolpath, timings: StageTimings) -> ExternalAxisBound | None:
    """Return the lower bound of a plan of one tool over the external joint values; None where no external joint was
    free.

    Args:
        plan: plan of one tool.
        toolpath: its toolpath.
        timings: receives the duration of the stages.
    """
    if not plan.setup.cell.external_joints:
        return None
    if plan.path.lead is not None and plan.path.side is not None and (plan.path.lead.any() or plan.path.side.any()):
        return ExternalAxisBound(why="the tool tilts, and the bound would be that of the tool axes of the CAM file")
    if plan.path.is_reentry.any():
        return ExternalAxisBound(
            why="the tool is lifted inside of a cut, and the bound would be that of a path without"
        )
    from machopt.planning.external_axis_optimization import external_axis_bound

    return external_axis_bound.bound_over_external_axes(plan, toolpath, timings)
