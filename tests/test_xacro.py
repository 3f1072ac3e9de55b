"""Robots as xacro: expanded with packages and arguments of the cell, or refused with a remedy."""

from __future__ import annotations

import sys
from pathlib import Path

import numpy as np
import pytest
import trimesh
from small_cell import urdf_text

from machopt.cell.cell_reader import load_cell
from machopt.cell.urdf.xacro_expansion import is_xacro
from machopt.data_types.cell import Cell
from machopt.errors import InputError
from machopt.kinematics.urdf_loading import load_chain
from machopt.verification.motion.kinematics.urdf_kinematics import UrdfKinematics

CELL = """\
machopt_cell: 1
name: expanded
robot:
  urdf: my_robot/urdf/robot.urdf.xacro
  xacro_args: {reach: 1.15, prefix: left_}
  base_link: base_link
  flange_link: flange
  arm_joints: [left_a1, a2, a3, a4, a5, a6]
  home_deg: [0, -90, 90, 0, 45, 0]
  limits:
    acceleration_deg_s2: [300, 300, 300, 500, 500, 800]
    jerk_deg_s3: [2000, 2000, 2000, 4000, 4000, 6000]
tool: {tcp: {xyz_mm: [0, 0, 350]}}
workpiece: {pose: {xyz_mm: [1500, 0, 600]}}
"""
PARTS = """<?xml version="1.0"?>
<robot xmlns:xacro="http://www.ros.org/wiki/xacro">
  <xacro:property name="raised" value="${0.4 + 0.275}"/>
  <xacro:macro name="arm" params="prefix reach">BODY</xacro:macro>
</robot>
"""
ROBOT = """<?xml version="1.0"?>
<robot name="made" xmlns:xacro="http://www.ros.org/wiki/xacro">
  <xacro:arg name="prefix" default=""/>
  <xacro:arg name="reach" default="2"/>
  <xacro:include filename="$(find my_robot)/parts/arm.xacro"/>
  <xacro:arm prefix="$(arg prefix)" reach="$(arg reach)"/>
</robot>
"""


def parts() -> str:
    body = urdf_text().removeprefix('<robot name="small">').removesuffix("</robot>")
    body = body.replace('name="a1"', 'name="${prefix}a1"').replace('xyz="1.15 0.0 0.0"', 'xyz="${reach} 0.0 0.0"')
    body = body.replace('xyz="0.0 0.0 0.675"', 'xyz="0.0 0.0 ${raised}"')
    mesh = '<collision><geometry><mesh filename="package://my_robot/meshes/a.stl"/></geometry></collision>'
    found = '<collision><geometry><mesh filename="file://$(find my_robot)/meshes/a.stl"/></geometry></collision>'
    return PARTS.replace("BODY", body.replace('<link name="link_1">', f'<link name="link_1">{mesh}{found}'))


@pytest.fixture
def folder(tmp_path: Path) -> Path:
    root = tmp_path / "cell"
    for name in ("urdf", "parts", "meshes"):
        (root / "my_robot" / name).mkdir(parents=True)
    (root / "cell.yaml").write_text(CELL)
    (root / "my_robot/urdf/robot.urdf.xacro").write_text(ROBOT)
    (root / "my_robot/parts/arm.xacro").write_text(parts())
    trimesh.creation.box((0.1, 0.1, 0.2)).export(root / "my_robot/meshes/a.stl")
    return root


def test_macros_arguments_and_packages_make_the_same_robot(folder: Path, tmp_path: Path) -> None:
    cell = load_cell(folder)
    assert cell.arm_joints[0] == "left_a1"
    robot, shapes = load_chain(cell)
    plain = tmp_path / "plain.urdf"
    plain.write_text(urdf_text())
    other = Cell(**{**cell.__dict__, "urdf": plain, "expanded": None, "arm_joints": ("a1", *cell.arm_joints[1:])})
    q = np.linspace(-1, 1, 6)
    np.testing.assert_allclose(robot.compute_fk(q), load_chain(other)[0].compute_fk(q), atol=1e-12)
    np.testing.assert_allclose(
        UrdfKinematics(cell).compute_configuration(q[None]).flange[0], robot.compute_fk(q), atol=1e-12
    )
    assert len(shapes) == 9
    names = {f.relative_to(folder).as_posix() for f in cell.files}
    assert {"my_robot/urdf/robot.urdf.xacro", "my_robot/parts/arm.xacro", "my_robot/meshes/a.stl"} < names
    np.testing.assert_allclose(cell.limits.velocity, 2.0)
    assert "ament_index_python" not in sys.modules


@pytest.mark.parametrize(
    ("file", "old", "new", "words"),
    [
        ("cell.yaml", "reach: 1.15", "raech: 1.15", ["has no <xacro:arg name='raech'>", "valid: prefix, reach"]),
        (
            "my_robot/urdf/robot.urdf.xacro",
            '<xacro:arg name="prefix" default=""/>',
            "",
            ["needs the argument prefix", "xacro_args: {prefix:"],
        ),
        ("my_robot/urdf/robot.urdf.xacro", "(find my_robot)", "(find other)", ["$(find other)", "packages: {other:"]),
        ("my_robot/urdf/robot.urdf.xacro", "$(arg reach)", "$(optenv REACH 1)", ["environment variable", "xacro_args"]),
        ("my_robot/parts/arm.xacro", "0.4 + 0.275", "0.4 + nothing", ["cannot be expanded", "nothing"]),
        ("my_robot/parts/arm.xacro", "</xacro:macro>", "", ["is not XML", "arm.xacro"]),
        (
            "my_robot/parts/arm.xacro",
            'velocity="2"',
            'velocity="2,0"',
            ["of the URDF it expands to", "velocity is '2,0'"],
        ),
    ],
)
def test_failed_expansion_is_reported(folder: Path, file: str, old: str, new: str, words: list[str]) -> None:
    text = (folder / file).read_text()
    assert old in text
    change = text.replace(old, new)
    if file == "my_robot/urdf/robot.urdf.xacro" and new == "":
        cell = (folder / "cell.yaml").read_text()
        (folder / "cell.yaml").write_text(cell.replace(", prefix: left_", ""))
    (folder / file).write_text(change)
    with pytest.raises(InputError) as caught:
        load_cell(folder)
    for word in words:
        assert word in str(caught.value)


def test_missing_package_names_what_to_install(folder: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setitem(sys.modules, "xacro", None)
    with pytest.raises(InputError, match=r"pip install xacro`, or the URDF it expands to"):
        load_cell(folder)


def test_included_files_outside_need_permission(folder: Path) -> None:
    outside = folder.parent / "arm.xacro"
    outside.write_text(parts())
    main = folder / "my_robot/urdf/robot.urdf.xacro"
    main.write_text(ROBOT.replace("$(find my_robot)/parts/arm.xacro", str(outside)))
    with pytest.raises(InputError, match="outside the cell folder"):
        load_cell(folder)


def test_comments_are_not_executed(folder: Path) -> None:
    """Robots of ROS-Industrial often contain their former macro as a comment."""
    plain = folder / "plain.urdf"
    plain.write_text("<robot name='r'>\n<!-- was <xacro:arm_macro a='$(env HOME)'/>\n -->\n<link name='l'/></robot>")
    assert not is_xacro(plain)
    plain.write_text("<robot name='r'><!-- one --><xacro:arm/><!-- two --></robot>")
    assert is_xacro(plain)
