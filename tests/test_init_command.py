"""``machopt init``: from a URDF to a cell that loads, orients the tool and reaches its workpiece."""

from __future__ import annotations

import json
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from external_axis_cells import RAIL
from small_cell import robot_folder, small_cell, urdf_text

from machopt.cell.cell_reader import load_cell
from machopt.cell.urdf import find_arm, read_robot, read_standalone_description
from machopt.cell_setup.template.cell_text import REFERENCE_NM_PER_RAD, REFERENCE_SPAN_M, estimate_joint_stiffness
from machopt.cell_setup.template.init_request import InitRequest
from machopt.cell_setup.template.robot_files import copy_robot
from machopt.cell_setup.workpiece_placement import (
    build_sample_path,
    compute_pointing_rpy,
    find_flange_direction,
    find_place,
)
from machopt.cli import main
from machopt.commands.init import run_init
from machopt.data_types.cell import Cell
from machopt.data_types.documents.cell_documents import InitDocument
from machopt.errors import InputError
from machopt.input_files.json_schemas import FILES, FOLDER, format_schema_name, render_schema
from machopt.kinematics.machine import load_machine
from machopt.kinematics.urdf_loading import load_chain, load_robot
from machopt.numerics.rigid_transforms import compute_rpy_matrix
from machopt.options.plan_option_reader import load_options
from machopt.planning.pipeline.planning_setup import fix_external_axes, prepare_planning
from machopt.planning.sampling.candidate_enumeration import enumerate_candidates
from machopt.planning.stations.planning_path import build_planning_path
from machopt.toolpath.toolpath_reader import read_toolpath
from machopt.workspace_map.postures import build_tool_poses, compute_candidates
from machopt.workspace_map.sample_posture_computation import build_reaching_arm

ROOT = Path(__file__).resolve().parents[1]
REAL = ("m20ia", "kr210l150", "kr500_r2800_2")


@pytest.fixture
def robot(tmp_path: Path) -> Path:
    file = tmp_path / "arm.urdf"
    file.write_text(urdf_text())
    return file


def test_new_cell_loads_reaches_its_workpiece_and_is_free_of_contacts(robot: Path, tmp_path: Path) -> None:
    from machopt.collision.collision_model import CollisionModel

    toolpath = ROOT / "toolpaths" / "plate_holes.csv"
    request = InitRequest(robot=robot, out=tmp_path / "new" / "cell", toolpath=toolpath, post="krl", tool_angle_deg=0.0)
    done = run_init(request)
    cell = load_cell(tmp_path / "new" / "cell")
    assert (cell.base_link, cell.flange_link, cell.controller.post) == ("base_link", "flange", "krl")
    assert cell.stiffness is not None
    assert cell.stiffness.estimated
    assert any("estimated, not measured" in w for w in cell.warnings)
    assert done.guesses
    text = (tmp_path / "new" / "cell" / "cell.yaml").read_text()
    assert text.startswith("# yaml-language-server: $schema=schemas/cell.schema.json\n")
    assert (tmp_path / "new" / "cell" / "schemas" / "cell.schema.json").read_text() == render_schema("cell.yaml")
    urdf = read_robot(robot)
    assert np.degrees(cell.limits.velocity) == pytest.approx(
        [np.degrees(j.velocity) for j in urdf.joints[:6]], abs=1e-3
    )
    assert cell.limits.acceleration == pytest.approx(cell.limits.velocity / 0.35, rel=1e-5)
    assert cell.limits.jerk == pytest.approx(cell.limits.acceleration / 0.14, rel=1e-5)
    bodies = load_chain(cell)
    assert cell.tool.T_flange_tcp[:3, 2] == pytest.approx(find_flange_direction(bodies[0]), abs=1e-6)
    assert CollisionModel(cell, *bodies, 0.002).suspicious == ()


@pytest.mark.parametrize("turn", [(0, 90, 0), (90, 0, 0), (0, 180, 0), (10, -20, 30), (0, 0, 0)])
def test_tool_points_out_of_the_arm_in_any_flange_frame(turn: tuple[float, ...], tmp_path: Path) -> None:
    """The frames of flange and tool0 differ by 90°; a tool along the wrong z axis points sideways."""
    there = load_robot(small_cell(tmp_path))
    R = compute_rpy_matrix(np.radians(turn))
    T = there.T_base_flange_zero.copy()
    T[:3, :3] = T[:3, :3] @ R
    found, before = find_flange_direction(replace(there, T_base_flange_zero=T)), find_flange_direction(there)
    assert found is not None
    assert before is not None
    assert R @ found == pytest.approx(before, abs=1e-9)
    assert there.T_base_flange_zero[:3, :3] @ before == pytest.approx([1.0, 0.0, 0.0], abs=1e-9)  # the arm of the URDF
    assert compute_rpy_matrix(compute_pointing_rpy(found))[:, 2] == pytest.approx(found, abs=1e-9)


def test_shipped_cells_have_flanges_along_z() -> None:
    for name in ("kr240_drilling", "cutting_cobot"):
        found = find_flange_direction(load_robot(load_cell(ROOT / "cells" / name)))
        assert found == pytest.approx([0.0, 0.0, 1.0], abs=1e-9)


def find_reachable_points(cell: Cell, toolpath: Path) -> np.ndarray:
    """Return (N,) whether some rotation of each point has a configuration, with the external joints at home."""
    options = load_options(overrides=["collision=false", "rotation_step_deg=30"])
    setup, path = prepare_planning(cell, options), build_planning_path(read_toolpath(toolpath), ())
    candidates = enumerate_candidates(fix_external_axes(path, cell.external_home), setup.arm, options)
    return np.asarray((candidates.reason == 0).any(axis=(1, 2)))


@pytest.mark.parametrize("turned", [(0.0, 0.0, 0.0), (0.0, 0.0, 90.0), (90.0, 0.0, 0.0)])
def test_arm_on_a_rail_gets_a_cell_with_a_reachable_part(turned: tuple[float, ...], tmp_path: Path) -> None:
    """The base is rotated and away from the URDF's root; the part is placed in world and rotated as requested."""
    stand = '<origin xyz="0.4 -0.3 0.6" rpy="0 0 1.5707963"/>'
    rail = RAIL.replace('<origin xyz="-0.1 0 0.2"/>', stand)
    assert stand in rail
    (tmp_path / "arm.urdf").write_text(urdf_text().replace("</robot>", rail + "</robot>"))
    toolpath = ROOT / "toolpaths" / "plate_holes.csv"
    cell = run_init(
        InitRequest(robot=tmp_path / "arm.urdf", out=tmp_path / "cell", toolpath=toolpath, workpiece_rpy_deg=turned)
    ).cell
    assert (cell.external_joints, cell.external_prismatic) == (("rail",), (True,))
    assert find_reachable_points(cell, toolpath).all()
    robot = load_robot(cell)
    T = load_machine(cell, robot).compute_T_base_workpiece(cell.external_home[None])[0]
    points = read_toolpath(toolpath).position @ T[:3, :3].T + T[:3, 3]
    tip = robot.compute_fk(cell.home, cell.tool.T_flange_tcp)[:3, 3]  # home is vertically above one of the points
    additional = np.linalg.norm((points - tip)[:, :2], axis=1)
    assert additional.min() < 3e-3  # m: positions are rounded to 1 mm, angles to 0.01 degrees
    text = (tmp_path / "cell" / "cell.yaml").read_text()
    assert "the URDF's root link, below the rail, in world" in text
    assert "a1, a2, a3, a4, a5, a6, rail (mm); deg (mm where it slides)" in text


def test_terminal_questions_repeat_until_the_answer_is_valid(
    robot: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    answers = iter(["-5", "three", "320", "", "12", "400", "60", "krll", "krl"])
    requested: list[str] = []

    def answer(words: str) -> str:
        requested.append(words)
        return next(answers)

    monkeypatch.setattr("builtins.input", answer)
    assert main(["init", str(robot), "-o", str(tmp_path / "cell"), "--ask"]) == 0
    cell = load_cell(tmp_path / "cell")
    assert np.linalg.norm(cell.tool.T_flange_tcp[:3, 3]) == pytest.approx(0.32)
    assert cell.tool.cutter is not None
    assert (cell.tool.mass, cell.tool.cutter.diameter, cell.tool.cutter.length) == (0.0, 0.012, 0.06)
    assert cell.controller.post == "krl"
    out = capsys.readouterr().out
    assert out.count("a number above 0 would work") == 2
    assert "less than the 320 mm from flange to TCP would work" in out
    assert "did you mean 'krl'" in out
    monkeypatch.setattr("builtins.input", raise_end_of_input)
    assert main(["init", str(robot), "-o", str(tmp_path / "other"), "--ask"]) == 0
    assert load_cell(tmp_path / "other").controller.post is None


def raise_end_of_input(_: str) -> str:
    raise EOFError


def test_whole_path_is_reached_in_one_branch(tmp_path: Path) -> None:
    cell = small_cell(tmp_path)
    arm = build_reaching_arm(cell, load_robot(cell), load_options(None))
    found = find_place(arm, *build_sample_path(3.0), 3.0)
    assert found is not None
    assert found.margin > np.radians(5)
    assert (found.home > arm.lower).all()
    assert (found.home < arm.upper).all()
    far = np.array([[0.0, 0.0, 0.0], [30.0, 0.0, 0.0]])
    assert find_place(arm, far, np.array([[0.0, 0.0, 1.0]] * 2), 3.0) is None


@pytest.mark.parametrize("axis", [(0.0, 0.0, 1.0), (-1.0, 0.0, 0.0), (-0.6, 0.0, 0.8)])
def test_workpiece_is_placed_away_from_wrist_and_elbow_singularities(axis: tuple[float, ...], tmp_path: Path) -> None:
    """With the distance to joint limits as only criterion, a first job was placed too near a wrist singularity."""
    cell = small_cell(tmp_path)
    arm = build_reaching_arm(cell, load_robot(cell), load_options(None))
    # wide joint limits, which have no influence here
    arm = replace(arm, lower=np.full(6, -2 * np.pi), upper=np.full(6, 2 * np.pi))
    t = np.linspace(0.0, 1.0, 300)[:, None]
    position = np.concatenate([0.4 * np.cos(40 * t), 0.4 * np.sin(40 * t), 0.1 * t], axis=1)
    found = find_place(arm, position, np.broadcast_to(axis, position.shape), 3.0)
    assert found is not None
    assert found.share == 1.0
    T = build_tool_poses(position + found.T_base_workpiece[:3, 3], np.array(axis), np.radians(np.arange(0, 360, 30)))
    bent = compute_candidates(arm, T).singularity_margin.reshape(len(t), 12, -1)
    best = np.nan_to_num(bent, nan=0.0).max(axis=1).min(axis=0).max()  # of the branch that is best over all points
    assert best > np.radians(20)
    assert found.margin <= best + np.radians(2)  # ``margin`` is computed with fewer points


def test_path_too_large_for_the_arm_has_its_middle_in_reach(robot: Path, tmp_path: Path) -> None:
    """The start is valid; the report of a plan then states what is missing at which points."""
    file = tmp_path / "large.csv"
    file.write_text("x_mm,y_mm,z_mm,i,j,k,feed_mm_min,kind\n100,0,0,0,0,1,600,path\n9100,0,0,0,0,1,600,\n")
    done = run_init(InitRequest(robot=robot, out=tmp_path / "cell", toolpath=file))
    assert any("reaches all of large.csv, so workpiece.pose has its middle in reach" in g for g in done.guesses)
    middle = done.cell.workpiece.T_link_workpiece @ [4.6, 0.0, 0.0, 1.0]
    assert 0.3 < np.linalg.norm(middle[:3]) < 2.5


@pytest.mark.parametrize("name", REAL)
def test_published_arms_are_found(name: str) -> None:
    arm = find_arm(read_robot(robot_folder(name) / f"{name}.urdf"))
    assert (arm.base_link, arm.flange_link, arm.flanges) == ("base_link", "tool0", ("link_6", "flange"))
    assert len(arm.arm) == 6


def test_missing_links_and_invalid_arms_are_reported(robot: Path, tmp_path: Path) -> None:
    urdf = read_robot(robot)
    with pytest.raises(InputError, match=r"--flange-link: link 'flang' is not there; did you mean 'flange'"):
        find_arm(urdf, None, "flang")
    with pytest.raises(InputError, match=r"six joints that turn would work"):
        find_arm(urdf, "link_1")
    assert find_arm(urdf, "base_link", "link_6").flange_link == "link_6"
    two = robot.read_text().replace("</robot>", "").replace('"flange"', '"l_flange"')
    second = urdf_text().partition("<link")[2].replace('name="', 'name="r_').replace('link="', 'link="r_')
    (tmp_path / "two.urdf").write_text(
        two + "<link" + second.replace("</robot>", "") + '<joint name="j" type="fixed"><parent link="base_link"/>'
        '<child link="r_base_link"/><origin xyz="0 2 0" rpy="0 0 0"/></joint></robot>'
    )
    with pytest.raises(InputError, match=r"more than one arm; name one of l_flange, r_flange"):
        find_arm(read_robot(tmp_path / "two.urdf"))


@pytest.mark.parametrize("source", ["nosuch", "strut"])
def test_robot_errors_name_the_file_of_the_user(source: str, tmp_path: Path) -> None:
    """The message does not name a line of the cell in its temporary folder, which is already deleted."""
    strut = (
        '<link name="rod"/><link name="end"/><joint name="strut" type="fixed"><parent link="rod"/><child link="end"/>'
        '</joint><joint name="couple" type="revolute"><parent link="base_link"/><child link="rod"/><axis xyz="0 0 1"/>'
        f'<limit lower="-1" upper="1" velocity="3" effort="1"/><mimic joint="{source}"/></joint></robot>'
    )
    file = tmp_path / "arm.urdf"
    file.write_text(urdf_text().replace("</robot>", strut))
    with pytest.raises(InputError, match=f"mimics '{source}'") as refused:
        run_init(InitRequest(robot=file, out=tmp_path / "cell"))
    assert str(refused.value).startswith(f"{file}: ")
    assert "cell.yaml" not in str(refused.value)
    assert not (tmp_path / "cell").exists()


def test_meshes_of_a_robot_are_copied_from_any_place(tmp_path: Path) -> None:
    import trimesh

    mesh = trimesh.creation.box((0.1, 0.1, 0.1))
    for place in ("pkg/meshes/a.stl", "robot/beside/b.stl", "else/c.stl"):
        (tmp_path / place).parent.mkdir(parents=True, exist_ok=True)
        mesh.export(tmp_path / place)
    names = ("package://pkg/meshes/a.stl", "beside/b.stl", "../else/c.stl")
    parts = "".join(
        f'<link name="l{n}"><collision><geometry><mesh filename="{uri}"/></geometry></collision></link>'
        for n, uri in enumerate(names)
    )
    joints = "".join(
        f'<joint name="j{n}" type="fixed"><parent link="l{n}"/><child link="l{n + 1}"/></joint>' for n in range(2)
    )
    (tmp_path / "robot" / "r.urdf").write_text(f'<robot name="r">{parts}{joints}</robot>')
    out = tmp_path / "out"
    out.mkdir()
    assert copy_robot(read_standalone_description(tmp_path / "robot" / "r.urdf"), out, {}) == ()
    assert {p.relative_to(out).as_posix() for p in out.rglob("*.stl")} == {
        "pkg/meshes/a.stl",
        "beside/b.stl",
        "meshes/c.stl",
    }
    assert '"meshes/c.stl"' in (out / "robot.urdf").read_text()
    (tmp_path / "else" / "c.stl").unlink()
    with pytest.raises(InputError, match=r"line 1: collision mesh of link 'l2': no such file"):
        copy_robot(read_standalone_description(tmp_path / "robot" / "r.urdf"), out, {})


def test_similar_arm_of_half_size_has_an_eighth_of_the_stiffness() -> None:
    assert estimate_joint_stiffness(REFERENCE_SPAN_M) == REFERENCE_NM_PER_RAD
    assert np.array(estimate_joint_stiffness(REFERENCE_SPAN_M / 2)) * 8 == pytest.approx(REFERENCE_NM_PER_RAD, rel=5e-3)


def test_path_without_unit_or_feed_is_refused_with_the_options(
    robot: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    """The refusal names the same options as every other command that reads toolpaths."""
    file = tmp_path / "path.csv"
    file.write_text("x,y,z\n" + "".join(f"{0.5 * k},0,0\n" for k in range(4)))
    arguments = ["init", str(robot), "-o", str(tmp_path / "a b"), "--toolpath", str(file)]
    assert main(arguments) == 2
    assert "--unit" in capsys.readouterr().err
    assert main([*arguments, "--unit", "inch"]) == 2
    assert "--feed" in capsys.readouterr().err
    assert main([*arguments, "--unit", "inch", "--feed", "600"]) == 2
    assert "--kind" in capsys.readouterr().err
    assert main([*arguments, "--unit", "inch", "--feed", "600", "--kind", "path"]) == 0
    assert capsys.readouterr().out.endswith(f"next: machopt validate '{tmp_path / 'a b'}'\n")


def test_command_refuses_to_overwrite_and_to_guess(
    robot: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    out = tmp_path / "cell"
    assert main(["init", str(robot), "-o", str(out), "--workpiece-mm", "1500,0,600", "--json"]) == 0
    message = json.loads(capsys.readouterr().out)
    assert InitDocument.model_validate(message).to_json_types() == message
    assert message["flange_link"] == "flange"
    assert message["guesses"]
    before = (out / "cell.yaml").read_bytes()
    assert main(["init", str(robot), "-o", str(out)]) == 2
    assert "is not empty" in capsys.readouterr().err
    assert (out / "cell.yaml").read_bytes() == before
    with pytest.raises(SystemExit, match="2"):
        main(["init", str(robot), "-o", str(tmp_path / "c2"), "--package", "mine=nowhere"])
    assert "expected NAME=FOLDER" in capsys.readouterr().err
    assert [p for p in tmp_path.iterdir() if p.name.startswith(".")] == []


def test_missing_velocities_are_estimated_low_and_reported(robot: Path, tmp_path: Path) -> None:
    """velocity="0" is common in URDFs exported by CAD; the other missing values are also estimated and reported."""
    robot.write_text(robot.read_text().replace('velocity="2"', 'velocity="0"', 1))
    done = run_init(InitRequest(robot=robot, out=tmp_path / "cell", workpiece_mm=(1500.0, 0.0, 600.0)))
    np.testing.assert_allclose(np.degrees(done.cell.limits.velocity), [45.0, *[np.degrees(2.0)] * 5], rtol=1e-4)
    assert any("the URDF has no velocity for a1:" in g and "--velocity-deg-s" in g for g in done.guesses)
    assert (
        "# ESTIMATED for a1, for which the URDF gives no limit: 45 deg/s" in (tmp_path / "cell/cell.yaml").read_text()
    )
    assert not any("above the URDF's velocity" in w for w in done.cell.warnings)


def test_joint_without_zero_in_its_range_has_a_valid_home(robot: Path, tmp_path: Path) -> None:
    """Joint 4 of the Panda ends at -0.0698 rad = -3.99925 deg: three decimals of that value are outside the range."""
    text = robot.read_text()
    high = text.index('upper="', text.index('name="a2"')) + len('upper="')
    robot.write_text(text[:high] + "-0.0698" + text[text.index('"', high) :])
    assert run_init(InitRequest(robot=robot, out=tmp_path / "cell")).folder.is_dir()


def test_seven_axis_arm_is_refused_with_working_advice(tmp_path: Path) -> None:
    text = urdf_text().replace('<parent link="base_link"/>', '<parent link="stand"/>', 1)
    turn = (
        '<link name="stand"/><joint name="a0" type="revolute"><parent link="base_link"/><child link="stand"/>'
        '<axis xyz="0 0 1"/><limit lower="-1" upper="1" velocity="1" effort="1"/></joint></robot>'
    )
    file = tmp_path / "seven.urdf"
    file.write_text(text.replace("</robot>", turn))
    with pytest.raises(InputError, match=r"7 joints .*\(a0, a1, .*, a6\); machopt plans for arms of six") as refused:
        run_init(InitRequest(robot=file, out=tmp_path / "cell"))
    assert "--base-link stand plans with a0 as an external axis" in str(refused.value)
    done = run_init(InitRequest(robot=file, out=tmp_path / "cell", base_link="stand"))
    assert done.cell.external_joints == ("a0",)


@pytest.mark.parametrize("how", ["holds the mesh", "package.xml", "given"])
def test_package_in_a_folder_of_another_name_is_found(how: str, tmp_path: Path) -> None:
    """ROS names a package in package.xml; robots are often distributed in folders with other names."""
    import trimesh

    folder = tmp_path / "kuka_kr" / "urdf"
    folder.mkdir(parents=True)
    package = tmp_path / "elsewhere" if how == "given" else tmp_path / "kuka_kr"
    (package / "meshes").mkdir(parents=True)
    trimesh.creation.box((0.1, 0.1, 0.1)).export(package / "meshes" / "a.stl")
    collision = '<collision><geometry><mesh filename="package://kr_support/meshes/a.stl"/></geometry></collision>'
    macro = urdf_text().replace('<link name="link_1">', f'<link name="link_1">{collision}')
    (folder / "parts.xacro").write_text(macro.replace("<robot", '<robot xmlns:xacro="http://www.ros.org/wiki/xacro"'))
    if how == "given":
        (package / "urdf").mkdir()
        (folder / "parts.xacro").rename(package / "urdf" / "parts.xacro")
    robot = folder / "robot.xacro"
    robot.write_text(
        '<robot name="r" xmlns:xacro="http://www.ros.org/wiki/xacro">'
        '<xacro:include filename="$(find kr_support)/urdf/parts.xacro"/></robot>'
    )
    if how == "package.xml":
        (package / "package.xml").write_text("<package><!-- <name>no</name> --><name>kr_support</name></package>")
    requested = InitRequest(robot=robot, out=tmp_path / "cell", workpiece_mm=(1500.0, 0.0, 600.0))
    if how == "given":
        with pytest.raises(InputError, match=r"refers to the ROS package 'kr_support'.*--package kr_support=FOLDER"):
            run_init(requested)
        requested = replace(requested, packages={"kr_support": package})
    assert (run_init(requested).folder / "kr_support" / "meshes" / "a.stl").is_file()
    if how == "package.xml":  # a folder whose package.xml has another name is not the package, whatever it contains
        (package / "package.xml").write_text("<package><name>other</name></package>")
        with pytest.raises(InputError, match="refers to the ROS package 'kr_support'"):
            run_init(replace(requested, out=tmp_path / "c2"))


@pytest.mark.parametrize("file", sorted(FILES))
def test_schema_of_a_file_is_current(file: str) -> None:
    assert (FOLDER / format_schema_name(file)).read_text(encoding="utf-8") == render_schema(file), (
        "run docs/make_reference.py"
    )
    assert {f.name for f in FOLDER.iterdir()} == {format_schema_name(f) for f in FILES}


def test_post_with_missing_requirements_is_replaced_by_a_related_one(robot: Path, tmp_path: Path) -> None:
    """FANUC's CONFIG needs the sign of J5 in N, which no URDF states: the first validate must not fail."""
    done = run_init(InitRequest(robot=robot, out=tmp_path / "cell", workpiece_mm=(1000.0, 0.0, 500.0), post="fanuc"))
    assert done.cell.controller.post == "fanuc_joint"
    assert any("controller.nonflip_j5 in cell.yaml allows fanuc" in g for g in done.guesses)
    assert "# fanuc once controller.nonflip_j5 is known" in (tmp_path / "cell" / "cell.yaml").read_text()
    with pytest.raises(InputError, match="krll"):
        run_init(InitRequest(robot=robot, out=tmp_path / "other", workpiece_mm=(1000.0, 0.0, 500.0), post="krll"))
    assert not (tmp_path / "other").exists()


def test_program_of_joint_positions_is_reached_by_its_robot(robot: Path, tmp_path: Path) -> None:
    program = tmp_path / "job.src"
    lines = "".join(f"LIN {{A1 {a},A2 -80,A3 100,A4 0,A5 45,A6 0}}\n" for a in (5, 8, 10))
    program.write_text(f"DEF job()\n$VEL.CP=0.02\nPTP {{A1 0,A2 -90,A3 90,A4 0,A5 45,A6 0}}\n{lines}END\n")
    done = run_init(InitRequest(robot=robot, out=tmp_path / "cell", toolpath=program))
    assert not any("no place" in guess for guess in done.guesses)


def test_program_instead_of_a_robot_is_refused_with_what_is_expected(tmp_path: Path) -> None:
    program = tmp_path / "job.src"
    program.write_text("DEF job()\nEND\n")
    with pytest.raises(InputError, match=r"is not XML.*expected a URDF"):
        run_init(InitRequest(robot=program, out=tmp_path / "cell"))
