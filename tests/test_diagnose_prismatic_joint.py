"""Measured poses of an arm with a prismatic first joint: kinematics against pinocchio, and findings."""

from __future__ import annotations

import json
from pathlib import Path

import numpy as np
import pinocchio as pin
import pytest

from machopt.cell.cell_reader import load_cell
from machopt.cli import main
from machopt.dynamics.gravity_torque import compute_gravity_torque
from machopt.kinematics.robot import GRAVITY
from machopt.kinematics.urdf_loading import load_masses, load_robot

JOINTS = (  # type, origin in the preceding link, axis, mass of the link
    ("prismatic", (0.0, 0.0, 0.0), (0.6, 0.0, 0.8), 400.0),
    ("revolute", (0.0, 0.0, 0.8), (0.0, 0.0, 1.0), 200.0),
    ("revolute", (0.3, 0.0, 0.3), (0.0, 1.0, 0.0), 120.0),
    ("revolute", (0.0, 0.0, 1.1), (0.0, 1.0, 0.0), 80.0),
    ("revolute", (0.9, 0.0, 0.1), (1.0, 0.0, 0.0), 30.0),
    ("revolute", (0.2, 0.0, 0.0), (0.0, 1.0, 0.0), 20.0),
)
SPRINGS = np.array([0.0, 4e-7, 6e-7, 5e-7, 1.5e-6, 2e-6])  # rad/(N·m)
TWIST = np.array([3e-4, 0.0, -4e-4, 0.0, 0.0, 5e-4])  # m, rad, of the frame of joint 4
TCP = np.array([0.03, 0.0, 0.35])  # m in link 6


def urdf(moved: np.ndarray | None = None) -> str:
    out, parent = '<robot name="gantry"><link name="base_link"/>', "base_link"
    for i, (kind, at, axis, mass) in enumerate(JOINTS, 1):
        xyz, rpy = np.array(at), np.zeros(3)
        if moved is not None and i == 4:
            xyz, rpy = xyz + moved[:3], moved[3:]
        range_ = 'lower="-2" upper="2"' if kind == "prismatic" else 'lower="-3" upper="3"'
        out += (
            f'<link name="link_{i}"><inertial><origin xyz="0.1 0 0.1"/><mass value="{mass}"/>'
            '<inertia ixx="1" iyy="1" izz="1" ixy="0" ixz="0" iyz="0"/></inertial></link>'
            f'<joint name="joint_{i}" type="{kind}"><parent link="{parent}"/><child link="link_{i}"/>'
            f'<origin xyz="{_numbers(xyz)}" rpy="{_numbers(rpy)}"/><axis xyz="{_numbers(np.array(axis))}"/>'
            f'<limit {range_} velocity="2" effort="10000"/></joint>'
        )
        parent = f"link_{i}"
    return (
        out + '<link name="flange"/><joint name="bolts" type="fixed"><parent link="link_6"/><child link="flange"/>'
        '<origin xyz="0 0 0.15"/></joint></robot>'
    )


def _numbers(values: np.ndarray) -> str:
    return " ".join(f"{v:.12g}" for v in values)


CELL = """machopt_cell: 1
name: gantry
robot:
  urdf: gantry.urdf
  base_link: base_link
  flange_link: flange
  limits: {velocity_deg_s: [1000, 90, 90, 90, 90, 90], acceleration_deg_s2: [1000, 300, 300, 300, 300, 300],
           jerk_deg_s3: [9000, 3000, 3000, 3000, 3000, 3000]}
  home_deg: [0, 0, 10, 10, 10, 10]
tool: {tcp: {xyz_mm: [30, 0, 200]}}
workpiece: {pose: {xyz_mm: [0, 0, 0]}}
"""


@pytest.fixture
def cell(tmp_path: Path) -> Path:
    folder = tmp_path / "cell"
    folder.mkdir()
    (folder / "gantry.urdf").write_text(urdf())
    (folder / "cell.yaml").write_text(CELL)
    return folder


def angles(rng: np.random.Generator, n: int) -> np.ndarray:
    low, high = np.array([[-1.5, -2.0, -0.6, -0.3, -2.5, -1.5], [1.5, 2.0, 1.0, 1.3, 2.5, 1.5]])
    return rng.uniform(low, high, (n, 6))


def compute_loaded_tcp(model: pin.Model, data: pin.Data, q: np.ndarray) -> np.ndarray:
    """Return the TCP (3,) in m with the joint springs deflected by weight."""
    theta = q
    for _ in range(6):
        theta = q - SPRINGS * pin.computeGeneralizedGravity(model, data, theta)
    pin.forwardKinematics(model, data, theta)
    return data.oMi[6].act(TCP)


def record(folder: Path, rng: np.random.Generator, *, moved: np.ndarray | None = None, slide: float = 1e3) -> Path:
    """Write 30 poses measured twice; ``slide`` is the number written for one metre of joint 1."""
    folder.mkdir()
    model = pin.buildModelFromXML(urdf(moved))
    data = model.createData()
    rows = ["pose,session,q1_mm,q2_deg,q3_deg,q4_deg,q5_deg,q6_deg,x_mm,y_mm,z_mm"]
    for pose, q in enumerate(angles(rng, 30)):
        for session in range(2):
            at = 1e3 * compute_loaded_tcp(model, data, q) + rng.normal(0.0, 0.03, 3)
            values = [slide * q[0], *np.degrees(q[1:]), *at]
            rows.append(f"{pose},{session}," + ",".join(f"{v:.7f}" for v in values))
    (folder / "data.csv").write_text("\n".join(rows) + "\n")
    (folder / "recording.yaml").write_text(
        "machopt_recording: 1\nkind: absolute\ndata: data.csv\nregistration: fit\n"
        "standard_uncertainty: {displacement_mm: 0.03, joint_deg: 0.001}\n"
    )
    return folder


def diagnose_command(cell: Path, recording: Path, out: Path) -> dict:
    assert main(["diagnose", str(cell), str(recording), "-o", str(out), "--quiet"]) == 0
    return json.loads((out / "diagnosis.json").read_text())


def test_poses_derivatives_and_weights_equal_pinocchio(cell: Path) -> None:
    loaded = load_cell(cell, any_chain=True)
    robot, masses, rng = load_robot(loaded), load_masses(loaded), np.random.default_rng(1)
    model = pin.buildModelFromXML(urdf())
    model.gravity.linear = np.array([0.0, 0.0, -GRAVITY])
    data, q = model.createData(), angles(rng, 5)
    state = robot.compute_state(q, bodies=True)
    weight, slope = compute_gravity_torque(robot, masses, state)
    assert robot.slides is not None
    assert robot.slides.tolist() == [True] + [False] * 5
    flange = model.getFrameId("flange")
    for m in range(len(q)):
        J = pin.computeFrameJacobian(model, data, q[m], flange, pin.LOCAL_WORLD_ALIGNED)
        pin.framesForwardKinematics(model, data, q[m])
        assert np.abs(state.J[m] - J).max() < 1e-12
        assert np.abs(state.T_base_tool[m] - data.oMf[flange].homogeneous).max() < 1e-12
        assert np.abs(robot.compute_fk(q)[m] - state.T_base_tool[m]).max() == 0.0
        assert np.abs(robot.compute_link_poses(q)[m, 6] @ robot.T_base_flange_zero - state.T_base_tool[m]).max() < 1e-12
        assert np.abs(weight[m] + pin.computeGeneralizedGravity(model, data, q[m])).max() < 1e-8
        turned = pin.computeStaticTorqueDerivatives(model, data, q[m], [pin.Force.Zero()] * model.njoints)
        assert np.abs(slope[m] + turned).max() < 1e-7


def test_shifted_frame_behind_a_prismatic_joint_is_found_and_corrected(cell: Path, tmp_path: Path) -> None:
    recording = record(tmp_path / "recording", np.random.default_rng(2), moved=TWIST)
    result = diagnose_command(cell, recording, tmp_path / "out")
    (finding,) = result["findings"]
    assert result["verdict"] == "explained"
    assert (finding["effect"], finding["location"]) == ("geometry", "joint:4")
    turn = finding["parameters"]["turn z"]
    assert turn["ci95"][0] < 0.5 < turn["ci95"][1]
    assert result["model"] is None  # stiffness.yaml cannot contain a prismatic joint
    (cell / "kinematics.yaml").write_text((tmp_path / "out" / "kinematics.yaml").read_text())
    (cell / "cell.yaml").write_text(CELL + "kinematics: kinematics.yaml\n")
    again = diagnose_command(cell, recording, tmp_path / "again")
    assert again["verdict"] == "consistent"
    assert not again["findings"]


def test_nothing_is_named_where_only_springs_deflect(cell: Path, tmp_path: Path) -> None:
    result = diagnose_command(cell, record(tmp_path / "recording", np.random.default_rng(3)), tmp_path / "out")
    assert result["verdict"] == "consistent"
    assert not result["findings"]


def test_prismatic_joint_in_metres_is_a_wrong_unit(cell: Path, tmp_path: Path) -> None:
    result = diagnose_command(
        cell, record(tmp_path / "recording", np.random.default_rng(4), slide=1.0), tmp_path / "out"
    )
    assert [(f["effect"], f["location"]) for f in result["findings"]] == [("units", "column:q1_mm")]


def test_wrong_joints_and_load_tests_are_refused(
    cell: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    recording = record(tmp_path / "recording", np.random.default_rng(5))
    table = recording / "data.csv"
    table.write_text(table.read_text().replace("q1_mm,q2_deg", "q1_mm,q2_mm", 1))
    assert main(["diagnose", str(cell), str(recording), "-o", str(tmp_path / "out"), "--quiet"]) == 2
    assert "q2_deg is expected" in capsys.readouterr().err
    assert not (tmp_path / "out").exists()
