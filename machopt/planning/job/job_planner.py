"""Planning of a job and of its motion, tool after tool where the tool changes."""

from __future__ import annotations

import contextlib
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from functools import partial

from machopt.data_types.plan_options import PlanOptions
from machopt.data_types.tool_segments import ToolSegment
from machopt.data_types.toolpath import Toolpath
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
from machopt.planning.job.constraint_conflicts import add_constraint_conflict, add_undrivable_conflict
from machopt.planning.job.constraint_conflicts import is_complete as is_whole
from machopt.planning.job.joined_motion import DrivenToolSegment, join_point_tables, join_timelines
from machopt.planning.job.joined_plan import ToolSegmentPlan, compute_length_shares, join_plans
from machopt.planning.job.locked_axes import add_locked_axes_note, has_trajectory, iterate_locked_subsets
from machopt.planning.job.rapid_rerouting import reroute_blocked_rapids
from machopt.planning.job.request_checks import plan_motion
from machopt.planning.job.worst_index_over_tools import plan_worst_index_over_tools
from machopt.planning.motion.search_budget import SearchBudget, limit_search
from machopt.planning.motion.trajectory_builder import MotionTimeline
from machopt.planning.pipeline.gaps import mark_gaps
from machopt.planning.pipeline.plan import Plan
from machopt.planning.pipeline.planning_setup import StageTimings
from machopt.planning.plan_output.move_results import add_slowdown_notes, mark_undriven_points
from machopt.planning.plan_output.point_table import PointResults, build_point_table
from machopt.planning.reentry.reentry_planning import plan_with_reentries
from machopt.planning.tilt.tilt_planning import return_to_cam_axes
from machopt.planning.tolerance.process_results import add_process_results

ROUNDINGS = (0.25, 0.05, 0.01)  # shares of the corner tolerances, tried in this order
SPARES = 2  # maximum number of new plans where driving uses up the margins


@dataclass(frozen=True)
class JobPlan:
    """Plan of a job with its points and, where possible, its motion."""

    plan: Plan
    points: PointResults
    timeline: MotionTimeline | None
    parts: tuple[DrivenToolSegment, ...]  # one per stint, in order


def plan_job(
    stints: Sequence[ToolSegment],
    toolpath: Toolpath,
    options: PlanOptions,
    timings: StageTimings,
    before: Sequence[Plan] = (),
    refused: str = "",
) -> JobPlan:
    """Plan a job, and compute its motion where no point is missing.

    Args:
        stints: the job, divided at tool changes.
        toolpath: the whole of it.
        options: for the whole job.
        timings: durations of the stages, of all tools together.
        before: plans of the same stints with other user requests, whose unchanged parts are reused; or none.
        refused: why the joint result of method joint is not to be driven; empty: it is tried.

    Raises:
        InputError: an option requests something that is not supported.
    """
    with use_temporary_cache() if stints[0].cell.external_joints else contextlib.nullcontext():
        job = _job(stints, toolpath, options, timings, before, refused)
    if job.timeline is None or job.timeline.trajectory is None:
        return job
    return replace(job, points=replace(job.points, table=add_slowdown_notes(job.points.table, job.timeline.dips)))


def _job(
    stints: Sequence[ToolSegment],
    toolpath: Toolpath,
    options: PlanOptions,
    timings: StageTimings,
    before: Sequence[Plan],
    refused: str,
) -> JobPlan:
    lent = before if len(before) == len(stints) else (None,) * len(stints)
    if len(stints) == 1:
        done = _whole_job(stints[0], options, timings, lent[0], refused)
        return JobPlan(done.stretch.plan, done.points, done.timeline, (done,))
    plans = [_planned(stints[0], options, timings, len(stints), lent[0])]
    scale = plans[0].scores.scale  # common scale: the worst index is that of the whole job
    rest = zip(stints[1:], lent[1:], strict=True)
    plans += [_planned(s, options, timings, len(stints), one, scale=scale) for s, one in rest]
    plans, bound = plan_worst_index_over_tools(plans, compute_length_shares(plans), timings)

    def again(stint: ToolSegment) -> Callable[[PlanOptions], Plan]:
        return lambda other: _planned(stint, other, timings, len(stints), scale=scale)

    parts = [_done(s, one, options, timings, again(s), refused) for s, one in zip(stints, plans, strict=True)]
    whole = join_plans([p.stretch for p in parts], bound, options)
    return JobPlan(whole, join_point_tables(parts, toolpath), join_timelines(parts), tuple(parts))


def _whole_job(
    stint: ToolSegment, options: PlanOptions, timings: StageTimings, before: Plan | None, refused: str
) -> DrivenToolSegment:
    """A job of one tool; with fewer external joints free where it has no complete motion with all of them."""

    def done(locked_options: PlanOptions, lent: Plan | None = None) -> DrivenToolSegment:
        first = _planned(stint, locked_options, timings, 1, lent)
        return _done(stint, first, locked_options, timings, lambda o: _planned(stint, o, timings, 1), refused)

    subsets = (
        list(iterate_locked_subsets(stint.cell, stint.restrict_options(options))) if stint.cell.external_joints else []
    )
    if not subsets:
        return done(options, before)
    with limit_search(SearchBudget()):
        free = done(options, before)
    if has_trajectory(free):
        return free
    for names, locked_options in subsets:
        with limit_search(SearchBudget()):
            found = done(replace(options, external=locked_options.external))
        if has_trajectory(found):
            return add_locked_axes_note(found, names, options)
    return free


def _planned(
    stint: ToolSegment,
    whole: PlanOptions,
    timings: StageTimings,
    count: int,
    before: Plan | None = None,
    scale: float | None = None,
) -> Plan:
    """One tool's plan, for its own worst index."""
    toolpath, options = stint.toolpath, stint.restrict_options(whole)
    if before is not None and before.path.is_reentry.any():
        before = None  # its planning points are not those of the path without re-entries
    the_plan = find_best_plan(stint.cell, toolpath, options, timings, before, scale=scale)
    if options.max_reentries:
        with timings.stage("reentry"):
            the_plan = plan_with_reentries(the_plan, toolpath)
    the_plan = add_constraint_conflict(the_plan, stint.cell, toolpath, options, timings)
    the_plan = replace(the_plan, over_external=compute_external_axis_bound(the_plan, toolpath, timings))
    begin, end = (stint.begin if stint.number > 1 else None), (stint.end if stint.number < count else None)
    return replace(the_plan, begin=begin, end=end) if count > 1 else the_plan


def _done(
    stint: ToolSegment,
    the_plan: Plan,
    whole: PlanOptions,
    timings: StageTimings,
    again: Callable[[PlanOptions], Plan],
    refused: str,
) -> DrivenToolSegment:
    """Return one tool's plan with its points, and its motion where there is one.

    Args:
        again: plans the same with other options for the whole job.
        refused: why the joint result of method joint is not to be driven.
    """
    toolpath, options = stint.toolpath, stint.restrict_options(whole)
    drive = partial(drive_tool_segment, stint, whole=whole, timings=timings)
    if options.method == "joint":
        the_plan, as_told, timeline = drive_posture_and_feed(
            stint, the_plan, timings, lambda plan, other: drive(plan, again=other), again, refused
        )
    elif options.advised_feed_share is not None:
        the_plan, as_told, timeline = drive_share_of_advice(
            stint, the_plan, options.advised_feed_share, lambda plan, other: drive(plan, again=other), again
        )
    else:
        the_plan, as_told, timeline = drive(the_plan, again=again)
    if timeline is not None and timeline.trajectory is not None:
        the_plan = mark_gaps(as_told, list(timeline.driven), timeline.given_up)
    elif timeline is not None:
        the_plan = add_undrivable_conflict(the_plan, timeline.obstructions, toolpath, options)
    if timeline is None or timeline.trajectory is None:
        the_plan = mark_undriven_points(the_plan, timeline.obstructions if timeline is not None else ())
    with timings.stage("points"):
        points = build_point_table(the_plan, toolpath)
    if toolpath.process_operation is not None:
        with timings.stage("tolerance"):
            points = add_process_results(points, return_to_cam_axes(the_plan), toolpath, timeline)
    return DrivenToolSegment(ToolSegmentPlan(the_plan, stint.first, stint.tool), points, timeline)


def _rounded_less(
    planned: Plan, driven: Plan, timeline: MotionTimeline, motion: Callable[[Plan], tuple[Plan, MotionTimeline | None]]
) -> tuple[Plan, Plan, MotionTimeline | None]:
    """Drive a plan whose rounded corners violate a margin with smaller corner rounding in the affected runs.

    With less rounding the arm is at the planning points as planned, where it keeps the margins; the cost is feed. If
    that
    fails, the motion is dropped where a margin is violated.
    """
    the_plan, first = planned, find_lost_margin(planned, driven)
    for rounding in ROUNDINGS:
        stop = find_lost_margin(the_plan, driven)
        if stop is None:
            return the_plan, driven, timeline
        runs = {**the_plan.rounding, **dict.fromkeys(find_runs_with_lost_margins(the_plan, driven), rounding)}
        the_plan, narrower = motion(replace(the_plan, rounding=runs))
        if narrower is None or narrower.trajectory is None:
            break
        timeline, driven = narrower, apply_driven_rotation(the_plan, narrower.phi)
    if first is None or find_lost_margin(the_plan, driven) is None:
        return the_plan, driven, timeline
    return planned, planned, replace(timeline, trajectory=None, obstructions=(first,))


def _compensate_and_drive(
    one: Plan,
    *,
    stint: ToolSegment,
    options: PlanOptions,
    reserved: PlanOptions,
    timings: StageTimings,
    again: Callable[[PlanOptions], Plan],
) -> tuple[Plan, MotionTimeline | None]:
    """Return a plan, shifted against its deflection where the options ask for it, and its motion."""
    shifted = compensate_with_retries(stint, one, reserved, timings, again) if options.compensate else one
    return shifted, plan_motion(shifted, stint.toolpath, options, timings)


def drive_tool_segment(
    stint: ToolSegment, the_plan: Plan, whole: PlanOptions, timings: StageTimings, again: Callable[[PlanOptions], Plan]
) -> tuple[Plan, Plan, MotionTimeline | None]:
    """Return the plan, the plan as driven, and the motion; replanned with larger margins where driving uses them up.

    Args:
        stint: toolpath of one tool.
        the_plan: plan of that tool.
        whole: options of the whole job.
        timings: receives the duration of the stages.
        again: plans the same with other options for the whole job.
    """
    options, reserved, arm = stint.restrict_options(whole), whole, the_plan.setup.arm
    for tries_left in range(SPARES, -1, -1):
        motion = partial(
            _compensate_and_drive, stint=stint, options=options, reserved=reserved, timings=timings, again=again
        )
        the_plan, timeline = reroute_blocked_rapids(the_plan, motion, timings)
        if timeline is None or timeline.trajectory is None:
            return the_plan, the_plan, timeline
        driven = apply_driven_rotation(the_plan, timeline.phi)
        stop = find_lost_margin(the_plan, driven)
        if stop is None:
            return the_plan, driven, timeline
        reserved = add_margin_reserve(reserved, the_plan, driven)
        alternative = again(reserved) if tries_left else None
        if alternative is None or not (is_whole(alternative) or options.allow_gaps):
            return _rounded_less(the_plan, driven, timeline, motion)
        the_plan = restore_requested_margins(alternative, options, arm)
    raise AssertionError("the last try returns")
