"""Kinematics of the arm compared with pinocchio, and the Jacobian compared with finite differences."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pinocchio as pin
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from property_example_count import NIGHTLY, scale_example_count
from small_cell import real_cell, small_cell

from machopt.cell.cell_reader import load_cell
from machopt.data_types.cell import Cell
from machopt.errors import InputError
from machopt.kinematics.urdf_loading import load_chain, load_robot
from machopt.numerics.rigid_transforms import build_transform, compute_rpy_matrix, invert_transform

CELLS = Path(__file__).resolve().parent.parent / "cells"
SHIPPED = ("kr500_milling", "kr240_drilling", "irb6700_drilling", "s420f_handling", "cutting_cobot")
REAL = ("kr210l150", "kr500_r2800_2", "m20ia", "rx160")
EXACT = 1e-12  # m and rad: both sides are double precision over a reach of 3 m


def cell_named(name: str, folder: Path) -> Cell:
    if name in SHIPPED:
        return load_cell(CELLS / name)
    return real_cell(folder, name)


class Reference:
    """The same arm, computed by pinocchio alone."""

    def __init__(self, cell: Cell) -> None:
        self.cell, self.model = cell, pin.buildModelFromUrdf(str(cell.urdf))
        self.data = self.model.createData()
        self.ids = [self.model.getJointId(j) for j in cell.arm_joints]
        self.columns = [self.model.idx_vs[j] for j in self.ids]
        self.base, self.flange = (self.model.getFrameId(n, pin.BODY) for n in (cell.base_link, cell.flange_link))

    def at(self, q: np.ndarray, T_flange_tool: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """Return the tool in base_link, its Jacobian in base_link axes, and the six moving links in base_link."""
        x = pin.neutral(self.model)
        for j, value in zip(self.ids, q, strict=True):
            x[self.model.idx_qs[j]] = value
        pin.framesForwardKinematics(self.model, self.data, x)
        to_base = invert_transform(self.data.oMf[self.base].homogeneous)
        T = to_base @ self.data.oMf[self.flange].homogeneous @ T_flange_tool
        J = pin.computeFrameJacobian(self.model, self.data, x, self.flange, pin.LOCAL_WORLD_ALIGNED)[:, self.columns]
        R = to_base[:3, :3]
        linear, angular = R @ J[:3], R @ J[3:]
        lever = T[:3, 3] - (to_base @ self.data.oMf[self.flange].homogeneous)[:3, 3]
        linear = linear + np.cross(angular.T, lever).T  # at the origin of the tool instead of the flange
        return T, np.vstack([linear, angular]), np.stack([to_base @ self.data.oMi[j].homogeneous for j in self.ids])


def configurations(cell: Cell, n: int, seed: int = 0) -> np.ndarray:
    return np.random.default_rng(seed).uniform(cell.limits.lower[:6], cell.limits.upper[:6], (n, 6))


@pytest.mark.parametrize("name", SHIPPED + REAL)
def test_pose_and_jacobian_equal_pinocchio(name: str, tmp_path: Path) -> None:
    cell = cell_named(name, tmp_path)
    robot, reference, tool = load_robot(cell), Reference(cell), cell.tool.T_flange_tcp
    q = configurations(cell, 60)
    T, J = robot.compute_fk_jacobian(q, tool)
    links = robot.compute_link_poses(q)
    zero = reference.at(np.zeros(6), tool)[2]
    for i, qi in enumerate(q):
        T_ref, J_ref, links_ref = reference.at(qi, tool)
        np.testing.assert_allclose(T[i], T_ref, atol=EXACT)
        np.testing.assert_allclose(J[i], J_ref, atol=EXACT)
        np.testing.assert_allclose(links[i, 1:] @ zero, links_ref, atol=EXACT)
    np.testing.assert_array_equal(links[:, 0], np.broadcast_to(np.eye(4), (60, 4, 4)))
    np.testing.assert_allclose(robot.compute_fk(q, tool), T, atol=EXACT)
    np.testing.assert_allclose(robot.compute_fk(q) @ tool, T, atol=EXACT)


@pytest.mark.parametrize("name", SHIPPED)
def test_jacobian_is_the_derivative_of_the_pose(name: str, tmp_path: Path) -> None:
    cell = cell_named(name, tmp_path)
    robot, tool = load_robot(cell), cell.tool.T_flange_tcp
    q = configurations(cell, 20, 1)
    T, J = robot.compute_fk_jacobian(q, tool)
    h = 1e-5  # rad; truncation h²·reach ≈ 3e-10, rounding 1e-16/h·reach ≈ 3e-11
    for i in range(6):
        step = np.zeros(6)
        step[i] = h
        dT = (robot.compute_fk(q + step, tool) - robot.compute_fk(q - step, tool)) / (2 * h)
        np.testing.assert_allclose(J[:, :3, i], dT[:, :3, 3], atol=3e-9)
        spin = dT[:, :3, :3] @ np.swapaxes(T[:, :3, :3], 1, 2)
        omega = np.stack([spin[:, 2, 1], spin[:, 0, 2], spin[:, 1, 0]], axis=1)
        np.testing.assert_allclose(J[:, 3:, i], omega, atol=3e-9)


def test_leading_dimensions_do_not_matter(tmp_path: Path) -> None:
    robot = load_robot(small_cell(tmp_path))
    q = np.random.default_rng(2).uniform(-1, 1, (2, 3, 6))
    T, J = robot.compute_fk_jacobian(q)
    assert T.shape == (2, 3, 4, 4)
    assert J.shape == (2, 3, 6, 6)
    assert robot.compute_link_poses(q).shape == (2, 3, 7, 4, 4)
    for index in np.ndindex(2, 3):
        one_T, one_J = robot.compute_fk_jacobian(q[index])
        np.testing.assert_allclose(T[index], one_T, atol=EXACT)
        np.testing.assert_allclose(J[index], one_J, atol=EXACT)
    assert robot.compute_fk(np.zeros((0, 6))).shape == (0, 4, 4)


vector = st.lists(st.floats(-1.0, 1.0).map(lambda x: round(x, 3)), min_size=3, max_size=3)


@settings(max_examples=scale_example_count(25), deadline=None, derandomize=not NIGHTLY)
@given(
    st.lists(st.tuples(vector, vector, vector.filter(lambda v: np.linalg.norm(v) > 0.1)), min_size=7, max_size=7),
    st.lists(st.floats(-3.0, 3.0), min_size=6, max_size=6),
)
def test_any_urdf_chain_is_read(tmp_path_factory: pytest.TempPathFactory, joints: list, q: list) -> None:  # type: ignore[type-arg]
    """Origins with all three angles, axes of any direction and length, a base_link that is not the root."""
    folder = tmp_path_factory.mktemp("urdf")
    text = '<robot name="any"><link name="root"/><link name="base_link"/><link name="flange"/>'
    text += "".join(f'<link name="l{i}"/>' for i in range(1, 7))
    text += '<joint name="stand" type="fixed"><parent link="root"/><child link="base_link"/>'
    text += '<origin xyz="1 2 3" rpy=".3 .2 .1"/></joint>'
    chain = ["base_link", *(f"l{i}" for i in range(1, 7)), "flange"]
    for i, (xyz, rpy, axis) in enumerate(joints):
        kind = "revolute" if i < 6 else "fixed"
        text += (
            f'<joint name="a{i + 1}" type="{kind}"><parent link="{chain[i]}"/><child link="{chain[i + 1]}"/>'
            f'<origin xyz="{" ".join(map(str, xyz))}" rpy="{" ".join(map(str, rpy))}"/>'
            f'<axis xyz="{" ".join(map(str, axis))}"/><limit lower="-3" upper="3" velocity="1" effort="1"/></joint>'
        )
    cell = replace(small_cell(folder), arm_joints=tuple(f"a{i}" for i in range(1, 7)))
    cell.urdf.write_text(text + "</robot>", encoding="utf-8")
    T = np.eye(4)
    for (xyz, rpy, axis), angle in zip(joints, [*q, 0.0], strict=True):  # by hand, without pinocchio
        n = np.array(axis) / np.linalg.norm(axis)
        turn = pin.AngleAxis(angle, n).toRotationMatrix()
        T = T @ build_transform(compute_rpy_matrix(np.array(rpy)), np.array(xyz)) @ build_transform(turn, np.zeros(3))
    np.testing.assert_allclose(
        load_robot(cell).compute_fk(np.array(q)), T, atol=1e-9
    )  # the numbers of the URDF are decimals


def test_flange_outside_the_arm_and_a_wrong_joint_are_refused(tmp_path: Path) -> None:
    cell = small_cell(tmp_path)
    with pytest.raises(InputError, match="not carried by the last arm joint"):
        load_robot(replace(cell, flange_link="link_5"))
    with pytest.raises(InputError, match="not a moving joint"):
        load_robot(replace(cell, arm_joints=("a1", "a2", "a3", "a4", "a5", "f")))
    with pytest.raises(InputError, match="is not in the URDF"):
        load_robot(replace(cell, flange_link="nowhere"))


def test_collision_bodies_follow_their_links(tmp_path: Path) -> None:
    """The pose of a body from link_poses equals that of pinocchio's geometry model."""
    cell = small_cell(tmp_path)
    robot, shapes = load_chain(cell)
    model = pin.buildModelFromUrdf(str(cell.urdf))
    geometry = pin.buildGeomFromUrdf(model, str(cell.urdf), pin.COLLISION)
    placed = pin.GeometryData(geometry)
    q = configurations(cell, 1, 3)[0]
    pin.updateGeometryPlacements(model, model.createData(), geometry, placed, q)
    poses = robot.compute_link_poses(q)
    assert [s.link for s in shapes] == list(range(7))
    by_name = {g.name: placed.oMg[i].homogeneous for i, g in enumerate(geometry.geometryObjects)}
    for s in shapes:
        np.testing.assert_allclose(poses[s.link] @ s.shape.T_parent_shape, by_name[s.shape.name], atol=EXACT)
