"""As-built geometry in kinematics.yaml: planner and verifier build the same arm."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from test_cli import PASS, changed_cell, optimize, toolpath

from machopt.cell.cell_reader import load_cell
from machopt.cell.kinematics_file import load_kinematics, write_kinematics
from machopt.data_types.cell import Cell
from machopt.data_types.kinematic_corrections import KinematicCorrection, KinematicCorrections
from machopt.dynamics.gravity_torque import compute_gravity_torque
from machopt.effects.kinematic_corrections import extend_kinematics
from machopt.effects.structure import as_built_joint_frames
from machopt.errors import InputError
from machopt.kinematics.encoder_corrections import build_encoder_correction
from machopt.kinematics.inverse.solver import build_solver
from machopt.kinematics.urdf_loading import load_chain, load_masses, load_robot
from machopt.verification.motion.kinematics.encoder_correction import compute_true_angles
from machopt.verification.motion.kinematics.urdf_kinematics import UrdfKinematics

CELLS = Path(__file__).parents[1] / "cells"
PLACES = ("base", *(f"joint:{i}" for i in range(1, 7)), "tool")


def entry(place: str, rng: np.random.Generator) -> KinematicCorrection:
    size = {"xyz_mm": rng.normal(0.0, 0.5, 3).tolist(), "turn_mrad": rng.normal(0.0, 0.9, 3).tolist()}
    return KinematicCorrection("geometry", place, size)


def built_cell(name: str, seed: int = 0) -> Cell:
    rng = np.random.default_rng(seed)
    return replace(
        load_cell(CELLS / name), kinematics=KinematicCorrections(tuple(entry(place, rng) for place in PLACES))
    )


def write_geometry_file(tmp_path: Path, text: str) -> Path:
    path = tmp_path / "kinematics.yaml"
    path.write_text("machopt_kinematics: 1\ncorrections:\n" + text)
    return path


def test_planner_and_verifier_build_the_same_arm() -> None:
    cell = built_cell("kr240_drilling")
    robot, arm = load_robot(cell), UrdfKinematics(cell)
    q = np.random.default_rng(1).uniform(-1.5, 1.5, (50, 6))
    stance = arm.compute_configuration(q)
    # both multiply the same matrices in different order: rounding of metres
    np.testing.assert_allclose(robot.compute_fk(q, cell.tool.T_flange_tcp), stance.tcp, atol=1e-13)
    np.testing.assert_allclose(
        robot.nominal_robot.compute_fk(q), UrdfKinematics(cell, drawn=True).compute_configuration(q).flange, atol=1e-13
    )
    state = robot.compute_state(q, cell.tool.T_flange_tcp, bodies=True)
    np.testing.assert_allclose(
        compute_gravity_torque(robot, load_masses(cell), state)[0], arm.compute_gravity_torque(q), atol=1e-9
    )  # relative to torques of 1e3
    assert (
        1e-3 < np.abs(robot.compute_fk(q) - robot.nominal_robot.compute_fk(q)).max() < 2e-2
    )  # a difference of millimetres


def test_link_of_the_arm_carries_its_bodies() -> None:
    cell = built_cell("kr240_drilling")
    drawn = {s.shape.name: s.shape.T_parent_shape for s in load_chain(load_cell(CELLS / "kr240_drilling"))[1]}
    for s in load_chain(cell)[1]:
        off = np.abs(s.shape.T_parent_shape - drawn[s.shape.name]).max()
        assert (off == 0.0) if s.link == 0 else (1e-5 < off < 2e-2)


@pytest.mark.parametrize("name", ["kr240_drilling", "cutting_cobot"])
def test_branches_of_the_nominal_arm_lead_to_the_as_built_arm(name: str) -> None:
    robot = load_robot(built_cell(name))
    q = np.random.default_rng(2).uniform(-1.4, 1.4, (60, 6))
    T = robot.compute_fk(q)
    found, drawn = build_solver(robot).solve(T), build_solver(robot.nominal_robot).solve(T)
    there = np.isfinite(found.q[..., 0])
    assert (
        np.abs(robot.compute_fk(np.nan_to_num(found.q)) - T[:, None])[there].max() < 1e-9
    )  # as_built_solver.POSE_TOLERANCE
    apart = np.abs(np.angle(np.exp(1j * (found.q - drawn.q))))
    regular = there & (drawn.wrist > 0.2) & (drawn.elbow > 0.2) & (drawn.shoulder > 0.1)
    assert apart[regular].max() < 0.1  # milliradians divided by sines of 0.2, twice: the same branch has the same index
    own = np.abs(np.angle(np.exp(1j * (found.q - q[:, None])))).max(axis=2)
    assert np.mean(np.nanmin(np.where(there, own, 9.0), axis=1) < 1e-6) > 0.9  # the others are at a singularity


def test_geometry_differs_from_joint_offsets() -> None:
    known = KinematicCorrections((entry("joint:3", np.random.default_rng(3)),))
    assert build_encoder_correction(known) is None
    q = np.ones((2, 6))
    np.testing.assert_array_equal(compute_true_angles(known, q), q)


def test_written_geometry_is_read_back(tmp_path: Path) -> None:
    known = KinematicCorrections(tuple(entry(place, np.random.default_rng(4)) for place in PLACES))
    write_kinematics(tmp_path / "k.yaml", known)
    assert load_kinematics(tmp_path / "k.yaml") == known


@pytest.mark.parametrize(
    ("text", "said"),
    [
        ('  - {effect: geometry, location: "joint:13", parameters: {xyz_mm: [0, 0, 0]}}\n', "joint:13"),
        ('  - {effect: geometry, location: "joint:2", parameters: {xyz_mm: [0, 0]}}\n', "three numbers"),
        ('  - {effect: geometry, location: "joint:2", parameters: {xyz_mm: [0, 0, 300]}}\n', "at most 50 mm"),
        ('  - {effect: geometry, location: "joint:2", parameters: {turn_deg: [0, 0, 1]}}\n', "turn_mrad"),
        ('  - {effect: geometry, location: "joint:2", parameters: {}}\n', "xyz_mm or turn_mrad"),
    ],
)
def test_invalid_geometry_is_refused(tmp_path: Path, text: str, said: str) -> None:
    with pytest.raises(InputError, match=said):
        load_kinematics(write_geometry_file(tmp_path, text))


def test_new_geometry_adds_to_known_geometry() -> None:
    known = KinematicCorrections((KinematicCorrection("geometry", "joint:2", {"xyz_mm": [0.25, 0.0, 0.0]}),))
    found = KinematicCorrection("geometry", "joint:2", {"xyz_mm": [0.5, 0.0, 1.0], "turn_mrad": [0.0, 0.5, 0.0]})
    (both,) = extend_kinematics(known, [found]).corrections
    assert as_built_joint_frames.read_frame_offset(both.parameters).shift.tolist() == [0.00075, 0.0, 0.001]
    assert both.parameters["turn_mrad"] == [0.0, 0.5, 0.0]


@pytest.mark.slow
def test_plan_on_an_as_built_arm_is_verified(tmp_path: Path) -> None:
    """Joint targets are exported for the as-built arm, and Cartesian targets for the nominal kinematics of the
    controller; both are read back."""
    line = "stiffness: stiffness.yaml"
    cell = changed_cell(tmp_path, (line, f"{line}\nkinematics: kinematics.yaml"))
    text = (
        '  - {effect: geometry, location: "joint:2", parameters: {xyz_mm: [0.3, 0.2, 0], turn_mrad: [0.4, 0, -0.5]}}\n'
    )
    text += (
        '  - {effect: geometry, location: "joint:5", parameters: {xyz_mm: [0, -0.2, 0.1], turn_mrad: [0.2, 0, 0.3]}}\n'
    )
    write_geometry_file(cell, text)
    # exit code 4 would be: not verified
    assert optimize(cell, toolpath(tmp_path, PASS), tmp_path / "out", "--post", "krl") == 0
