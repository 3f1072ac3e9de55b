"""Placement task of one tool of one toolpath, prepared for assessment in any process."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace

import numpy as np

from machopt.data_types.cell import Cell
from machopt.data_types.plan_options import PlanOptions
from machopt.data_types.process_columns import ToleranceSummary
from machopt.data_types.tool_segments import ToolSegment
from machopt.data_types.toolpath import Toolpath
from machopt.kinematics.machine import load_machine
from machopt.placement.external_joint_estimate import estimate_with_external_joints
from machopt.placement.moved_cell import MovedBodies, move_cell
from machopt.placement.placement_estimate import PlacementEstimate, estimate_placement
from machopt.placement.search_options import PlacementShift
from machopt.placement.tolerance_estimate import ToleranceEstimator
from machopt.planning.cost.stiffness_index import compute_load_directions
from machopt.planning.external_axes.axis_modes import resolve_axis_options
from machopt.planning.external_axes.operation_groups import OperationGroup, build_operation_groups
from machopt.planning.external_axis_optimization.single_toolpath_planning import find_best_plan
from machopt.planning.job.job_planner import drive_tool_segment
from machopt.planning.job.joined_plan import ToolSegmentPlan, compute_length_shares, join_plans
from machopt.planning.job.worst_index_over_tools import plan_worst_index_over_tools
from machopt.planning.pipeline.plan_data_types import Plan
from machopt.planning.pipeline.planning_setup import PlanningSetup, StageTimings, fix_external_axes, prepare_planning
from machopt.planning.pipeline.sequence_breaks import SequenceBreak
from machopt.planning.plan_output.infeasibility_reasons import explain_points, list_breaks
from machopt.planning.sampling.planning_arm import PlanningArm
from machopt.planning.stations.path_subset import list_run_points
from machopt.planning.stations.planning_path import PlanningPath, build_planning_path
from machopt.planning.tolerance.process_results import summarise_tolerances


@dataclass(frozen=True, eq=False)
class SegmentTask:
    """One tool's toolpath; its springs and its kinematic chain are the same at every place."""

    segment: ToolSegment
    setup: PlanningSetup  # without collisions
    path: PlanningPath  # external joints at their locked values, else at home
    groups: tuple[OperationGroup, ...]  # operations that share external joint values; empty without external joints
    tolerances: ToleranceEstimator | None  # None: nothing has a tolerance, or external joints are free

    @classmethod
    def build(cls, segment: ToolSegment, options: PlanOptions) -> SegmentTask:
        """Prepare one tool's toolpath.

        Args:
            segment: toolpath of one tool.
            options: plan options.
        """
        cell, path = segment.cell, build_planning_path(segment.toolpath)
        setup = prepare_planning(cell, replace(options, collision=False), segment.toolpath)
        if not cell.external_joints:
            return cls(segment, setup, path, (), _build_estimator(setup, segment, path, options))
        groups = build_operation_groups(cell, segment.toolpath, path, resolve_axis_options(cell, options))
        at = np.empty((len(path.index), len(cell.external_joints)))
        for group in groups:
            at[list_run_points(path, group.runs)] = np.clip(cell.external_home, group.low, group.high)
        path = fix_external_axes(path, at)
        is_free = any((g.high > g.low).any() for g in groups)
        return cls(
            segment, setup, path, tuple(groups), None if is_free else _build_estimator(setup, segment, path, options)
        )

    @property
    def has_free_external_joints(self) -> bool:
        """Whether external joints are free."""
        return any((g.high > g.low).any() for g in self.groups)

    @property
    def cut_length(self) -> float:
        """Length cut in m."""
        step = np.linalg.norm(np.diff(self.path.position, axis=0), axis=1)
        return float(step @ self.path.counted[1:])

    def estimate(self, carried: MovedBodies, shift: PlacementShift, options: PlanOptions) -> PlacementEstimate:
        """Return the estimate of a place.

        Args:
            carried: moved bodies.
            shift: shift of the place.
            options: plan options.
        """
        cell = move_cell(self.setup.driven, carried, shift)
        arm = PlanningArm.build(cell, self.setup.arm.solver, load_machine(cell, self.setup.robot), options)
        arm = replace(arm, stability=self.setup.arm.stability)
        if self.has_free_external_joints:
            found = estimate_with_external_joints(self.setup, arm, self.path, options, self.groups)
        else:
            found = estimate_placement(self.setup, arm, self.path, options, self.tolerances)
        return replace(found, point=found.point + self.segment.first)


def _build_estimator(
    setup: PlanningSetup, segment: ToolSegment, path: PlanningPath, options: PlanOptions
) -> ToleranceEstimator | None:
    d = compute_load_directions(path, setup.arm, setup.elasticity, options.force)
    return ToleranceEstimator.build(setup, segment.toolpath, path, d, options)


def build_single_segment(cell: Cell, toolpath: Toolpath) -> tuple[ToolSegment, ...]:
    """Return a job without tool changes.

    Args:
        cell: robot cell.
        toolpath: toolpath of the job.
    """
    home = cell.joints_at_home
    return (ToolSegment(cell=cell, toolpath=toolpath, whole=toolpath, first=0, begin=home, end=home),)


@dataclass(frozen=True)
class JobAtPlacement:
    """A job planned at a place."""

    plan: Plan
    seconds: float  # of its motion
    obstruction: str  # why there is no motion; empty where there is one
    tolerances: tuple[ToleranceSummary, ...]  # outcomes by operation, points counted from the first of the job


def plan_at_placement(
    segments: Sequence[ToolSegment], carried: MovedBodies, shift: PlacementShift, options: PlanOptions
) -> JobAtPlacement:
    """Plan a job at a place, including its motion.

    Args:
        segments: toolpath of each tool.
        carried: moved bodies.
        shift: shift of the place.
        options: plan options.
    """
    moved_segments = [replace(segment, cell=move_cell(segment.cell, carried, shift)) for segment in segments]
    plans: list[Plan] = []
    for segment in moved_segments:
        plans.append(_plan_segment(segment, len(moved_segments), plans[0].scores.scale if plans else None, options))
    scale, bound = plans[0].scores.scale, None  # common scale: the worst index is that of the whole job
    if len(plans) > 1:
        plans, bound = plan_worst_index_over_tools(plans, compute_length_shares(plans), StageTimings())

    def replan(segment: ToolSegment) -> Callable[[PlanOptions], Plan]:
        return lambda other: _plan_segment(
            segment, len(moved_segments), scale if len(moved_segments) > 1 else None, other
        )

    seconds, why, rows = 0.0, "", []
    for k, segment in enumerate(moved_segments):
        plans[k], driven, timeline = drive_tool_segment(segment, plans[k], options, StageTimings(), replan(segment))
        if timeline is None or timeline.trajectory is None:
            why = _get_first_obstruction(plans[k], timeline.obstructions if timeline is not None else ())
            break
        seconds += float(timeline.trajectory.time[-1])
        found = summarise_tolerances(driven, segment.toolpath, timeline)
        rows += [replace(row, worst_point=row.worst_point + segment.first) for row in found]
    done = [ToolSegmentPlan(one, s.first, s.tool) for one, s in zip(plans, moved_segments, strict=True)]
    return JobAtPlacement(join_plans(done, bound, options) if len(done) > 1 else plans[0], seconds, why, tuple(rows))


def _plan_segment(segment: ToolSegment, count: int, scale: float | None, options: PlanOptions) -> Plan:
    """Plan one tool; between tools the machine rests at the tool change position."""
    one = find_best_plan(segment.cell, segment.toolpath, segment.restrict_options(options), StageTimings(), scale=scale)
    begin, end = (segment.begin if segment.number > 1 else None), (segment.end if segment.number < count else None)
    return replace(one, begin=begin, end=end) if count > 1 else one


def _get_first_obstruction(one: Plan, obstructions: Sequence[SequenceBreak]) -> str:
    """The first reason why a plan is not driven."""
    points = [f"point {one.path.index[p]:g}: {sentence}" for p, sentence in explain_points(one).items()]
    breaks = [f"{b.where}: {b.text}" for b in (*list_breaks(one), *obstructions)]
    return (*points, *breaks, "it could not be driven")[0]
