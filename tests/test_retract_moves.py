"""Retract moves along the tool axis, and their failure without room."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from test_planning_pipeline import FREE, pass_over_block, small_job

from machopt.data_types.plan_options import PlanOptions
from machopt.planning.motion.retract_moves import GAP_LIFTS, LIFTS, RetractMoves
from machopt.planning.pipeline.plan_data_types import Plan

ROW = 4


@pytest.fixture(scope="module")
def made(tmp_path_factory: pytest.TempPathFactory) -> Plan:
    return small_job(tmp_path_factory.mktemp("lifts"), pass_over_block(), FREE)


def within(plan: Plan, room: float) -> Plan:
    """Return the plan with joints that may move by ``room`` rad from their values at ROW."""
    q, arm = plan.chosen.assignment.q[ROW], plan.setup.arm
    return replace(plan, setup=replace(plan.setup, arm=replace(arm, lower=q - room, upper=q + room)))


def test_tool_retracts_along_its_own_axis(made: Plan) -> None:
    robot, tool = made.setup.robot, made.setup.arm.T_flange_tcp
    lifted = RetractMoves(made).lifted(ROW, 0.05)
    assert lifted is not None
    before, after = (robot.compute_fk(q, tool) for q in (made.chosen.assignment.q[ROW], lifted[:6]))
    np.testing.assert_allclose(after[:3, 3], before[:3, 3] - 0.05 * before[:3, 2], atol=1e-7)
    np.testing.assert_allclose(after[:3, :3], before[:3, :3], atol=1e-7)


def test_first_height_suffices_without_bodies_and_none_without_room(made: Plan) -> None:
    assert made.setup.collision is None
    assert RetractMoves(made).gap(ROW) == GAP_LIFTS[0]
    assert np.isnan(RetractMoves(within(made, 1e-4)).gap(ROW))
    assert RetractMoves(within(made, 1e-4)).lifted(ROW, 0.05) is None


def test_detours_lift_one_or_both_ends_but_not_home(made: Plan) -> None:
    both = list(RetractMoves(made).detours(ROW, ROW + 2))
    assert [len(way) for way in both] == [2, 1, 1] * len(LIFTS)
    one = list(RetractMoves(made).detours(-1, ROW))
    assert [len(way) for way in one] == [1] * len(LIFTS)  # no lift is tested twice
    np.testing.assert_array_equal(one[0][0], RetractMoves(made).lifted(ROW, LIFTS[0]))
    assert list(RetractMoves(within(made, 1e-4)).detours(ROW, -1)) == []


def test_gap_remains_where_the_rapid_move_starts(tmp_path_factory: pytest.TempPathFactory) -> None:
    """The tip is 10 mm above the block."""
    p = small_job(tmp_path_factory.mktemp("free"), pass_over_block(), PlanOptions(rotation_step=np.radians(30.0)))
    assert p.setup.collision is not None
    height = RetractMoves(p).gap(ROW)
    assert height in GAP_LIFTS
    lifted = RetractMoves(p).lifted(ROW, height)
    assert lifted is not None
    assert not p.setup.collision.check_configurations(lifted[None], np.array([False])).hit[0]
