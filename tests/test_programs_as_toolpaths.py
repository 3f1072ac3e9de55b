"""Robot programs as toolpaths of ``inspect`` and ``optimize``: recognised by content, with or without their robot."""

from __future__ import annotations

import json
from pathlib import Path

import numpy as np
import pytest
from sample_robot_programs import ARM, MAPPED, PLAIN, ROOT, TOOL, WORKPIECE, Recipe, program

from machopt.cell.cell_reader import load_cell
from machopt.cli import main
from machopt.commands.toolpath_reading_options import build_known_robot
from machopt.data_types.robot_program import RobotController
from machopt.data_types.toolpath import MoveKind, Toolpath
from machopt.errors import InputError
from machopt.programs.program_reader import ProgramRobot
from machopt.programs.program_writer import format_program_name, list_post_names, write_program
from machopt.toolpath.toolpath_reader import read_toolpath

ROOT_FOLDER = Path(__file__).resolve().parents[1]
CELL = ROOT_FOLDER / "cells" / "kr500_milling"
JOINTS_ONLY = ("fanuc_joint", "jbi", "ros_yaml", "ros_json", "compas_fab", "urscript_servoj")
MAPPED_ROBOT = ProgramRobot(ARM.compute_fk, MAPPED, TOOL, WORKPIECE)


def write_program_file(
    folder: Path, post: str, controller: RobotController = MAPPED
) -> tuple[Path, np.ndarray, np.ndarray]:
    """Return the main file of a program, and its tip positions (mm) and kinds of move."""
    p = program(Recipe(4, moves=30), controller)
    name = format_program_name("part", post)
    files = write_program(folder, name, p, post, controller)
    return files[0], p.T_workpiece_tcp[:, :3, 3] * 1e3, p.moves


@pytest.mark.parametrize("post", list_post_names())
def test_every_program_is_a_toolpath(tmp_path: Path, post: str) -> None:
    """With the robot, every target has a position in any format."""
    file, place, moves = write_program_file(tmp_path, post)
    t = read_toolpath(file, robot=MAPPED_ROBOT, default_feed=0.01)
    assert t.format.startswith("robot/")
    np.testing.assert_array_equal(t.move, moves)
    # axes are printed to 1e-4° or finer: six axes, at a distance of four metres
    np.testing.assert_allclose(t.position * 1e3, place, rtol=0, atol=6 * np.radians(1e-4) * 4e3)
    if post in JOINTS_ONLY:
        with pytest.raises(InputError, match=r"joint positions without a known place.*optimize has one") as caught:
            read_toolpath(file, default_feed=0.01)
        assert "\n" not in str(caught.value)
        return
    alone = read_toolpath(file, default_feed=0.01)
    known = np.isin(t.line, alone.line)
    led = np.append([True], known[:-1]) | (np.cumsum(known) <= 1)  # a cut with a known start, or the first point
    assert (alone.move == MoveKind.CUT).sum() == ((moves == MoveKind.CUT) & led).sum()
    cut = t.position[t.cutting & led]
    np.testing.assert_allclose(alone.position[alone.cutting], cut, rtol=0, atol=1e-9)  # the same numbers in the file


def test_program_uses_its_own_base_and_tool(tmp_path: Path) -> None:
    """The position of joint moves between Cartesian ones uses the base and tool
    of the program, not those of the cell."""
    file, place, moves = write_program_file(tmp_path, "rapid")
    elsewhere = WORKPIECE.copy()
    elsewhere[0, 3] += 0.25
    longer = TOOL.copy()
    longer[:3, 3] += 0.1 * TOOL[:3, 2]
    t = read_toolpath(file, robot=ProgramRobot(ARM.compute_fk, MAPPED, longer, elsewhere))
    np.testing.assert_allclose(t.position * 1e3, place, rtol=0, atol=2e-3)
    assert (moves == MoveKind.RAPID).any()
    assert any("lies 250.0 mm from the cell's workpiece" in w for w in t.warnings)
    assert not read_toolpath(file, robot=MAPPED_ROBOT).warnings


def test_joint_targets_alone_are_placed_in_the_workpiece_of_the_cell(tmp_path: Path) -> None:
    file, place, _ = write_program_file(tmp_path, "fanuc_joint")
    elsewhere = WORKPIECE @ np.array([[1.0, 0, 0, 0.25], [0, 1, 0, 0], [0, 0, 1, 0], [0, 0, 0, 1]])
    t = read_toolpath(file, robot=ProgramRobot(ARM.compute_fk, MAPPED, TOOL, elsewhere))
    np.testing.assert_allclose(t.position * 1e3, place - [250, 0, 0], rtol=0, atol=2e-3)
    assert t.meta["base"] == "the cell's workpiece"
    wrong = read_toolpath(file, robot=ProgramRobot(ARM.compute_fk, PLAIN, TOOL, WORKPIECE))  # without the joint map
    assert np.abs(wrong.position * 1e3 - place).max() > 100


def test_base_without_numbers_is_reported_as_the_workpiece(tmp_path: Path) -> None:
    controller = RobotController(joint_map=MAPPED.joint_map, T_base_root=ROOT, base_number=2, tool_number=3)
    file, place, _ = write_program_file(tmp_path, "krl", controller)
    t = read_toolpath(file, robot=ProgramRobot(ARM.compute_fk, controller, TOOL, WORKPIECE))
    assert any("names its base BASE_DATA[2] without numbers" in w for w in t.warnings)
    np.testing.assert_allclose(t.position * 1e3, place, rtol=0, atol=2e-3)


def test_pulses_require_the_scale_of_the_cell(tmp_path: Path) -> None:
    scale = np.array([1341.4, -1341.4, 1000.0, 900.5, 700.0, 500.0])
    controller = RobotController(joint_map=MAPPED.joint_map, T_base_root=ROOT, pulses_per_deg=scale)
    file, place, _ = write_program_file(tmp_path, "jbi", controller)
    t = read_toolpath(file, robot=ProgramRobot(ARM.compute_fk, controller, TOOL, WORKPIECE))
    half_a_pulse = np.radians(0.5 / 500.0)
    np.testing.assert_allclose(t.position * 1e3, place, rtol=0, atol=7 * half_a_pulse * 4e3)
    with pytest.raises(InputError, match=r"in encoder pulses; a cell with controller\.pulses_per_deg"):
        read_toolpath(file, robot=MAPPED_ROBOT)


UP = "DEF a()\n$VEL.CP=0.02\nLIN {X 0,Y 0,Z 5,A 0,B 0,C 0}\nLIN {X 10,Y 0,Z 5,A 30,B 0,C 0}\nEND\n"


def test_tool_axis_is_reported_where_the_frame_points_opposite(tmp_path: Path) -> None:
    (tmp_path / "a.src").write_text(UP)
    t = read_toolpath(tmp_path / "a.src")
    np.testing.assert_allclose(t.axis, [[0, 0, -1]] * 2, atol=1e-12)
    assert any("--tool-axis=+z" in w for w in t.warnings)
    up = read_toolpath(tmp_path / "a.src", tool_axis="+z")
    np.testing.assert_allclose(up.axis, [[0, 0, 1]] * 2, atol=1e-12)
    np.testing.assert_allclose(up.reference[1], [np.cos(np.pi / 6), 0.5, 0], atol=1e-12)
    assert not up.warnings
    side = read_toolpath(tmp_path / "a.src", tool_axis="-x")
    np.testing.assert_allclose(side.axis[0], [-1, 0, 0], atol=1e-12)
    np.testing.assert_allclose(side.reference[0], [0, 1, 0], atol=1e-12)  # perpendicular to the tool axis
    with pytest.raises(InputError, match="unknown tool axis 'z'"):
        read_toolpath(tmp_path / "a.src", tool_axis="z")


@pytest.mark.parametrize(
    ("header", "attitude"),
    [
        ("a_deg,b_deg,c_deg", "30,0,180"),
        ("w_deg,p_deg,r_deg", "180,0,30"),
        ("qw,qx,qy,qz", "0,0.9659258263,0.2588190451,0"),
        ("rvx_rad,rvy_rad,rvz_rad", "3.0345454,0.8131040,0"),
    ],
)
def test_tables_of_robot_poses(tmp_path: Path, header: str, attitude: str) -> None:
    """One orientation in four notations: Rz(30°) Rx(180°), so the tool points down and its x axis is at 30°."""
    (tmp_path / "a.csv").write_text(
        f"x_mm,y_mm,z_mm,{header},feed_mm_min\n1,2,3,{attitude},600\n4,2,3,{attitude},600\n"
    )
    t = read_toolpath(tmp_path / "a.csv", kind="path")
    np.testing.assert_allclose(t.axis[0], [0, 0, 1], atol=1e-6)  # seven printed decimals
    np.testing.assert_allclose(t.reference[0], [np.cos(np.pi / 6), 0.5, 0], atol=1e-6)
    turned = read_toolpath(tmp_path / "a.csv", tool_axis="+z", kind="path")
    np.testing.assert_allclose(turned.axis[0], [0, 0, -1], atol=1e-6)


# ---- commands


@pytest.fixture(scope="module")
def job(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Programs of one planned job: Cartesian ones and one with joints only."""
    folder = tmp_path_factory.mktemp("programs")
    rows = ["-100,0,60,rapid,", "-100,0,5,cut,1000", *(f"{-100 + 4 * k},0,-0.5,cut,1500" for k in range(6))]
    table = folder / "pass.csv"
    table.write_text(
        "\n".join(["x_mm,y_mm,z_mm,move,feed_mm_min", *rows, "-80,0,5,cut,1000", "-80,0,60,rapid,"]) + "\n"
    )
    posts = [w for post in ("krl", "rapid", "fanuc_joint") for w in ("--post", post)]
    assert main(["optimize", str(CELL), str(table), "-o", str(folder / "out"), "--quiet", *posts]) == 0
    return folder


def cuts(t: Toolpath) -> np.ndarray:
    return np.asarray(t.position[t.cutting] * 1e3)


@pytest.mark.parametrize("file", ["krl/pass_csv.src", "rapid/pass_csv.mod", "fanuc_joint/PASS_CSV.ls"])
def test_program_is_planned_again(job: Path, file: str, tmp_path: Path) -> None:
    before = cuts(read_toolpath(job / "pass.csv"))
    again = read_toolpath(job / "out" / file, robot=build_known_robot(load_cell(CELL)))
    # five decimals of a degree at a distance of three metres
    np.testing.assert_allclose(cuts(again), before, rtol=0, atol=1e-3)
    out = tmp_path / "out"
    program_file = str(job / "out" / file)
    assert main(["optimize", str(CELL), program_file, "-o", str(out), "--quiet", "--method", "default"]) == 0
    found = json.loads((out / "result.json").read_text())
    assert found["toolpath"]["format"].startswith("robot/")
    assert found["programs"][0]["differences"] == []
    assert main(["verify", str(CELL), program_file, str(out), "--quiet"]) == 0


def test_inspect_shows_programs_in_text_json_and_pictures(
    job: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    page = tmp_path / "page.html"
    assert main(["inspect", str(job / "out/krl/pass_csv.src"), "--html", str(page)]) == 0
    message = capsys.readouterr().out
    assert "format: robot/krl" in message
    assert f"pictures: {page}" in message
    assert '<svg class="plot"' in page.read_text(encoding="utf-8")
    joints = str(job / "out/fanuc_joint/PASS_CSV.ls")
    assert main(["inspect", joints]) == 2
    assert "inspect takes one with --cell" in capsys.readouterr().err
    assert main(["inspect", joints, "--json", "--cell", str(CELL)]) == 0
    assert json.loads(capsys.readouterr().out)["moves"]["cut"] == 8
    assert main(["inspect", joints, "--cell", str(CELL), "--html", str(tmp_path / "no" / "page.html")]) == 2
    assert "cannot be written" in capsys.readouterr().err


def test_strict_inspection_refuses_unknown_statements(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    (tmp_path / "a.src").write_text(UP.replace("LIN {X 10", "WIGGLE(3)\n$MOTION_SUPERVISION=7\nLIN {X 10"))
    assert main(["inspect", str(tmp_path / "a.src"), "--tool-axis=+z", "--json"]) == 0
    found = json.loads(capsys.readouterr().out)
    strange = [w["word"] for w in found["ignored"] if not w["understood"]]
    assert strange
    assert main(["inspect", str(tmp_path / "a.src"), "--tool-axis=+z", "--strict"]) == 2
    assert "strict reading" in capsys.readouterr().err
