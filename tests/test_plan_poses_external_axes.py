"""Load tests of arms on rails and next to positioners, whose axes are fixed during the test."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from external_axis_cells import external_cell
from small_cell import small_cell

from machopt.commands.plan_poses.computation import compute_pose_plan
from machopt.data_types.cell import Cell, describe_fixed_external_joints
from machopt.data_types.stiffness import ArmStiffness, ExternalJointSpring
from machopt.errors import InputError
from machopt.kinematics.machine import load_machine
from machopt.kinematics.urdf_loading import load_robot
from machopt.measurement.design.external_axis_position_option import (
    describe_external_axis_positions,
    set_external_axis_positions,
    update_base_frame,
)
from machopt.measurement.design.request import PosesRequest, remove_workpiece
from machopt.measurement.diagnosis.discrimination.next_measurement import NextMeasurement, plan_next_measurement

K = ArmStiffness(joints=np.array([1.4e6, 1.2e6, 9.4e5, 3.6e5, 3.7e5, 3.8e5]))
FEW = PosesRequest(
    cell=Path("cell"),
    out=Path("out"),
    poses=3,
    candidates=40,
    starts=1,
    weights_kg=(50.0,),
    target_percent=None,
    anchors_mm=((3000.0, 0.0, 1500.0),),
    pull_N=(500.0,),
)


def test_fixed_values_are_set_by_name_and_reported(tmp_path: Path) -> None:
    cell = external_cell(tmp_path, rail=True, table=True)
    fixed = set_external_axis_positions(cell, ("rail=-1500", "e2=30"))
    np.testing.assert_allclose(fixed.external_home, [-1.5, np.radians(30.0)])
    assert "rail at -1500 mm and turn at 30°" in describe_external_axis_positions(fixed)
    np.testing.assert_allclose(
        update_base_frame(fixed, load_robot(fixed)).T_world_base[:3, 3], [0.0, -1.5, 0.0], atol=1e-12
    )
    assert remove_workpiece(fixed).workpiece.link == "plate"
    assert describe_external_axis_positions(small_cell(tmp_path)) == ""


def test_recording_reader_reports_a_fixed_rail(tmp_path: Path) -> None:
    (message,) = describe_fixed_external_joints(external_cell(tmp_path, rail=True, table=True))
    assert "external joints (rail, turn) are taken to stand still" in message
    assert describe_fixed_external_joints(small_cell(tmp_path)) == ()


@pytest.mark.parametrize("word", ["rail=99999", "rail", "rail=far", "turn=1", "e2=1"])
def test_unfixable_joints_are_refused(tmp_path: Path, word: str) -> None:
    with pytest.raises(InputError, match=r"--external: .*rail"):
        set_external_axis_positions(external_cell(tmp_path, rail=True), (word,))


def test_plan_reports_the_rail_as_rigid(tmp_path: Path) -> None:
    rail = ExternalJointSpring(joint="rail", stiffness=4e7, slides=True, compliance=np.zeros((6, 6)), at=np.zeros(3))
    cell = replace(external_cell(tmp_path, rail=True), stiffness=replace(K, external=(rail,)))
    made = compute_pose_plan(FEW, lambda _: None, cell)
    assert any("external_joints of stiffness.yaml (rail): not fitted" in output for output in made.result.warnings)


@pytest.mark.slow
def test_arm_on_a_rail_is_measured_like_a_fixed_one(tmp_path: Path) -> None:
    """Positions in world, weight and contacts equal those of an arm mounted at the position of the rail."""
    railed = replace(set_external_axis_positions(external_cell(tmp_path, rail=True), ("rail=400",)), stiffness=K)
    machine = load_machine(railed, load_robot(railed))
    T = machine.compute_T_world_base(railed.external_home[None])[0]
    still = small_cell(
        tmp_path / "..", stiffness=K, workpiece=railed.workpiece, obstacles=(), T_world_base=T, may_touch=()
    )

    def found(cell: Cell) -> NextMeasurement:
        return plan_next_measurement(replace(FEW, no_collision=True), cell, None, lambda _: None)

    ours, theirs = found(railed), found(still)
    np.testing.assert_allclose(ours.pool.q, theirs.pool.q, atol=1e-12)
    assert ours.plan is not None
    assert theirs.plan is not None
    np.testing.assert_array_equal(ours.plan.cases.pose, theirs.plan.cases.pose)
    # bodies of rail, arm and part at that rail position
    near = plan_next_measurement(FEW, railed, None, lambda _: None)
    assert near.collision is not None
    assert len(near.pool) > 0
