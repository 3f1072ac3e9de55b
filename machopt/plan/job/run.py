"""From a job to its plan and its motion: tool after tool where it changes them."""

from __future__ import annotations

import contextlib
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace

from machopt.domain.options import PlanOptions
from machopt.domain.stint import Stint
from machopt.domain.toolpath import Toolpath
from machopt.plan.best.base import best_plan, over_external
from machopt.plan.compensation.margins import as_driven, asked_again, lost, runs_lost, with_spare
from machopt.plan.job.compensable import shifted_where_it_can
from machopt.plan.job.conflict import undriven, with_conflict
from machopt.plan.job.conflict import whole as is_whole
from machopt.plan.job.drive import motion_of
from machopt.plan.job.fewer_freedoms import has_trajectory, locked_subsets, with_locked
from machopt.plan.job.joined import Stretch, joined, shares_of
from machopt.plan.job.joined_motion import Done, joined_points, joined_timeline
from machopt.plan.job.passages import past_blocked
from machopt.plan.job.worst_over_tools import together
from machopt.plan.kept import kept_through
from machopt.plan.motion.search_budget import SearchBudget, limit_search
from machopt.plan.motion.timeline import Timeline
from machopt.plan.pipeline.gaps import told
from machopt.plan.pipeline.planned import Plan
from machopt.plan.pipeline.setup import Timings
from machopt.plan.written.move_ends import given_up, slowed
from machopt.plan.written.points import PointResults, point_results

ROUNDINGS = (0.25, 0.05, 0.01)  # shares of the corner tolerances, one after the other
SPARES = 2  # plans made again where driving one takes of the margins it keeps


@dataclass(frozen=True)
class Job:
    """A job that is planned and, where that can be, driven."""

    plan: Plan
    points: PointResults
    timeline: Timeline | None
    parts: tuple[Done, ...]  # one, or one a tool that is on, in the order of the stints


def plan_job(
    stints: Sequence[Stint],
    toolpath: Toolpath,
    options: PlanOptions,
    timings: Timings,
    before: Sequence[Plan] = (),
) -> Job:
    """Plan a job, and drive it where nothing is missing.

    Args:
        stints: the job, cut where it changes tools.
        toolpath: the whole of it.
        options: for the whole job.
        timings: what the stages take, of all tools together.
        before: the plans of the same stints but for the user's wishes, which lend what these do not change; or none.

    Raises:
        InputError: an option asks for what is not planned.
    """
    with kept_through() if stints[0].cell.external_joints else contextlib.nullcontext():
        job = _job(stints, toolpath, options, timings, before)
    if job.timeline is None or job.timeline.trajectory is None:
        return job
    return replace(job, points=replace(job.points, table=slowed(job.points.table, job.timeline.dips)))


def _job(
    stints: Sequence[Stint], toolpath: Toolpath, options: PlanOptions, timings: Timings, before: Sequence[Plan]
) -> Job:
    lent = before if len(before) == len(stints) else (None,) * len(stints)
    if len(stints) == 1:
        done = _whole_job(stints[0], options, timings, lent[0])
        return Job(done.stretch.plan, done.points, done.timeline, (done,))
    plans = [_planned(stints[0], options, timings, len(stints), lent[0])]
    scale = plans[0].scores.scale  # of all: the worst index is that of the whole job
    rest = zip(stints[1:], lent[1:], strict=True)
    plans += [_planned(s, options, timings, len(stints), one, scale=scale) for s, one in rest]
    plans, bound = together(plans, shares_of(plans), timings)

    def again(stint: Stint) -> Callable[[PlanOptions], Plan]:
        return lambda other: _planned(stint, other, timings, len(stints), scale=scale)

    parts = [_done(s, one, options, timings, again(s)) for s, one in zip(stints, plans, strict=True)]
    whole = replace(joined([p.stretch for p in parts], bound), options=options)
    return Job(whole, joined_points(parts, toolpath), joined_timeline(parts), tuple(parts))


def _whole_job(stint: Stint, options: PlanOptions, timings: Timings, before: Plan | None) -> Done:
    """A job of one tool; with fewer external joints free where it has no complete motion with all of them."""

    def done(asked: PlanOptions, lent: Plan | None = None) -> Done:
        first = _planned(stint, asked, timings, 1, lent)
        return _done(stint, first, asked, timings, lambda o: _planned(stint, o, timings, 1))

    subsets = list(locked_subsets(stint.cell, stint.of(options))) if stint.cell.external_joints else []
    if not subsets:
        return done(options, before)
    with limit_search(SearchBudget()):
        free = done(options, before)
    if has_trajectory(free):
        return free
    for names, asked in subsets:
        with limit_search(SearchBudget()):
            found = done(replace(options, external=asked.external))
        if has_trajectory(found):
            return with_locked(found, names, options)
    return free


def _planned(
    stint: Stint,
    whole: PlanOptions,
    timings: Timings,
    count: int,
    before: Plan | None = None,
    scale: float | None = None,
) -> Plan:
    """One tool's plan, for its own worst index."""
    toolpath, options = stint.toolpath, stint.of(whole)
    the_plan = best_plan(stint.cell, toolpath, options, timings, before, scale=scale)
    the_plan = with_conflict(the_plan, stint.cell, toolpath, options, timings)
    the_plan = replace(the_plan, over_external=over_external(the_plan, toolpath, timings))
    begin, end = (stint.begin if stint.number > 1 else None), (stint.end if stint.number < count else None)
    return replace(the_plan, begin=begin, end=end) if count > 1 else the_plan


def _done(
    stint: Stint, the_plan: Plan, whole: PlanOptions, timings: Timings, again: Callable[[PlanOptions], Plan]
) -> Done:
    """One tool's plan with its points, and its motion where there is one.

    Args:
        again: plans the same with other options for the whole job.
    """
    toolpath, options = stint.toolpath, stint.of(whole)
    the_plan, as_told, timeline = driven(stint, the_plan, whole, timings, again)
    if timeline is not None and timeline.trajectory is not None:
        the_plan = told(as_told, list(timeline.driven), timeline.given_up)
    elif timeline is not None:
        the_plan = undriven(the_plan, timeline.obstructions, toolpath, options)
    if timeline is None or timeline.trajectory is None:
        the_plan = given_up(the_plan, timeline.obstructions if timeline is not None else ())
    with timings.stage("points"):
        points = point_results(the_plan, toolpath)
    return Done(Stretch(the_plan, stint.first, stint.tool), points, timeline)


def _rounded_less(
    planned: Plan, taken: Plan, timeline: Timeline, motion: Callable[[Plan], tuple[Plan, Timeline | None]]
) -> tuple[Plan, Plan, Timeline | None]:
    """Drive a plan whose rounded corners fall short of a margin with narrower corners in the runs where they do.

    With corners that are rounded less the arm stands at the planning points as planned, where it keeps the margins;
    the price is feed. Without an answer the motion is given up where a margin is missed.
    """
    the_plan, first = planned, lost(planned, taken)
    for rounding in ROUNDINGS:
        stop = lost(the_plan, taken)
        if stop is None:
            return the_plan, taken, timeline
        runs = {**the_plan.rounding, **dict.fromkeys(runs_lost(the_plan, taken), rounding)}
        the_plan, narrower = motion(replace(the_plan, rounding=runs))
        if narrower is None or narrower.trajectory is None:
            break
        timeline, taken = narrower, as_driven(the_plan, narrower.phi)
    if first is None or lost(the_plan, taken) is None:
        return the_plan, taken, timeline
    return planned, planned, replace(timeline, trajectory=None, obstructions=(first,))


def driven(
    stint: Stint, the_plan: Plan, whole: PlanOptions, timings: Timings, again: Callable[[PlanOptions], Plan]
) -> tuple[Plan, Plan, Timeline | None]:
    """The plan, what is driven of it, and the motion; made again with spare where driving takes of the margins.

    Args:
        whole: options of the whole job.
        again: plans the same with other options for the whole job.
    """
    toolpath, options, spared, arm = stint.toolpath, stint.of(whole), whole, the_plan.setup.arm
    for tries_left in range(SPARES, -1, -1):

        def motion(one: Plan, asked: PlanOptions = spared) -> tuple[Plan, Timeline | None]:
            shifted = shifted_where_it_can(stint, one, asked, timings, again) if options.compensate else one
            return shifted, motion_of(shifted, toolpath, options, timings)

        the_plan, timeline = past_blocked(the_plan, motion, timings)
        if timeline is None or timeline.trajectory is None:
            return the_plan, the_plan, timeline
        taken = as_driven(the_plan, timeline.phi)
        stop = lost(the_plan, taken)
        if stop is None:
            return the_plan, taken, timeline
        spared = with_spare(spared, the_plan, taken)
        other = again(spared) if tries_left else None
        if other is None or not (is_whole(other) or options.allow_gaps):
            return _rounded_less(the_plan, taken, timeline, motion)
        the_plan = asked_again(other, options, arm)
    raise AssertionError("the last try returns")
