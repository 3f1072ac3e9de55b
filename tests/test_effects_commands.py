"""One user effect file in every command: diagnosis, output file, planning, map."""

from __future__ import annotations

import json
import shutil
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from test_diagnose_motion import arm, build_fourier_motion, build_motion_recording, diagnose_recording
from test_effects_user_defined import JELLY

from machopt.api import Cell
from machopt.cell.cell_reader import load_cell
from machopt.cell.stiffness.stiffness_file import load_stiffness
from machopt.cli import main
from machopt.data_types.kinematic_corrections import KinematicCorrection
from machopt.data_types.measurements.recording import Recording
from machopt.dynamics.gravity_torque import compute_gravity_torque
from machopt.dynamics.rigid_body import load_dynamics
from machopt.effects import registry, user_effects
from machopt.effects.protocol import JOINTS, JointLoading
from machopt.kinematics.urdf_loading import load_masses, load_robot
from machopt.measurement.diagnosis.dynamic import motion_channels
from machopt.measurement.estimation.load_test_equations import build_load_test_experiment
from machopt.measurement.identification.fitting.loaded_equilibrium import LoadedEquilibriumModel
from machopt.measurement.recording import write_recording

CELL = Path(__file__).resolve().parent.parent / "cells" / "kr240_drilling"
BEND, HALF = 2e-6, 0.3  # rad/(N·m), additional compliance at zero torque; share of the largest torque at the joint
QUIET = ["--quiet", "-o"]
PATH = (
    "x_mm,y_mm,z_mm,i,j,k,move,feed_mm_min,operation\n"
    "0,0,60,0,0,1,rapid,,a\n0,0,0,0,0,1,approach,900,a\n40,0,0,0,0,1,cut,900,a\n40,0,60,0,0,1,retract,900,a\n"
)


def load_test(jelly: Path) -> Recording:
    """Simulate twenty poses with loads of up to 300 N applied and removed, in two sessions, with noise of 5 µm and 5
    µrad; joint 3 follows the user's law."""
    cell = load_cell(CELL)
    robot, tool, masses = load_robot(cell), cell.tool.T_flange_tcp, load_masses(cell)
    assert cell.stiffness is not None
    rng = np.random.default_rng(4)
    poses = np.radians([0, -90, 100, 0, 60, 0]) + rng.uniform(-0.5, 0.5, (20, 6))
    q = np.tile(np.repeat(poses, 6, axis=0), (2, 1))
    way = rng.uniform(-1.0, 1.0, (40, 6)) * np.repeat([300.0, 60.0], 3)
    w = np.tile(np.repeat(way, 3, axis=0) * np.tile([0.5, 1.0, 0.5], 40)[:, None], (2, 1))
    state = robot.compute_state(q, tool, bodies=True)
    tau = np.einsum("nci,nc->ni", state.J, w)
    weight = compute_gravity_torque(robot, masses, state)[0]
    rows, pose = np.arange(len(q)), np.tile(np.repeat(np.arange(20), 6), 2)
    cycle, session = rows // 3, rows // 120
    still = Recording(
        kind="deflection",
        source="made up",
        q=q,
        pose=pose,
        cycle=cycle,
        session=session,
        line=rows + 2,
        wrench=w,
        displacement=np.zeros_like(w),
    )
    springs, _ = LoadedEquilibriumModel(build_load_test_experiment(still, robot, tool), robot, tool, masses).predict(
        1.0 / cell.stiffness.joints
    )
    with user_effects.activate_user_effects(user_effects.run_user_files((jelly,))):
        law = registry.EFFECTS["joint_jelly"].joint_laws[0]
        half = np.array([HALF * np.abs(tau + weight)[:, 2].max()])
        with_load, without = (law.columns(half, JointLoading(t[:, 2])) for t in (tau + weight, weight))
    gives = BEND * (with_load - without) * state.J[:, :, 2]
    return replace(still, displacement=springs + gives + 5e-6 * rng.normal(size=w.shape))


@pytest.mark.slow
def test_one_effect_file_goes_through_every_command(tmp_path: Path) -> None:
    jelly, cell, rec, out = (tmp_path / n for n in ("jelly.py", "cell", "rec", "out"))
    jelly.write_text(JELLY)
    write_recording(rec, load_test(jelly))
    assert main(["diagnose", str(CELL), str(rec), "--effects", str(jelly), *QUIET, str(out)]) == 0
    result = json.loads((out / "diagnosis.json").read_text())
    named = [(f["effect"], f["location"]) for f in result["findings"] if f["effect"] != "geometric_stiffness"]
    assert named == [("joint_jelly", "joint:3")]  # K_C is always fitted, and named where significant
    assert {"joint:1", "joint:2"} <= {x["location"] for x in result["detection_limits"] if x["effect"] == "joint_jelly"}
    assert "jelly of joint 3" in result["sentence"]
    page = (out / "report.html").read_text()
    assert "jelly of joint 3" in page
    assert "The joint gives as jelly does." in page

    shutil.copytree(CELL, cell)
    shutil.copy(out / "stiffness.yaml", cell / "stiffness.yaml")
    with user_effects.activate_user_effects(user_effects.run_user_files((jelly,))):
        written = {(t.effect, t.location) for t in load_stiffness(cell / "stiffness.yaml").terms}
    assert ("joint_jelly", "joint:3") in written

    path = tmp_path / "path.csv"
    path.write_text(PATH)
    mine = ["--effects", str(jelly)]
    wanted = ["--set", "rotation_step_deg=20", "--set", "collision=false"]
    assert main(["optimize", str(cell), str(path), *mine, *wanted, *QUIET, str(tmp_path / "plan")]) == 0
    grid = ["--step", "700", "--collision", "none"]
    assert main(["map", str(cell), *mine, *grid, *QUIET, str(tmp_path / "map")]) == 0
    assert main(["map", str(cell), "--step", "700", *QUIET, str(tmp_path / "unknown")]) == 2  # without its effect file

    known = [str(cell), str(rec), "--effects", str(jelly), *QUIET, str(tmp_path / "again")]
    assert main(["diagnose", *known]) == 0
    again = json.loads((tmp_path / "again" / "diagnosis.json").read_text())
    assert "joint_jelly" not in {f["effect"] for f in again["findings"]}


SCALE = '''
from dataclasses import dataclass

import numpy as np

from machopt.effects.protocol import JOINTS, Effect, JointAngleLawDefaults, LawParameter, Quantity


@dataclass(frozen=True)
class Linear(JointAngleLawDefaults):
    """delta = kappa q"""

    name = "grows with the angle"
    equation = "Δ_j = κ q_j"
    note = "without load, farther out the more"
    prior = 1e-2
    coefficients = (LawParameter(key="per_mille", unit="rad/rad", factor=1e-3, required=True,
                                 magnitude_limit=50.0, unit_in_words="mrad/rad"),)

    def columns(self, shape, angle, derivative=0):
        of = angle if derivative == 0 else np.full(np.shape(angle), float(derivative == 1))
        return np.asarray(of, float)[..., None]

    def compute_max_slope(self, values, shape):
        return abs(float(values[0]))

    def compute_max_error(self, values, shape):
        return np.inf

    def sizes(self, values, shape):
        return {"scale": Quantity(1e3 * float(values[0]), "mrad/rad")}


EFFECTS = [
    Effect(
        name="encoder_scale", noun="wrong scale", sentence="The encoder counts more or less than it turns.",
        port="angle", places=JOINTS, angle_laws=(Linear(),),
    )
]
'''


@pytest.fixture
def scaled(tmp_path: Path) -> tuple[Path, Path]:
    """Write a cell whose kinematics.yaml contains a user-defined effect, and the effect file."""
    scale, cell = tmp_path / "scale.py", tmp_path / "cell"
    scale.write_text(SCALE)
    shutil.copytree(CELL, cell)
    (cell / "kinematics.yaml").write_text(
        "machopt_kinematics: 1\ncorrections:\n"
        '  - {effect: encoder_scale, location: "joint:1", parameters: {per_mille: 2.0}}\n'
    )
    text = (cell / "cell.yaml").read_text()
    (cell / "cell.yaml").write_text(text.replace("stiffness:", "kinematics: kinematics.yaml\nstiffness:", 1))
    return scale, cell


def test_inspecting_commands_know_user_effects(
    scaled: tuple[Path, Path], tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    scale, cell = scaled
    path = tmp_path / "path.csv"
    path.write_text(PATH)
    for words in (["validate", str(cell)], ["inspect", str(cell)], ["inspect", str(path), "--cell", str(cell)]):
        assert main(words) == 2
        assert "where its file is given" in capsys.readouterr().err
        assert main([*words, "--effects", str(scale), "--json"]) == 0
        message = capsys.readouterr()
        assert "encoder_scale" not in message.err
        assert f"--effects runs the code in {scale} with your rights" in message.err
        assert "cannot_be_planned" not in json.loads(message.out)
    assert "encoder_scale" not in registry.EFFECTS  # the user effect is removed again
    assert main(["inspect", str(path), "--effects", str(scale)]) == 2
    assert "--effects: found a toolpath and no cell" in capsys.readouterr().err
    assert Cell.load(cell, effects=[scale]).validate() == ()


def test_user_joint_angle_effect_is_found_in_motions(tmp_path: Path) -> None:
    """Link-side encoders identify it and TCP readings search for it; an effect that the channel refits is reported
    as absorbed."""
    scale = tmp_path / "scale.py"
    scale.write_text(SCALE)
    rng, bench = np.random.default_rng(6), arm(tmp_path)
    t, q, v, a = build_fourier_motion(1, rng)
    tau = load_dynamics(bench).compute_torque(q, v, a) + 0.1 * rng.normal(size=q.shape)
    other = 1.002 * q + 2e-5 * rng.normal(size=q.shape)
    with user_effects.activate_user_effects(user_effects.run_user_files((scale,))):
        found, _, _ = diagnose_recording(build_motion_recording(t, q, v, tau, q_secondary=other), bench, "link")
        cell = load_cell(CELL)
        t, q, v, _ = build_fourier_motion(6, rng, periods=2, rate=20.0)
        q = np.radians([0, -90, 100, 0, 60, 0]) + 0.5 * q
        tip = load_robot(cell).compute_state(q, cell.tool.T_flange_tcp).T_base_tool[:, :3, 3]
        _, searched, _, _ = motion_channels.build_motion_problem(
            build_motion_recording(t, q, v, position=tip), cell, "tip", rng
        )
    assert [(f.effect, f.location) for f in found.findings] == [("encoder_scale", "joint:1")]
    size = found.findings[0].parameters["scale"]
    assert size.value == pytest.approx(2.0, rel=0.02)
    written = found.findings[0].correction
    assert isinstance(written, KinematicCorrection)
    assert written.parameters["per_mille"] == pytest.approx(size.value)
    assert {h.location for h in searched.hypotheses if h.effect == "encoder_scale"} == set(JOINTS[:6])

    whole = SCALE.replace("encoder_scale", "encoder_zero").replace("np.asarray(of, float)", "np.ones_like(of)")
    scale.write_text(whole)
    with user_effects.activate_user_effects(user_effects.run_user_files((scale,))):
        t, q, v, _ = build_fourier_motion(1, rng)
        _, searched, _, _ = motion_channels.build_motion_problem(
            build_motion_recording(t, q, v, q_secondary=q + 1e-5), bench, "link", rng
        )
    assert [(u.effect, u.location) for u in searched.untestable if u.effect == "encoder_zero"] == [
        ("encoder_zero", "joint:1")
    ]
    assert "encoder_zero" not in {h.effect for h in searched.hypotheses}


def simulate_tracked_poses() -> Recording:
    """Simulate forty poses measured twice by a tracker, noise 10 µm; joint 1 turns 2 ‰ more than its encoder shows."""
    cell = load_cell(CELL)
    robot, tool = load_robot(cell), cell.tool.T_flange_tcp
    assert cell.stiffness is not None
    rng = np.random.default_rng(8)
    q = np.radians([0, -90, 100, 0, 60, 0]) + rng.uniform(-0.6, 0.6, (40, 6)) * [2.2, 0.6, 0.6, 2.0, 1.0, 2.0]
    q = np.tile(q, (2, 1))
    placed = q * [1.002, 1.0, 1.0, 1.0, 1.0, 1.0]
    for _ in range(8):
        tau = compute_gravity_torque(robot, load_masses(cell), robot.compute_state(placed, tool, bodies=True))[0]
        placed = q * [1.002, 1.0, 1.0, 1.0, 1.0, 1.0] + tau / cell.stiffness.joints
    position = robot.compute_state(placed, tool).T_base_tool[:, :3, 3] + 1e-5 * rng.normal(size=(len(q), 3))
    visit, rows = np.repeat([0, 1], 40), np.arange(len(q))
    return Recording(
        kind="absolute", source="made up", q=q, pose=np.tile(np.arange(40), 2), cycle=visit, session=visit,
        line=rows + 2, position=position, registration="fit",
    )  # fmt: skip


@pytest.mark.slow
def test_kinematic_effect_file_goes_through_every_command(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    """The effect is found, written to kinematics.yaml, used by optimize, verify and map, and then known to diagnose."""
    scale, cell, rec, out = (tmp_path / n for n in ("scale.py", "cell", "rec", "out"))
    scale.write_text(SCALE)
    write_recording(rec, simulate_tracked_poses())
    assert main(["diagnose", str(CELL), str(rec), "--effects", str(scale), *QUIET, str(out)]) == 0
    result = json.loads((out / "diagnosis.json").read_text())
    assert [(f["effect"], f["location"]) for f in result["findings"]] == [("encoder_scale", "joint:1")]
    size = result["findings"][0]["parameters"]["scale"]
    assert size["unit"] == "mrad/rad"
    assert size["ci95"][0] < 2.0 < size["ci95"][1]
    assert {"joint:2", "joint:3"} <= {
        x["location"] for x in result["detection_limits"] if x["effect"] == "encoder_scale"
    }
    assert "wrong scale of joint 1" in result["sentence"]
    page = (out / "report.html").read_text()
    assert "The encoder counts more or less than it turns." in page
    assert "Goes into kinematics.yaml" in page

    shutil.copytree(CELL, cell)
    shutil.copy(out / "kinematics.yaml", cell / "kinematics.yaml")
    text = (cell / "cell.yaml").read_text()
    (cell / "cell.yaml").write_text(text.replace("stiffness:", "kinematics: kinematics.yaml\nstiffness:", 1))
    path = tmp_path / "path.csv"
    path.write_text(PATH)
    mine = ["--effects", str(scale)]
    wanted = ["--set", "rotation_step_deg=20", "--set", "collision=false"]
    assert main(["optimize", str(cell), str(path), *mine, *wanted, *QUIET, str(tmp_path / "plan")]) == 0
    verdict = json.loads((tmp_path / "plan" / "manifest.json").read_text())["verdict"]
    assert "kinematics.yaml encoder_scale at joint:1" in verdict
    capsys.readouterr()
    assert main(["verify", str(cell), str(path), str(tmp_path / "plan"), *mine]) == 0
    printed = capsys.readouterr().out
    assert "encoder_scale at joint:1 NOT checked" in printed
    assert "no independent formula for 'encoder_scale'" in printed  # with the reason
    grid = ["--step", "700", "--collision", "none"]
    assert main(["map", str(cell), *mine, *grid, *QUIET, str(tmp_path / "map")]) == 0
    assert main(["map", str(cell), *grid, *QUIET, str(tmp_path / "unknown")]) == 2  # without its effect file
    assert "'encoder_scale'" in (message := capsys.readouterr().err)
    assert "where its file is given" in message

    known = [str(cell), str(rec), "--effects", str(scale), *QUIET, str(tmp_path / "again")]
    assert main(["diagnose", *known]) == 0
    again = json.loads((tmp_path / "again" / "diagnosis.json").read_text())
    assert again["findings"] == []
