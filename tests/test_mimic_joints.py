"""Mimic joints compared with pinocchio with all joints of the URDF set explicitly."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pinocchio as pin
import pytest
from independent_trajectory_reader import read_trajectory_csv
from parallel_linkage_arm import build_mimic_joints, expand_mimic_joints, linked_urdf, write_linkage_cell
from small_cell import small_cell

from machopt.collision.collision_model import CollisionModel
from machopt.commands.optimize.run import OptimizeRequest, run_optimize
from machopt.data_types.cell import Cell, Tool
from machopt.data_types.toolpath import MoveKind
from machopt.dynamics.gravity_torque import compute_gravity_torque
from machopt.errors import InputError
from machopt.kinematics.inverse.solver import build_solver
from machopt.kinematics.mimic_joints import check_no_mimic_joints
from machopt.kinematics.urdf_loading import load_chain, load_masses
from machopt.planning.retiming.joint_derivatives import solve_joints_near_seeds
from machopt.verification.motion.kinematics.urdf_kinematics import UrdfKinematics

CELL = """\
machopt_cell: 1
name: linked
robot:
  urdf: robot.urdf
  base_link: base_link
  flange_link: flange
  home_deg: [0, -90, 0, 0, 45, 0]
  limits:
    acceleration_deg_s2: [300, 300, 300, 500, 500, 800]
    jerk_deg_s3: [2000, 2000, 2000, 4000, 4000, 6000]
tool: {tcp: {xyz_mm: [0, 0, 350], rpy_deg: [0, 30, 0]}, cutter: {diameter_mm: 12, length_mm: 60}}
workpiece:
  pose: {xyz_mm: [1500, 0, 600]}
  geometry: [{name: block, box_mm: [400, 500, 100], xyz_mm: [0, 0, -50]}]
stiffness: stiffness.yaml
plan: {rotation_step_deg: 10}
"""
MASS = (
    '<inertial><origin xyz="0.3 0.1 0.05"/><mass value="120"/>'
    '<inertia ixx="1" ixy="0" ixz="0" iyy="1" iyz="0" izz="1"/></inertial>'
)


@pytest.fixture(scope="module")
def cell(tmp_path_factory: pytest.TempPathFactory) -> Cell:
    """The arm is on the ceiling and rotated, with a mass in each link, so no quantity is zero by chance."""
    cell = small_cell(tmp_path_factory.mktemp("linked"))
    text = linked_urdf()
    for n in range(1, 7):
        text = text.replace(f'<link name="link_{n}">', f'<link name="link_{n}">{MASS}')
    write_linkage_cell(cell.folder, text)
    ceiling = np.diag([1.0, -1.0, -1.0, 1.0])
    ceiling[:3, 3] = 0.3, -0.2, 3.0
    tool = Tool(T_flange_tcp=cell.tool.T_flange_tcp, mass=45.0, com=np.array([0.05, 0.02, 0.15]))
    return replace(cell, mimics=build_mimic_joints(), T_world_base=ceiling, tool=tool)


@pytest.fixture(scope="module")
def q(cell: Cell) -> np.ndarray:
    rng = np.random.default_rng(5)
    return cell.limits.lower + rng.random((20, 6)) * (cell.limits.upper - cell.limits.lower)


def by_hand(cell: Cell, q: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Compute TCP in base_link, Jacobian by the chain rule through the mimic joint,
    and gravity torque from the potential."""
    model = pin.buildModelFromUrdf(str(cell.urdf))
    frame = model.frames[model.getFrameId(cell.flange_link)]
    model.inertias[frame.parentJoint] += frame.placement.act(
        pin.Inertia(cell.tool.mass, cell.tool.com, np.zeros((3, 3)))
    )
    model.gravity.linear = cell.T_world_base[:3, :3].T @ np.array([0, 0, -9.80665])
    data = model.createData()

    def tcp(x: np.ndarray) -> np.ndarray:
        pin.framesForwardKinematics(model, data, expand_mimic_joints(model, x, cell.mimics))
        return data.oMf[model.getFrameId(cell.flange_link)].homogeneous @ cell.tool.T_flange_tcp

    def potential(x: np.ndarray) -> float:
        return float(pin.computePotentialEnergy(model, data, expand_mimic_joints(model, x, cell.mimics)))

    T, J, g, h = tcp(q), np.empty((6, 6)), np.empty(6), 1e-6
    for i in range(6):
        step = h * np.eye(6)[i]
        J[:3, i] = (tcp(q + step)[:3, 3] - tcp(q - step)[:3, 3]) / (2 * h)
        J[3:, i] = pin.log3(tcp(q + step)[:3, :3] @ tcp(q - step)[:3, :3].T) / (2 * h)
        g[i] = -(potential(q + 1e2 * step) - potential(q - 1e2 * step)) / (2e2 * h)
    return T, J, g


def test_planner_and_verification_agree_with_pinocchio(cell: Cell, q: np.ndarray) -> None:
    robot, _ = load_chain(cell)
    # the axis of m3 has the opposite direction: −(−1)
    np.testing.assert_array_equal(robot.coupling[2], [0, 1, 1, 0, 0, 0])
    arm, masses = UrdfKinematics(cell), load_masses(cell)
    state = robot.compute_state(q, cell.tool.T_flange_tcp, bodies=True)
    torque, slope = compute_gravity_torque(robot, masses, state)
    stance = arm.compute_configuration(q)
    np.testing.assert_allclose(arm.compute_gravity_torque(q), torque, atol=1e-7)
    for n, row in enumerate(q):
        T, J, g = by_hand(cell, row)
        for pose, jacobian in ((state.T_base_tool[n], state.J[n]), (stance.tcp[n], stance.J[n])):
            np.testing.assert_allclose(pose, T, atol=1e-9)
            np.testing.assert_allclose(jacobian, J, atol=1e-7)
        np.testing.assert_allclose(torque[n], g, atol=1e-3)  # of about 1e4 N·m, by differences
    step = 1e-5
    for i in range(6):
        moved = [
            compute_gravity_torque(robot, masses, robot.compute_state(q + s * step * np.eye(6)[i], bodies=True))[0]
            for s in (1, -1)
        ]
        np.testing.assert_allclose(slope[:, :, i], (moved[0] - moved[1]) / (2 * step), atol=1e-3)


def test_every_branch_reaches_the_pose_and_one_is_the_start(cell: Cell, q: np.ndarray) -> None:
    robot, _ = load_chain(cell)
    T = robot.compute_fk(q)
    found = build_solver(robot).solve(T).q
    there = np.isfinite(found[..., 0])
    pose, branch = np.nonzero(there)
    np.testing.assert_allclose(robot.compute_fk(found[pose, branch]), T[pose], atol=1e-9)
    off = np.abs(np.remainder(found - q[:, None] + np.pi, 2 * np.pi) - np.pi).max(axis=-1)
    assert (np.nanmin(off, axis=1) < 1e-7).all()
    again, failed = solve_joints_near_seeds(robot, np.eye(4), T, q + 1e-3)
    assert failed < 0
    np.testing.assert_allclose(again, q, atol=1e-8)


def test_body_poses_equal_pinocchio(cell: Cell, q: np.ndarray) -> None:
    robot, shapes = load_chain(cell)
    model = pin.buildModelFromUrdf(str(cell.urdf))
    geometry = pin.buildGeomFromUrdf(model, str(cell.urdf), pin.GeometryType.COLLISION)
    data, places = model.createData(), pin.GeometryData(geometry)
    poses = robot.compute_link_poses(q)
    for n, row in enumerate(q[:5]):
        pin.updateGeometryPlacements(model, data, geometry, places, expand_mimic_joints(model, row, cell.mimics))
        for s in shapes:
            expected = places.oMg[geometry.getGeometryId(s.shape.name)].homogeneous
            np.testing.assert_allclose(poses[n, s.link] @ s.shape.T_parent_shape, expected, atol=1e-9)
    collision = CollisionModel(cell, robot, shapes, 0.0)
    cutting = np.zeros(len(q), bool)
    assert (collision.check_motion(q, cutting, 0.02).hit >= collision.check_configurations(q, cutting).hit).all()


@pytest.mark.parametrize(
    ("text", "multiplier", "words"),
    [
        (linked_urdf(shift="0.01 0 0"), -1.0, "'m3' mimics 'a2' and turns about a line of its own"),
        (linked_urdf(), -1.0, ""),
    ],
)
def test_follower_requires_the_axis_of_the_next_joint(
    cell: Cell, tmp_path: Path, text: str, multiplier: float, words: str
) -> None:
    linked = replace(cell, urdf=write_linkage_cell(tmp_path, text), mimics=build_mimic_joints(multiplier))
    if not words:
        load_chain(linked)
        return
    with pytest.raises(InputError, match=words):
        load_chain(linked)


def test_commands_without_linkage_support_refuse_them(cell: Cell) -> None:
    with pytest.raises(InputError, match="'m3' mimics 'a2', and identify has no laws"):
        check_no_mimic_joints(cell, "identify")
    check_no_mimic_joints(replace(cell, mimics=()), "identify")


@pytest.mark.slow
def test_linked_arm_mills_and_its_motion_agrees_with_the_urdf(tmp_path: Path) -> None:
    """The whole command is run; pinocchio with an explicitly set mimic joint then follows the tip."""
    cell = small_cell(tmp_path)
    write_linkage_cell(tmp_path, linked_urdf(offset=0.0))
    (tmp_path / "stiffness.yaml").write_text(
        "machopt_stiffness: 1\njoints_Nm_per_rad: [3.8e6, 6.6e6, 3.9e6, 5.6e5, 6.6e5, 4.7e5]\n"
    )
    (tmp_path / "cell.yaml").write_text(CELL)
    path = tmp_path / "line.csv"
    path.write_text(
        "x_mm,y_mm,z_mm,i,j,k,move,feed_mm_min\n0,0,50,0,0,1,rapid,\n"
        + "".join(f"{x},0,5,0,0,1,cut,1200\n" for x in range(0, 60, 10))
        + "50,0,50,0,0,1,rapid,\n"
    )
    outcome = run_optimize(OptimizeRequest(cell=tmp_path, toolpath=path, out=tmp_path / "out"))
    assert outcome.exit_code == 0
    table = read_trajectory_csv(tmp_path / "out" / "trajectory.csv").trajectory
    model = pin.buildModelFromUrdf(str(cell.urdf))
    data, frame = model.createData(), model.getFrameId("flange")
    cutting = np.flatnonzero((table.move == MoveKind.CUT) & (table.point >= 1.0))  # after the plunge
    for n in cutting[:: max(len(cutting) // 20, 1)]:
        pin.framesForwardKinematics(model, data, expand_mimic_joints(model, table.q[n], build_mimic_joints(offset=0.0)))
        tip = data.oMf[frame].homogeneous @ np.array([0.0, 0.0, 0.35, 1.0])
        assert abs(tip[1]) < 2e-5
        assert abs(tip[2] - 0.605) < 2e-5
