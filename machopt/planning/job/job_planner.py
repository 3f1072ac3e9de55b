"""Planning of a job and of its motion, tool after tool where the tool changes."""

from __future__ import annotations

import contextlib
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from functools import partial

from machopt.data_types.plan_options import PlanOptions
from machopt.data_types.tool_segments import ToolSegment
from machopt.data_types.toolpath import Toolpath
from machopt.numerics.heap_release import release_free_memory
from machopt.planning.cache import use_temporary_cache
from machopt.planning.compensation.driven_margins import (
    add_margin_reserve,
    apply_driven_rotation,
    find_lost_margin,
    find_runs_with_lost_margins,
    restore_requested_margins,
)
from machopt.planning.external_axis_optimization.single_toolpath_planning import (
    compute_external_axis_bound,
    find_best_plan,
)
from machopt.planning.job.advised_feed_motion import drive_posture_and_feed, drive_share_of_advice
from machopt.planning.job.compensation_retries import compensate_with_retries
from machopt.planning.job.constraint_conflicts import add_constraint_conflict, add_undrivable_conflict, is_complete
from machopt.planning.job.joined_motion import DrivenToolSegment, join_point_tables, join_timelines
from machopt.planning.job.joined_plan import ToolSegmentPlan, compute_length_shares, join_plans
from machopt.planning.job.locked_axes import add_locked_axes_note, has_trajectory, iterate_locked_subsets
from machopt.planning.job.rapid_rerouting import reroute_blocked_rapids
from machopt.planning.job.worst_index_over_tools import plan_worst_index_over_tools
from machopt.planning.motion.search_budget import SearchBudget, limit_search
from machopt.planning.motion.trajectory_builder import MotionTimeline, plan_motion
from machopt.planning.pipeline.gaps import mark_gaps
from machopt.planning.pipeline.plan_data_types import Plan
from machopt.planning.pipeline.planning_setup import StageTimings
from machopt.planning.plan_output.move_results import add_slowdown_notes, mark_undriven_points
from machopt.planning.plan_output.point_table import PointResults, build_point_table
from machopt.planning.reentry.reentry_planning import plan_with_reentries
from machopt.planning.tilt.tilt_planning import return_to_cam_axes
from machopt.planning.tolerance.process_results import add_process_results

CORNER_ROUNDING_SHARES = (0.25, 0.05, 0.01)  # shares of the corner tolerances, tried in this order
MAX_MARGIN_REPLANS = 2  # maximum number of new plans where driving uses up the margins


@dataclass(frozen=True)
class JobPlan:
    """Plan of a job with its points and, where possible, its motion."""

    plan: Plan
    points: PointResults
    timeline: MotionTimeline | None
    parts: tuple[DrivenToolSegment, ...]  # one per segment, in order


def plan_job(
    segments: Sequence[ToolSegment],
    toolpath: Toolpath,
    options: PlanOptions,
    timings: StageTimings,
    before: Sequence[Plan] = (),
    refused: str = "",
) -> JobPlan:
    """Plan a job, and compute its motion where no point is missing.

    Args:
        segments: the job, divided at tool changes.
        toolpath: the whole of it.
        options: for the whole job.
        timings: durations of the stages, of all tools together.
        before: plans of the same segments with other user requests, whose unchanged parts are reused; or none.
        refused: why the joint result of method joint is not to be driven; empty: it is tried.

    Raises:
        InputError: an option requests something that is not supported.
    """
    with use_temporary_cache() if segments[0].cell.external_joints else contextlib.nullcontext():
        job = _plan_segments(segments, toolpath, options, timings, before, refused)
    if job.timeline is None or job.timeline.trajectory is None:
        return job
    return replace(job, points=replace(job.points, table=add_slowdown_notes(job.points.table, job.timeline.dips)))


def _plan_segments(
    segments: Sequence[ToolSegment],
    toolpath: Toolpath,
    options: PlanOptions,
    timings: StageTimings,
    before: Sequence[Plan],
    refused: str,
) -> JobPlan:
    earlier = before if len(before) == len(segments) else (None,) * len(segments)
    if len(segments) == 1:
        done = _plan_single_segment(segments[0], options, timings, earlier[0], refused)
        return JobPlan(done.segment_plan.plan, done.points, done.timeline, (done,))
    plans = [_plan_segment(segments[0], options, timings, len(segments), earlier[0])]
    scale = plans[0].scores.scale  # common scale: the worst index is that of the whole job
    rest = zip(segments[1:], earlier[1:], strict=True)
    plans += [_plan_segment(s, options, timings, len(segments), one, scale=scale) for s, one in rest]
    plans, bound = plan_worst_index_over_tools(plans, compute_length_shares(plans), timings)

    def replan_segment(segment: ToolSegment) -> Callable[[PlanOptions], Plan]:
        return lambda other: _plan_segment(segment, other, timings, len(segments), scale=scale)

    parts = [
        _drive_segment(s, one, options, timings, replan_segment(s), refused)
        for s, one in zip(segments, plans, strict=True)
    ]
    whole = join_plans([p.segment_plan for p in parts], bound, options)
    return JobPlan(whole, join_point_tables(parts, toolpath), join_timelines(parts), tuple(parts))


def _plan_single_segment(
    segment: ToolSegment, options: PlanOptions, timings: StageTimings, before: Plan | None, refused: str
) -> DrivenToolSegment:
    """A job of one tool; with fewer external joints free where it has no complete motion with all of them."""

    def plan_and_drive(locked_options: PlanOptions, earlier: Plan | None = None) -> DrivenToolSegment:
        first = _plan_segment(segment, locked_options, timings, 1, earlier)
        return _drive_segment(
            segment, first, locked_options, timings, lambda o: _plan_segment(segment, o, timings, 1), refused
        )

    subsets = (
        list(iterate_locked_subsets(segment.cell, segment.restrict_options(options)))
        if segment.cell.external_joints
        else []
    )
    if not subsets:
        return plan_and_drive(options, before)
    with limit_search(SearchBudget()):
        free = plan_and_drive(options, before)
    if has_trajectory(free):
        return free
    for names, locked_options in subsets:
        with limit_search(SearchBudget()):
            found = plan_and_drive(replace(options, external=locked_options.external))
        if has_trajectory(found):
            return add_locked_axes_note(found, names, options)
    return free


def _plan_segment(
    segment: ToolSegment,
    job_options: PlanOptions,
    timings: StageTimings,
    count: int,
    before: Plan | None = None,
    scale: float | None = None,
) -> Plan:
    """One tool's plan, for its own worst index."""
    toolpath, options = segment.toolpath, segment.restrict_options(job_options)
    if before is not None and before.path.is_reentry.any():
        before = None  # its planning points are not those of the path without re-entries
    plan = find_best_plan(segment.cell, toolpath, options, timings, before, scale=scale)
    if options.max_reentries:
        with timings.stage("reentry"):
            plan = plan_with_reentries(plan, toolpath)
    plan = add_constraint_conflict(plan, segment.cell, toolpath, options, timings)
    plan = replace(plan, over_external=compute_external_axis_bound(plan, toolpath, timings))
    begin, end = (segment.begin if segment.number > 1 else None), (segment.end if segment.number < count else None)
    return replace(plan, begin=begin, end=end) if count > 1 else plan


def _drive_segment(
    segment: ToolSegment,
    plan: Plan,
    job_options: PlanOptions,
    timings: StageTimings,
    replan: Callable[[PlanOptions], Plan],
    refused: str,
) -> DrivenToolSegment:
    """Return one tool's plan with its points, and its motion where there is one.

    Args:
        replan: plans the same with other options for the whole job.
        refused: why the joint result of method joint is not to be driven.
    """
    toolpath, options = segment.toolpath, segment.restrict_options(job_options)
    drive = partial(drive_tool_segment, segment, job_options=job_options, timings=timings)
    release_free_memory()  # of the search
    if options.method == "joint":
        plan, driven_plan, timeline = drive_posture_and_feed(
            segment, plan, timings, lambda plan, other: drive(plan, replan=other), replan, refused
        )
    elif options.advised_feed_share is not None:
        plan, driven_plan, timeline = drive_share_of_advice(
            segment, plan, options.advised_feed_share, lambda plan, other: drive(plan, replan=other), replan
        )
    else:
        plan, driven_plan, timeline = drive(plan, replan=replan)
    if timeline is not None and timeline.trajectory is not None:
        plan = mark_gaps(driven_plan, list(timeline.driven), timeline.given_up)
    elif timeline is not None:
        plan = add_undrivable_conflict(plan, timeline.obstructions, toolpath, options)
    if timeline is None or timeline.trajectory is None:
        plan = mark_undriven_points(plan, timeline.obstructions if timeline is not None else ())
    release_free_memory()  # of the single moves
    with timings.stage("points"):
        points = build_point_table(plan, toolpath)
    if toolpath.process_operation is not None:
        with timings.stage("tolerance"):
            points = add_process_results(points, return_to_cam_axes(plan), toolpath, timeline)
    return DrivenToolSegment(ToolSegmentPlan(plan, segment.first, segment.tool), points, timeline)


def _reduce_corner_rounding(
    planned: Plan, driven: Plan, timeline: MotionTimeline, motion: Callable[[Plan], tuple[Plan, MotionTimeline | None]]
) -> tuple[Plan, Plan, MotionTimeline | None]:
    """Drive a plan whose rounded corners violate a margin with smaller corner rounding in the affected runs.

    With less rounding the arm is at the planning points as planned, where it keeps the margins; the cost is feed. If
    that
    fails, the motion is dropped where a margin is violated.
    """
    plan, first = planned, find_lost_margin(planned, driven)
    for rounding in CORNER_ROUNDING_SHARES:
        stop = find_lost_margin(plan, driven)
        if stop is None:
            return plan, driven, timeline
        runs = {**plan.rounding, **dict.fromkeys(find_runs_with_lost_margins(plan, driven), rounding)}
        plan, narrower = motion(replace(plan, rounding=runs))
        if narrower is None or narrower.trajectory is None:
            break
        timeline, driven = narrower, apply_driven_rotation(plan, narrower.phi)
    if first is None or find_lost_margin(plan, driven) is None:
        return plan, driven, timeline
    return planned, planned, replace(timeline, trajectory=None, obstructions=(first,))


def _compensate_and_drive(
    one: Plan,
    *,
    segment: ToolSegment,
    options: PlanOptions,
    reserved: PlanOptions,
    timings: StageTimings,
    replan: Callable[[PlanOptions], Plan],
) -> tuple[Plan, MotionTimeline | None]:
    """Return a plan, shifted against its deflection where the options ask for it, and its motion."""
    shifted = compensate_with_retries(segment, one, reserved, timings, replan) if options.compensate else one
    return shifted, plan_motion(shifted, segment.toolpath, options, timings)


def drive_tool_segment(
    segment: ToolSegment,
    plan: Plan,
    job_options: PlanOptions,
    timings: StageTimings,
    replan: Callable[[PlanOptions], Plan],
) -> tuple[Plan, Plan, MotionTimeline | None]:
    """Return the plan, the plan as driven, and the motion; replanned with larger margins where driving uses them up.

    Args:
        segment: toolpath of one tool.
        plan: plan of that tool.
        job_options: options of the whole job.
        timings: receives the duration of the stages.
        replan: plans the same with other options for the whole job.
    """
    options, reserved, arm = segment.restrict_options(job_options), job_options, plan.setup.arm
    for tries_left in range(MAX_MARGIN_REPLANS, -1, -1):
        motion = partial(
            _compensate_and_drive, segment=segment, options=options, reserved=reserved, timings=timings, replan=replan
        )
        plan, timeline = reroute_blocked_rapids(plan, motion, timings)
        if timeline is None or timeline.trajectory is None:
            return plan, plan, timeline
        driven = apply_driven_rotation(plan, timeline.phi)
        stop = find_lost_margin(plan, driven)
        if stop is None:
            return plan, driven, timeline
        reserved = add_margin_reserve(reserved, plan, driven)
        alternative = replan(reserved) if tries_left else None
        if alternative is None or not (is_complete(alternative) or options.allow_gaps):
            return _reduce_corner_rounding(plan, driven, timeline, motion)
        plan = restore_requested_margins(alternative, options, arm)
    raise AssertionError("the last try returns")
