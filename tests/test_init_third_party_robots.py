"""``machopt init`` of published robots: grippers, simulator extensions, nested packages, parts out of reach."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from small_cell import small_cell, urdf_text

from machopt.cell.cell_reader import load_cell
from machopt.cell.urdf.xml_tree import add_missing_prefixes
from machopt.cell_setup.template.cell_draft import TOOL_MM, estimate_tool_length
from machopt.cell_setup.template.init_request import InitRequest
from machopt.cell_setup.workpiece_placement import find_place, find_place_or_middle
from machopt.cli import main
from machopt.commands.init import run_init
from machopt.errors import InputError
from machopt.kinematics.urdf_loading import load_robot
from machopt.options.plan_option_reader import load_options
from machopt.toolpath.toolpath_reader import read_toolpath
from machopt.workspace_map.sample_posture_computation import build_reaching_arm

TOOLPATHS = Path(__file__).resolve().parents[1] / "toolpaths"


def build_unnamed_arm() -> str:
    """Return an arm whose last link matches no naming convention."""
    return urdf_text().replace('"flange"', '"wrist_end"')


def hand(name: str, kind: str = "revolute") -> str:
    return (
        f'<link name="{name}_link"/><joint name="{name}" type="{kind}"><parent link="wrist_end"/>'
        f'<child link="{name}_link"/><axis xyz="0 0 1"/><limit lower="-1" upper="1" velocity="1" effort="1"/></joint>'
    )


@pytest.mark.parametrize("kind", ["revolute", "continuous", "prismatic"])
def test_gripper_behind_the_arm_is_not_part_of_its_joints(kind: str, tmp_path: Path) -> None:
    file = tmp_path / "arm.urdf"
    file.write_text(build_unnamed_arm().replace("</robot>", hand("jointGripper", kind) + "</robot>"))
    done = run_init(InitRequest(robot=file, out=tmp_path / "cell", workpiece_mm=(1500.0, 0.0, 600.0)))
    assert done.cell.flange_link == "wrist_end"
    assert done.cell.arm_joints == ("a1", "a2", "a3", "a4", "a5", "a6")
    values = [g for g in done.guesses if "jointGripper behind wrist_end is assumed to belong to a gripper" in g]
    assert len(values) == (kind != "prismatic")  # a prismatic joint is not one of six rotating joints


def test_seventh_joint_with_another_name_is_questioned(tmp_path: Path) -> None:
    file = tmp_path / "arm.urdf"
    file.write_text(build_unnamed_arm().replace("</robot>", hand("a7") + "</robot>"))
    with pytest.raises(InputError, match=r"--flange-link link_6 ends the arm at a6"):
        run_init(InitRequest(robot=file, out=tmp_path / "cell"))


def test_undeclared_prefixes_are_read_as_by_urdf_parsers(tmp_path: Path) -> None:
    """``drake:acceleration`` caused an internal error; the rest of the file of the new cell is unchanged."""
    given = (
        urdf_text()
        .replace('effort="1000"', 'effort="1000" drake:acceleration="2"')
        .replace("</robot>", "<drake:note/></robot>")
    )
    file = tmp_path / "arm.urdf"
    file.write_text(given)
    out = tmp_path / "cell"
    assert main(["init", str(file), "-o", str(out), "--workpiece-mm", "1500,0,600", "--quiet"]) == 0
    (out / "robot.urdf").write_text(given)  # simulates a cell written by hand
    assert main(["validate", str(out), "--quiet"]) == 0
    assert load_cell(out).urdf_text.count('xmlns:drake="urn:drake"') == 1


def test_text_with_declared_prefixes_remains_unchanged() -> None:
    assert add_missing_prefixes('<robot xmlns:d="u" name="é"><link d:a="1" name="x"/></robot>') is None
    assert add_missing_prefixes('<!-- <robot a:b="1"> --><robot name="é"><e:f/></robot>') == (
        '<!-- <robot a:b="1"> --><robot xmlns:e="urn:e" name="é"><e:f/></robot>'
    )


def test_nested_package_with_meshes_is_found(tmp_path: Path) -> None:
    import trimesh

    outer = tmp_path / "arm_x"
    (outer / "urdf").mkdir(parents=True)
    (outer / "arm_x" / "meshes").mkdir(parents=True)
    trimesh.creation.box((0.1, 0.1, 0.1)).export(outer / "arm_x" / "meshes" / "a.stl")
    collision = '<collision><geometry><mesh filename="package://arm_x/meshes/a.stl"/></geometry></collision>'
    file = outer / "urdf" / "r.urdf"
    file.write_text(urdf_text().replace('<link name="link_1">', f'<link name="link_1">{collision}'))
    done = run_init(InitRequest(robot=file, out=tmp_path / "cell", workpiece_mm=(1500.0, 0.0, 600.0)))
    assert (done.folder / "arm_x" / "meshes" / "a.stl").is_file()


@pytest.mark.parametrize(("span", "length"), [(0.5, TOOL_MM[0]), (1.34, 130.0), (3.4, TOOL_MM[1])])
def test_default_tool_fits_the_arm(span: float, length: float) -> None:
    request = InitRequest(robot=Path("r"), out=Path("o"))
    assert estimate_tool_length(request, span) == length
    assert estimate_tool_length(replace(request, tool_length_mm=17.0), span) == 17.0


def test_unreachable_part_is_rotated_into_reach(tmp_path: Path) -> None:
    """A wrist that cannot point down reaches only a part in front of the arm."""
    cell = small_cell(tmp_path)
    arm = build_reaching_arm(cell, load_robot(cell), load_options(None))
    arm = replace(
        arm,
        lower=np.radians([-185.0, -110.0, 60.0, -80.0, -80.0, -350.0]),
        upper=np.radians([185.0, -50.0, 110.0, 80.0, 80.0, 350.0]),
    )
    path = read_toolpath(TOOLPATHS / "plain.csv")
    position = 0.4 * path.position
    turns = ((0.0, 0.0, 0.0), (0.0, -90.0, 0.0))
    assert find_place(arm, position, path.axis, 3.0) is None
    found = find_place_or_middle(arm, position, path.axis, 3.0, turns=turns)
    assert found is not None
    assert (found.share, found.turn) == (1.0, turns[1])
    np.testing.assert_allclose(found.T_base_workpiece[:3, 2], [-1.0, 0.0, 0.0], atol=1e-12)
