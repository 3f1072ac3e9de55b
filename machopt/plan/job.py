"""From a job to its plan and its motion: tool after tool where it changes them."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

from machopt.domain.options import PlanOptions
from machopt.domain.stint import Stint
from machopt.domain.toolpath import Toolpath
from machopt.plan.conflict import with_conflict
from machopt.plan.drive import motion_of
from machopt.plan.external import best_plan
from machopt.plan.gaps import told
from machopt.plan.joined import Stretch, joined
from machopt.plan.joinedmotion import Done, joined_points, joined_timeline
from machopt.plan.made import Plan
from machopt.plan.pipeline import as_driven
from machopt.plan.points import PointResults, point_results
from machopt.plan.refine import compensate
from machopt.plan.setup import Timings
from machopt.plan.timeline import Timeline


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
    before: Plan | None = None,
) -> Job:
    """Plan a job, and drive it where nothing is missing.

    Args:
        stints: the job, cut where it changes tools.
        toolpath: the whole of it.
        options: for the whole job.
        timings: what the stages take, of all tools together.
        before: a plan of the same but for the user's wishes; of a job that changes tools nothing is taken from it.

    Raises:
        InputError: an option asks for what is not planned.
    """
    one = len(stints) == 1
    first = _done(stints[0], options, timings, len(stints), before=before if one else None)
    if one:
        return Job(first.stretch.plan, first.points, first.timeline, (first,))
    scale = first.stretch.plan.scores.scale  # of all: the worst index is that of the whole job
    parts = (first, *(_done(s, options, timings, len(stints), scale) for s in stints[1:]))
    whole = replace(joined([p.stretch for p in parts]), options=options)
    return Job(whole, joined_points(parts, toolpath), joined_timeline(parts), parts)


def _done(
    stint: Stint,
    whole: PlanOptions,
    timings: Timings,
    count: int,
    scale: float | None = None,
    before: Plan | None = None,
) -> Done:
    """One tool's plan, its points, and its motion where there is one."""
    toolpath, options = stint.toolpath, stint.of(whole)
    the_plan = best_plan(stint.cell, toolpath, options, timings, before, scale=scale)
    the_plan = with_conflict(the_plan, stint.cell, toolpath, options, timings)
    begin, end = (stint.begin if stint.number > 1 else None), (stint.end if stint.number < count else None)
    the_plan = replace(the_plan, begin=begin, end=end) if count > 1 else the_plan
    if options.compensate:
        with timings.stage("compensate"):
            the_plan = compensate(the_plan, toolpath)
    timeline = motion_of(the_plan, toolpath, options, timings)
    if timeline is not None and timeline.trajectory is not None:
        the_plan = told(as_driven(the_plan, timeline.phi), list(timeline.driven), timeline.given_up)
    with timings.stage("points"):
        points = point_results(the_plan, toolpath)
    return Done(Stretch(the_plan, stint.first, stint.tool), points, timeline)
