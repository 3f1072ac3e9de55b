"""Compliance of rails and positioners, compared with pinocchio, the verifier and the base spring."""

from __future__ import annotations

import csv
import json
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from external_axis_cells import external_cell, external_folder
from small_cell import pose
from test_machine import KINDS, by_pinocchio, machine

from machopt.cell.cell_reader import load_cell
from machopt.cell.stiffness.stiffness_file import load_stiffness, write_stiffness
from machopt.cli import main
from machopt.data_types.cell import Cell
from machopt.data_types.stiffness import ArmStiffness, ExternalJointSpring, StiffnessTerm
from machopt.errors import InputError
from machopt.kinematics.urdf_loading import load_masses, load_robot
from machopt.numerics.rigid_transforms import invert_transform
from machopt.planning.uncertainty.external_axis_settlement import compute_base_wrench
from machopt.stiffness.arm_stiffness import ArmElasticity
from machopt.stiffness.external_joint_compliance import ExternalJointCompliance
from machopt.verification.motion.kinematics.urdf_kinematics import UrdfKinematics
from machopt.verification.motion.stiffness.arm_compliance import ComplianceModel
from machopt.verification.motion.stiffness.external_joints import compute_external_compliance

STEP = 1e-6  # rad or m of a central difference; its error is of the order STEP²
K = {"rail": 4.0e7, "turn": 6.0e5, "tilt": 9.0e5}  # N/m, N·m/rad
RIGID = np.zeros((6, 6))


def springs(cell: Cell, body: bool = False) -> tuple[ExternalJointSpring, ...]:
    """Return one spring per joint; with ``body``, a full compliance matrix for each body."""
    rng, out = np.random.default_rng(3), []
    for name, slides in zip(cell.external_joints, cell.external_prismatic, strict=True):
        A = rng.normal(size=(6, 6)) * np.r_[np.full(3, 1e-4), np.full(3, 3e-4)][:, None]
        C, at = (A @ A.T, rng.uniform(-0.3, 0.3, 3)) if body else (RIGID, np.zeros(3))
        out.append(ExternalJointSpring(joint=name, stiffness=K[name], slides=slides, compliance=C, at=at))
    return tuple(out)


def postures(cell: Cell, count: int = 4) -> np.ndarray:
    rng = np.random.default_rng(5)
    return np.hstack([rng.uniform(-1.0, 1.0, (count, 6)), rng.uniform(-0.9, 0.9, (count, len(cell.external_joints)))])


def rotate_wrench_axes(R: np.ndarray) -> np.ndarray:
    return np.kron(np.eye(2), R)


@pytest.mark.parametrize("kind", KINDS, ids="-".join)
def test_joint_compliance_acts_along_the_joint_motion(tmp_path: Path, kind: dict[str, bool]) -> None:
    cell = external_cell(tmp_path, **kind)
    m = machine(cell)
    found = ExternalJointCompliance.build(m, springs(cell))
    assert found is not None
    for x in postures(cell):
        T, T_base_part, _ = by_pinocchio(cell, x)
        C = np.zeros((6, 6))
        for n, name in enumerate(cell.external_joints):
            step = STEP * np.eye(len(x))[6 + n]
            after, before = (by_pinocchio(cell, x + sign * step)[0] for sign in (1.0, -1.0))
            skew = (after[:3, :3] - before[:3, :3]) @ T[:3, :3].T / (2.0 * STEP)
            s = np.r_[(after - before)[:3, 3] / (2.0 * STEP), skew[2, 1], skew[0, 2], skew[1, 0]]
            s = rotate_wrench_axes(T_base_part[:3, :3]) @ s  # of the tool relative to the part, base_link axes
            C += np.outer(s, s) / K[name]
        place = (T_base_part @ T)[:3, 3]
        own = found.compute_compliance(x[None, 6:], place[None])[0]
        assert np.allclose(own, C, rtol=0.0, atol=1e-8 * np.abs(C).max())


@pytest.mark.parametrize("kind", KINDS, ids="-".join)
def test_verifier_agrees_by_its_own_implementation(tmp_path: Path, kind: dict[str, bool]) -> None:
    cell = external_cell(tmp_path, **kind)
    known, x = springs(cell, body=True), postures(cell)
    stance = UrdfKinematics(cell).compute_configuration(x[:, :6], x[:, 6:])
    found = ExternalJointCompliance.build(machine(cell), known)
    assert found is not None
    own = found.compute_compliance(x[:, 6:], stance.tcp[:, :3, 3])
    assert np.allclose(
        own,
        compute_external_compliance(UrdfKinematics(cell), stance, known),
        rtol=1e-10,
        atol=1e-10 * np.abs(own).max(),
    )
    assert np.allclose(own, np.swapaxes(own, 1, 2), atol=1e-12 * np.abs(own).max())
    assert (np.linalg.eigvalsh(own) > -1e-12 * np.abs(own).max()).all()


def test_carriage_acts_like_the_base_spring(tmp_path: Path) -> None:
    """The carriage compliance equals ``base_compliance`` of base_link for any rail position."""
    cell = external_cell(tmp_path, rail=True)
    robot, x = load_robot(cell), postures(cell)
    diagonal = [2e-8, 3e-8, 1e-8, 2e-8, 4e-8, 1e-8]
    base = replace(
        cell.stiffness or ArmStiffness(joints=np.full(6, 1e6)),
        terms=(StiffnessTerm("base_compliance", "base", {"compliance_diagonal": diagonal}),),
    )
    on = ExternalJointSpring(
        joint="rail", stiffness=np.inf, slides=None, compliance=np.diag(diagonal), at=np.array([-0.1, 0.0, 0.2])
    )  # position of base_link on the carriage
    place = robot.compute_fk(x[:, :6], cell.tool.T_flange_tcp)[:, :3, 3]
    found = ExternalJointCompliance.build(machine(cell), (on,))
    assert found is not None
    tool, k = cell.tool.T_flange_tcp, np.full((len(x), 6), 1e6)
    by_rail = ArmElasticity(robot, tool, replace(base, terms=())).evaluate(
        x[:, :6], k, found.compute_compliance(x[:, 6:], place)
    )
    by_base = ArmElasticity(robot, tool, base).evaluate(x[:, :6], k)
    force, e = np.tile([100.0, -250.0, 400.0], (len(x), 1)), np.tile([0.0, 0.6, 0.8], (len(x), 1))
    assert np.allclose(by_rail.compute_deflection(force), by_base.compute_deflection(force), rtol=1e-10)
    assert np.allclose(by_rail.compute_compliance_along(e), by_base.compute_compliance_along(e), rtol=1e-10)
    assert np.allclose(by_rail.compute_compliance(), by_base.compute_compliance(), rtol=1e-9, atol=1e-18)
    assert np.allclose(by_rail.compute_jiao_index(e), by_base.compute_jiao_index(e), rtol=1e-9)


def test_rail_compliance_does_not_depend_on_its_position(tmp_path: Path) -> None:
    cell = external_cell(tmp_path, rail=True)
    found = ExternalJointCompliance.build(machine(cell), springs(cell, body=True))
    assert found is not None
    C = found.compute_compliance(np.linspace(-2.5, 2.5, 5)[:, None], np.tile([1.4, 0.3, 0.8], (5, 1)))
    assert np.allclose(C, C[0], rtol=1e-12)


def test_table_compliance_is_largest_at_its_rim(tmp_path: Path) -> None:
    """r²/k in tangential direction, zero on the axis, which is at x = 1.6 m."""
    cell = external_cell(tmp_path, table=True)
    found = ExternalJointCompliance.build(machine(cell), springs(cell))
    assert found is not None
    C = found.compute_compliance(np.array([[0.0], [0.7]]), np.array([[1.6, 0.0, 0.9], [1.6, 0.4, 0.9]]))
    assert np.abs(C[0, :3, :3]).max() < 1e-20
    assert np.isclose(C[1, 0, 0], 0.4**2 / K["turn"], rtol=1e-12)


BLOCK = """external_joints:
  rail:
    stiffness_N_mm: 4.0e+4
    std_N_mm: 3.0e+3
    compliance_diagonal: [2e-9, 2e-9, 1e-9, 2e-8, 3e-8, 1e-8]
    at_mm: [0, 0, 100]
    mass_kg: 900
    com_mm: [0, 0, -80]
  e2: {stiffness_Nm_per_rad: 6.0e+5, std_Nm_per_rad: 9.0e+4}
"""
COVARIANCE = "covariance: [" + ", ".join(str([1e-14 if i == j else 0.0 for i in range(6)]) for j in range(6)) + "]\n"


def test_written_file_is_read_back(tmp_path: Path) -> None:
    folder = external_folder(tmp_path, rail=True, table=True)
    file = folder / "stiffness.yaml"
    file.write_text(file.read_text() + COVARIANCE + BLOCK)
    cell = load_cell(folder)
    assert cell.stiffness is not None
    rail, turn = cell.stiffness.external
    assert (rail.joint, rail.slides, rail.stiffness, rail.std, rail.mass) == ("rail", True, 4e7, 3e6, 900.0)
    assert (turn.joint, turn.slides, turn.stiffness, turn.std) == ("turn", False, 6e5, 9e4)
    assert np.allclose(np.diag(rail.compliance), [2e-9, 2e-9, 1e-9, 2e-8, 3e-8, 1e-8])
    write_stiffness(tmp_path / "again.yaml", cell.stiffness)
    again = load_stiffness(tmp_path / "again.yaml").external
    for a, b in zip((rail, turn), again, strict=True):
        assert all(np.array_equal(getattr(a, n), getattr(b, n)) for n in vars(a))


@pytest.mark.parametrize(
    ("entry", "told"),
    [
        ("slide: {stiffness_N_mm: 4e4}", "'slide' is no external joint of the cell; those of the cell are rail, turn"),
        ("rail: {stiffness_Nm_per_rad: 4e6}", "joint 'rail' slides; stiffness_N_mm would work"),
        ("turn: {stiffness_N_mm: 4e4}", "joint 'turn' turns; stiffness_Nm_per_rad would work"),
        ("turn: {stiffness_Nm_per_rad: 5}", "expected N·m/rad between 100 and 1e+10"),
        ("turn: {}", "is empty"),
        ("turn: {com_mm: [1, 0, 0]}", "add mass_kg"),
        ("turn: {compliance_diagonal: [1, 0, 0, 0, 0, 0]}", "expected m/N of at most 0.0001"),
        ("turn: {compliance_diagonal: [-1e-9, 0, 0, 0, 0, 0]}", "a compliance is at least zero"),
        ("turn: {stifness_Nm_per_rad: 5e5}", "stiffness_Nm_per_rad"),
        ("rail: {std_N_mm: 400, mass_kg: 3}", "add stiffness_N_mm"),
        ("rail: {std_N_mm: 400, stiffness_N_mm: 300}", "expected less than the stiffness, 300"),
        ("rail: {std_N_mm: 400, stiffness_N_mm: 4000}", "covariance (or discrepancy"),
        ("e2: {mass_kg: 3}\n  turn: {mass_kg: 3}", "joint 'turn' is named twice"),
    ],
)
def test_invalid_values_are_refused(tmp_path: Path, entry: str, told: str) -> None:
    folder = external_folder(tmp_path, rail=True, table=True)
    file = folder / "stiffness.yaml"
    file.write_text(file.read_text() + f"external_joints:\n  {entry}\n")
    with pytest.raises(InputError) as refused:
        load_cell(folder)
    assert told in str(refused.value)
    assert "stiffness.yaml" in str(refused.value)


@pytest.mark.parametrize("kind", [KINDS[0], KINDS[3], KINDS[4]], ids="-".join)
def test_weight_deflects_external_joints_by_their_torques(tmp_path: Path, kind: dict[str, bool]) -> None:
    """Torques of all weight at the external joints by pinocchio, with an inclined base, so that weight also loads
    the rail."""
    import pinocchio as pin

    askew = pose(0.3, -0.1, 0.2, 0.4)
    askew[:3, :3] = askew[:3, :3] @ pin.rpy.rpyToMatrix(0.2, -0.3, 0.0)
    cell = replace(external_cell(tmp_path, **kind), T_world_base=askew)
    known = tuple(replace(s, mass=100.0 * (n + 1), com=np.array([0.2, -0.1, 0.3])) for n, s in enumerate(springs(cell)))
    m, x = machine(cell), postures(cell)
    found = ExternalJointCompliance.build(m, known)
    assert found is not None
    model = pin.buildModelFromXML(cell.urdf_text)
    frame = model.frames[model.getFrameId(cell.flange_link)]
    own = pin.Inertia(cell.tool.mass, cell.tool.com, np.zeros((3, 3)))
    model.inertias[frame.parentJoint] += frame.placement.act(own)
    for s in known:
        model.inertias[model.getJointId(s.joint)] += pin.Inertia(s.mass, s.com, np.zeros((3, 3)))
    data, q0 = model.createData(), pin.neutral(model)
    pin.framesForwardKinematics(model, data, q0)
    to_world = cell.T_world_base @ np.linalg.inv(data.oMf[model.getFrameId(cell.base_link)].homogeneous)
    model.gravity.linear = to_world[:3, :3].T @ np.array([0.0, 0.0, -9.80665])
    robot = load_robot(cell)
    masses = load_masses(cell)
    for row in x:
        T, _, _ = by_pinocchio(cell, row)
        q = q0.copy()
        for name, value in zip((*cell.arm_joints, *cell.external_joints), row, strict=True):
            q[model.idx_qs[model.getJointId(name)]] = value
        torque = -pin.computeGeneralizedGravity(model, data, q)
        expected = np.zeros(3)
        for n, s in enumerate(known):
            step = STEP * np.eye(len(row))[6 + n]
            after, before = (by_pinocchio(cell, row + sign * step)[0][:3, 3] for sign in (1.0, -1.0))
            expected += (after - before) / (2.0 * STEP) * torque[model.idx_vs[model.getJointId(s.joint)]] / s.stiffness
        state = robot.compute_state(row[None, :6], cell.tool.T_flange_tcp, bodies=True)
        gravity = invert_transform(m.compute_T_world_base(row[None, 6:]))[0, :3, :3] @ np.array([0.0, 0.0, -9.80665])
        arm = compute_base_wrench(replace(masses, gravity=gravity), state)
        moved = found.compute_gravity_settling(row[None, 6:], T[None, :3, 3], arm)[0]
        assert np.allclose(moved, expected, rtol=0.0, atol=1e-7 * np.abs(expected).max())


def test_whole_command_includes_external_compliance(tmp_path: Path) -> None:
    """The deflection of the plan exceeds that with rigid axes by the compliance of the external joints; the verifier
    agrees with its own formulas."""
    folder = external_folder(tmp_path, rail=True, table=True)
    job = tmp_path / "job.csv"
    job.write_text(
        "x_mm,y_mm,z_mm,i,j,k,move,feed_mm_min\n-60,-80,60,0,0,1,rapid,\n-60,-80,0,0,0,1,approach,600\n"
        "0,0,0,0,0,1,cut,1500\n60,80,0,0,0,1,cut,1500\n60,80,60,0,0,1,retract,3000\n"
    )
    rigid = (folder / "stiffness.yaml").read_text()
    (folder / "stiffness.yaml").write_text(rigid + COVARIANCE + BLOCK)
    across = ["--set", "force_N.normal=200"]
    assert main(["optimize", str(folder), str(job), "-o", str(tmp_path / "out"), "--quiet", *across]) == 0
    assert main(["verify", str(folder), str(job), str(tmp_path / "out"), "--quiet"]) == 0
    output = " ".join(json.loads((tmp_path / "out" / "result.json").read_text())["warnings"])
    assert "Weight on the springs of the external joints" in output
    cell = load_cell(folder)
    assert cell.stiffness is not None
    with (tmp_path / "out" / "points.csv").open() as file:
        rows = list(csv.DictReader(file))
    q = np.radians([[float(r[f"q{j}_deg"]) for j in range(1, 7)] for r in rows])
    stance = UrdfKinematics(cell).compute_configuration(
        q, np.array([[float(r["e1_mm"]) / 1e3, np.radians(float(r["e2_deg"]))] for r in rows])
    )
    force = np.tile([0.0, 0.0, 200.0], (len(rows), 1))
    values = 1.0 / np.array([1e3 * float(r["k_axial_N_mm"]) for r in rows])
    rigid_axes = ComplianceModel(cell, UrdfKinematics(cell), replace(cell.stiffness, external=())).evaluate(
        stance, stance.tcp[:, :3, 3]
    )
    alone = rigid_axes.compute_displacement(force)[:, 2] / 200.0
    more = compute_external_compliance(UrdfKinematics(cell), stance, cell.stiffness.external)[:, 2, 2]
    assert np.allclose(values, alone + more, rtol=1e-5)
    assert (more > 1e-3 * alone).all()


def test_shifted_path_is_judged_at_its_programmed_place(tmp_path: Path) -> None:
    """Under load the tool reaches the programmed position; columns evaluated at the shifted position failed their
    check."""
    folder = external_folder(tmp_path, rail=True)
    job = tmp_path / "job.csv"
    job.write_text(
        "x_mm,y_mm,z_mm,i,j,k,move,feed_mm_min\n-60,-80,60,0,0,1,rapid,\n-60,-80,0,0,0,1,approach,600\n"
        "0,0,0,0,0,1,cut,900\n60,80,0,0,0,1,cut,900\n60,80,60,0,0,1,retract,3000\n"
    )
    soft = (
        "external_joints: {rail: {stiffness_N_mm: 3000, at_mm: [0, 0, -40],"
        " compliance_diagonal: [1e-7, 1e-7, 1e-7, 2e-6, 2e-6, 2e-6]}}\n"
    )
    (folder / "stiffness.yaml").write_text((folder / "stiffness.yaml").read_text() + soft)
    arguments = ["--compensate", "--set", "external.rail.mode=locked", "--set", "rotation_step_deg=30"]
    force = ["--set", "force_N.normal=120", "--set", "force_N.axial=80"]
    assert main(["optimize", str(folder), str(job), "-o", str(tmp_path / "out"), "--quiet", *arguments, *force]) == 0
    with (tmp_path / "out" / "compensation.csv").open() as file:
        most = max(abs(float(v)) for row in csv.DictReader(file) for k, v in row.items() if k.startswith("d"))
    assert most > 0.05  # mm; otherwise the test shows nothing
