"""The verifier's kinematics of all configurations at once against pinocchio's own of one after the other."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pinocchio as pin
import pytest
from small_cell import small_cell

from machopt.domain.cell import Cell
from machopt.formats.cell import load_cell
from machopt.verify.arm import Arm

CELLS = Path(__file__).resolve().parents[1] / "cells"
SHIPPED = sorted(folder.name for folder in CELLS.iterdir() if (folder / "cell.yaml").is_file())
ROUNDING = 1e-12  # m and entries of rotations: some dozens of products of size one, over metres
AROUND = """<link name="floor"/><link name="carriage"/><link name="turntable"/><link name="plate"/><link name="lamp"/>
<joint name="rail" type="prismatic"><parent link="floor"/><child link="carriage"/><origin xyz="0.3 -0.2 0.1"
 rpy="0.4 -0.2 0.7"/><axis xyz="0.6 0 0.8"/><limit lower="-2" upper="2" velocity="1" effort="1"/></joint>
<joint name="stand" type="fixed"><parent link="carriage"/><child link="base_link"/>
 <origin xyz="0 0.1 0.5" rpy="0.1 0.2 0.3"/></joint>
<joint name="turn" type="continuous"><parent link="floor"/><child link="turntable"/><origin xyz="2 0.4 0.2"
 rpy="0.3 0.1 -0.6"/><axis xyz="0.48 0.6 0.64"/></joint>
<joint name="bolted" type="fixed"><parent link="turntable"/><child link="plate"/><origin xyz="0.1 0 0.2" rpy="0 0.5 0"/>
</joint>
<joint name="swing" type="revolute"><parent link="link_3"/><child link="lamp"/><origin xyz="0 0.1 0.2" rpy="0 1 0"/>
 <axis xyz="0 0 -1"/><limit lower="-1" upper="1" velocity="1" effort="1"/></joint>"""


def one_by_one(cell: Cell, q: np.ndarray, external: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """(S, J + 2, 4, 4) in world as Arm.placements has them, and (S, 6, 3) axes in base_link, by pinocchio."""
    model = pin.buildModelFromUrdf(str(cell.urdf))
    data = model.createData()
    names = (*cell.arm_joints, *cell.external_joints)
    base, flange = model.getFrameId(cell.base_link), model.getFrameId(cell.flange_link)
    pin.framesForwardKinematics(model, data, pin.neutral(model))
    to_world = cell.T_world_base @ data.oMf[base].inverse().homogeneous
    places, axes = [], []
    for row in np.hstack([q, external]):
        full = pin.neutral(model)
        for name, value in zip(names, row, strict=True):
            j = model.getJointId(name)
            at = model.idx_qs[j]
            full[at : at + model.nqs[j]] = value if model.nqs[j] == 1 else (np.cos(value), np.sin(value))
        pin.computeJointJacobians(model, data, full)
        pin.updateFramePlacements(model, data)
        part = np.eye(4)
        if cell.workpiece.link != "world":
            part = to_world @ data.oMf[model.getFrameId(cell.workpiece.link)].homogeneous
        joints = [to_world @ data.oMi[j].homogeneous for j in range(model.njoints)]
        tip = to_world @ data.oMf[flange].homogeneous
        places.append([*joints, tip, part @ cell.workpiece.T_link_workpiece])
        turn = data.J[3:, [model.idx_vs[model.getJointId(name)] for name in cell.arm_joints]]
        axes.append((data.oMf[base].rotation.T @ turn).T)
    return np.array(places), np.array(axes)


def held_against(cell: Cell, externals: int = 0) -> None:
    rng = np.random.default_rng(11)
    q, external = rng.uniform(-7.0, 7.0, (40, 6)), rng.uniform(-2.0, 2.0, (40, externals))
    arm = Arm(cell)
    places, _ = one_by_one(cell, q, external)
    np.testing.assert_allclose(arm.placements(q, external), places, rtol=0, atol=ROUNDING)
    tcp = np.linalg.inv(places[:, -1]) @ places[:, -2] @ cell.tool.T_flange_tcp
    np.testing.assert_allclose(arm.tcp_in_workpiece(q, external), tcp, rtol=0, atol=ROUNDING)
    at_rest, axes = one_by_one(cell, q, np.zeros((40, externals)))
    stance, back = arm.stance(q), np.linalg.inv(cell.T_world_base)
    np.testing.assert_allclose(stance.axis, axes, rtol=0, atol=ROUNDING)
    np.testing.assert_allclose(stance.flange, back @ at_rest[:, -2], rtol=0, atol=ROUNDING)
    np.testing.assert_allclose(stance.frames[:, 1:], (back @ at_rest)[:, arm.joints], rtol=0, atol=ROUNDING)
    np.testing.assert_array_equal(stance.origin, stance.frames[:, 1:, :3, 3])


@pytest.mark.parametrize("name", SHIPPED)
def test_every_shipped_robot(name: str) -> None:
    held_against(load_cell(CELLS / name))


def test_rail_and_turntable_with_oblique_axes_and_a_joint_nobody_moves(tmp_path: Path) -> None:
    cell = small_cell(tmp_path)
    cell.urdf.write_text(cell.urdf.read_text().replace("</robot>", AROUND + "</robot>"))
    tilt = np.eye(4)
    tilt[:3, :3] = np.array([[0.8, 0, 0.6], [0, 1, 0], [-0.6, 0, 0.8]])
    tilt[:3, 3] = 0.1, -0.2, 0.3
    around = replace(
        cell, T_world_base=tilt, external_joints=("rail", "turn"), workpiece=replace(cell.workpiece, link="plate")
    )
    held_against(around, externals=2)


def test_no_rows(tmp_path: Path) -> None:
    arm = Arm(small_cell(tmp_path))
    assert arm.placements(np.empty((0, 6)), np.empty((0, 0))).shape == (0, arm.model.njoints + 2, 4, 4)
