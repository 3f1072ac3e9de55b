"""Jobs without a complete motion of all free external joints are planned with some of them locked."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from external_axis_cells import external_cell
from test_planning_path import Rows, toolpath

from machopt.cell.tool_selection import split_into_tool_segments
from machopt.data_types.plan_options import ExternalJointOptions, PlanOptions, ProcessForce, SteeringRule
from machopt.data_types.stiffness import ArmStiffness
from machopt.data_types.toolpath import MoveKind, Toolpath
from machopt.planning.job import job_planner
from machopt.planning.job.locked_axes import iterate_locked_subsets
from machopt.planning.motion import search_budget
from machopt.planning.motion.blocked_rapid_break import RestPose, build_blocked_break
from machopt.planning.motion.rapid_moves import BlockedRapid
from machopt.planning.motion.search_budget import (
    SearchBudget,
    allow_extensions,
    count_in_vain,
    is_used_up,
    limit_search,
)
from machopt.planning.motion.trajectory_builder import MotionTimeline
from machopt.planning.pipeline.plan_data_types import Plan
from machopt.planning.pipeline.planning_setup import StageTimings
from machopt.planning.pipeline.sequence_breaks import SequenceBreak

UP = (0.0, 0.0, 1.0)
OPTIONS = PlanOptions(
    collision=False, rotation_step=np.radians(60.0), force=ProcessForce(axial=100.0), sample=0.05,
    external=tuple(ExternalJointOptions(joint=name, mode="operation") for name in ("turn", "tilt")),
)  # fmt: skip
K = ArmStiffness(joints=np.array([1.4e6, 1.2e6, 9.4e5, 3.6e5, 3.7e5, 3.8e5]))


def slot() -> Toolpath:
    rows: Rows = [((0.0, 0.1, 0.05), UP, MoveKind.RAPID)]
    rows += [((0.0, 0.1 + d, 0.0), UP, MoveKind.CUT) for d in (0.0, 0.02)]
    return toolpath([*rows, ((0.0, 0.12, 0.05), UP, MoveKind.RETRACT)])


def blocked_unless_locked(monkeypatch: pytest.MonkeyPatch, wanted: set[str]) -> list[set[str]]:
    """Block motions unless all joints ``wanted`` are locked; return the locked joints of each motion tried."""
    real, tried = job_planner.plan_motion, list[set[str]]()

    def motion(plan: Plan, path: Toolpath, options: PlanOptions, timings: StageTimings) -> MotionTimeline | None:
        timeline = real(plan, path, options, timings)
        locked = {axis.joint for axis in plan.options.external if axis.mode == "locked"}
        tried.append(locked)
        if timeline is None or wanted <= locked:
            return timeline
        stop = SequenceBreak(before=np.nan, after=0.0, code="home_collides", text="in the way", help="none")
        return replace(timeline, trajectory=None, obstructions=(stop,))

    monkeypatch.setattr(job_planner, "plan_motion", motion)
    return tried


@pytest.mark.parametrize("wanted", [{"tilt"}, {"turn"}, {"tilt", "turn"}])
def test_drivable_subset_is_the_answer(tmp_path: Path, monkeypatch: pytest.MonkeyPatch, wanted: set[str]) -> None:
    cell, path = replace(external_cell(tmp_path, table=True, tilt=True), stiffness=K), slot()
    tried = blocked_unless_locked(monkeypatch, wanted)
    job = job_planner.plan_job(split_into_tool_segments(cell, path), path, OPTIONS, StageTimings())
    assert tried[0] == set()  # the plan with all free joints is tried first
    assert job.timeline is not None
    assert job.timeline.trajectory is not None
    assert not len(job.plan.missing)
    where = [cell.external_joints.index(name) for name in wanted]
    np.testing.assert_array_equal(job.timeline.trajectory.external[:, where], 0.0)
    note = job.timeline.detours[-1]
    assert all(name in note for name in wanted)
    assert job.plan.options.external == OPTIONS.external  # the options of the user are unchanged


def test_free_plan_is_the_answer_without_a_drivable_subset(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    cell, path = replace(external_cell(tmp_path, table=True), stiffness=K), slot()
    tried = blocked_unless_locked(monkeypatch, {"nothing"})
    options = replace(OPTIONS, external=OPTIONS.external[:1])
    job = job_planner.plan_job(split_into_tool_segments(cell, path), path, options, StageTimings())
    assert tried[0] == set()
    assert {"turn"} in tried
    assert job.timeline is not None
    assert job.timeline.trajectory is None


def test_each_free_joint_is_locked_alone_and_then_all(tmp_path: Path) -> None:
    cell = external_cell(tmp_path, rail=True, table=True, tilt=True)
    every = ("rail",), ("tilt",), ("turn",), ("rail", "tilt", "turn")
    assert [names for names, _ in iterate_locked_subsets(cell, PlanOptions())] == [*every]
    for own in (
        ExternalJointOptions(joint="tilt", mode="locked"),
        ExternalJointOptions(joint="e2", preferred=0.2),
        ExternalJointOptions(joint="tilt", range=(0.1, 0.3)),
        ExternalJointOptions(joint="tilt", operations=(("op", "locked"),)),
    ):
        found = [names for names, _ in iterate_locked_subsets(cell, PlanOptions(external=(own,)))]
        assert found == [("rail",), ("turn",), ("rail", "turn")]
    assert not list(iterate_locked_subsets(cell, PlanOptions(steer=(SteeringRule(joint="rail"),))))


def test_number_of_failed_attempts_is_bounded() -> None:
    assert allow_extensions(2000) == 2000
    budget = SearchBudget(3000)
    with limit_search(budget):
        for _ in range(2):
            count_in_vain(allow_extensions(2000))
        assert is_used_up()
        assert budget.left == -1000
        assert allow_extensions(2000) == search_budget.AFTERWARDS
    assert not is_used_up()
    assert allow_extensions(2000) == 2000


def test_truncated_search_differs_from_an_unsuccessful_one() -> None:
    blocked = BlockedRapid(pair="a ~ b", where=np.zeros(6), fraction=0.5, reason="way")
    start, end = RestPose(np.zeros(6), 0.0, 0), RestPose(np.ones(6), 1.0, 1)
    assert build_blocked_break(blocked, start, end).code == "rapid_blocked"
    with limit_search(SearchBudget(0)):
        assert build_blocked_break(blocked, start, end).code == "rapid_search_cut_short"
