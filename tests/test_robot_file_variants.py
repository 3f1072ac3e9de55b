"""Robot files of manufacturers and tools: unused elements cause a note, errors name their line and a working remedy."""

from __future__ import annotations

import json
import re
from pathlib import Path

import numpy as np
import pytest
import trimesh
from small_cell import urdf_text

from machopt.cell.cell_reader import load_cell
from machopt.cell.urdf import read_robot
from machopt.cell_setup.template.init_request import InitRequest
from machopt.cell_setup.template.init_result import InitResult
from machopt.cli import main
from machopt.commands.init import run_init
from machopt.errors import InputError
from machopt.kinematics.urdf_loading import load_chain, load_robot
from machopt.verification.motion.collision.bodies import build_bodies
from machopt.verification.motion.kinematics.urdf_kinematics import UrdfKinematics

PLACE = (1500.0, 0.0, 600.0)
BOX = '<collision><geometry><box size="0.3 0.1 0.1"/></geometry></collision>'
MASS = '<inertial><mass value="40"/><inertia ixx="1" ixy="0" ixz="0" iyy="1" iyz="0" izz="1"/></inertial>'
LIMIT = '<limit lower="-2" upper="2" velocity="3" effort="1"/>'


def run_init_on_text(text: str, folder: Path, **options: object) -> InitResult:
    file = folder / "arm.urdf"
    file.write_text(text)
    return run_init(InitRequest(robot=file, out=folder / "cell", workpiece_mm=PLACE, **options))  # type: ignore[arg-type]


def with_parts(parts: str) -> str:
    return urdf_text().replace("</robot>", f"{parts}</robot>")


def follower(
    mimic: str,
    parent: str = "link_1",
    kind: str = "continuous",
    name: str = "cylinder",
    body: str = BOX,
    limit: str = "",
) -> str:
    return (
        f'<link name="link_{name}">{body}</link><joint name="{name}" type="{kind}"><origin xyz="-0.3 0.4 0.1"/>'
        f'<parent link="{parent}"/><child link="link_{name}"/><axis xyz="0 1 0"/>{limit}{mimic}</joint>'
    )


SIDE = {
    "balancer": follower('<mimic joint="a2" multiplier="-0.25"/>'),
    "whole_number": follower('<mimic joint="a2" multiplier="-1"/>'),
    "zero": follower('<mimic joint="a2" multiplier="0"/>'),
    "offset": follower('<mimic joint="a2" multiplier="-0.165" offset="0.2"/>'),
    "base": follower('<mimic joint="a2" multiplier="0.3"/>', "base_link"),
    "rod_of_elbow": follower('<mimic joint="a3" multiplier="-1"/>', "link_2"),
    "piston": follower('<mimic joint="a2" multiplier="0.1"/>', kind="prismatic", limit=LIMIT),
    "revolute": follower('<mimic joint="a2" multiplier="-0.4"/>', kind="revolute", limit=LIMIT),
    "with_mass": follower('<mimic joint="a2" multiplier="-0.25"/>', body=BOX + MASS),
    "mass_only": follower('<mimic joint="a2" multiplier="-0.25"/>', body=MASS),
    "cylinder_and_piston": follower('<mimic joint="a2" multiplier="-0.25"/>')
    + follower('<mimic joint="a2" multiplier="0.1"/>', "link_cylinder", "prismatic", "piston", limit=LIMIT),
    "of_a_follower": follower('<mimic joint="a2" multiplier="-0.25"/>')
    + follower('<mimic joint="cylinder" multiplier="2"/>', "link_2", name="rod"),
    "rod_with_end": follower('<mimic joint="a3" multiplier="-1"/>', "link_2")
    + f'<link name="end">{BOX}</link><joint name="e" type="fixed"><parent link="link_cylinder"/>'
    '<child link="end"/></joint>',
    "behind_wrist": follower('<mimic joint="a5" multiplier="0.5"/>', "link_4"),
}


@pytest.mark.parametrize("name", sorted(SIDE))
def test_joint_outside_the_chain_is_left_out_and_reported(name: str, tmp_path: Path) -> None:
    """Planner and verifier have the bodies and the kinematics
    of the arm without the joint; the masses are unchanged."""
    cell = run_init_on_text(with_parts(SIDE[name]), tmp_path).cell
    output = [w for w in cell.warnings if "outside of the chain" in w]
    bodies = SIDE[name].count("<collision>")
    assert bool(output) == bool(bodies or "<mass" in SIDE[name])
    robot, shapes = load_chain(cell)
    assert len(shapes) == 7
    assert sum(b.kind == "link" for b in build_bodies(cell, UrdfKinematics(cell))) == 7
    plain = tmp_path / "plain"
    plain.mkdir()
    q = np.linspace(-1.0, 1.0, 6)
    np.testing.assert_allclose(
        robot.compute_fk(q), load_robot(run_init_on_text(urdf_text(), plain).cell).compute_fk(q), atol=1e-12
    )
    np.testing.assert_allclose(
        UrdfKinematics(cell).compute_configuration(q[None]).flange[0], robot.compute_fk(q), atol=1e-12
    )


def test_coupled_wrist_is_refused_without_wrong_advice(tmp_path: Path) -> None:
    """A hollow wrist with two bends: axis 5 and a following joint that rotates back about another line."""
    text = urdf_text()
    at = text.index('<joint name="a6"')
    text = text[:at] + text[at:].replace('<parent link="link_5"/>', '<parent link="bend"/>', 1)
    bend = (
        f'<link name="bend">{BOX}</link><joint name="back" type="revolute"><origin xyz="0.1 0 0" rpy="0 -1.2 0"/>'
        f'<parent link="link_5"/><child link="bend"/><axis xyz="1 0 0"/>{LIMIT}'
        '<mimic joint="a5" multiplier="-1"/></joint>'
    )
    with pytest.raises(InputError) as refused:
        run_init_on_text(text.replace("</robot>", bend + "</robot>"), tmp_path)
    assert "would be planned" not in str(refused.value)


UNUSED = {
    "axis_rpy": ('<axis xyz="0 0 -1"/>', '<axis xyz="0 0 -1" rpy="0 0 0"/>'),
    "dynamics_letter": ('<axis xyz="0 0 -1"/>', '<axis xyz="0 0 -1"/><dynamics D="0.5"/>'),
    "dynamics_more": ('<axis xyz="0 0 -1"/>', '<axis xyz="0 0 -1"/><dynamics damping="1" viscosity="2"/>'),
    "dynamics_empty": ('<axis xyz="0 0 -1"/>', '<axis xyz="0 0 -1"/><dynamics/>'),
    "kinematic": ("</robot>", "<kinematic><a>1</a></kinematic></robot>"),
    "kinematic_in_link": ('<link name="flange"/>', '<link name="flange"><kinematic/></link>'),
    "kinematic_in_joint": ('<axis xyz="0 0 -1"/>', '<axis xyz="0 0 -1"/><kinematic/>'),
    "origin_in_link": ('<link name="flange"/>', '<link name="flange"><origin xyz="0 0 1"/></link>'),
    "joint_attribute": ('<joint name="a1"', '<joint group="arm" name="a1"'),
    "link_attribute": ('<link name="flange"/>', '<link name="flange" id="7"/>'),
    "robot_attribute": ('<robot name="small"', '<robot name="small" author="somebody"'),
    "limit_attribute": ('velocity="2"', 'velocity="2" note="estimated"'),
    "safety_attribute": (
        '<axis xyz="0 0 -1"/>',
        '<axis xyz="0 0 -1"/><safety_controller k_velocity="1" origin_of="maker"/>',
    ),
}


@pytest.mark.parametrize("name", sorted(UNUSED))
def test_unused_elements_cause_a_note(name: str, tmp_path: Path) -> None:
    old, new = UNUSED[name]
    assert old in urdf_text()
    cell = run_init_on_text(urdf_text().replace(old, new, 1), tmp_path).cell
    known = len(run_init_on_text(urdf_text(), plain_folder(tmp_path)).cell.warnings)
    assert len(cell.warnings) > known or any("not used" in n for n in cell.notes)
    assert load_robot(cell).axis.shape == (6, 3)


def plain_folder(folder: Path) -> Path:
    (folder / "plain").mkdir()
    return folder / "plain"


MEANT = {
    "velocity": ('velocity="2"', 'velocty="2"'),
    "multiplier": ('<axis xyz="0 0 -1"/>', '<axis xyz="0 0 -1"/><mimic joint="a2" multipler="2"/>'),
    "quaternion": ('<origin xyz="0.0 0.0 0.675"', '<origin quat="1 0 0 0" xyz="0.0 0.0 0.675"'),
    "degrees": ('<origin xyz="0.0 0.0 0.675" rpy="0 0 0"', '<origin xyz="0.0 0.0 0.675" rpy_deg="0 0 0"'),
    "axis": ('<axis xyz="0 0 -1"/>', '<axis xzy="0 0 -1"/>'),
    "mass_in_joint": ('<axis xyz="0 0 -1"/>', '<axis xyz="0 0 -1"/><inertial/>'),
    "collision_in_joint": ('<axis xyz="0 0 -1"/>', f'<axis xyz="0 0 -1"/><group>{BOX}</group>'),
    "colision": ('<link name="flange"/>', '<link name="flange"><colision/></link>'),
    "unit": ('<box size="0.6 0.6 0.4"/>', '<box size="0.6 0.6 0.4" unit="mm"/>'),
    "mesh_unit": ('<box size="0.6 0.6 0.4"/>', '<mesh filename="a.stl" unit="mm"/>'),
}


@pytest.mark.parametrize("name", sorted(MEANT))
def test_ambiguous_elements_are_refused(name: str, tmp_path: Path) -> None:
    old, new = MEANT[name]
    assert old in urdf_text()
    (tmp_path / "arm.urdf").write_text(urdf_text().replace(old, new, 1))
    with pytest.raises(InputError, match=r"line \d+"):
        read_robot(tmp_path / "arm.urdf")


def limit_joints(joints: tuple[str, ...], **values: float) -> str:
    text = urdf_text()
    for name in joints:
        at = text.index("<limit", text.index(f'<joint name="{name}"'))
        end = text.index("/>", at)
        limit = text[at:end]
        for key, value in values.items():
            limit = re.sub(rf'{key}="[^"]*"', f'{key}="{value}"', limit)
        text = text[:at] + limit + text[end:]
    return text


@pytest.mark.parametrize("turn", [6.2832, 6.29, 6.4, 7.85, 9.43, 12.57, 12.6, 13.0, 18.9, 25.0])
def test_limits_above_a_turn_are_those_of_a_wrist(turn: float, tmp_path: Path) -> None:
    cell = run_init_on_text(limit_joints(("a4", "a6"), lower=-turn, upper=turn), tmp_path).cell
    assert cell.limits.upper[[3, 5]] == pytest.approx([turn, turn], abs=2e-4)


@pytest.mark.parametrize("degrees", [45.0, 90.0, 185.0, 360.0])
def test_limits_in_degrees_are_refused_with_the_values_in_radians(degrees: float, tmp_path: Path) -> None:
    file = tmp_path / "arm.urdf"
    file.write_text(limit_joints(("a1", "a4", "a6"), lower=-degrees, upper=degrees))
    with pytest.raises(InputError) as refused:
        run_init(InitRequest(robot=file, out=tmp_path / "cell", workpiece_mm=PLACE))
    radians = float(re.findall(r"to ([\d.]+) would work", str(refused.value))[0])
    assert radians == pytest.approx(np.radians(degrees), rel=1e-4)
    run_init_on_text(limit_joints(("a1", "a4", "a6"), lower=-radians, upper=radians), tmp_path)


@pytest.mark.parametrize("velocity", [200.0, 1000.0, 3.6e5, 1e-5])
def test_impossible_velocity_names_the_urdf_and_the_option(
    velocity: float, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    file = tmp_path / "arm.urdf"
    file.write_text(limit_joints(("a3",), velocity=velocity))
    command = ["init", str(file), "-o", str(tmp_path / "cell"), "--workpiece-mm", "1500,0,600"]
    assert main(command) == 2
    message = capsys.readouterr().err
    assert str(file) in message
    assert "line " in message
    assert "cell.yaml" not in message
    assert "--velocity-deg-s" in message
    assert main([*command, "--velocity-deg-s", "100,100,100,200,200,200"]) == 0
    path = tmp_path / "cell" / "cell.yaml"  # the cell takes the velocity from the URDF
    path.write_text("\n".join(line for line in path.read_text().split("\n") if "velocity_deg_s" not in line))
    with pytest.raises(InputError) as refused:
        load_cell(tmp_path / "cell")
    assert str(refused.value).startswith(str(tmp_path / "cell" / "robot.urdf"))


@pytest.mark.parametrize(
    ("velocity", "warned"), [(2.0, False), (26.0, False), (34.0, False), (36.0, True), (100.0, True)]
)
def test_velocity_above_every_data_sheet_causes_a_warning(velocity: float, warned: bool, tmp_path: Path) -> None:
    cell = run_init_on_text(limit_joints(("a6",), velocity=velocity), tmp_path).cell
    assert any("faster than any arm" in w for w in cell.warnings) == warned


XACRO = '<?xml version="1.0"?>\n<robot name="small" xmlns:xacro="http://ros.org/wiki/xacro">\n'


def xacro_of(head: str) -> str:
    body = urdf_text().removeprefix('<robot name="small">').replace('xyz="1.15 0.0 0.0"', 'xyz="$(arg reach) 0.0 0.0"')
    return f"{XACRO}{head}{body}"


def test_missing_argument_is_named_and_accepted(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    file = tmp_path / "arm.urdf.xacro"
    for head in ('<xacro:arg name="reach"/>', ""):
        file.write_text(xacro_of(head))
        for command in (["inspect", str(file)], ["init", str(file), "-o", str(tmp_path / "c")]):
            assert main(command) == 2
            assert "--xacro-arg reach=VALUE" in capsys.readouterr().err
    file.write_text(xacro_of('<xacro:arg name="reach"/>'))
    assert main(["inspect", str(file), "--xacro-arg", "reach=1.15", "--json"]) == 0
    assert json.loads(capsys.readouterr().out)["collision_bodies"] == 7
    out = tmp_path / "cell"
    assert main(["init", str(file), "-o", str(out), "--xacro-arg", "reach=1.15"]) == 0
    assert load_robot(load_cell(out)).compute_fk(np.zeros(6))[0, 3] > 1.0  # the expanded robot needs no arguments
    capsys.readouterr()
    assert main(["inspect", str(file), "--xacro-arg", "raech=1", "--xacro-arg", "reach=1"]) == 2
    assert "raech" in capsys.readouterr().err
    with pytest.raises(SystemExit):
        main(["inspect", str(file), "--xacro-arg", "reach"])


@pytest.mark.parametrize("option", ["--xacro-arg", "--package"])
def test_robot_options_are_refused_for_other_files(
    option: str, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    (tmp_path / "p.csv").write_text("x_mm,y_mm,z_mm,i,j,k,feed_mm_min\n0,0,0,0,0,1,600\n1,0,0,0,0,1,600\n")
    assert main(["inspect", str(tmp_path / "p.csv"), option, f"a={tmp_path}"]) == 2
    assert option in capsys.readouterr().err
    cell = run_init_on_text(urdf_text(), tmp_path).folder
    assert main(["inspect", str(cell), option, f"a={tmp_path}"]) == 2
    assert main(["inspect", str(tmp_path / "arm.urdf"), "--xacro-arg", "a=1"]) == 2


@pytest.mark.parametrize("where", ["relative", "absolute", "up"])
def test_package_is_found_from_the_current_folder(where: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    robot, other = tmp_path / "in" / "robot" / "urdf", tmp_path / "lib" / "my_res" / "urdf"
    robot.mkdir(parents=True)
    other.mkdir(parents=True)
    (other / "c.xacro").write_text(
        '<robot xmlns:xacro="http://ros.org/wiki/xacro"><xacro:property name="r" value="1.15"/></robot>'
    )
    text = xacro_of('<xacro:include filename="$(find my_res)/urdf/c.xacro"/>').replace("$(arg reach)", "${r}")
    (robot / "r.xacro").write_text(text)
    monkeypatch.chdir(tmp_path if where != "up" else robot)
    folder = {"relative": "lib/my_res", "absolute": str(other.parent), "up": "../../../lib/my_res"}[where]
    file = str(robot / "r.xacro")
    assert main(["inspect", file]) == 2
    assert main(["inspect", file, "--package", f"my_res={folder}"]) == 0
    assert main(["init", file, "-o", str(tmp_path / "out"), "--package", f"my_res={folder}"]) == 0


PLATES = {
    "plate": '<box size="0.12 0.12 0.005"/>',
    "thin": '<cylinder radius="0.05" length="0.002"/>',
    "small_box": '<box size="0.005 0.005 0.005"/>',
    "pin": '<cylinder radius="0.002" length="0.005"/>',
    "ball": '<sphere radius="0.002"/>',
    "mesh": '<mesh filename="plate.stl"/>',
    "mesh_in_mm": '<mesh filename="plate_mm.stl" scale="0.001 0.001 0.001"/>',
}


@pytest.mark.parametrize("name", sorted(PLATES))
def test_adapter_plate_is_no_wrong_unit(name: str, tmp_path: Path) -> None:
    trimesh.creation.box((0.005, 0.005, 0.002)).export(tmp_path / "plate.stl")
    trimesh.creation.box((5.0, 5.0, 2.0)).export(tmp_path / "plate_mm.stl")
    plate = f'<link name="flange"><collision><geometry>{PLATES[name]}</geometry></collision></link>'
    run_init_on_text(urdf_text().replace('<link name="flange"/>', plate), tmp_path)


@pytest.mark.parametrize("sides", [(0.0003, 0.0002, 0.0001), (0.0015, 0.001, 0.001), (0.0028, 0.001, 0.001)])
def test_link_in_thousandths_is_refused(sides: tuple[float, ...], tmp_path: Path) -> None:
    trimesh.creation.box(sides).export(tmp_path / "a.stl")
    mesh = '<link name="flange"><collision><geometry><mesh filename="a.stl"/></geometry></collision></link>'
    with pytest.raises(InputError, match="scale=") as refused:
        run_init_on_text(urdf_text().replace('<link name="flange"/>', mesh), tmp_path)
    scale = re.findall(r'scale="[^"]*"', str(refused.value))[0]
    run_init_on_text(
        urdf_text().replace('<link name="flange"/>', mesh.replace("/></geo", f" {scale}/></geo")), tmp_path
    )


def test_endless_joint_becomes_continuous_as_advised(tmp_path: Path) -> None:
    text = limit_joints(("a6",), lower=-1e4, upper=1e4)
    with pytest.raises(InputError, match='type="continuous"'):
        run_init_on_text(text, tmp_path)
    run_init_on_text(text.replace('<joint name="a6" type="revolute">', '<joint name="a6" type="continuous">'), tmp_path)


@pytest.mark.parametrize("kind", ["seven", "turntable"])
def test_advised_link_gives_an_arm(kind: str, tmp_path: Path) -> None:
    joint = (
        '<link name="more"/><joint name="a0" type="revolute"><parent link="PARENT"/><child link="CHILD"/>'
        f'<origin xyz="0 0 0.1"/><axis xyz="0 0 1"/>{LIMIT}</joint>'
    )
    text = urdf_text()
    axis = "0 0 1" if kind == "turntable" else "0 1 0"
    joint = (
        joint.replace("PARENT", "more").replace("CHILD", "base_link").replace('axis xyz="0 0 1"', f'axis xyz="{axis}"')
    )
    text = text.replace("</robot>", joint + "</robot>")
    with pytest.raises(InputError) as refused:
        run_init_on_text(text, tmp_path)
    for option, link in re.findall(r"--(base|flange)-link (\S+?)[ ;]", str(refused.value)):
        place = {} if option == "base" else {"workpiece_mm": PLACE}
        file = tmp_path / "arm.urdf"
        done = run_init(InitRequest(robot=file, out=tmp_path / f"{option}", **{f"{option}_link": link}, **place))  # type: ignore[arg-type]
        assert len(done.cell.arm_joints) == 6


@pytest.mark.parametrize("uri", ["package://gone/meshes/a.stl", "gone.stl", "../gone.stl"])
def test_missing_mesh_is_a_note_where_only_kinematics_is_needed(uri: str, tmp_path: Path) -> None:
    folder = run_init_on_text(urdf_text(), tmp_path).folder
    body = f'<collision><geometry><mesh filename="{uri}"/></geometry></collision>'
    robot = folder / "robot.urdf"
    robot.write_text(robot.read_text().replace('<link name="flange"/>', f'<link name="flange">{body}</link>'))
    with pytest.raises(InputError):
        load_cell(folder)
    cell = load_cell(folder, bodies=False)
    assert sum("'flange' is missing" in w for w in cell.warnings) == 1
    assert len(load_chain(cell)[1]) == 7
    with pytest.raises(InputError, match=r"--package gone=FOLDER" if "package" in uri else "gone"):
        run_init_on_text(robot.read_text(), plain_folder(tmp_path))
