"""Batched kinematics of the verifier compared with pinocchio."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pinocchio as pin
import pytest
from external_axis_cells import external_cell
from small_cell import pose, small_cell

from machopt.cell.cell_reader import load_cell
from machopt.data_types.cell import Cell, CollisionShape
from machopt.verification.motion.collision.bodies import build_bodies
from machopt.verification.motion.collision.checked_pairs import list_checked_pairs
from machopt.verification.motion.collision.contact_search import find_contacts
from machopt.verification.motion.kinematics.urdf_kinematics import UrdfKinematics

CELLS = Path(__file__).resolve().parents[1] / "cells"
SHIPPED = sorted(folder.name for folder in CELLS.iterdir() if (folder / "cell.yaml").is_file())
ROUNDING = 1e-12  # m and entries of rotation matrices: some tens of products of size 1, over metres
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


def one_by_one(cell: Cell, q: np.ndarray, external: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Compute with pinocchio what Arm.placements returns.

    Return (S, J + 2, 4, 4) placements in world, (S, 6, 3) axes in base_link and (S, 4, 4) base_link in world.
    """
    model = pin.buildModelFromUrdf(str(cell.urdf))
    data = model.createData()
    names = (*cell.arm_joints, *cell.external_joints)
    base, flange = model.getFrameId(cell.base_link), model.getFrameId(cell.flange_link)
    pin.framesForwardKinematics(model, data, pin.neutral(model))
    to_world = cell.T_world_base @ data.oMf[base].inverse().homogeneous
    places, axes, bases = [], [], []
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
        bases.append(to_world @ data.oMf[base].homogeneous)
    return np.array(places), np.array(axes), np.array(bases)


def held_against(cell: Cell, externals: int = 0) -> None:
    rng = np.random.default_rng(11)
    q, external = rng.uniform(-7.0, 7.0, (40, 6)), rng.uniform(-2.0, 2.0, (40, externals))
    arm = UrdfKinematics(cell)
    places, axes, base = one_by_one(cell, q, external)
    np.testing.assert_allclose(arm.compute_placements(q, external), places, rtol=0, atol=ROUNDING)
    tcp = np.linalg.inv(places[:, -1]) @ places[:, -2] @ cell.tool.T_flange_tcp
    np.testing.assert_allclose(arm.compute_tcp_in_workpiece(q, external), tcp, rtol=0, atol=ROUNDING)
    stance, back = arm.compute_configuration(q, external), np.linalg.inv(base)
    np.testing.assert_allclose(stance.axis, axes, rtol=0, atol=ROUNDING)
    np.testing.assert_allclose(stance.flange, back @ places[:, -2], rtol=0, atol=ROUNDING)
    np.testing.assert_allclose(stance.frames[:, 1:], (back[:, None] @ places)[:, arm.joints], rtol=0, atol=ROUNDING)
    np.testing.assert_array_equal(stance.origin, stance.frames[:, 1:, :3, 3])
    np.testing.assert_allclose(arm.T_base_workpiece(external), back @ places[:, -1], rtol=0, atol=ROUNDING)


@pytest.mark.parametrize("name", SHIPPED)
def test_every_shipped_robot_agrees_with_pinocchio(name: str) -> None:
    cell = load_cell(CELLS / name)
    held_against(cell, externals=len(cell.external_joints))


def test_rail_and_turntable_with_oblique_axes_and_a_fixed_joint(tmp_path: Path) -> None:
    cell = small_cell(tmp_path)
    cell.urdf.write_text(cell.urdf.read_text().replace("</robot>", AROUND + "</robot>"))
    tilt = np.eye(4)
    tilt[:3, :3] = np.array([[0.8, 0, 0.6], [0, 1, 0], [-0.6, 0, 0.8]])
    tilt[:3, 3] = 0.1, -0.2, 0.3
    around = replace(
        cell, T_world_base=tilt, external_joints=("rail", "turn"), workpiece=replace(cell.workpiece, link="plate")
    )
    held_against(around, externals=2)


def test_zero_rows_are_accepted(tmp_path: Path) -> None:
    arm = UrdfKinematics(small_cell(tmp_path))
    assert arm.compute_placements(np.empty((0, 6)), np.empty((0, 0))).shape == (0, arm.model.njoints + 2, 4, 4)


def test_fixed_part_has_one_pose_in_all_rows() -> None:
    arm = UrdfKinematics(load_cell(CELLS / "kr500_milling"))
    rows = arm.T_base_workpiece(np.empty((3, 0)))
    assert rows.shape == (3, 4, 4)
    assert (rows == arm.T_base_workpiece(np.empty((1, 0)))).all()


def test_constant_pose_is_marked_or_refused(tmp_path: Path) -> None:
    arm = UrdfKinematics(external_cell(tmp_path, rail=True))
    with pytest.raises(ValueError, match="give their positions"):
        arm.compute_configuration(np.zeros((1, 6)))
    with pytest.raises(ValueError, match="give their positions"):
        arm.compute_gravity_torque(np.zeros((1, 6)))


def test_weight_of_a_tilting_gantry_follows_from_energy(tmp_path: Path) -> None:
    """The torques equal the slope of m g times the height of the tool, the only mass, in each joint."""
    cell = external_cell(tmp_path, rail=True)
    text = cell.urdf.read_text().replace('name="rail" type="prismatic"', 'name="rail" type="revolute"')
    cell.urdf.write_text(text)
    cell = replace(cell, tool=replace(cell.tool, mass=30.0, com=np.array([0.0, 0.02, 0.1])))
    arm, h = UrdfKinematics(cell), 1e-6
    q, e = np.random.default_rng(3).uniform(-1, 1, (5, 6)), np.linspace(-0.9, 0.9, 5)[:, None]

    def energy(x: np.ndarray) -> np.ndarray:
        return 30.0 * 9.80665 * (arm.compute_placements(x, e)[:, -2] @ np.append(cell.tool.com, 1.0))[:, 2]

    steps = h * np.eye(6)
    slope = np.column_stack([(energy(q + step) - energy(q - step)) / (2 * h) for step in steps])
    np.testing.assert_allclose(arm.compute_gravity_torque(q, e), -slope, atol=1e-4)  # 1 kJ to 15 digits, divided by 2 h
    assert np.abs(arm.compute_gravity_torque(q, e) - arm.compute_gravity_torque(q, 0 * e)).max() > 10.0


def names(cell: Cell) -> set[frozenset[str]]:
    arm = UrdfKinematics(cell)
    return {frozenset((a.name, b.name)) for a, b in list_checked_pairs(cell, arm, build_bodies(cell, arm))}


def test_pairs_depend_on_the_joints_between_bodies(tmp_path: Path) -> None:
    post = CollisionShape(name="post", kind="box", size=(0.1, 0.1, 1.0), mesh=None, T_parent_shape=pose(1.0, 3.4, 0.5))
    clamp = CollisionShape(
        name="clamp", kind="box", size=(0.05, 0.05, 0.05), mesh=None, T_parent_shape=pose(0.2, 0.1, 0.1), link="plate"
    )
    cell = replace(external_cell(tmp_path, rail=True, table=True), obstacles=(post, clamp))
    found = names(cell)
    for pair in (
        ("carriage_0", "post"),  # the rail moves the carriage into the post
        ("base_link_0", "post"),
        ("clamp", "post"),
        ("block", "post"),
        ("plate_0", "post"),
        ("plate_0", "carriage_0"),
        ("plate_0", "link_5_0"),
        ("plate_0", "cutter"),
        ("clamp", "link_1_0"),
        ("clamp", "carriage_0"),
    ):
        assert frozenset(pair) in found, pair
    for pair in (("carriage_0", "base_link_0"), ("plate_0", "block"), ("plate_0", "clamp"), ("clamp", "block")):
        assert frozenset(pair) not in found, pair
    hung = names(external_cell(tmp_path, table=True))  # here the table is a child of base_link
    assert {frozenset(("plate_0", "link_1_0")), frozenset(("plate_0", "cutter"))} <= hung
    still = names(replace(external_cell(tmp_path), obstacles=(post,)))
    assert frozenset(("base_link_0", "post")) not in still


def test_contacts_of_bodies_on_rail_and_table(tmp_path: Path) -> None:
    """The carriage passes through a post between two samples; a clamp on the table passes through another one."""
    post = CollisionShape(
        name="post", kind="box", size=(0.02, 0.02, 1.0), mesh=None, T_parent_shape=pose(0.1, 1.0, -0.3)
    )
    clamp = CollisionShape(
        name="clamp", kind="box", size=(0.05, 0.05, 0.3), mesh=None, T_parent_shape=pose(0.45, 0.0, 0.15), link="plate"
    )
    stop = CollisionShape(
        name="stop", kind="box", size=(0.02, 0.02, 0.2), mesh=None, T_parent_shape=pose(1.6, 0.45, 0.6)
    )
    cell = replace(external_cell(tmp_path, rail=True, table=True), obstacles=(post, clamp, stop))
    arm = UrdfKinematics(cell)
    wanted = list_checked_pairs(cell, arm, build_bodies(cell, arm))
    q = np.tile(cell.home, (2, 1))

    def hits(*external: tuple[float, float]) -> set[str]:
        return {c.pair for c in find_contacts(arm, wanted, q, np.array(external), np.ones(2, bool))}

    assert hits((0.0, 0.0), (0.6, 0.5)) == set()
    assert "post ~ carriage_0" in hits((0.0, 0.0), (2.0, 0.0))
    assert hits((0.0, 0.5), (0.0, 2.5)) == {"stop ~ clamp"}
