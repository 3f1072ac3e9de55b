"""``machopt optimize``: from a cell and a CAM file to a folder with motion, program, tables, verdict and report."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any

import numpy as np

from machopt.domain.cell import Cell
from machopt.domain.options import PlanOptions
from machopt.domain.results.optimize import OptimizeResult
from machopt.domain.toolpath import Toolpath
from machopt.effects.own import in_use, with_effects
from machopt.errors import InputError
from machopt.formats.cell import load_cell
from machopt.formats.options import load_options, options_as_user
from machopt.formats.tables import write_compensation_csv, write_points_csv, write_trajectory_csv
from machopt.formats.toolpath import read_toolpath
from machopt.model.robot import load_robot
from machopt.output import MANIFEST, output_folder, write_manifest, write_result
from machopt.output.roles import ROLES
from machopt.plan.gaps import told
from machopt.plan.mapped import Mapped, mapped
from machopt.plan.pipeline import Plan, Timings, as_driven, plan
from machopt.plan.refine import compensate
from machopt.plan.timeline import Timeline, build_timeline
from machopt.plan.wrongunit import wrong_unit
from machopt.postprocess.wanted import is_post_file, wanted_posts
from machopt.postprocess.written import withdrawn, withheld, write_programs
from machopt.recheck.folder import content_checks, verify_folder
from machopt.recheck.posts import tolerance_of
from machopt.report.data import FrontPoint
from machopt.report.page import write_report
from machopt.se3 import inverse
from machopt.services.front import FILE as FRONT
from machopt.services.front import front, measured, refuse, write_front
from machopt.services.inputs import hashes_of
from machopt.services.knownrobot import known_robot
from machopt.services.manifest import optimize_manifest
from machopt.services.page import report_data
from machopt.services.points import point_results
from machopt.services.result import Made, result_of


@dataclass(frozen=True)
class Request:
    """What the user asked for."""

    cell: Path
    toolpath: Path
    out: Path
    plan_file: Path | None = None
    overrides: tuple[str, ...] = ()
    direct: dict[str, object] | None = None  # options by their user key, e.g. {"method": "jiao2022"}
    reading: dict[str, Any] = field(default_factory=dict)  # keywords of formats.toolpath.read_toolpath
    allow_external: bool = False
    posts: tuple[str, ...] = ()  # names or template files; none: the cell's own
    front: bool = False  # further plans with other weights, for the trade-off
    program_tolerance_mm: float | None = None  # 0.05, or twice path_tolerance_mm where that is more
    effects: tuple[Path, ...] = ()  # Python files with effects of the user's own, which stiffness.yaml may hold
    map_all: bool = False  # look for the collisions of every configuration, for the report's map


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
        cell = load_cell(request.cell, allow_external=request.allow_external)
        options = load_options(cell.plan, request.plan_file, list(request.overrides), **(request.direct or {}))
        posts, tolerance = wanted_posts(cell, request.posts), tolerance_of(request.program_tolerance_mm, options)
        toolpath = read_toolpath(request.toolpath, robot=known_robot(cell), **request.reading)
        if request.front:
            refuse(options)
        _refuse_fixed_beyond(toolpath, options)
        if not options.allow_gaps:
            _refuse_wrong_unit(cell, toolpath, request)
    manifest = optimize_manifest(
        cell,
        request.toolpath,
        toolpath,
        options,
        reading=request.reading,
        plan_file=request.plan_file,
        post_files=[Path(text) for text in request.posts if is_post_file(text)],
        effects=request.effects,
        tolerance=tolerance,
    )
    with output_folder(request.out) as folder:
        the_plan = plan(cell, toolpath, options, timings)
        if options.compensate:
            with timings.stage("compensate"):
                the_plan = compensate(the_plan, toolpath)
        timeline = _motion(the_plan, toolpath, options, timings)
        driven = timeline is not None and timeline.trajectory is not None
        if timeline is not None and driven:
            the_plan = told(as_driven(the_plan, timeline.phi), list(timeline.driven), timeline.given_up)
        with timings.stage("points"):
            points = point_results(the_plan, toolpath)
        with timings.stage("export"):
            write_points_csv(folder / "points.csv", points.table)
            if timeline is not None and timeline.trajectory is not None:
                labels = [o.label for o in toolpath.operations]
                write_trajectory_csv(folder / "trajectory.csv", timeline.trajectory, labels)
                if the_plan.compensation is not None:
                    c = the_plan.compensation
                    write_compensation_csv(folder / "compensation.csv", the_plan.path.index, c.offset, c.force)
        made = Made(
            cell=cell,
            toolpath=toolpath,
            options=options,
            plan=the_plan,
            points=points,
            timeline=timeline,
            verification=None,
            programs=withheld(posts, tolerance, "there is no motion"),
            manifest=manifest,
        )
        if timeline is not None and driven:
            with timings.stage("programs"):
                made = made.with_programs(write_programs(folder, posts, the_plan, toolpath, timeline, tolerance))
            with timings.stage("verify"):
                found = content_checks(cell, toolpath, folder, options=options, manifest=made.manifest)
                made = made.verified(found)
        if request.front and timeline is not None and made.exit_code == 0:
            with timings.stage("front"):
                own = measured("as asked", "", the_plan, timeline, points)
                made = replace(made, front=tuple(front(cell, toolpath, options, own, _motion)))
                write_front(folder / FRONT, list(made.front))
        with timings.stage("map"):
            shown = mapped(made.plan, request.map_all)
        result = _tell(made, folder, timings, shown)
        if made.verification is not None:
            whole = verify_folder(
                cell, toolpath, folder, options=options, inputs=manifest.inputs, contents=made.verification
            )
            if made.verification.ok and not whole.ok:  # what was written is not what was meant: a bug, or a bad disk
                result = _tell(replace(made, verification=whole), folder, timings, shown)
    return Outcome(result.exit_code, result, request.out / "report.html")


def _tell(made: Made, folder: Path, timings: Timings, shown: Mapped) -> OptimizeResult:
    """Write report, result and manifest; programs go where the motion does not hold."""
    if made.exit_code != 0 and any(p.files for p in made.programs):
        made = made.with_programs(withdrawn(folder, made.programs, made.verdict))
    with timings.stage("report"):
        data = report_data(
            made.plan,
            made.toolpath,
            made.points,
            made.timeline,
            made.verification,
            made.programs,
            shown=shown,
            unchecked=made.unchecked,
            hashes=hashes_of(made.manifest.inputs),
            options=options_as_user(made.options),
            timings=timings.seconds,
        )
        data = replace(
            data,
            front=tuple(
                FrontPoint(
                    p.plan,
                    p.changed,
                    p.mean_index,
                    p.worst_index,
                    p.cycle_time_s,
                    p.joint_travel_deg,
                    p.clearance_mm,
                    p.dominated,
                )
                for p in made.front
            ),
        )
        write_report(folder / "report.html", data)
    for name in ("result.json", MANIFEST):
        (folder / name).unlink(missing_ok=True)
    result = result_of(made, folder, timings.seconds)
    write_result(folder / "result.json", result)
    told = replace(made.manifest, verdict=made.verdict, exit_code=made.exit_code, unchecked=made.unchecked)
    write_manifest(folder, told, ROLES)
    return result


def _refuse_wrong_unit(cell: Cell, toolpath: Toolpath, request: Request) -> None:
    """Refuse a path whose numbers count another unit: all out of reach is no answer to it."""
    if cell.workpiece.link != "world" or cell.external_joints:
        return  # refused by the plan
    T_base_workpiece = inverse(cell.T_world_base) @ cell.workpiece.T_link_workpiece
    stated = "unit" in request.reading
    why = wrong_unit(toolpath, load_robot(cell), T_base_workpiece, cell.tool.T_flange_tcp, stated=stated)
    if why:
        raise InputError(why, file=request.toolpath)


def _refuse_fixed_beyond(toolpath: Toolpath, options: PlanOptions) -> None:
    if options.fixed and options.method != "global":
        raise InputError(
            f"method {options.method} chooses every rotation by itself and would not keep fixed ones; method global "
            "would",
            file="options",
            where="fixed",
        )
    for fixed in options.fixed:
        if fixed.point >= len(toolpath):
            raise InputError(
                f"point {fixed.point} is fixed, but {toolpath.source} has points 0 to {len(toolpath) - 1}",
                file="options",
                where="fixed",
            )


def _motion(the_plan: Plan, toolpath: Toolpath, options: PlanOptions, timings: Timings) -> Timeline | None:
    """The motion, unless points are missing that the user did not allow to miss."""
    cut = the_plan.path.counted
    missing = the_plan.missing
    needed = missing[the_plan.path.may_touch[missing]]  # rapid points that cannot be reached are passed by
    if (len(needed) or the_plan.breaks) and not options.allow_gaps:
        return None
    if cut.any() and not np.setdiff1d(np.flatnonzero(cut), missing).size:
        return None
    with timings.stage("retime"):
        return build_timeline(the_plan, toolpath)
