"""Output folder of a planned motion with one program, and the result of its comparison."""

from __future__ import annotations

from pathlib import Path

from machopt.data_types.toolpath import Toolpath
from machopt.output.tables.plan_tables import write_points_csv, write_rapid_corners_csv, write_trajectory_csv
from machopt.planning.compensation.driven_margins import apply_driven_rotation
from machopt.planning.motion.trajectory_builder import MotionTimeline
from machopt.planning.pipeline.plan_data_types import Plan
from machopt.planning.plan_output.point_table import build_point_table
from machopt.program_export.program_moves import MotionProgram
from machopt.programs.program_writer import format_program_name, write_program
from machopt.programs.writing.target_insertion import ProgramTolerance
from machopt.verification.folder.programs.post_lookup import select_controller
from machopt.verification.folder.programs.program_comparison_result import ListedProgram, ProgramComparison
from machopt.verification.folder.programs.read_back import check_programs


def write_and_compare_program(
    out: Path,
    plan: Plan,
    toolpath: Toolpath,
    timeline: MotionTimeline,
    made: MotionProgram,
    tolerance: ProgramTolerance,
    post: str,
) -> ProgramComparison:
    """Write tables and program to the new folder ``out`` and compare them."""
    out.mkdir(parents=True)
    assert timeline.trajectory is not None
    write_points_csv(out / "points.csv", build_point_table(apply_driven_rotation(plan, timeline.phi), toolpath).table)
    cell = plan.setup.cell
    labels = [o.label for o in toolpath.operations]
    write_trajectory_csv(out / "trajectory.csv", timeline.trajectory, labels, cell.external_prismatic)
    if timeline.trajectory.corners is not None:
        write_rapid_corners_csv(out / "rapid_corners.csv", timeline.trajectory.corners, cell.external_prismatic)
    files = write_program(
        out, format_program_name(toolpath.source, post), made.program, post, select_controller(cell, post)
    )
    names = tuple(f.relative_to(out).as_posix() for f in files)
    (found,) = check_programs(
        cell, toolpath, out, [ListedProgram(post, post, names)], options=plan.options, tolerance=tolerance
    )
    return found
