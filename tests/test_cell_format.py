"""cell.yaml, its URDF and stiffness.yaml: accepted input and the errors of invalid input."""

from __future__ import annotations

import os
import shutil
from pathlib import Path

import numpy as np
import pytest
import trimesh
import yaml as other_yaml
from hypothesis import given, settings
from hypothesis import strategies as st
from property_example_count import scale_example_count
from small_cell import robot_folder

from machopt.cell.cell_reader import load_cell
from machopt.cell.stiffness.stiffness_file import load_stiffness, write_stiffness
from machopt.data_types.cell import Cell
from machopt.data_types.stiffness import ArmStiffness, PositionError, StiffnessGrid, StiffnessTerm
from machopt.errors import InputError
from machopt.file_formats.strict_yaml import parse_yaml

ROOT = Path(__file__).resolve().parents[1]

CELL = """\
machopt_cell: 1
name: test cell
robot:
  urdf: robot.urdf
  base_link: base
  flange_link: flange
  pose: {xyz_mm: [0, 0, 200], rpy_deg: [0, 0, 0]}
  home_deg: [0, -90, 90, 0, 10, 0]
  limits:
    velocity_deg_s: [100, 100, 100, 200, 200, 300]
    acceleration_deg_s2: [300, 300, 300, 600, 600, 900]
    jerk_deg_s3: [3000, 3000, 3000, 6000, 6000, 9000]
tool:
  tcp: {xyz_mm: [10, 20, 300], rpy_deg: [0, 90, 0]}
  mass_kg: 45
  com_mm: [0, 0, 150]
  geometry: [{name: spindle, mesh: spindle.stl}]
  cutter: {diameter_mm: 10, length_mm: 40}
workpiece:
  pose: {xyz_mm: [1500, 0, 800], rpy_deg: [0, 0, 90]}
  geometry: [{name: plate, box_mm: [400, 300, 50]}]
obstacles:
  - {name: post, cylinder_mm: [50, 1000], xyz_mm: [500, 900, 500]}
  - {name: ball, sphere_mm: 80}
stiffness: stiffness.yaml
plan: {rotation_step_deg: 10, force_N: {axial: 2e2}}
"""
STIFFNESS = "machopt_stiffness: 1\njoints_Nm_per_rad: [1.41e6, 4.01e5, 9.35e5, 3.60e5, 3.70e5, 380e3]\n"


def joint(name: str, parent: str, child: str, kind: str = "revolute", limit: str | None = None) -> str:
    limit = '<limit lower="-3" upper="3" velocity="9" effort="0"/>' if limit is None else limit
    return (
        f'<joint name="{name}" type="{kind}"><parent link="{parent}"/><child link="{child}"/>'
        f'<origin xyz="0 0 0.3"/><axis xyz="0 1 0"/>{limit}</joint>'
    )


def urdf(*more: str, arm: list[str] | None = None, mesh: str = "link.stl") -> str:
    links = "".join(f'<link name="{n}"/>' for n in ("base", "l1", "l2", "l3", "l4", "l5"))
    links += (
        f'<link name="l6"><visual><geometry><mesh filename="picture.dae"/></geometry></visual>'
        f'<collision><geometry><mesh filename="{mesh}"/></geometry></collision></link><link name="flange"/>'
    )
    chain = ["base", "l1", "l2", "l3", "l4", "l5", "l6"]
    if arm is None:
        arm = [joint(f"a{i + 1}", chain[i], chain[i + 1]) for i in range(6)]
    fixed = joint("f", "l6", "flange", "fixed", "")
    return f'<robot name="r">{links}{"".join(arm)}{fixed}{"".join(more)}</robot>'


@pytest.fixture
def folder(tmp_path: Path) -> Path:
    root = tmp_path / "cell"
    root.mkdir()
    (root / "cell.yaml").write_text(CELL)
    (root / "stiffness.yaml").write_text(STIFFNESS)
    (root / "robot.urdf").write_text(urdf())
    for name in ("spindle.stl", "link.stl"):
        trimesh.creation.box((0.1, 0.1, 0.2)).export(root / name)
    return root


def change(folder: Path, *pairs: tuple[str, str], file: str = "cell.yaml") -> None:
    text = (folder / file).read_text()
    for old, new in pairs:
        assert old in text, old
        text = text.replace(old, new)
    (folder / file).write_text(text)


def refusal(folder: Path, **options: bool) -> str:
    with pytest.raises(InputError) as caught:
        load_cell(folder, **options)
    return str(caught.value)


def expect(message: str, *parts: str) -> None:
    for part in parts:
        assert part in message, f"{part!r} is not in: {message}"


# accepted input ------------------------------------------------------------------------------------------------


def test_all_quantities_are_converted_to_si(folder: Path) -> None:
    cell = load_cell(folder)
    assert cell.name == "test cell"
    assert cell.arm_joints == ("a1", "a2", "a3", "a4", "a5", "a6")
    np.testing.assert_allclose(cell.T_world_base[:3, 3], [0, 0, 0.2])
    np.testing.assert_allclose(cell.tool.T_flange_tcp[:3, 3], [0.01, 0.02, 0.3])
    np.testing.assert_allclose(cell.tool.T_flange_tcp[:3, 2], [1, 0, 0], atol=1e-15)  # pitch 90°: z becomes x
    np.testing.assert_allclose(cell.workpiece.T_link_workpiece[:3, 0], [0, 1, 0], atol=1e-15)
    np.testing.assert_allclose(cell.home, np.radians([0, -90, 90, 0, 10, 0]))
    np.testing.assert_allclose(cell.limits.jerk, np.radians([3000, 3000, 3000, 6000, 6000, 9000]))
    np.testing.assert_allclose(cell.limits.upper, 3)
    assert cell.tool.cutter is not None
    assert (cell.tool.cutter.diameter, cell.tool.cutter.length) == (0.01, 0.04)
    assert [s.kind for s in cell.obstacles] == ["cylinder", "sphere"]
    assert cell.obstacles[0].size == (0.05, 1.0)
    assert cell.tool.geometry[0].mesh == folder / "spindle.stl"
    assert cell.stiffness is not None
    assert cell.stiffness.joints[5] == 380e3
    assert cell.plan == {"rotation_step_deg": 10.0, "force_N": {"axial": 200.0}}
    names = {f.name for f in cell.files}
    assert names == {"cell.yaml", "robot.urdf", "stiffness.yaml", "spindle.stl", "link.stl"}
    assert not cell.home.flags.writeable
    assert cell.warnings == ()


def test_rpy_is_about_fixed_axes_z_y_x(folder: Path) -> None:
    from scipy.spatial.transform import Rotation

    change(folder, ("rpy_deg: [0, 90, 0]", "rpy_deg: [10, 20, 30]"))
    expected = Rotation.from_euler("xyz", [10, 20, 30], degrees=True).as_matrix()
    np.testing.assert_allclose(load_cell(folder).tool.T_flange_tcp[:3, :3], expected, atol=1e-15)


def test_cell_yaml_is_accepted_instead_of_the_folder(folder: Path) -> None:
    assert load_cell(folder / "cell.yaml").folder == folder


def test_position_limits_narrow_those_of_the_urdf(folder: Path) -> None:
    change(folder, ("limits:\n", "limits:\n    position_deg: [[-90, 90]," + "[-171.887, 171.89]," * 5 + "]\n"))
    limits = load_cell(folder).limits
    np.testing.assert_allclose(limits.upper[0], np.pi / 2)
    np.testing.assert_allclose(limits.upper[1], 3.0)  # 171.89° exceeds 3 rad by rounding: the URDF limit applies


def test_undriven_joints_and_unsearched_turns_are_reported(folder: Path) -> None:
    text = urdf('<link name="jaw"/>', joint("grip", "l6", "jaw", "prismatic"))
    (folder / "robot.urdf").write_text(text.replace('name="a6" type="revolute"', 'name="a6" type="continuous"'))
    change(folder, ("limits:\n", "limits:\n    position_deg: [" + "[-90, 90]," * 5 + "[-720, 720]]\n"))
    cell = load_cell(folder)
    np.testing.assert_allclose(cell.limits.upper[5], 4 * np.pi)
    # the position limits replace the range that the warning would request
    assert not [w for w in cell.warnings if "continuous" in w]
    expect(" ".join(cell.notes), "joints grip", "of the range of a6 the planner uses -540 to 540 deg")


def test_missing_velocities_come_from_the_urdf_with_a_message(folder: Path) -> None:
    change(folder, ("    velocity_deg_s: [100, 100, 100, 200, 200, 300]\n", ""))
    cell = load_cell(folder)
    np.testing.assert_allclose(cell.limits.velocity, 9.0)
    expect(" ".join(cell.notes), "velocity_deg_s is not given", "a1 515.7 deg/s", "position_deg is not given")
    (folder / "robot.urdf").write_text(urdf().replace('velocity="9"', 'velocity="0"', 1))
    expect(refusal(folder), "robot.limits", "joint 'a1' of the URDF has velocity 0", "expected velocity_deg_s")


def test_allowed_contacts_are_pairs_of_names_or_a_file(folder: Path) -> None:
    change(folder, ("stiffness: stiffness.yaml\n", "stiffness: stiffness.yaml\nignore_pairs: [[l6, post]]\n"))
    assert load_cell(folder).may_touch[0].first == ("l6_0",)
    change(folder, ("[[l6, post]]", "[[l6, post, ball]]"))
    expect(refusal(folder), "ignore_pairs", "['l6', 'post', 'ball'] as entry 1", "pairs of names")
    change(folder, ("[[l6, post, ball]]", "robot.srdf"))
    expect(refusal(folder), "ignore_pairs", "no such file: robot.srdf")
    (folder / "robot.srdf").write_text('<robot><disable_collisions link1="l6" link2="l1"/></robot>')
    cell = load_cell(folder)
    assert cell.may_touch == ()  # l1 has no collision body
    assert "robot.srdf" in {f.name for f in cell.files}


def test_continuous_joint_gets_two_turns_and_a_warning(folder: Path) -> None:
    (folder / "robot.urdf").write_text(urdf().replace('name="a6" type="revolute"', 'name="a6" type="continuous"'))
    cell = load_cell(folder)
    np.testing.assert_allclose(cell.limits.upper[5], 2 * np.pi)
    expect(cell.warnings[0], "'a6' is continuous", "±360°")


def test_rail_and_positioner_follow_the_arm_in_listed_order(folder: Path) -> None:
    rail = joint("rail", "floor", "base", "prismatic", '<limit lower="0" upper="4" velocity="1" effort="0"/>')
    turn = joint("turn", "floor", "table")
    (folder / "robot.urdf").write_text(urdf('<link name="floor"/><link name="table"/>', turn, rail))
    change(
        folder,
        ("  home_deg: [0,", "  external_joints: [turn, rail]\n  home_deg: [0,"),
        ("90, 0, 10, 0]", "90, 0, 10, 0, 45, 1500]"),
        ("100, 100, 100, 200, 200, 300]", "100, 100, 100, 200, 200, 300, 50, 800]"),
        ("300, 300, 300, 600, 600, 900]", "300, 300, 300, 600, 600, 900, 60, 1000]"),
        ("3000, 3000, 3000, 6000, 6000, 9000]", "3000, 3000, 3000, 6000, 6000, 9000, 700, 5000]"),
        ("workpiece:\n", "workpiece:\n  link: table\n"),
    )
    change(folder, ("sphere_mm: 80", "sphere_mm: 80, link: table"))
    cell = load_cell(folder)
    assert [s.link for s in cell.obstacles] == ["world", "table"]
    assert cell.external_joints == ("turn", "rail")
    assert cell.external_prismatic == (False, True)
    np.testing.assert_allclose(cell.external_home, [np.pi / 4, 1.5])
    np.testing.assert_allclose(cell.limits.velocity[6:], [np.radians(50), 0.8])
    np.testing.assert_allclose(cell.home, np.radians([0, -90, 90, 0, 10, 0]))
    np.testing.assert_allclose(cell.limits.upper[6:], [3.0, 4.0])
    # pose is that of the robot root; the rail at zero is 0.3 m higher
    np.testing.assert_allclose(cell.T_world_base[:3, 3], [0, 0, 0.5])
    change(folder, ("home_deg: [0, -90, 90, 0, 10, 0, 45, 1500]", "home_deg: [0, -90, 90, 0, 10, 0]"))
    np.testing.assert_allclose(load_cell(folder).external_home, 0)
    change(folder, ("[turn, rail]", "[turn]"))
    expect(refusal(folder), "external_joints", "prismatic joint 'rail'", "add it to external_joints")
    change(
        folder, ("external_joints: [turn]", "external_joints: [turn, rail]"), ("base_link: base", "base_link: floor")
    )
    expect(refusal(folder), "'rail' is between base_link 'floor' and the flange", "base_link would be 'base'")
    change(folder, ("base_link: floor", "base_link: base"), ("  link: table\n", ""))
    expect(refusal(folder), "joint 'turn' moves neither the flange nor the workpiece link")


def test_values_that_look_like_metres_or_radians_cause_a_warning(folder: Path) -> None:
    change(
        folder,
        ("xyz_mm: [10, 20, 300]", "xyz_mm: [0.01, 0.02, 0.3]"),
        ("[100, 100, 100, 200, 200, 300]", "[1.7, 1.7, 1.7, 3.5, 3.5, 5.2]"),
        ("  cutter: {diameter_mm: 10, length_mm: 40}\n", ""),
    )
    text = "\n".join(load_cell(folder).warnings)
    expect(text, "tool.tcp.xyz_mm: [0.01, 0.02, 0.3] looks like metres", "velocity_deg_s", "looks like rad/s")


def robot_cell(source: Path, tmp_path: Path) -> Cell:
    folder = tmp_path / source.name
    shutil.copytree(source, folder)
    text = CELL.replace("robot.urdf", f"{source.name}.urdf").replace("base_link: base", "base_link: base_link")
    text = text.replace("mesh: spindle.stl", "sphere_mm: 50").replace(
        "[0, -90, 90, 0, 10, 0]", "[0, -30, 40, 0, 10, 0]"
    )
    (folder / "cell.yaml").write_text(text)
    (folder / "stiffness.yaml").write_text(STIFFNESS)
    return load_cell(folder)


@pytest.mark.parametrize("name", ["kr500_r2800_2", "kr210l150", "m20ia", "rx160"])
def test_published_robot_descriptions_load(name: str, tmp_path: Path) -> None:
    cell = robot_cell(robot_folder(name, meshes=True), tmp_path)
    assert len(cell.arm_joints) == 6
    assert sum(f.suffix == ".stl" for f in cell.files) == 7  # every collision mesh, no visual mesh
    assert len(cell.packages) == 1  # found next to the URDF


@pytest.mark.parametrize("cell", sorted((ROOT / "cells").glob("*/cell.yaml")), ids=lambda p: p.parent.name)
def test_shipped_cells_load_without_a_warning(cell: Path) -> None:
    assert load_cell(cell).warnings == ()


# refused input: schema -----------------------------------------------------------------------------------------

SCHEMA = [
    ("mass_kg", "mas_kg", ["line 15: tool.mas_kg", "unknown key 'mas_kg'", "did you mean 'mass_kg'?"]),
    ("mass_kg: 45", "mass_kg: heavy", ["line 15: tool.mass_kg", "found the text 'heavy'", "expected a number"]),
    ("mass_kg: 45", "mass_kg: true", ["tool.mass_kg", "found true", "expected a number"]),
    ("mass_kg: 45", "mass_kg: -1", ["tool.mass_kg", "found -1", "greater than or equal to 0"]),
    ("mass_kg: 45", "mass_kg: .nan", ["line 15: tool.mass_kg", "found .nan", "expected a finite number"]),
    ("mass_kg: 45", "mass_kg: 1e400", ["tool.mass_kg", "expected a finite number"]),
    ("mass_kg: 45", "mass_kg: 45\n  mass_kg: 46", ["line 16: tool.mass_kg", "twice", "line 15"]),
    ("com_mm: [0, 0, 150]", "com_mm: [0, 0]", ["tool.com_mm", "found a list of 2 ([0, 0])", "expected 3 values"]),
    ("  base_link: base\n", "", ["line 3: robot.base_link", "required key is missing"]),
    ("name: test cell", "name: no\nnames: 2", ["line 3: names", "unknown key", "did you mean 'name'?"]),
    ("machopt_cell: 1", "machopt_cell: 2", ["line 1: machopt_cell", "found 2"]),
    ("tool:\n", "tool: 3\nx:\n", ["tool", "found 3", "expected a mapping with tcp"]),
    ("diameter_mm: 10", "diameter_mm: 0", ["line 18: tool.cutter.diameter_mm", "found 0", "greater than 0"]),
    ("length_mm: 40", "length_mm: -4", ["tool.cutter.length_mm", "found -4", "greater than 0"]),
    ("sphere_mm: 80", "sphere_mm: 0", ["line 24: obstacles[1]", "sphere_mm: found [0.0]", "above 0"]),
    ("[50, 1000]", "[50]", ["obstacles[0].cylinder_mm", "expected 2 values", "[radius, height along z]"]),
    ("sphere_mm: 80", "sphere_mm: 80, box_mm: [1, 2, 3]", ["obstacles[1]", "found box_mm, sphere_mm", "exactly one"]),
    (", sphere_mm: 80", "", ["obstacles[1]", "found no shape", "exactly one of box_mm"]),
    ("sphere_mm: 80", "sphere_mm: 80, scale: 2", ["obstacles[1]", "scale belongs to a mesh"]),
    ("obstacles:", "kinematics: k.yaml\nobstacles:", ["line 22: kinematics", "no such file: k.yaml"]),
    ("rotation_step_deg: 10", "rotation_step: 10", ["plan.rotation_step", "did you mean 'rotation_step_deg'?"]),
    ("rotation_step_deg: 10", "rotation_step_deg: 100", ["plan.rotation_step_deg", "found 100", "0.5 to 90"]),
    ("name: ball", "name: post", ["two bodies are named 'post'"]),
    ("machopt_cell: 1", "machopt_cell: 1: 2", ["line 1, column", "is not YAML"]),
    ("obstacles:", "ignore_pairs: [[a, b]]\nobstacles:", ["line 22: ignore_pairs", "'a' is no link and no body"]),
    ("obstacles:", "tools: {3: {tcp: {}}}\nobstacles:", ["both tool and tools; expected tool or tools"]),
    ("obstacles:", "collision: false\nobstacles:", ["collision", "belong under plan:", "--set key=value"]),
    ("obstacles:", "notes: old\nobstacles:", ["notes", "write it as a comment: #"]),
    ("obstacles:", "tcp: {}\nobstacles:", ["unknown key 'tcp'; it belongs under tool or tools; valid: "]),
    ("sphere_mm: 80", "sphere_mm: 80, link: a", ["obstacles[1].link", "link 'a' is not in robot.urdf", "world, base"]),
    (
        "sphere_mm: 80",
        "sphere_mm: 80, link: l3",
        ["obstacles[1].link", "moved by the arm's joint 'a3'", "tool.geometry"],
    ),
]


@pytest.mark.parametrize(("old", "new", "parts"), SCHEMA, ids=[p[-1][0] + f"#{n}" for n, p in enumerate(SCHEMA)])
def test_schema_errors_name_file_line_key_found_and_expected(
    folder: Path, old: str, new: str, parts: list[str]
) -> None:
    change(folder, (old, new))
    expect(refusal(folder), str(folder / "cell.yaml"), *parts)


def test_several_problems_are_listed_in_one_message(folder: Path) -> None:
    change(folder, ("mass_kg: 45", "mass_kg: x"), ("com_mm:", "con_mm:"), ("sphere_mm: 80", "sphere_mm: no"))
    message = refusal(folder)
    expect(message, "tool.con_mm", "\n  line 15: tool.mass_kg", "\n  line 24: obstacles[1].sphere_mm")


def test_missing_and_empty_and_binary_files(folder: Path, tmp_path: Path) -> None:
    expect(refusal(tmp_path), str(tmp_path), "no cell.yaml in this folder")
    expect(
        refusal(tmp_path / "nowhere.yaml"), "nowhere.yaml", "no such file; a cell folder or its cell.yaml would work"
    )
    (folder / "cell.yaml").write_text("")
    expect(refusal(folder), "is empty", "machopt_cell")
    (folder / "cell.yaml").write_bytes(b"name: \xff\xfe")
    expect(refusal(folder), "is not UTF-8")


# refused input: joints -----------------------------------------------------------------------------------------

JOINTS = [
    ("base_link: base", "base_link: bas", ["robot.base_link", "'bas' is not in robot.urdf", "did you mean 'base'?"]),
    (
        "base_link: base\n  flange_link: flange",
        "base_link: l3\n  flange_link: l1",
        ["robot.flange_link", "'l1' is not connected behind base_link 'l3'"],
    ),
    ("flange_link: flange", "flange_link: l5", ["robot.flange_link", "a5 (revolute)", "expected six revolute joints"]),
    ("  home", "  arm_joints: [a1, a2, a3, a4, a5, b6]\n  home", ["robot.arm_joints[5]", "'b6' is not in", "valid:"]),
    ("  home", "  arm_joints: [a2, a1, a3, a4, a5, a6]\n  home", ["robot.arm_joints", "in order, a1 (revolute), a2"]),
    ("  home", "  arm_joints: [a1, a1, a3, a4, a5, a6]\n  home", ["robot.arm_joints[1]", "named twice"]),
    ("  home", "  arm_joints: [a1, a2]\n  home", ["robot.arm_joints", "found a list of 2", "expected 6 values"]),
    ("  home", "  arm_joints: [f, a1, a2, a3, a4, a5]\n  home", ["robot.arm_joints[0]", "'f' is fixed"]),
    ("  home", "  external_joints: [a6]\n  home", ["a5 (revolute)", "expected six revolute joints"]),
    (
        "100, 100, 100, 200, 200, 300]",
        "100, 100]",
        ["robot.limits.velocity_deg_s", "found 2 values", "expected 6", "(a1, a2, a3, a4, a5, a6)"],
    ),
    ("600, 600, 900]", "600, 0, 900]", ["robot.limits.acceleration_deg_s2[4]", "found 0 for joint 'a5'", "above 0"]),
    ("6000, 9000]", "6000, -9]", ["robot.limits.jerk_deg_s3[5]", "found -9"]),
    ("limits:\n", "limits:\n    position_deg: [[-90, 90]]\n", ["limits.position_deg", "found 1 values", "expected 6"]),
    (
        "limits:\n",
        "limits:\n    position_deg: [[9, -9]" + ", [-90, 90]" * 5 + "]\n",
        ["robot.limits.position_deg[0]", "found [9.0, -9.0] for joint 'a1'", "lowest < highest"],
    ),
    (
        "limits:\n",
        "limits:\n    position_deg: [[-90, 180]" + ", [-90, 90]" * 5 + "]\n",
        ["robot.limits.position_deg[0]", "the URDF allows [-171.887, 171.887]"],
    ),
    ("home_deg: [0, -90,", "home_deg: [0, -190,", ["robot.home_deg[1]", "found -190 for joint 'a2'", "[-171.887, 171"]),
    ("home_deg: [0, -90,", "home_deg: [0, 0, -90,", ["robot.home_deg", "found 7 values", "expected 6"]),
    ("workpiece:\n", "workpiece:\n  link: tabel\n", ["workpiece.link", "'tabel' is not in robot.urdf", "valid: world"]),
    ("workpiece:\n", "workpiece:\n  link: l3\n", ["workpiece.link", "moved by the arm's joint 'a3'"]),
]


@pytest.mark.parametrize(("old", "new", "parts"), JOINTS, ids=[p[-1][0] + f"#{n}" for n, p in enumerate(JOINTS)])
def test_joint_refusals(folder: Path, old: str, new: str, parts: list[str]) -> None:
    change(folder, (old, new))
    expect(refusal(folder), "cell.yaml", *parts)


URDFS = [
    ("not xml at all", ["is not XML", "line 1"]),
    ("<sdf/>", ["found the root element <sdf>", "<robot>"]),
    ('<robot xmlns:xacro="http://www.ros.org/wiki/xacro"><xacro:macro name="x"/></robot>', ["xacro"]),
    ('<!DOCTYPE r [<!ENTITY a "b">]><robot/>', ["entities"]),
    (urdf().replace('lower="-3"', 'lower="3"', 1), ["joint 'a1'", "lower 3, upper 3", "lower < upper"]),
    (urdf().replace('<limit lower="-3" upper="3" velocity="9" effort="0"/>', "", 1), ["joint 'a1' has no <limit>"]),
    (urdf().replace('upper="3"', 'upper="nan"', 1), ["joint 'a1': upper is 'nan'", "finite"]),
    (urdf().replace('name="a2"', 'name="a1"'), ["joint 'a1' is given twice"]),
    (urdf().replace('name="a2" type="revolute"', 'name="a2" type="hinge"'), ["joint 'a2' has type 'hinge'", "valid"]),
    (urdf().replace('<child link="l2"/>', '<child link="lx"/>'), ["joint 'a2' names the link 'lx'"]),
    (urdf().replace('<child link="l2"/>', '<child link="l1"/>'), ["'l1' hangs on two joints, 'a1' and 'a2'"]),
    (urdf().replace('<child link="l2"/>', ""), ["joint 'a2' has no <child>"]),
    (urdf('<link name="lonely"/>'), ["2 root links", "lonely"]),
    (urdf().replace('<robot name="r">', "<robot>"), ["<robot> has no name"]),
    (urdf(joint("loop", "l6", "base")), ["closed loop"]),
    (urdf(mesh="nowhere.stl"), ["link 'l6'", "no such file: nowhere.stl"]),
    (urdf(mesh="package://some_pkg/a.stl"), ["link 'l6'", "package 'some_pkg'", "packages: {some_pkg:"]),
    (urdf(mesh="../outside.stl"), ["outside the cell folder", "--allow-external"]),
    (urdf(mesh='link.stl" scale="0 1 1'), ["scale '0 1 1'", "three positive numbers"]),
    (urdf(mesh='link.stl" scale="1000 1000 1000'), ["link.stl is 200 m wide", 'scale="1 1 1"']),
]


@pytest.mark.parametrize(("text", "parts"), URDFS, ids=[p[-1][0] + f"#{n}" for n, p in enumerate(URDFS)])
def test_urdf_refusals(folder: Path, text: str, parts: list[str]) -> None:
    (folder / "robot.urdf").write_text(text)
    expect(refusal(folder), "robot.urdf", *parts)


def build_mimic_arm(*more: str, mimic: str = '<mimic joint="a2" multiplier="-1" offset="0.1"/>', body: str = "") -> str:
    """Return the arm with an additional mimic joint on axis 3 that follows axis 2."""
    knee = joint("m3", "l2", "knee", limit='<limit lower="-2" upper="3.2" velocity="0" effort="0"/>' + mimic)
    text = urdf(f'<link name="knee">{body}</link>', knee, *more)
    return text.replace(
        '<parent link="l2"/><child link="l3"/><origin xyz="0 0 0.3"/>', '<parent link="knee"/><child link="l3"/>'
    )


def test_mimic_joint_is_read_and_narrows_the_range_of_its_source(folder: Path) -> None:
    (folder / "robot.urdf").write_text(build_mimic_arm())
    cell = load_cell(folder)
    assert [(m.joint, m.source, m.multiplier, m.offset) for m in cell.mimics] == [("m3", "a2", -1.0, 0.1)]
    assert cell.arm_joints == ("a1", "a2", "a3", "a4", "a5", "a6")
    np.testing.assert_allclose(cell.limits.lower[:3], [-3, -3, -3])  # −q + 0.1 ≤ 3.2 holds for q ≥ −3.1
    np.testing.assert_allclose(cell.limits.upper[:3], [3, 2.1, 3])
    expect(" ".join(cell.notes), "'m3', which follows 'a2', narrows that one to -171.9 to 120.3 deg")


def test_mimic_joint_limits_the_speed_of_its_source(folder: Path) -> None:
    """The mimic joint turns with the multiplier times the source velocity, so its velocity limit also limits the
    source joint."""
    free = load_cell(folder).limits.velocity[1]
    text = build_mimic_arm(mimic='<mimic joint="a2" multiplier="-2"/>')
    slow = text.replace('upper="3.2" velocity="0"', 'upper="3.2" velocity="0.5"')
    assert slow != text
    (folder / "robot.urdf").write_text(slow)
    cell = load_cell(folder)
    assert cell.limits.velocity[1] == pytest.approx(0.25)
    assert free > 0.25
    expect(" ".join(cell.notes), "velocity limit of 'm3', which follows 'a2', lowers that one's to 14.32 deg/s")


BODY = "<collision><geometry><sphere radius='0.1'/></geometry></collision>"
LINKAGES = [
    (
        urdf().replace('velocity="9" effort="0"/>', 'velocity="9" effort="0"/><mimic joint="a2"/>', 1),
        ["a1 (mimics 'a2')", "expected six"],
    ),
    (build_mimic_arm(mimic='<mimic joint="ax"/>'), ["'m3' mimics 'ax', which is no joint of the arm; it has a1"]),
    (
        build_mimic_arm(mimic='<mimic joint="a2" multiplier="0.5"/>'),
        ["multiplier 0.5", "a whole number other than 0 would work"],
    ),
    (
        build_mimic_arm(body=BODY),
        ["link 'knee' has a collision body on joint 'm3', which mimics 'a2'"],
    ),
    (
        build_mimic_arm().replace('lower="-2" upper="3.2"', 'lower="5" upper="6"'),
        ["'m3' mimics 'a2' and would leave its own range [5, 6]"],
    ),
]


@pytest.mark.parametrize(("text", "parts"), LINKAGES, ids=[p[0] for _, p in LINKAGES])
def test_unsupported_mimic_joints_are_refused_by_name(folder: Path, text: str, parts: list[str]) -> None:
    (folder / "robot.urdf").write_text(text)
    expect(refusal(folder), *parts)


def test_mimic_joints_outside_the_chain_narrow_their_source_and_are_left_out(folder: Path) -> None:
    """Mimic joints outside the chain, revolute or prismatic, narrow the range of their source; before, they were
    refused."""
    for kind in ("revolute", "prismatic"):
        limit = '<limit lower="0" upper="2" velocity="9" effort="0"/><mimic joint="a3"/>'
        text = urdf(f'<link name="rod">{BODY}</link>', joint("r", "l1", "rod", kind, limit))
        (folder / "robot.urdf").write_text(text)
        cell = load_cell(folder)
        assert (cell.limits.lower[2], cell.limits.upper[2]) == pytest.approx((0.0, 2.0))
        assert sum("bodies of rod are left out" in w for w in cell.warnings) == 1


# refused input: files ------------------------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("file", "key"),
    [("robot.urdf", "robot.urdf"), ("stiffness.yaml", "stiffness"), ("spindle.stl", "geometry[0].mesh")],
)
def test_missing_files_are_reported_with_their_key(folder: Path, file: str, key: str) -> None:
    (folder / file).unlink()
    expect(refusal(folder), "cell.yaml: line", key, f"no such file: {file}")


def test_files_outside_the_folder_require_permission(folder: Path) -> None:
    (folder / "spindle.stl").rename(folder.parent / "spindle.stl")
    change(folder, ("mesh: spindle.stl", "mesh: ../spindle.stl"))
    expect(refusal(folder), "tool.geometry[0].mesh", "../spindle.stl lies outside", "--allow-external")
    assert load_cell(folder, allow_external=True).tool.geometry[0].mesh == folder.parent / "spindle.stl"


def test_links_out_of_the_folder_count_as_outside(folder: Path) -> None:
    (folder / "robot.urdf").rename(folder.parent / "robot.urdf")
    try:
        os.symlink(folder.parent / "robot.urdf", folder / "robot.urdf")
    except OSError:
        pytest.skip("this file system has no symbolic links")
    expect(refusal(folder), "robot.urdf", "outside the cell folder")


def test_packages_map_is_used_and_checked(folder: Path) -> None:
    (folder / "robot.urdf").write_text(urdf(mesh="package://some_pkg/link.stl"))
    (folder / "parts").mkdir()
    shutil.move(folder / "link.stl", folder / "parts" / "link.stl")
    change(folder, ("  home_deg", "  packages: {some_pkg: parts}\n  home_deg"))
    cell = load_cell(folder)
    assert cell.packages == {"some_pkg": folder / "parts"}
    assert folder / "parts" / "link.stl" in cell.files
    change(folder, ("some_pkg: parts", "some_pkg: part"))
    expect(refusal(folder), "robot.packages.some_pkg", "no such folder: part")


@pytest.mark.parametrize(
    ("content", "parts"),
    [
        (b"solid nothing\nendsolid nothing\n", ["holds no triangles"]),
        (b"", ["spindle.stl"]),
        (b"\x00\x01garbage that is no mesh", ["spindle.stl"]),
        (
            b"solid x\nfacet normal 0 0 1\nouter loop\nvertex 1 2 nan\nvertex 0 0 1\nvertex 1 0 0\nendloop\nendfacet\n"
            b"endsolid x\n",
            ["spindle.stl"],
        ),
    ],
    ids=["empty solid", "no bytes", "garbage", "nan"],
)
def test_broken_meshes(folder: Path, content: bytes, parts: list[str]) -> None:
    (folder / "spindle.stl").write_bytes(content)
    expect(refusal(folder), "cell.yaml: line 17: tool.geometry[0].mesh", *parts)


def test_mesh_in_mm_is_answered_with_the_scale(folder: Path) -> None:
    trimesh.creation.box((100.0, 100.0, 200.0)).export(folder / "spindle.stl")
    expect(refusal(folder), "tool.geometry[0].mesh", "200 m wide", "scale: 0.001")
    change(folder, ("mesh: spindle.stl", "mesh: spindle.stl, scale: 1e-3"))
    assert load_cell(folder).tool.geometry[0].size == (1e-3,)
    change(folder, ("scale: 1e-3", "scale: 1e-9"))
    output = refusal(folder)
    expect(output, "spindle.stl is only 0.0002 mm wide")
    assert "would work" not in output  # 0.2 mm would be refused next, so no value is suggested


def test_mesh_of_an_unsupported_type_is_refused(folder: Path) -> None:
    (folder / "spindle.step").write_text("x")
    change(folder, ("spindle.stl", "spindle.step"))
    expect(refusal(folder), "spindle.step is of type '.step'", ".stl, .obj")


# stiffness.yaml -----------------------------------------------------------------------------------------------

GRID = "grid: {origin_mm: [0, 0, 0], cell_mm: 300, shape: [2, 1, 1], joints_Nm_per_rad: [[1e6,1e6,1e6,1e6,1e6,1e6]]}\n"
ROW = "[1e-12,0,0,0,0,0]"
STIFF = [
    ("machopt_stiffness: 1\n", ["joints_Nm_per_rad", "required key is missing", "one stiffness per joint of the arm"]),
    (STIFFNESS.replace("380e3", "0"), ["line 2: joints_Nm_per_rad[5]", "found 0", "between 100 and 1e+10"]),
    (STIFFNESS.replace(", 380e3", ""), ["joints_Nm_per_rad", "a list of 5", "expected 6 values"]),
    (STIFFNESS + "grd: 1\n", ["line 3: grd", "did you mean 'grid'?"]),
    (STIFFNESS + GRID, ["grid.joints_Nm_per_rad", "found 1 rows", "needs 2"]),
    (STIFFNESS + GRID.replace("[2, 1, 1]", "[0, 1, 1]"), ["grid.shape[0]", "found 0", "at least 1"]),
    (STIFFNESS + GRID.replace("[2, 1, 1]", "[1, 1, 1]").replace("1e6,1e6]", "1e6]"), ["[0]", "found 5 values"]),
    (STIFFNESS + f"covariance: [{ROW}]\n", ["covariance", "a list of 1", "expected 6 values"]),
    (STIFFNESS + "covariance: [[1,1,0,0,0,0]" + ",[0,0,0,0,0,0]" * 5 + "]\n", ["not symmetric", "row 1 column 2"]),
    (STIFFNESS + "covariance: [[-1,0,0,0,0,0]" + ",[0,0,0,0,0,0]" * 5 + "]\n", ["negative eigenvalue -1"]),
    (STIFFNESS + "terms: [{effect: x}]\n", ["terms[0].location", "required key is missing"]),
]


@pytest.mark.parametrize(("text", "parts"), STIFF, ids=[p[-1][0] + f"#{n}" for n, p in enumerate(STIFF)])
def test_stiffness_refusals(tmp_path: Path, text: str, parts: list[str]) -> None:
    file = tmp_path / "stiffness.yaml"
    file.write_text(text)
    with pytest.raises(InputError) as caught:
        load_stiffness(file)
    expect(str(caught.value), str(file), *parts)


@settings(max_examples=scale_example_count(25), deadline=None)
@given(seed=st.integers(0, 2**32 - 1))
def test_stiffness_round_trip(seed: int, tmp_path_factory: pytest.TempPathFactory) -> None:
    rng = np.random.default_rng(seed)
    root = rng.normal(size=(6, 4)) * 1e-8  # rank 4: rounding makes eigenvalues slightly negative
    grid = StiffnessGrid(rng.normal(size=3), 0.3, (2, 1, 2), rng.uniform(1e5, 1e7, (4, 6)), rng.uniform(0, 1e5, (4, 6)))
    term = StiffnessTerm("link_compliance", "link:4", {"c": np.float64(1e-7), "n": [1, 2]})
    before = ArmStiffness(joints=rng.uniform(1e5, 1e7, 6), covariance=root @ root.T, grid=grid, terms=(term,))
    file = tmp_path_factory.mktemp("stiffness") / "stiffness.yaml"
    write_stiffness(file, before)
    after = load_stiffness(file)
    np.testing.assert_array_equal(after.joints, before.joints)
    np.testing.assert_array_equal(after.covariance, before.covariance)
    assert after.grid is not None
    np.testing.assert_array_equal(after.grid.joints, grid.joints)
    assert grid.std is not None
    assert after.grid.std is not None
    np.testing.assert_array_equal(after.grid.std, grid.std)
    # the mm ↔ m conversion rounds once in each direction
    np.testing.assert_allclose(after.grid.origin, grid.origin, rtol=1e-15)
    assert after.grid.shape == grid.shape
    assert after.terms[0].parameters == {"c": 1e-7, "n": [1, 2]}
    # a YAML 1.1 reader also reads every number as a number
    assert other_yaml.safe_load(file.read_text())["terms"][0]["parameters"]["c"] == 1e-7


def test_stiffness_written_by_diagnose_is_read_back(tmp_path: Path) -> None:
    joints = np.radians([[-120.0, 90.5], *[[-10.0, 10.0]] * 5])
    before = ArmStiffness(joints=np.full(6, 1e6), position=PositionError(5.2e-5, 3.11e-4, 2e-5, 632, joints))
    file = tmp_path / "stiffness.yaml"
    write_stiffness(file, before)
    after = load_stiffness(file).position
    assert after is not None
    assert before.position is not None
    np.testing.assert_allclose([after.std, after.plain, after.noise], [5.2e-5, 3.11e-4, 2e-5], rtol=1e-12)
    np.testing.assert_allclose(after.joints, joints, rtol=1e-12)
    assert after.poses == 632
    q = np.radians([[0.0, 0, 0, 0, 0, 0], [95.0, 0, 0, 0, 0, 10.9], [0.0, 0, 0, 0, 0, -12]])
    np.testing.assert_array_equal(after.is_in_covered_range(q).all(axis=1), [True, False, False])
    assert after.beyond(q[:1]) == ()
    (output,) = after.beyond(q)
    assert output.startswith("67 % of these poses lie outside the joint angles (joint 1, 6)")
    file.write_text(file.read_text().replace("[-120.0, 90.5]", "[90.5, -120.0]"))
    with pytest.raises(InputError, match="the lower first"):
        load_stiffness(file)


# YAML 1.2 -----------------------------------------------------------------------------------------------------


def test_scalars_follow_the_core_schema_of_yaml_1_2() -> None:
    text = "[1e-3, no, on, 010, 0o10, 0x1F, '3', 1_000, 12:30, ~, true, .5, -2., +3, 2024-01-01]"
    assert parse_yaml(text, "t").value == [
        1e-3,
        "no",
        "on",
        10,
        8,
        31,
        "3",
        "1_000",
        "12:30",
        None,
        True,
        0.5,
        -2.0,
        3,
        "2024-01-01",
    ]


@pytest.mark.parametrize(
    ("text", "part"),
    [
        ("a: &x [*x]", "an alias that contains itself"),
        ("a: !thing 3", "tag !thing is not accepted"),
        ("[a]: 3", "a key must be a word"),
        ("a: 1\n---\nb: 2", "another document"),
        ("a: 99999999999999999999", "below 2^63"),
        ("a: -.inf", "expected a finite number"),
    ],
)
def test_yaml_refusals(text: str, part: str) -> None:
    with pytest.raises(InputError) as caught:
        parse_yaml(text, "file.yaml")
    expect(str(caught.value), "file.yaml", "line", part)


def test_alias_bomb_is_stopped() -> None:
    levels = "".join(f"a{n}: &a{n} [{', '.join([f'*a{n - 1}'] * 10)}]\n" for n in range(1, 9))
    with pytest.raises(InputError, match="too many values"):
        parse_yaml("a0: &a0 [1, 2]\n" + levels, "bomb.yaml")


@pytest.mark.parametrize("text", ["[" * 5000, "{a: " * 200 + "1" + "}" * 200, "- " * 300 + "1"])
def test_deep_nesting_is_stopped(text: str) -> None:
    with pytest.raises(InputError, match=r"deep\.yaml: is nested too deeply"):
        parse_yaml(text, "deep.yaml")
    assert parse_yaml("[" * 50 + "1" + "]" * 50, "deep.yaml").value is not None
