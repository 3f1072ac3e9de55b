"""A plan's files, written and checked: tables, programs, verdict, result and report."""

from __future__ import annotations

from dataclasses import dataclass, replace
from pathlib import Path

from machopt.domain.results.optimize import OptimizeResult
from machopt.formats.parquet import write_beside
from machopt.plan.job.pareto import measured
from machopt.plan.written.contact_map import mapped
from machopt.postprocess.written import write_programs
from machopt.recheck.folder import content_checks, verify_folder
from machopt.services.front import FILE as FRONT
from machopt.services.front import front, write_front
from machopt.services.planned import Planned
from machopt.services.tell import tell, write_tables
from machopt.verify import Verification
from machopt.verify.readonce import read_once


@dataclass(frozen=True)
class Written:
    """What stands in the folder, and what was checked of it."""

    result: OptimizeResult
    verification: Verification | None  # of every file; None where there is no motion


def write(the_plan: Planned, folder: Path) -> Written:
    """Write a plan's files and check what was written.

    Args:
        folder: an empty folder.
    """
    with read_once():  # by the verdict on the tables, and by that on all of it
        return _written(the_plan, folder)


def _written(the_plan: Planned, folder: Path) -> Written:
    given, made, timings = the_plan.given, the_plan.made.with_touching_pairs(), the_plan.timings
    timeline = made.timeline
    with timings.stage("export"):
        write_tables(folder, made.plan, made.points, timeline)
    if timeline is not None and timeline.trajectory is not None:
        with timings.stage("programs"):
            jobs = [(s.stint, s.plan, s.timeline) for s in made.stints]
            made = made.with_programs(write_programs(folder, given.posts, jobs, given.tolerance))
        with timings.stage("verify"):
            found = content_checks(given.cell, given.toolpath, folder, options=given.options, manifest=made.manifest)
            made = made.verified(found)
    if given.front and timeline is not None and made.exit_code == 0:
        with timings.stage("front"):
            own = measured("as asked", "", made.plan, timeline, made.points, made.plan)
            made = replace(made, front=tuple(front(given, made.plan, own)))
            write_front(folder / FRONT, list(made.front))
    if given.tables == "parquet":
        with timings.stage("export"):
            write_beside(folder.glob("*.csv"))
    with timings.stage("map"):
        shown = mapped(made.plan, given.map_all)
    result = tell(made, folder, timings, shown)
    whole = made.verification
    if made.verification is not None:
        whole = verify_folder(
            given.cell,
            given.toolpath,
            folder,
            options=given.options,
            inputs=given.manifest.inputs,
            contents=made.verification,
        )
        if made.verification.ok and not whole.ok:  # what was written is not what was meant: a bug, or a bad disk
            result = tell(replace(made, verification=whole), folder, timings, shown)
    return Written(result, whole)
