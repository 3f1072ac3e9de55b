"""Recordings of arms with seven joints: accepted by init, identify and diagnose, refused by planning commands."""

from __future__ import annotations

import json
import shutil
from pathlib import Path

import numpy as np
import pytest
from seven_joint_arm import JOINTS, SPRINGS, SevenJointArm, format_urdf, record_load_tests, record_motion, record_poses
from seven_joint_arm import write_cell as write_seven_joint_cell

from machopt.cell.cell_reader import load_cell
from machopt.cli import main
from machopt.errors import CellError, TooManyArmJointsError
from machopt.kinematics.urdf_loading import load_masses, load_robot

DATA = Path(__file__).parents[2] / "shared" / "data" / "real" / "panda"
OFFSETS_DEG = np.array([0.0, 0.0, 0.12, 0.0, -0.08, 0.0, 0.0])
STRAIGHT = np.zeros(7)


def diagnose(cell: Path, recording: Path, out: Path) -> dict[str, object]:
    assert main(["diagnose", str(cell), str(recording), "-o", str(out), "--quiet"]) == 0
    return json.loads((out / "diagnosis.json").read_text())  # type: ignore[no-any-return]


def test_kinematics_and_gravity_of_seven_joints_agree_with_pinocchio(tmp_path: Path) -> None:
    import pinocchio as pin

    from machopt.dynamics.gravity_torque import compute_gravity_torque

    cell = load_cell(write_seven_joint_cell(tmp_path / "cell"), any_chain=True)
    robot, arm = load_robot(cell), SevenJointArm(np.full(7, np.inf), STRAIGHT)
    q = np.random.default_rng(0).uniform(-1.5, 1.5, (20, 7))
    state = robot.compute_state(q, cell.tool.T_flange_tcp, bodies=True)
    weight = compute_gravity_torque(robot, load_masses(cell), state)[0]
    for n, x in enumerate(q):
        np.testing.assert_allclose(state.T_base_tool[n], arm.compute_pose(x).homogeneous, atol=1e-12)
        J = pin.computeFrameJacobian(arm.model, arm.data, x, arm.tcp, pin.ReferenceFrame.LOCAL_WORLD_ALIGNED)
        np.testing.assert_allclose(state.J[n], J, atol=1e-12)
        expected = -pin.computeGeneralizedGravity(arm.model, arm.data, x) * (9.80665 / 9.81)
        np.testing.assert_allclose(weight[n], expected, rtol=1e-9, atol=1e-9)


def test_zero_offsets_of_seven_joints_are_named_and_their_files_explain_the_poses(tmp_path: Path) -> None:
    """The written files equal the assessed model: with them in the cell the stated error remains and nothing is
    named."""
    cell = write_seven_joint_cell(tmp_path / "cell")
    arm = SevenJointArm(SPRINGS, np.radians(OFFSETS_DEG))
    recording = record_poses(arm, tmp_path / "poses", np.random.default_rng(1))
    found = diagnose(cell, recording, tmp_path / "out")
    assert found["verdict"] == "explained"
    named = {f["location"]: f for f in found["findings"]}
    assert set(named) == {"joint:3", "joint:5"}
    for place, true in (("joint:3", 0.12), ("joint:5", -0.08)):
        assert named[place]["effect"] == "joint_zero_offset"
        low, high = named[place]["parameters"]["offset"]["ci95"]
        assert low <= true <= high
    assert found["final"]["heldout_rmse"] < 1.1 * 0.015
    text = (cell / "cell.yaml").read_text()
    for name in ("kinematics.yaml", "stiffness.yaml"):
        (cell / name).write_text((tmp_path / "out" / name).read_text())
    (cell / "cell.yaml").write_text(f"{text}kinematics: kinematics.yaml\n")
    again = diagnose(cell, recording, tmp_path / "again")
    assert again["verdict"] == "consistent"
    assert again["findings"] == []
    assert again["baseline"]["heldout_rmse"] < 1.1 * 0.015


def test_springs_of_seven_joints_are_identified_from_load_tests(tmp_path: Path) -> None:
    cell = write_seven_joint_cell(tmp_path / "cell")
    recording = record_load_tests(SevenJointArm(SPRINGS, STRAIGHT), tmp_path / "loads", np.random.default_rng(3))
    out = tmp_path / "out"
    assert main(["identify", str(cell), str(recording), "-o", str(out), "--quiet"]) == 0
    found = json.loads((out / "identification.json").read_text())
    assert [j["joint"] for j in found["joints"]] == list(range(1, 8))
    assert [j["identified"] for j in found["joints"]] == [True] * 6 + [False]  # the TCP lies on the axis of joint 7
    # the standard error of this design is at most 0.4 %
    for joint, true in zip(found["joints"][:6], SPRINGS[:6], strict=True):
        assert abs(joint["k_Nm_per_rad"] / true - 1.0) < 0.02
    (cell / "stiffness.yaml").write_text((out / "stiffness.yaml").read_text())
    left = diagnose(cell, recording, tmp_path / "diagnosed")  # the springs are soft: loads change their own levers
    assert left["verdict"] == "explained"
    assert [(f["effect"], f["location"]) for f in left["findings"]] == [("geometric_stiffness", "arm")]
    assert left["final"]["heldout_rmse"] < 1.1 * 0.004


@pytest.mark.slow
def test_payload_is_estimated_from_torques_of_seven_joints(tmp_path: Path) -> None:
    cell = write_seven_joint_cell(tmp_path / "cell")
    arm = SevenJointArm(SPRINGS, STRAIGHT, payload=2.5)
    found = diagnose(cell, record_motion(arm, tmp_path / "motion", np.random.default_rng(4)), tmp_path / "out")
    assert found["verdict"] == "explained"
    assert [(f["effect"], f["location"]) for f in found["findings"]] == [("payload", "tool")]
    low, high = found["findings"][0]["parameters"]["mass"]["ci95"]
    assert low <= 2.5 <= high


@pytest.mark.parametrize("kind", ["poses", "loads", "motion"])
def test_dry_run_reads_seven_joints(kind: str, tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    cell = write_seven_joint_cell(tmp_path / "cell")
    arm, rng = SevenJointArm(SPRINGS, STRAIGHT), np.random.default_rng(5)
    record = {"poses": record_poses, "loads": record_load_tests, "motion": record_motion}[kind]
    recording = record(arm, tmp_path / kind, rng)
    assert main(["diagnose", str(cell), str(recording), "--dry-run"]) == 0
    assert "q7_deg" in capsys.readouterr().out


def test_planning_for_seven_joints_is_refused_with_one_message(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    cell = write_seven_joint_cell(tmp_path / "cell")
    job = tmp_path / "job.csv"
    job.write_text("x_mm,y_mm,z_mm,i,j,k\n0,0,0,0,0,1\n10,0,0,0,0,1\n")
    with pytest.raises(TooManyArmJointsError):
        load_cell(cell)
    for call in (
        ["optimize", str(cell), str(job), "-o", str(tmp_path / "o")],
        ["plan-poses", str(cell), "-o", str(tmp_path / "o")],
        ["map", str(cell), "-o", str(tmp_path / "o")],
        ["validate", str(cell)],
    ):
        assert main(call) == 2
        output = capsys.readouterr()
        text = output.err + output.out
        assert text.count("robot.arm_joints") == 1
        assert all(name in text for name in JOINTS)


def test_init_writes_a_cell_for_diagnosis_on_request(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    robot = tmp_path / "seven.urdf"
    robot.write_text(format_urdf())
    assert main(["init", str(robot), "-o", str(tmp_path / "cell")]) == 2
    assert "--for-diagnosis" in capsys.readouterr().err
    assert main(["init", str(robot), "-o", str(tmp_path / "cell"), "--for-diagnosis"]) == 0
    assert load_cell(tmp_path / "cell", any_chain=True).arm_joints == JOINTS


@pytest.mark.parametrize(
    ("file", "text", "where"),
    [
        ("stiffness.yaml", f"machopt_stiffness: 1\njoints_Nm_per_rad: [{', '.join(['1.0e5'] * 6)}]\n", "joints_Nm_per"),
        (
            "kinematics.yaml",
            "machopt_kinematics: 1\ncorrections:\n"
            '  - {effect: joint_zero_offset, location: "joint:8", parameters: {offset_deg: 0.02}}\n',
            "corrections[0].location",
        ),
    ],
)
def test_file_with_another_number_of_joints_is_refused(file: str, text: str, where: str, tmp_path: Path) -> None:
    cell = write_seven_joint_cell(tmp_path / "cell")
    (cell / file).write_text(text)
    if file == "kinematics.yaml":
        (cell / "cell.yaml").write_text((cell / "cell.yaml").read_text() + "kinematics: kinematics.yaml\n")
    with pytest.raises(CellError) as refused:
        load_cell(cell, any_chain=True)
    assert where in (refused.value.where or "")


@pytest.mark.slow
@pytest.mark.skipif(not DATA.exists(), reason="../shared/data/real/panda is not here")
def test_torques_of_a_real_arm_of_seven_joints_are_diagnosed(tmp_path: Path) -> None:
    found = diagnose(DATA / "cell", DATA / "recording", tmp_path / "out")
    assert found["final"]["heldout_rmse"] < found["baseline"]["heldout_rmse"]


@pytest.mark.parametrize("command", ["identify", "diagnose"])
def test_column_of_a_missing_joint_is_refused(command: str, tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    """Seven columns for a six-joint arm, and six columns for a seven-joint arm."""
    seven = write_seven_joint_cell(tmp_path / "seven")
    recording = record_load_tests(SevenJointArm(SPRINGS, STRAIGHT), tmp_path / "loads", np.random.default_rng(3), 4)
    six = tmp_path / "six"
    shutil.copytree(Path(__file__).parents[1] / "cells" / "kr240_drilling", six)
    assert main([command, str(six), str(recording), "-o", str(tmp_path / "o")]) == 2
    assert "7 joints" in capsys.readouterr().err
    table = recording / "data.csv"
    rows = [line.split(",") for line in table.read_text().splitlines()]
    at = rows[0].index("q7_deg")
    table.write_text("\n".join(",".join(row[:at] + row[at + 1 :]) for row in rows) + "\n")
    assert main([command, str(seven), str(recording), "-o", str(tmp_path / "o")]) == 2
    assert "q7_deg" in capsys.readouterr().err
