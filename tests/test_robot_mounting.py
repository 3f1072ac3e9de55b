"""Arm on the ceiling, on a wall or tilted, compared with a URDF mounted by a joint."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pinocchio as pin
import pytest

from machopt.cell.cell_reader import load_cell
from machopt.data_types.cell import Cell, Tool
from machopt.dynamics.gravity_torque import compute_gravity_torque
from machopt.kinematics.urdf_loading import load_chain, load_masses
from machopt.numerics.rigid_transforms import build_transform, compute_rpy_matrix
from machopt.verification.motion.kinematics.urdf_kinematics import UrdfKinematics

MOUNTS = {"floor": (0, 0, 0), "ceiling": (180, 0, 0), "wall": (0, 90, 0), "tilted": (10, -35, 120)}
FORCE = np.array([120.0, -40.0, -300.0])  # N in world


@pytest.fixture(scope="module")
def heavy() -> Cell:
    cell = load_cell(Path(__file__).resolve().parents[1] / "cells" / "kr500_milling")
    return replace(cell, tool=Tool(T_flange_tcp=cell.tool.T_flange_tcp, mass=35.0, com=np.array([0.02, 0.0, 0.12])))


@pytest.mark.parametrize("mount", MOUNTS)
def test_mounted_arm_equals_a_mounted_urdf(heavy: Cell, mount: str) -> None:
    T_world_base = build_transform(compute_rpy_matrix(np.radians(MOUNTS[mount])), np.array([0.4, -0.2, 2.5]))
    cell = replace(heavy, T_world_base=T_world_base)
    rpy = " ".join(f"{v:.17g}" for v in np.radians(MOUNTS[mount]))
    text = cell.urdf_text.replace(
        "</robot>",
        f'<link name="hall"/><joint name="bolts" type="fixed"><parent link="hall"/><child link="{cell.base_link}"/>'
        f'<origin xyz="0.4 -0.2 2.5" rpy="{rpy}"/></joint></robot>',
    )
    model = pin.buildModelFromXML(text)
    model.gravity.linear = np.array([0.0, 0.0, -9.80665])
    flange = model.frames[model.getFrameId(cell.flange_link)]
    model.inertias[flange.parentJoint] += flange.placement.act(pin.Inertia(35.0, cell.tool.com, np.zeros((3, 3))))
    data, frame = model.createData(), model.getFrameId(cell.flange_link)

    q = np.random.default_rng(3).uniform(model.lowerPositionLimit, model.upperPositionLimit, (10, 6))
    robot, _ = load_chain(cell)
    arm = UrdfKinematics(cell)
    state, stance = robot.compute_state(q, bodies=True), arm.compute_configuration(q)
    weights = compute_gravity_torque(robot, load_masses(cell), state)[0], arm.compute_gravity_torque(q)
    R = T_world_base[:3, :3]
    for n, row in enumerate(q):
        J = pin.computeFrameJacobian(model, data, row, frame, pin.ReferenceFrame.LOCAL_WORLD_ALIGNED)
        pin.framesForwardKinematics(model, data, row)
        np.testing.assert_allclose(T_world_base @ state.T_base_tool[n], data.oMf[frame].homogeneous, atol=1e-9)
        np.testing.assert_allclose(T_world_base @ stance.flange[n], data.oMf[frame].homogeneous, atol=1e-9)
        np.testing.assert_allclose(R @ state.J[n][:3], J[:3], atol=1e-9)
        # a force known in world, transformed to the joints
        np.testing.assert_allclose(state.J[n][:3].T @ (R.T @ FORCE), J[:3].T @ FORCE, atol=1e-6)
        for torque in weights:
            np.testing.assert_allclose(torque[n], -pin.computeGeneralizedGravity(model, data, row), atol=1e-6)


def test_weight_depends_on_the_mounting(heavy: Cell) -> None:
    """The test above would also pass for an arm without weight; joint 2 of this arm carries several kN·m."""
    q = np.array([[0.0, 0.2, 0.1, 0.3, 0.4, 0.0]])
    bears = []
    for rpy in MOUNTS.values():
        T = build_transform(compute_rpy_matrix(np.radians(rpy)), np.zeros(3))
        robot, _ = load_chain(heavy)
        masses = load_masses(replace(heavy, T_world_base=T))
        bears.append(compute_gravity_torque(robot, masses, robot.compute_state(q, bodies=True))[0][0, 1])
    assert abs(bears[0]) > 5e3
    assert bears[1] == pytest.approx(-bears[0])
    assert abs(bears[2] - bears[0]) > 1e3
