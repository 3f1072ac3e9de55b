"""The advice of ``machopt init`` solves the problem when it is followed."""

from __future__ import annotations

import re
from pathlib import Path
from xml.etree import ElementTree

import pytest
from small_cell import urdf_text

from machopt.cell_setup.template.init_request import InitRequest
from machopt.cli import main
from machopt.commands.init import run_init
from machopt.errors import InputError

ROBOTS = Path(__file__).resolve().parents[2] / "shared" / "data" / "robots_public"
SEVEN = (
    "motoman_sia10d_support/urdf/sia10d.urdf",
    "motoman_sia10f_support/urdf/sia10f.urdf",
    "motoman_sia20d_support/urdf/sia20d.urdf",
    "motoman_sia5d_support/urdf/sia5d.urdf",
    "kuka_lbr_iiwa_support/urdf/lbr_iiwa_14_r820.urdf",
)
_OPTION = re.compile(r"--(base|flange)-link (\S+) (?:plans|ends)")
_FIXED = re.compile(r'(\w+) with type="fixed"')
PLACE = (1000.0, 0.0, 500.0)


def add_joint(before: int, axis: str) -> str:
    """Return a URDF of seven joints: an additional joint rotates before joint ``before`` (1 to 6)."""
    root = ElementTree.fromstring(urdf_text())
    joint = next(j for j in root.iter("joint") if j.get("name") == f"a{before}")
    parent = joint.find("parent")
    assert parent is not None
    ElementTree.SubElement(root, "link", name="more")
    one = ElementTree.SubElement(root, "joint", name="a_more", type="revolute")
    ElementTree.SubElement(one, "parent", link=str(parent.get("link")))
    ElementTree.SubElement(one, "child", link="more")
    ElementTree.SubElement(one, "axis", xyz=axis)
    ElementTree.SubElement(one, "limit", lower="-2", upper="2", velocity="1", effort="1")
    parent.set("link", "more")
    return ElementTree.tostring(root, encoding="unicode")


def follow_advice(robot: Path, folder: Path) -> int:
    """Follow each piece of advice; return their number."""
    with pytest.raises(InputError) as refused:
        run_init(InitRequest(robot=robot, out=folder / "cell"))
    text = str(refused.value)
    count = 0
    for kind, link in _OPTION.findall(text):
        run_init(InitRequest(robot=robot, out=folder / kind, workpiece_mm=PLACE, **{f"{kind}_link": link}))
        count += 1
    for joint in _FIXED.findall(text):
        fixed = robot.parent / f"{folder.name}_fixed.urdf" if robot.is_relative_to(folder.parent) else folder / "f.urdf"
        xml = re.sub(r"<(visual|collision)\b(?:[^>]*/>|.*?</\1\s*>)", "", robot.read_text(), flags=re.DOTALL)
        at = re.search(rf'<joint\b[^>]*name="{joint}"[^>]*>', xml)
        assert at is not None
        fixed.write_text(xml.replace(at.group(), re.sub(r'type="\w+"', 'type="fixed"', at.group())))
        run_init(InitRequest(robot=fixed, out=folder / "fixed", workpiece_mm=PLACE))
        count += 1
    return count


AXES = ("0 0 1", "0 1 0", "1 0 0")
SEVENTH_JOINTS = [  # every run tests each position and each axis once; the proofs test all combinations
    pytest.param(before, axis, marks=() if (before - 1) % 3 == k else pytest.mark.proof)
    for before in range(1, 7)
    for k, axis in enumerate(AXES)
]


@pytest.mark.slow
@pytest.mark.parametrize(("before", "axis"), SEVENTH_JOINTS)
def test_advice_for_seven_joints_leads_to_a_cell(before: int, axis: str, tmp_path: Path) -> None:
    robot = tmp_path / "robot.urdf"
    robot.write_text(add_joint(before, axis))
    folder = tmp_path / "out"
    folder.mkdir()
    assert follow_advice(robot, folder) >= 1  # without the additional joint it is the arm of all other tests


@pytest.mark.slow
@pytest.mark.skipif(not ROBOTS.exists(), reason="../shared/data/robots_public is not here")
@pytest.mark.parametrize("name", SEVEN)
def test_advice_for_manufacturer_arms_leads_to_a_cell(name: str, tmp_path: Path) -> None:
    folder = tmp_path / "out"
    folder.mkdir()
    assert follow_advice(ROBOTS / name, folder) >= 1


@pytest.mark.parametrize("link", ["link_1", "link_3", "link_5", "base_link"])
def test_offered_links_end_an_arm(link: str, tmp_path: Path) -> None:
    robot = tmp_path / "robot.urdf"
    robot.write_text(urdf_text())
    with pytest.raises(InputError) as refused:
        run_init(InitRequest(robot=robot, out=tmp_path / "cell", flange_link=link))
    offered = re.search(r"as to (.*)$", str(refused.value))
    assert offered is not None
    for k, one in enumerate(offered.group(1).split(", ")):
        run_init(InitRequest(robot=robot, out=tmp_path / f"cell{k}", flange_link=one, workpiece_mm=PLACE))


@pytest.mark.parametrize(
    ("words", "option"),
    [
        (["--tcp-mm", "0,0,0.15"], "--tcp-mm"),
        (["--tcp-mm", "0,0,0.3"], "--tcp-mm"),
        (["--tcp-mm", "0.1,0,0.2"], "--tcp-mm"),
        (["--tcp-mm", "0,0,0.0001"], "--tcp-mm"),
        (["--tcp-mm", "0,0,250000"], "--tcp-mm"),
        (["--tcp-mm", "0,0,15e9"], "--tcp-mm"),
        (["--tool-length-mm", "0.25"], "--tool-length-mm"),
        (["--tool-length-mm", "0.001"], "--tool-length-mm"),
        (["--tool-length-mm", "250000"], "--tool-length-mm"),
        (["--cutter-length-mm", "0.04"], "--cutter-length-mm"),
        (["--cutter-length-mm", "40000"], "--cutter-length-mm"),
        (["--cutter-diameter-mm", "0.006"], "--cutter-diameter-mm"),
        (["--cutter-diameter-mm", "0.000006"], "--cutter-diameter-mm"),
    ],
)
def test_length_in_another_unit_names_its_option_and_a_valid_value(
    words: list[str], option: str, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    robot = tmp_path / "robot.urdf"
    robot.write_text(urdf_text())
    call = ["init", str(robot), "-o", str(tmp_path / "cell"), "--workpiece-mm", "1200,0,600"]
    assert main([*call, *words]) == 2
    text = capsys.readouterr().err
    assert option in text
    assert "cell.yaml" not in text
    advised = re.search(r", \[?([-\d.e+]+(?:, [-\d.e+]+)*)\]? would work", text)
    if advised is not None:
        value = advised.group(1).replace(" ", "")
        value = value.split(",")[-1] if option == "--tool-length-mm" else value
        assert main([*call, words[0], value]) == 0
