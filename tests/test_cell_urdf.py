"""Damaged URDF files: no part of a robot is silently lost."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from minimal_cell_files import read_refusal_message, replace_in_file, urdf, write_minimal_cell

from machopt.cell.cell_reader import load_cell
from machopt.cell.urdf import read_urdf
from machopt.errors import InputError
from machopt.kinematics.urdf_loading import load_chain, load_masses


@pytest.fixture
def folder(tmp_path: Path) -> Path:
    return write_minimal_cell(tmp_path / "cell")


def test_intact_cell_has_every_body_and_mass(folder: Path) -> None:
    cell = load_cell(folder)
    assert cell.warnings == ()
    assert len(load_chain(cell)[1]) == 6
    np.testing.assert_allclose(load_masses(cell).mass, [190.0] * 6 + [45.0])


BOX, MESH = '<box size="0.2 0.2 0.3"/>', '<mesh filename="link.stl"/>'
DAMAGES = [  # text in the file, its replacement (once), words of the refusal in addition to file and line
    ('value="190"', 'value="190,0"', ["mass of link 'l1'", "'190,0'", "decimal points"]),
    ('value="190"', 'value="nan"', ["mass of link 'l1'", "'nan'", "finite"]),
    ('value="190"', 'value="1e400"', ["'1e400'", "finite"]),
    ('value="190"', 'value="1_90"', ["'1_90'"]),
    ('value="190"', 'value="0x10"', ["'0x10'"]),
    ('value="190"', 'value=""', ["mass of link 'l1'", "''"]),
    ('value="190"', 'value="-190"', ["-190 kg", "expected 0 to"]),
    ('value="190"', 'value="1e30"', ["1e+30 kg", "expected 0 to"]),
    ('value="190"', 'valeu="190"', ["unknown attribute 'valeu'", "did you mean 'value'?"]),
    ('<mass value="190"/>', "<mass>190</mass>", ["the text '190'"]),
    ('<mass value="190"/>', '<mass value="190"/><mass value="1"/>', ["mass is given twice"]),
    ("<inertial>", "<inertail>", ["<inertail>", "did you mean 'inertial'?"]),
    ('ixx="2" ', "", ["inertia of link 'l1' has no 'ixx'"]),
    ('izz="1"', 'izz="1,5"', ["izz is '1,5'"]),
    ("<collision>", "<colision>", ["<colision> inside link", "did you mean 'collision'?"]),
    ("<collision>", "<Collision>", ["<Collision> inside link", "did you mean 'collision'?"]),
    ("<collision>", "<x:collision>", ["<x:collision>", "did you mean 'collision'?"]),
    ("<visual>", "<visaul>", ["<visaul>", "did you mean 'visual'?"]),
    (BOX, '<capsule radius="0.1" length="0.3"/>', ["<capsule>", "a cylinder and two spheres"]),
    (BOX, '<cone radius="0.1" length="0.3"/>', ["<cone> inside link > collision > geometry", "valid: mesh, box"]),
    (BOX, '<box size="0.2 0.3"/>', ["box of collision of link 'l1'", "'0.2 0.3'", "three finite numbers"]),
    (BOX, '<box size="0.2 0.2 0.3 0.4"/>', ["three finite numbers"]),
    (BOX, '<box size="0,2 0,2 0,3"/>', ["three finite numbers", "decimal points"]),
    (BOX, '<box size="0.2 0 0.3"/>', ["sizes above 0"]),
    (BOX, '<box size="0.2 -1 0.3"/>', ["sizes above 0"]),
    (BOX, '<box dimension="0.2 0.2 0.3"/>', ["unknown attribute 'dimension'"]),
    (BOX, '<sphere radius="0"/>', ["sizes above 0"]),
    (BOX, "<sphere/>", ["sphere of collision of link 'l1' has no 'radius'"]),
    (BOX, '<cylinder radius="0.1"/>', ["has no 'length'"]),
    (BOX, '<cylinder radius="0.1" length="inf"/>', ["'inf'", "finite"]),
    (BOX, BOX + BOX, ["box is given twice"]),
    (BOX, BOX + '<sphere radius="1"/>', ["holds box, sphere", "expected one"]),
    (BOX, "", ["holds nothing", "expected one"]),
    (f"<geometry>{BOX}</geometry>", "", ["collision of link 'l1' has no <geometry>"]),
    (f"<geometry>{BOX}</geometry>", BOX, ["<box> inside", "collision", "valid: origin, geometry"]),
    (MESH, '<mesh file="link.stl"/>', ["unknown attribute 'file'", "did you mean 'filename'?"]),
    (MESH, "<mesh/>", ["has no 'filename'"]),
    (MESH, '<mesh filename="lost.stl"/>', ["no such file: lost.stl"]),
    (MESH, '<mesh filename="http://x/link.stl"/>', ["files are not fetched by http://"]),
    (MESH, '<mesh filename="link.stl" scale="1"/>', ["scale '1'", "three positive numbers"]),
    (MESH, '<mesh filename="link.stl" scale="1 1 -1"/>', ["three positive numbers"]),
    (MESH, '<mesh filename="link.stl" scale="1 1 2"/>', ["scaled unevenly"]),
    ('<origin xyz="0 0 0.15" rpy="0 0 0"/>', '<origin xyz="0 0.15"/>', ["origin of collision", "'0 0.15'"]),
    ('<origin xyz="0 0 0.15" rpy="0 0 0"/>', '<origin xyz="0 0 nan"/>', ["origin of collision", "'0 0 nan'"]),
    ('<origin xyz="0 0 0.15" rpy="0 0 0"/>', '<origin xyz="0 0 0.15" ryp="0 1 0"/>', ["did you mean 'rpy'?"]),
    ('<origin xyz="0 0 0.15" rpy="0 0 0"/>', '<origin xyz="0 0 0.15" rpy="0 90 0"/>', ["radians", "1.5708"]),
    ('<origin xyz="0 0 0.15" rpy="0 0 0"/>', '<origin quat_xyzw="0 0 0 1"/>', ["unknown attribute 'quat_xyzw'"]),
    ('<origin xyz="0 0 0.3" rpy="0 0 0"/>', '<origin xyz="0 0 3000"/>', ["if it is in mm, 0 0 3 would work"]),
    ('<origin xyz="0 0 0.3" rpy="0 0 0"/>', '<orign xyz="0 0 0.3"/>', ["<orign> inside joint", "did you mean"]),
    ('<axis xyz="0 0 1"/>', '<axis xyz="0 0 0"/>', ["axis of joint 'a1'", "no direction"]),
    ('<axis xyz="0 0 1"/>', '<axis xyz="0 1"/>', ["axis of joint 'a1'", "three finite numbers"]),
    ('<axis xyz="0 0 1"/>', '<axes xyz="0 0 1"/>', ["<axes>", "did you mean 'axis'?"]),
    ('lower="-3"', 'lower="-3,1"', ["limit of joint 'a1'", "'-3,1'"]),
    ('lower="-3"', 'lower="3"', ["joint 'a1'", "lower < upper"]),
    ('lower="-3"', 'lower="4"', ["joint 'a1'", "lower < upper"]),
    ('upper="3"', 'uper="3"', ["unknown attribute 'uper'", "did you mean 'upper'?"]),
    ('upper="3"', 'upper="inf"', ["'inf'"]),
    (' effort="100"', "", ["limit of joint 'a1' has no 'effort'"]),
    (' velocity="9"', "", ["limit of joint 'a1' has no 'velocity'"]),
    ("<limit ", "<limits ", ["<limits>", "did you mean 'limit'?"]),
    ('type="revolute"', 'type="hinge"', ["joint 'a1' has type 'hinge'", "valid: revolute"]),
    ('type="revolute"', "", ["joint 'a1' has type ''"]),
    ('<child link="l1"/>', '<child lnk="l1"/>', ["unknown attribute 'lnk'", "did you mean 'link'?"]),
    ('<link name="l1">', '<link name="l2">', ["link 'l2' is given twice, first in line 2"]),
    ('<link name="l1">', "<link>", ["a link has no 'name'"]),
    ('<link name="l1">', '<lnik name="l1">', ["<lnik> inside robot", "did you mean 'link'?"]),
    ('<joint name="a1"', '<jiont name="a1"', ["<jiont> inside robot", "did you mean 'joint'?"]),
    ('<link name="base"/>', '<link name="base"/><bodies><link name="l9"/></bodies>', ["<bodies> inside robot"]),
    ('<robot name="r">', '<!DOCTYPE r [<!ENTITY a "b">]>\n<robot name="r">', ["document type", "without <!DOCTYPE>"]),
    ('<robot name="r">', '<!DOCTYPE r SYSTEM "file:///etc/passwd">\n<robot name="r">', ["document type"]),
    ('<link name="base"/>', '<link name="&bodies;"/>', ["is not XML: undefined entity"]),
    ("</robot>", "", ["is not XML: no element found"]),
]


@pytest.mark.parametrize(("old", "new", "parts"), DAMAGES, ids=[f"{n} {d[2][0]}" for n, d in enumerate(DAMAGES)])
def test_damages_are_refused_with_file_and_line(folder: Path, old: str, new: str, parts: list[str]) -> None:
    text = urdf()
    line = text[: text.index(old)].count("\n") + 1
    # also replace the end tag
    if old in ("<inertial>", "<collision>", "<visual>", '<link name="l1">', '<joint name="a1"'):
        tag, becomes = old.strip("<>").split()[0], new.strip("<>").split()[0]
        if tag != becomes:
            at = text.index(old)
            end = text.index(f"</{tag}>", at)
            text = text[:end] + f"</{becomes}>" + text[end + len(tag) + 3 :]
    (folder / "robot.urdf").write_text(text.replace(old, new, 1))
    if "is given twice, first" in parts[0]:
        line = 10  # line of the second link with this name
    elif "lower < upper" in parts:
        line = 4  # ranges are checked where the cell refers to the URDF
    elif "has no <geometry>" in parts[0]:
        line = 6  # line of the body
    elif old == "</robot>":
        line = 96  # end of the file
    read_refusal_message(folder, "robot.urdf", f"line {line}", *parts)


def test_entity_expansion_is_refused(folder: Path) -> None:
    laughs = "".join(f'<!ENTITY l{n} "{f"&l{n - 1};" * 10}">' for n in range(1, 10))
    text = urdf().replace('<robot name="r">', f'<!DOCTYPE r [<!ENTITY l0 "ha">{laughs}]>\n<robot name="&l9;">')
    (folder / "robot.urdf").write_text(text)
    read_refusal_message(folder, "robot.urdf", "line 1", "document type")


@pytest.mark.parametrize("text", ["", " \n", "<robot", "\ufeff", "<robot>\0</robot>"])
def test_empty_and_truncated_files_are_refused(folder: Path, text: str) -> None:
    (folder / "robot.urdf").write_text(text)
    read_refusal_message(folder, "robot.urdf")


def test_other_encodings_are_refused(folder: Path) -> None:
    (folder / "robot.urdf").write_bytes(urdf().replace("l1", "ä1").encode("latin-1"))
    read_refusal_message(folder, "robot.urdf", "line 2", "not UTF-8")
    (folder / "robot.urdf").write_bytes(urdf().encode("utf-16"))
    read_refusal_message(folder, "robot.urdf", "not UTF-8")


def test_deep_nesting_is_refused(folder: Path) -> None:
    (folder / "robot.urdf").write_text('<robot name="r">' + "<gazebo>" * 100_000)
    read_refusal_message(folder, "robot.urdf", "line 1", "nested deeper than 100 levels")


def test_unsupported_urdf_elements_are_counted_and_accepted(folder: Path) -> None:
    more = (
        '<material name="red"><color rgba="1 0 0 1"/></material><gazebo reference="l1"><mu1>0.2</mu1></gazebo>'
        '<transmission name="t"><joint name="a1"><hardwareInterface>x</hardwareInterface></joint></transmission>'
        '<ros2_control name="c" type="system"><joint name="a1"><command_interface name="position"/></joint>'
        '</ros2_control><drake:acceleration value="1"/>'
    )
    text = urdf().replace('<robot name="r">', '<robot name="r" xmlns:xacro="http://ros.org/wiki/xacro" xmlns="x">')
    (folder / "robot.urdf").write_text(text.replace('<link name="base"/>', f'<link name="base"/>{more}'))
    found = read_urdf(folder / "robot.urdf")
    assert found.unused_elements == {
        "material": 1,
        "gazebo": 1,
        "transmission": 1,
        "ros2_control": 1,
        "drake:acceleration": 1,
    }
    cell = load_cell(folder)
    assert cell.warnings == ()
    assert any("gazebo (1)" in note for note in cell.notes)


def test_unknown_elements_beside_the_links_cause_a_warning(folder: Path) -> None:
    line = replace_in_file(folder, '<link name="base"/>', '<link name="base"/><weather wind="3"/>', "robot.urdf")
    assert f"line {line}: <weather> is no element of a URDF; it was not read" in load_cell(folder).warnings[0]


@pytest.mark.parametrize(
    ("old", "new", "part", "place"),
    [
        ('<axis xyz="0 0 1"/>', '<axis xyz="0 0 2"/>', "axis of joint 'a1' is 2 long; only its direction", 0),
        ('<axis xyz="0 0 1"/>', "", "joint 'a1' has no <axis>; it is taken along x", -4),
        ('ixx="2"', 'ixx="-2"', "inertia of link 'l1' is that of no body", 0),
        ('value="190"', 'value="0"', "link 'l1' has inertia but no mass", 1),
    ],
)
def test_unusual_values_cause_a_warning(folder: Path, old: str, new: str, part: str, place: int) -> None:
    line = replace_in_file(folder, old, new, "robot.urdf", 1)
    warnings = load_cell(folder).warnings
    assert any(part in w for w in warnings), warnings
    assert f"line {line + place}" in warnings[0]


def test_link_with_visual_geometry_only_is_named(folder: Path) -> None:
    text = urdf()
    start = text.index("<collision>", text.index('<link name="l3">'))
    (folder / "robot.urdf").write_text(text[:start] + text[text.index("<visual>", start) :])
    assert any("no collision geometry for the links l3" in w for w in load_cell(folder).warnings)


def test_robot_model_counts_its_bodies(folder: Path) -> None:
    """The robot model compares its body count with the strict reader, so that a body dropped by its own parser is
    detected."""
    cell = load_cell(folder)
    replace_in_file(folder, BOX, '<capsule radius="0.1" length="0.3"/>', "robot.urdf", 1)
    with pytest.raises(InputError, match=r"robot\.urdf: describes 6 collision bodies, of which the robot model has 5"):
        load_chain(cell)


def test_verifier_counts_bodies_by_its_own_reader(folder: Path) -> None:
    from machopt.verification.motion.collision.bodies import build_bodies
    from machopt.verification.motion.collision.checked_pairs import list_checked_pairs
    from machopt.verification.motion.collision.urdf_inventory import check_inventory
    from machopt.verification.motion.kinematics.urdf_kinematics import UrdfKinematics

    cell = load_cell(folder)

    def lost() -> list[str]:
        arm = UrdfKinematics(cell)
        bodies = build_bodies(cell, arm)
        return [
            c.where for c in check_inventory(cell, arm, bodies, list_checked_pairs(cell, arm, bodies)) if not c.passed
        ]

    assert not lost()
    replace_in_file(folder, BOX, '<capsule radius="0.1" length="0.3"/>', "robot.urdf", 1)
    (where,) = lost()
    assert "was not loaded" in where
