"""Margins hold for the executed motion, whose rotation is smoothed."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from small_cell import limits, pose, small_cell
from test_planning_path import Rows, toolpath
from test_planning_pipeline import UP, C, K, R

from machopt.data_types.cell import Cell, CutterGeometry, Tool
from machopt.data_types.infeasibility_reasons import InfeasibilityReason
from machopt.data_types.plan_options import FixedRotation, PlanOptions
from machopt.data_types.stiffness import ArmStiffness
from machopt.data_types.tool_segments import ToolSegment
from machopt.placement.moved_cell import MovedBodies
from machopt.placement.search_options import NO_SHIFT
from machopt.placement.segment_task import build_single_segment, plan_at_placement
from machopt.planning.compensation.driven_margins import apply_driven_rotation, find_lost_margin
from machopt.planning.job.job_planner import JobPlan, plan_job
from machopt.planning.motion.trajectory_builder import plan_motion
from machopt.planning.pipeline.path_planner import plan_path
from machopt.planning.pipeline.plan_data_types import Plan
from machopt.planning.pipeline.planning_setup import StageTimings
from machopt.verification.motion.checks.requested_choices import MARGIN_TOLERANCE_DEG

# down, then along x with an abrupt change of rotation: joint 1 has its extreme value at the corner
ROWS: Rows = [((-0.1, -0.1, z), UP, R if z == 0.08 else C) for z in (0.08, 0.03, 0.0105, 0.01)]
ROWS += [((-0.1 + 0.01 * k, -0.1, 0.01), UP, C) for k in (1, 2, 3)]
PINS = tuple(FixedRotation(n, g) for n, g in zip(range(3, 7), (-1.6, -1.8, -1.95, -2.1), strict=True))
OPTIONS = PlanOptions(collision=False, fixed=PINS)
TOOL = Tool(
    T_flange_tcp=pose(0.1, 0, 0.3, 0.7), mass=20.0, com=np.zeros(3), geometry=(), cutter=CutterGeometry(0.012, 0.06)
)
ON_IT = np.radians(1e-5)  # distance of the planned pose from the margin


@pytest.fixture(scope="module")
def on_the_margin(tmp_path_factory: pytest.TempPathFactory) -> tuple[Cell, Plan]:
    """Return a cell with a joint limit at the extreme value of the plan, and the plan."""
    cell = small_cell(tmp_path_factory.mktemp("cell"), stiffness=ArmStiffness(joints=K), tool=TOOL)
    path = toolpath(ROWS)
    least = plan_path(cell, path, OPTIONS).chosen.assignment.q[:, 0].min()
    near = replace(cell, limits=replace(limits(), lower=limits().lower.copy()))
    near.limits.lower[0] = least - OPTIONS.limit_margin - ON_IT
    return near, plan_path(near, path, OPTIONS)


def job(cell: Cell, options: PlanOptions) -> JobPlan:
    path, home = toolpath(ROWS), cell.joints_at_home
    return plan_job(
        (ToolSegment(cell=cell, toolpath=path, whole=path, first=0, begin=home, end=home),),
        path,
        options,
        StageTimings(),
    )


def test_driven_path_uses_more_margin_than_verify_allows(on_the_margin: tuple[Cell, Plan]) -> None:
    cell, planned = on_the_margin
    timeline = plan_motion(planned, toolpath(ROWS), OPTIONS, StageTimings())
    assert timeline is not None
    driven = apply_driven_rotation(planned, timeline.phi)
    assert not len(planned.missing)
    stop = find_lost_margin(planned, driven)
    assert stop is not None
    assert stop.after == 2.0
    short = cell.limits.lower[0] + OPTIONS.limit_margin - driven.chosen.assignment.q[:, 0].min()
    assert np.degrees(short) > 10 * MARGIN_TOLERANCE_DEG


def test_such_a_plan_is_repeated_with_a_larger_margin(on_the_margin: tuple[Cell, Plan]) -> None:
    cell, _ = on_the_margin
    done = job(cell, OPTIONS)
    assert done.timeline is not None
    assert done.timeline.trajectory is not None
    assert (done.plan.chosen.assignment.reason == InfeasibilityReason.OK).all()
    assert done.plan.options == OPTIONS  # the requested options, not those used internally
    margin = np.degrees(done.points.table.limit_margin)
    assert margin.min() > np.degrees(OPTIONS.limit_margin) - MARGIN_TOLERANCE_DEG


def test_plan_that_cannot_be_repeated_is_infeasible_with_a_reason(
    on_the_margin: tuple[Cell, Plan], monkeypatch: pytest.MonkeyPatch
) -> None:
    cell, _ = on_the_margin
    monkeypatch.setattr("machopt.planning.job.job_planner.MAX_MARGIN_REPLANS", 0)
    done = job(cell, OPTIONS)
    assert done.timeline is not None
    assert done.timeline.trajectory is None
    (stop,) = done.timeline.obstructions
    assert "limit_margin_deg" in stop.text
    assert "point 3" in done.plan.conflict


def test_placement_uses_the_driven_margin(on_the_margin: tuple[Cell, Plan], monkeypatch: pytest.MonkeyPatch) -> None:
    cell, _ = on_the_margin
    carried = MovedBodies(False, frozenset(), np.zeros(3))
    placed = plan_at_placement(build_single_segment(cell, toolpath(ROWS)), carried, NO_SHIFT, OPTIONS)
    done = job(cell, OPTIONS)
    assert done.timeline is not None
    assert done.timeline.trajectory is not None
    assert not placed.obstruction
    assert placed.seconds == done.timeline.trajectory.time[-1]  # the same motion as in optimize
    assert placed.plan.options == OPTIONS
    monkeypatch.setattr("machopt.planning.job.job_planner.MAX_MARGIN_REPLANS", 0)
    placed = plan_at_placement(build_single_segment(cell, toolpath(ROWS)), carried, NO_SHIFT, OPTIONS)
    assert "limit_margin_deg" in placed.obstruction
