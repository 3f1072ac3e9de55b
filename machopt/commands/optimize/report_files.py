"""Output of a run of ``machopt optimize``: report, result and manifest."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

from machopt.commands.input_hashes import map_hashes_by_name
from machopt.commands.optimize.document import build_optimize_document
from machopt.commands.optimize.job_result import OptimizeJobResult
from machopt.data_types.documents.optimize_document import OptimizeDocument
from machopt.data_types.stock import StockEngagement
from machopt.options.plan_option_reader import format_user_options
from machopt.output import MANIFEST, write_manifest, write_result
from machopt.output.file_roles import ROLES
from machopt.output.tables.plan_tables import (
    write_compensation_csv,
    write_engagement_csv,
    write_points_csv,
    write_rapid_corners_csv,
    write_tilt_csv,
    write_trajectory_csv,
)
from machopt.planning.motion.trajectory_builder import MotionTimeline
from machopt.planning.pipeline.plan_data_types import Plan
from machopt.planning.pipeline.planning_setup import StageTimings
from machopt.planning.plan_output.point_table import PointResults
from machopt.program_export.exported_programs import remove_programs
from machopt.report.page_data.optimize import PlanEvidence, build_report_data
from machopt.report.pages.optimize.optimize_page import write_report


def write_report_files(job_result: OptimizeJobResult, folder: Path, timings: StageTimings) -> OptimizeDocument:
    """Write report, result and manifest; remove the programs where the motion failed its verification.

    Args:
        job_result: Result of the run.
        folder: The output folder.
        timings: Computing time of each stage.
    """
    if job_result.exit_code != 0 and any(p.files for p in job_result.programs):
        job_result = job_result.with_programs(remove_programs(folder, job_result.programs, job_result.verdict))
    with timings.stage("report"):
        evidence = PlanEvidence(
            verification=job_result.verification,
            programs=[p.to_page_data() for p in job_result.programs],
            front=job_result.front,
            shown=job_result.shown,
            unchecked=job_result.unchecked,
            blockers=job_result.production_blockers,
            hashes=map_hashes_by_name(job_result.manifest.inputs),
            options=format_user_options(job_result.options),
            timings=timings.seconds,
            stock=job_result.stock,
        )
        data = build_report_data(job_result.plan, job_result.toolpath, job_result.points, job_result.timeline, evidence)
        write_report(folder / "report.html", data)
    for name in ("result.json", MANIFEST):
        (folder / name).unlink(missing_ok=True)
    result = build_optimize_document(job_result, folder, timings.seconds)
    write_result(folder / "result.json", result)
    manifest = replace(
        job_result.manifest, verdict=job_result.verdict, exit_code=job_result.exit_code, unchecked=job_result.unchecked
    )
    write_manifest(folder, manifest, ROLES)
    return result


def write_plan_tables(
    folder: Path,
    plan: Plan,
    points: PointResults,
    timeline: MotionTimeline | None,
    engagement: StockEngagement | None = None,
) -> None:
    """Write points.csv, and where there is a motion trajectory.csv, and compensation.csv, tilt.csv and
    rapid_corners.csv as far as it has any.

    Args:
        folder: The output folder.
        plan: The plan.
        points: Results at the toolpath's points.
        timeline: The motion over time; None where there is no motion.
        engagement: Contact with the stock, for engagement.csv; None where no operation takes it from there.
    """
    write_points_csv(folder / "points.csv", points.table)
    if engagement is not None:
        write_engagement_csv(folder / "engagement.csv", engagement)
    if timeline is None or timeline.trajectory is None:
        return
    cell, labels = plan.setup.cell, points.table.operations
    file = folder / "trajectory.csv"
    write_trajectory_csv(file, timeline.trajectory, labels, cell.external_prismatic, list_tool_names(plan))
    if plan.compensation is not None:
        c = plan.compensation
        write_compensation_csv(folder / "compensation.csv", plan.path.index, c.offset, c.force)
    if plan.path.lead is not None and plan.path.side is not None:
        write_tilt_csv(folder / "tilt.csv", plan.path.index, plan.path.lead, plan.path.side)
    if timeline.trajectory.corners is not None:
        write_rapid_corners_csv(folder / "rapid_corners.csv", timeline.trajectory.corners, cell.external_prismatic)


def list_tool_names(plan: Plan) -> tuple[str, ...]:
    """Return the tool of each segment of the plan, in order; none where the cell has no tool table.

    Args:
        plan: The plan.
    """
    cells = [part.plan.setup.cell for part in plan.parts] or [plan.setup.cell]
    return tuple(cell.tool_name for cell in cells if cell.tool_name is not None)
