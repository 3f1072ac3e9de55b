"""A planned motion written as an output folder with one program, and what the comparison says of it."""

from __future__ import annotations

from pathlib import Path

from machopt.domain.toolpath import Toolpath
from machopt.formats.posts import program_name, write_program
from machopt.formats.posts.densify import Tolerance
from machopt.formats.tables import write_points_csv, write_trajectory_csv
from machopt.plan.compensation.margins import as_driven
from machopt.plan.motion.timeline import Timeline
from machopt.plan.pipeline.planned import Plan
from machopt.plan.written.points import point_results
from machopt.postprocess.moves import Programmed
from machopt.recheck.compared import Compared, Posted
from machopt.recheck.posts import controller_for
from machopt.recheck.readback import check_programs


def posted(
    out: Path, plan: Plan, toolpath: Toolpath, timeline: Timeline, made: Programmed, tolerance: Tolerance, post: str
) -> Compared:
    """Tables and program into ``out``, which is made; compared."""
    out.mkdir(parents=True)
    assert timeline.trajectory is not None
    write_points_csv(out / "points.csv", point_results(as_driven(plan, timeline.phi), toolpath).table)
    cell = plan.setup.cell
    labels = [o.label for o in toolpath.operations]
    write_trajectory_csv(out / "trajectory.csv", timeline.trajectory, labels, cell.external_prismatic)
    files = write_program(out, program_name(toolpath.source, post), made.program, post, controller_for(cell, post))
    names = tuple(f.relative_to(out).as_posix() for f in files)
    (found,) = check_programs(
        cell, toolpath, out, [Posted(post, post, names)], options=plan.options, tolerance=tolerance
    )
    return found
