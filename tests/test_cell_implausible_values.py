"""Implausible values of a cell, and values in wrong units."""

from __future__ import annotations

import re
from pathlib import Path

import pytest
from minimal_cell_files import read_refusal_message, replace_in_file, write_minimal_cell

from machopt.cell.cell_reader import load_cell


@pytest.fixture
def folder(tmp_path: Path) -> Path:
    return write_minimal_cell(tmp_path / "cell")


TCP, LIMITS = "xyz_mm: [0, 0, 300], rpy_deg: [0, 90, 0]", "home_deg: [0, -90, 90, 0, 10, 0]"
SPEED, ACC, JERK = (
    "[100, 100, 100, 200, 200, 300]",
    "[300, 300, 300, 600, 600, 900]",
    "[3000, 3000, 3000, 6000, 6000, 9000]",
)
REFUSED = [
    (TCP, "xyz_mm: [0, 0, 300000]", ["tool.tcp.xyz_mm", "300 m from the flange", "[0.0, 0.0, 300.0]"]),
    (TCP, "xyz_mm: [0, 0, 0.3]", ["tool.tcp.xyz_mm", "40 mm long", "if that is m, [0.0, 0.0, 300.0] would work"]),
    (TCP, "xyz_mm: [0, 0, 300], rpy_deg: [0, 1e9, 0]", ["tool.tcp.rpy_deg", "degrees"]),
    ("mass_kg: 45", "mass_kg: 1e30", ["tool.mass_kg", "found 1e+30", "at most 10000"]),
    ("com_mm: [0, 0, 150]", "com_mm: [0, 0, 150000]", ["tool.com_mm", "expected mm"]),
    ("diameter_mm: 10, length_mm: 40", "diameter_mm: 0.01, length_mm: 0.04", ["cutter.diameter_mm", "10 would work"]),
    ("length_mm: 40", "length_mm: 0.04", ["tool.cutter.length_mm", "if it is in m, 40 would work"]),
    ("length_mm: 40", "length_mm: 40000", ["tool.cutter.length_mm", "if it is in µm, 40 would work"]),
    ("xyz_mm: [1500, 0, 800]", "xyz_mm: [1500e6, 0, 800]", ["workpiece.pose.xyz_mm", "1.5e+06 m away"]),
    ("box_mm: [400, 300, 50]", "box_mm: [0.4, 0.3, 0.05]", ["geometry[0].box_mm", "[400.0, 300.0, 50.0] would work"]),
    ("box_mm: [400, 300, 50]", "box_mm: [400e3, 3e5, 50]", ["geometry[0].box_mm", "400 m wide", "[400.0, 300.0"]),
    ("cylinder_mm: [50, 1000]", "cylinder_mm: [50e3, 1e6]", ["obstacles[0].cylinder_mm", "1000 m wide"]),
    (SPEED, "[100, 100, 100, 200, 200, 1e9]", ["velocity_deg_s[5]", "1e+09 for joint 'a6'", "at most 10000"]),
    (SPEED, "[100, 100, 100, 200, 200, 1e-9]", ["velocity_deg_s[5]", "at least 0.01"]),
    (SPEED, "[100, 100, 100, 200, 200, 0]", ["velocity_deg_s[5]", "found 0", "above 0"]),
    (ACC, "[1e9, 300, 300, 600, 600, 900]", ["acceleration_deg_s2[0]", "at most 1e+06"]),
    (JERK, "[1e9, 300, 300, 600, 600, 900]", ["jerk_deg_s3[0]", "at most 1e+08"]),
]


@pytest.mark.parametrize(("old", "new", "parts"), REFUSED, ids=[f"{n} {r[1][:20]}" for n, r in enumerate(REFUSED)])
def test_values_that_make_a_plan_meaningless_are_refused(folder: Path, old: str, new: str, parts: list[str]) -> None:
    line = replace_in_file(folder, old, new)
    read_refusal_message(folder, f"cell.yaml: line {line}", *parts)


ROBOT = [
    ('lower="-3" upper="3"', 'lower="-185" upper="185"', ["joint 'a1' turns from -185 to 185", "-3.2289 to 3.2289"]),
    ('xyz="0 0 0.3"', 'xyz="0 0 300"', ["an arm of 1800 m", "in mm: 1.8 m"]),
    ('xyz="0 0 0.3"', 'xyz="0 0 0.0003"', ["an arm of 0.0018 m", "in km: 1.8 m"]),
]


@pytest.mark.parametrize(("old", "new", "parts"), ROBOT, ids=[r[2][0] for r in ROBOT])
def test_robot_in_other_units_is_refused(folder: Path, old: str, new: str, parts: list[str]) -> None:
    replace_in_file(folder, old, new, "robot.urdf")
    read_refusal_message(folder, "robot.urdf", *parts)


ODD = [
    ("mass_kg: 45", "mass_kg: 3000", "3000 kg is more than the strongest robots carry"),
    ("com_mm: [0, 0, 150]", "com_mm: [0, 0, 0.15]", "tool.com_mm: [0.0, 0.0, 0.15] looks like metres"),
    ("rpy_deg: [0, 0, 90]", "rpy_deg: [0, 0, 1.5708]", "workpiece.pose.rpy_deg: [0.0, 0.0, 1.5708] looks like radians"),
    ("xyz_mm: [1500, 0, 800]", "xyz_mm: [1.5, 0, 0.8]", "workpiece.pose.xyz_mm: [1.5, 0.0, 0.8] looks like metres"),
    ("[0, -90, 90, 0, 10, 0]", "[0, -1.5708, 1.5708, 0, 0.17, 0]", "robot.home_deg: [0.0, -1.5708"),
    ("[0, -90, 90, 0, 10, 0]", "[0.131, -0.412, 2.254, 0, 0.17, 0]", "looks like radians"),
    (SPEED, "[1.7, 1.7, 1.7, 3.5, 3.5, 5.2]", "looks like rad/s"),
    (ACC, "[5, 5, 5, 10, 10, 15]", "full speed takes 20 s"),
    (JERK, "[50, 50, 50, 100, 100, 150]", "full acceleration takes 6 s"),
    ("box_mm: [400, 300, 50]", "box_mm: [4, 3, 0.5]", "only 4 mm wide"),
]


@pytest.mark.parametrize(("old", "new", "part"), ODD, ids=[o[1][:24] for o in ODD])
def test_unusual_values_cause_a_warning(folder: Path, old: str, new: str, part: str) -> None:
    replace_in_file(folder, old, new)
    if "3000 kg" in part:
        # that mass would be refused for the deflection of these springs
        replace_in_file(folder, "stiffness: stiffness.yaml\n", "")
    if "6 s" in part:
        replace_in_file(folder, SPEED, "[50, 50, 50, 100, 100, 150]")
    assert any(part in w for w in load_cell(folder).warnings), load_cell(folder).warnings


def test_speeds_equal_to_the_urdf_numbers_cause_a_warning(folder: Path) -> None:
    """A small arm's wrist can exceed 7 rad/s: values equal to those of the URDF show that the unit is rad/s."""
    robot = folder / "robot.urdf"
    robot.write_text(re.sub(r'velocity="[^"]*"', 'velocity="8.5"', robot.read_text()))
    replace_in_file(folder, SPEED, "[7.2, 7.2, 7.2, 8.5, 8.5, 8.5]")
    assert any("looks like rad/s" in w for w in load_cell(folder).warnings)


STIFFNESS = "[1.41e6, 4.01e5, 9.35e5, 3.60e5, 3.70e5, 380e3]"
KNM, NM_DEG = "[1410, 401, 935, 360, 370, 380]", "[24609, 6999, 16319, 6283, 6458, 6632]"


def test_stiffness_in_other_units_is_refused_by_the_tool_weight(folder: Path) -> None:
    replace_in_file(folder, STIFFNESS, KNM, "stiffness.yaml")
    read_refusal_message(folder, "cell.yaml: line 23: stiffness", "under the tool's 45 kg at 1.8 m", "kN·m/rad")
    replace_in_file(folder, KNM, NM_DEG, "stiffness.yaml")
    replace_in_file(folder, "mass_kg: 45", "mass_kg: 100")
    read_refusal_message(folder, "stiffness", "N·m/deg")
    replace_in_file(folder, "mass_kg: 100", "mass_kg: 10")
    assert any("N·m/deg? N·m/rad is expected" in w for w in load_cell(folder).warnings)
    replace_in_file(folder, "mass_kg: 10", "mass_kg: 0")
    replace_in_file(folder, NM_DEG, KNM, "stiffness.yaml")
    assert any("softer than any arm of this size" in w for w in load_cell(folder).warnings)


@pytest.mark.parametrize("value", ["0", "-1e5", "1e-30", "1e30", ".nan", ".inf", "soft"])
def test_implausible_stiffness_is_refused_at_its_line(folder: Path, value: str) -> None:
    replace_in_file(folder, "380e3", value, "stiffness.yaml")
    read_refusal_message(folder, "stiffness.yaml: line 2: joints_Nm_per_rad[5]")


def test_high_stiffness_and_grids_in_metres_cause_a_warning(folder: Path) -> None:
    replace_in_file(folder, STIFFNESS, "[1e9, 1e9, 1e9, 1e9, 1e9, 1e9]", "stiffness.yaml")
    assert any("N·mm/rad" in w for w in load_cell(folder).warnings)
    row = "[1e6, 1e6, 1e6, 1e6, 1e6, 1e6]"
    grid = f"grid: {{origin_mm: [0, 0, 0], cell_mm: 0.3, shape: [2, 1, 1], joints_Nm_per_rad: [{row}, {row}]}}\n"
    (folder / "stiffness.yaml").write_text(f"machopt_stiffness: 1\njoints_Nm_per_rad: {row}\n{grid}")
    assert any("grid spans 0.6 mm" in w for w in load_cell(folder).warnings)


def test_covariance_of_stiffness_instead_of_compliance_causes_a_warning(folder: Path) -> None:
    rows = [[1e10 * (r == c) for c in range(6)] for r in range(6)]
    with (folder / "stiffness.yaml").open("a") as file:
        file.write(f"covariance: {rows}\n")
    assert any("covariance makes a joint's compliance uncertain" in w for w in load_cell(folder).warnings)
