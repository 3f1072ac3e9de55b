"""``machopt optimize``: from a cell and a CAM file to a folder with motion, program, tables, verdict and report."""

from __future__ import annotations

import hashlib
from collections.abc import Callable
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np

import machopt
from machopt.domain.cell import Cell
from machopt.domain.options import PlanOptions
from machopt.domain.toolpath import Toolpath
from machopt.errors import InputError
from machopt.formats.cell import load_cell
from machopt.formats.options import load_options, options_as_user
from machopt.formats.outfolder import output_folder, write_json
from machopt.formats.tables import write_compensation_csv, write_points_csv, write_trajectory_csv
from machopt.formats.toolpath import read_toolpath
from machopt.job.knownrobot import known_robot
from machopt.job.page import report_data
from machopt.job.points import PointResults, point_results
from machopt.job.posts import Written, is_post_file, tolerance_of, wanted_posts, write_programs
from machopt.plan.compensate import compensate, residual
from machopt.plan.explain import hints
from machopt.plan.pipeline import Plan, Scored, Timings, as_driven, plan
from machopt.plan.refine import with_corners
from machopt.plan.timeline import Timeline, build_timeline
from machopt.plan.uncertainty import Gain, gains
from machopt.report.page import write_report
from machopt.verify import Verification, verify_output


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
    program_tolerance_mm: float | None = None  # 0.05, or twice path_tolerance_mm where that is more


@dataclass(frozen=True)
class Outcome:
    """What came out; ``exit_code`` follows the contract (0, 3 or 4)."""

    exit_code: int
    result: dict[str, object]  # result.json
    report: Path


def optimize(request: Request, progress: Callable[[str], None] = lambda _: None) -> Outcome:
    """Run the main job.

    Raises:
        InputError: bad cell, toolpath, options or output folder.
    """
    timings = Timings(progress=progress)
    with timings.stage("load"):
        cell = load_cell(request.cell, allow_external=request.allow_external)
        options = load_options(cell.plan, request.plan_file, list(request.overrides), **(request.direct or {}))
        posts, tolerance = wanted_posts(cell, request.posts), tolerance_of(request.program_tolerance_mm, options)
        toolpath = read_toolpath(request.toolpath, robot=known_robot(cell), **request.reading)
        _refuse_fixed_beyond(toolpath, options)
    with output_folder(request.out) as folder:
        the_plan = plan(cell, toolpath, options, timings)
        if options.compensate:
            with timings.stage("compensate"):
                the_plan = compensate(with_corners(the_plan, toolpath))
        timeline = _motion(the_plan, toolpath, options, timings)
        if timeline is not None and timeline.trajectory is not None:
            the_plan = as_driven(the_plan, timeline.phi)
        with timings.stage("points"):
            points = point_results(the_plan, toolpath)
        verification, programs = None, tuple[Written, ...]()
        with timings.stage("export"):
            write_points_csv(folder / "points.csv", points.table)
            if timeline is not None and timeline.trajectory is not None:
                labels = [o.label for o in toolpath.operations]
                write_trajectory_csv(folder / "trajectory.csv", timeline.trajectory, labels)
                if the_plan.compensation is not None:
                    c = the_plan.compensation
                    write_compensation_csv(folder / "compensation.csv", the_plan.path.index, c.offset, c.force)
        if timeline is not None and timeline.trajectory is not None:
            with timings.stage("programs"):
                programs = write_programs(folder, posts, the_plan, toolpath, timeline, tolerance)
            with timings.stage("verify"):
                verification = verify_output(cell, toolpath, folder, options=options)
        result = _result(
            request, cell, toolpath, options, the_plan, points, timeline, verification, programs, timings.seconds
        )
        with timings.stage("report"):
            data = report_data(
                the_plan, toolpath, points, timeline, verification, programs, hashes=result["inputs"],  # type: ignore[arg-type]
                options=options_as_user(options), timings=timings.seconds,
            )  # fmt: skip
            write_report(folder / "report.html", data)
        write_json(folder / "result.json", result)
    return Outcome(int(result["exit_code"]), result, request.out / "report.html")  # type: ignore[call-overload]


def _refuse_fixed_beyond(toolpath: Toolpath, options: PlanOptions) -> None:
    for fixed in options.fixed:
        if fixed.point >= len(toolpath):
            raise InputError(
                f"point {fixed.point} is fixed, but {toolpath.source} has points 0 to {len(toolpath) - 1}",
                file="options", where="fixed",
            )  # fmt: skip


def _motion(the_plan: Plan, toolpath: Toolpath, options: PlanOptions, timings: Timings) -> Timeline | None:
    """The motion, unless points are missing that the user did not allow to miss."""
    cut = the_plan.path.counted
    missing = the_plan.missing
    needed = missing[the_plan.path.may_touch[missing]]  # rapid points that cannot be reached are passed by
    broken = bool(the_plan.choice.broken) and the_plan.chosen_from != "jiao2022"
    if (len(needed) or broken) and not options.allow_gaps:
        return None
    if cut.any() and not np.setdiff1d(np.flatnonzero(cut), missing).size:
        return None
    with timings.stage("retime"):
        return build_timeline(the_plan, toolpath)


def _result(
    request: Request, cell: Cell, toolpath: Toolpath, options: PlanOptions, the_plan: Plan, points: PointResults,
    timeline: Timeline | None, verification: Verification | None, programs: tuple[Written, ...],
    seconds: dict[str, float],
) -> dict[str, object]:  # fmt: skip
    trajectory = timeline.trajectory if timeline else None
    if trajectory is None:
        exit_code, verdict = 3, "infeasible"
    elif (verification is not None and not verification.ok) or not all(p.ok for p in programs):
        exit_code, verdict = 4, "verification failed"
    else:
        exit_code, verdict = 0, "done" if not len(the_plan.missing) else "done with gaps"
    worst = _worst(the_plan, points)
    missing = [int(p) for p in the_plan.missing if the_plan.path.is_point[p]]
    return {
        "machopt_result": 1,
        "version": machopt.__version__,
        "verdict": verdict,
        "exit_code": exit_code,
        "inputs": {**{_name_in(cell, f): _sha(f) for f in cell.files}, toolpath.source: toolpath.sha256,
                   **{text: _sha(Path(text)) for text in request.posts if is_post_file(text)}},
        "options": options_as_user(options),
        "cell": cell.name,
        "toolpath": {"source": toolpath.source, "format": toolpath.format, "points": len(toolpath),
                     "cutting_points": int(toolpath.cutting.sum()),
                     "operations": [o.label for o in toolpath.operations],
                     "ignored": [vars(w) for w in toolpath.ignored]},
        "index": the_plan.scores.index,
        "index_scale": the_plan.scores.scale,
        "chosen_from": the_plan.chosen_from,
        "objective": {"cam_default": _objective(the_plan.cam_default), "jiao2022": _objective(the_plan.jiao2022),
                      "grid": vars(the_plan.grid), "chosen": _objective(the_plan.chosen),
                      "gain": [_gain(g) for g in gains(the_plan)]},
        "worst_point": worst,
        "compensation": _compensation(the_plan) if trajectory is not None else None,
        "infeasible_points": [
            {"point": k, "reason": points.table.reason[k]} for k in (round(the_plan.path.index[p]) for p in missing)
        ],
        "cycle_time_s": float(trajectory.time[-1]) if trajectory else None,
        "feed_held_share": timeline.held_share if trajectory and timeline else None,
        "feed_dips": [
            {"first_point": d.first, "last_point": d.last, "lowest_ratio": d.ratio, "where": d.where,
             "axis": d.joint, "limit": d.limit}
            for d in (timeline.dips if timeline else ())
        ],
        "rapid_detours": list(timeline.detours) if timeline else [],
        "obstructions": [vars(o) for o in (timeline.obstructions if timeline else ())],
        "verification": None if verification is None else {
            "passed": verification.ok,
            "checks": [vars(c) for c in verification.checks],
        },
        "programs": [p.as_result() for p in programs],
        "warnings": [*cell.warnings, *toolpath.warnings, *hints(the_plan)],
        "timings_s": {name: round(value, 3) for name, value in seconds.items()},
    }  # fmt: skip


def _objective(scored: Scored) -> dict[str, object]:
    feasible = int((scored.assignment.reason == 0).sum())
    return {**vars(scored.objective), "feasible_share": feasible / len(scored.assignment.reason)}


def _gain(gain: Gain) -> dict[str, object]:
    """How much less the mean cost is: of deflection, or of compliance where no force is given; null where unknown."""

    def share(value: float) -> float | None:
        return 100.0 * value if np.isfinite(value) else None

    return {"over": gain.over, "mean_percent": share(gain.mean), "std_percent": share(gain.std),
            "ci90": [share(v) for v in gain.interval] if np.isfinite(gain.std) else None,
            "distinguishable": gain.distinguishable if np.isfinite(gain.std) else None}  # fmt: skip


def _compensation(the_plan: Plan) -> dict[str, object] | None:
    found = residual(the_plan)
    if found is None:
        return None
    return {"max_mm": 1e3 * found.shift_worst, "mean_mm": 1e3 * found.shift_mean,
            "uncompensated_mean_mm": 1e3 * found.uncompensated,
            "residual_max_mm": 1e3 * found.worst, "residual_mean_mm": 1e3 * found.mean}  # fmt: skip


def _worst(the_plan: Plan, points: PointResults) -> dict[str, object] | None:
    cost = np.where(the_plan.path.counted, the_plan.chosen.cost, np.nan)[points.rows]
    if not np.isfinite(cost).any():
        return None
    i = int(np.nanargmax(cost))
    t = points.table
    return {"point": i, "k_axial_N_mm": t.k_axial[i] / 1e3, "k_normal_N_mm": t.k_normal[i] / 1e3,
            "deflection_mm": t.deflection[i] * 1e3, "gamma_deg": float(np.degrees(t.gamma[i])),
            "k_jiao_x_N_mm": t.k_jiao_x[i] / 1e3, "q_deg": np.degrees(t.q[i]).round(4).tolist()}  # fmt: skip


def _name_in(cell: Cell, file: Path) -> str:
    return str(file.relative_to(cell.folder) if file.is_relative_to(cell.folder) else file)


def _sha(file: Path) -> str:
    return hashlib.sha256(file.read_bytes()).hexdigest()
