"""``machopt optimize``: from a cell and a CAM file to a folder with motion, program, tables, verdict and report."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace
from pathlib import Path

from machopt.domain.results.optimize import OptimizeResult
from machopt.effects.own import in_use, with_effects
from machopt.output import output_folder
from machopt.plan.drive import motion_of
from machopt.plan.front import measured
from machopt.plan.gaps import told
from machopt.plan.mapped import mapped
from machopt.plan.pipeline import Timings, as_driven, plan
from machopt.plan.points import point_results
from machopt.plan.refine import compensate
from machopt.postprocess.written import withheld, write_programs
from machopt.recheck.folder import content_checks, verify_folder
from machopt.services.front import FILE as FRONT
from machopt.services.front import front, write_front
from machopt.services.load import Request, load
from machopt.services.made import Made
from machopt.services.tell import tell, write_tables


@dataclass(frozen=True)
class Outcome:
    """What came out; ``exit_code`` follows the contract (0, 3 or 4)."""

    exit_code: int
    result: OptimizeResult
    report: Path


def optimize(request: Request, progress: Callable[[str], None] = lambda _: None) -> Outcome:
    """Run the main job.

    Raises:
        InputError: bad cell, toolpath, options or output folder.
    """
    with in_use(with_effects(request.effects)):
        return _optimize(request, progress)


def _optimize(request: Request, progress: Callable[[str], None]) -> Outcome:
    timings = Timings(progress=progress)
    with timings.stage("load"):
        given = load(request)
    cell, options, toolpath = given.cell, given.options, given.toolpath
    with output_folder(request.out) as folder:
        the_plan = plan(cell, toolpath, options, timings)
        if options.compensate:
            with timings.stage("compensate"):
                the_plan = compensate(the_plan, toolpath)
        timeline = motion_of(the_plan, toolpath, options, timings)
        driven = timeline is not None and timeline.trajectory is not None
        if timeline is not None and driven:
            the_plan = told(as_driven(the_plan, timeline.phi), list(timeline.driven), timeline.given_up)
        with timings.stage("points"):
            points = point_results(the_plan, toolpath)
        with timings.stage("export"):
            write_tables(folder, the_plan, points, timeline)
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
        if timeline is not None and driven:
            with timings.stage("programs"):
                written = write_programs(folder, given.posts, the_plan, toolpath, timeline, given.tolerance)
                made = made.with_programs(written)
            with timings.stage("verify"):
                found = content_checks(cell, toolpath, folder, options=options, manifest=made.manifest)
                made = made.verified(found)
        if request.front and timeline is not None and made.exit_code == 0:
            with timings.stage("front"):
                own = measured("as asked", "", the_plan, timeline, points)
                made = replace(made, front=tuple(front(cell, toolpath, options, own, motion_of)))
                write_front(folder / FRONT, list(made.front))
        with timings.stage("map"):
            shown = mapped(made.plan, request.map_all)
        result = tell(made, folder, timings, shown)
        if made.verification is not None:
            whole = verify_folder(
                cell, toolpath, folder, options=options, inputs=given.manifest.inputs, contents=made.verification
            )
            if made.verification.ok and not whole.ok:  # what was written is not what was meant: a bug, or a bad disk
                result = tell(replace(made, verification=whole), folder, timings, shown)
    return Outcome(result.exit_code, result, request.out / "report.html")
