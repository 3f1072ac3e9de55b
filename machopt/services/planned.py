"""A plan in memory: everything that ``machopt optimize`` computes before it writes its first file."""

from __future__ import annotations

from dataclasses import dataclass

from machopt.plan.conflict import with_conflict
from machopt.plan.drive import motion_of
from machopt.plan.external import best_plan
from machopt.plan.gaps import told
from machopt.plan.pipeline import Plan, Timings, as_driven
from machopt.plan.points import point_results
from machopt.plan.refine import compensate
from machopt.postprocess.written import withheld
from machopt.services.load import Loaded
from machopt.services.made import Made


@dataclass(frozen=True)
class Planned:
    """A plan in memory: nothing of it is written yet."""

    given: Loaded
    made: Made  # without verification, programs and front, which are made of what is written
    timings: Timings


def planned(given: Loaded, timings: Timings, before: Plan | None = None) -> Planned:
    """The plan, and its motion where there is one.

    Args:
        before: a plan of the same but for pins, zones, preferences and branches, which lends what they do not change.
    """
    cell, options, toolpath = given.cell, given.options, given.toolpath
    the_plan = with_conflict(best_plan(cell, toolpath, options, timings, before), cell, toolpath, options, timings)
    if options.compensate:
        with timings.stage("compensate"):
            the_plan = compensate(the_plan, toolpath)
    timeline = motion_of(the_plan, toolpath, options, timings)
    if timeline is not None and timeline.trajectory is not None:
        the_plan = told(as_driven(the_plan, timeline.phi), list(timeline.driven), timeline.given_up)
    with timings.stage("points"):
        points = point_results(the_plan, toolpath)
    made = Made(
        cell=cell,
        toolpath=toolpath,
        options=options,
        plan=the_plan,
        points=points,
        timeline=timeline,
        verification=None,
        programs=withheld(given.posts, given.tolerance, "there is no motion"),
        manifest=given.manifest,
    )
    return Planned(given, made, timings)
