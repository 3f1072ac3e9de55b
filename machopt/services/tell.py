"""What came of a run of ``machopt optimize``, written: report, result, manifest."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

from machopt.domain.results.optimize import OptimizeResult
from machopt.formats.options import options_as_user
from machopt.formats.tables import write_compensation_csv, write_points_csv, write_trajectory_csv
from machopt.output import MANIFEST, write_manifest, write_result
from machopt.output.roles import ROLES
from machopt.plan.motion.timeline import Timeline
from machopt.plan.pipeline.planned import Plan
from machopt.plan.pipeline.setup import Timings
from machopt.plan.written.contact_map import Mapped
from machopt.plan.written.points import PointResults
from machopt.postprocess.written import withdrawn
from machopt.report.gather.optimize import report_data
from machopt.report.page import write_report
from machopt.services.inputs import hashes_of
from machopt.services.made import Made
from machopt.services.result import result_of


def tell(made: Made, folder: Path, timings: Timings, shown: Mapped) -> OptimizeResult:
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
            [p.as_page() for p in made.programs],
            front=made.front,
            shown=shown,
            unchecked=made.unchecked,
            blockers=made.production_blockers,
            hashes=hashes_of(made.manifest.inputs),
            options=options_as_user(made.options),
            timings=timings.seconds,
        )
        write_report(folder / "report.html", data)
    for name in ("result.json", MANIFEST):
        (folder / name).unlink(missing_ok=True)
    result = result_of(made, folder, timings.seconds)
    write_result(folder / "result.json", result)
    told = replace(made.manifest, verdict=made.verdict, exit_code=made.exit_code, unchecked=made.unchecked)
    write_manifest(folder, told, ROLES)
    return result


def write_tables(folder: Path, plan: Plan, points: PointResults, timeline: Timeline | None) -> None:
    """points.csv, and trajectory.csv and compensation.csv where there is a motion."""
    write_points_csv(folder / "points.csv", points.table)
    if timeline is None or timeline.trajectory is None:
        return
    cell, labels = plan.setup.cell, points.table.operations
    file = folder / "trajectory.csv"
    write_trajectory_csv(file, timeline.trajectory, labels, cell.external_prismatic, tool_names(plan))
    if plan.compensation is not None:
        c = plan.compensation
        write_compensation_csv(folder / "compensation.csv", plan.path.index, c.offset, c.force)


def tool_names(plan: Plan) -> tuple[str, ...]:
    """The tool of each stretch of the plan, in order; none where the cell has no table."""
    cells = [part.plan.setup.cell for part in plan.parts] or [plan.setup.cell]
    return tuple(cell.tool_name for cell in cells if cell.tool_name is not None)
