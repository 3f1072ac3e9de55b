"""Jobs with rail and turntable as programs: written, read back, and every damage to an axis detected."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np
import pytest
from external_axis_cells import external_cell
from planned_program_output import write_and_compare_program
from test_external_axes import OPTIONS, K, separate_operations, slots
from test_planning_path import toolpath

from machopt.data_types.cell import Cell
from machopt.data_types.plan_options import ExternalJointOptions
from machopt.data_types.robot_program import ExternalAxisMap, RobotController
from machopt.data_types.toolpath import Toolpath
from machopt.planning.external_axis_optimization.single_toolpath_planning import find_best_plan
from machopt.planning.motion.trajectory_builder import MotionTimeline, build_timeline
from machopt.planning.pipeline.plan_data_types import Plan
from machopt.program_export.program_moves import build_robot_program, build_sampled_program
from machopt.programs.writing.target_insertion import ProgramTolerance
from machopt.verification.folder.programs.program_comparison_result import ProgramComparison
from machopt.verification.folder.programs.read_back import check_programs

POSTS = ("krl", "rapid", "fanuc", "jbi", "csv", "ros_json")
TOLERANCE = ProgramTolerance(turn=float(np.radians(1.0)))


@dataclass(frozen=True)
class Job:
    cell: Cell
    path: Toolpath
    plan: Plan
    timeline: MotionTimeline

    def posted(self, folder: Path, post: str) -> ProgramComparison:
        make = build_sampled_program if post.startswith("ros") else build_robot_program
        made = make(self.plan, self.path, self.timeline)
        return write_and_compare_program(folder, self.plan, self.path, self.timeline, made, TOLERANCE, post)


@pytest.fixture(scope="module")
def job(tmp_path_factory: pytest.TempPathFactory) -> Job:
    """Two slots, each with its own rail position and table rotation."""
    cell = external_cell(tmp_path_factory.mktemp("cell"), rail=True, table=True)
    drives = {
        "rail": ExternalAxisMap(number=2, sign=-1.0, offset=500.0),
        "turn": ExternalAxisMap(number=1, sign=1.0, offset=10.0, unit="STN1", machine=2),
    }
    cell = replace(cell, stiffness=K, controller=RobotController(nonflip_j5="negative", external=drives))
    path = separate_operations(toolpath(slots(-0.1, 0.05)))
    options = replace(OPTIONS, external=tuple(ExternalJointOptions(joint=f"e{k}", mode="operation") for k in (1, 2)))
    p = find_best_plan(cell, path, options)
    timeline = build_timeline(p, path)
    assert timeline.trajectory is not None
    return Job(cell, path, p, timeline)


@pytest.mark.parametrize("post", POSTS)
def test_every_maker_writes_external_axes(tmp_path: Path, job: Job, post: str) -> None:
    found = job.posted(tmp_path / "out", post)
    assert found.differences == ()
    assert found.get_verdict("external axes at targets") is True


def grown(text: str, before: str, by: float) -> str:
    """Increase the number after the last ``before`` in the second line that contains it."""
    line = [line for line in text.split("\n") if before in line][1]
    head, _, tail = line.rpartition(before)
    number = tail[: len(tail) - len(tail.lstrip("-.0123456789"))]
    return text.replace(line, f"{head}{before}{float(number) + by:.4f}{tail[len(number) :]}", 1)


def cut(text: str, before: str) -> str:
    line = [line for line in text.split("\n") if before in line][1]
    head, _, tail = line.partition(before)
    return text.replace(line, head + tail.lstrip("-.0123456789"), 1)


def negate_numbers(text: str, before: str) -> str:
    """Change the sign of every number after a word."""
    return text.replace(before, before + "-").replace(before + "--", before)


DAMAGES: list[tuple[str, str, Callable[[str], str], str]] = [
    ("krl", "no E2 in a line", lambda t: cut(t, ",E2 "), "does not state the positions of the external axes"),
    ("krl", "a rail 0.2 mm off", lambda t: grown(t, ",E2 ", 0.2), "external axes at targets"),
    ("krl", "another direction", lambda t: negate_numbers(t, ",E1 "), "targets on the motion"),
]


@pytest.mark.parametrize(("post", "damage", "change", "told"), DAMAGES, ids=[d[1] for d in DAMAGES])
def test_damages_are_detected(
    tmp_path: Path, job: Job, post: str, damage: str, change: Callable[[str], str], told: str
) -> None:
    sound = job.posted(tmp_path / "out", post)
    file = tmp_path / "out" / sound.program.files[0]
    text = file.read_bytes().decode()
    changed = change(text)
    assert changed != text, damage
    file.write_bytes(changed.encode())
    (found,) = check_programs(
        job.cell, job.path, tmp_path / "out", [sound.program], options=job.plan.options, tolerance=TOLERANCE
    )
    assert any(told in d for d in found.differences), found.differences
