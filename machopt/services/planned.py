"""A plan in memory: everything that ``machopt optimize`` computes before it writes its first file."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING

from machopt.plan.job.run import plan_job
from machopt.plan.pipeline.planned import Plan
from machopt.plan.pipeline.setup import Timings
from machopt.services.load import Loaded

if TYPE_CHECKING:
    from machopt.services.made import Made


@dataclass(frozen=True)
class Planned:
    """A plan in memory: nothing of it is written yet."""

    given: Loaded
    made: Made  # without verification, programs and front, which are made of what is written
    timings: Timings


def planned(given: Loaded, timings: Timings, before: Sequence[Plan] = ()) -> Planned:
    """The plan, and its motion where there is one; tool after tool where the job changes it.

    Args:
        before: the plans of the same stints but for the user's wishes, which lend what these do not change; or none.
    """
    job = plan_job(given.stints, given.toolpath, given.options, timings, before)
    from machopt.postprocess.written import withheld  # late: loaded beside the plan (machopt.services.run)
    from machopt.services.made import Made, MadeStint

    made = Made(
        cell=given.cell,
        toolpath=given.toolpath,
        options=given.options,
        stints=tuple(MadeStint(s, p.stretch.plan, p.timeline) for s, p in zip(given.stints, job.parts, strict=True)),
        plan=job.plan,
        points=job.points,
        timeline=job.timeline,
        verification=None,
        programs=withheld(given.posts, given.tolerance, "there is no motion"),
        manifest=given.manifest,
    )
    return Planned(given, made, timings)
