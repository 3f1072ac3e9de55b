"""External axes in programs: values, frames and groups of every maker, written and read back."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from external_axis_cells import external_cell
from small_cell import pose

from machopt.data_types.cell import Cell
from machopt.data_types.robot_program import LIN, PTP, ExternalAxisMap, RobotController, RobotProgram
from machopt.data_types.toolpath import MoveKind
from machopt.errors import InputError
from machopt.kinematics.urdf_loading import load_robot
from machopt.programs.maker_registry import find_language
from machopt.programs.program_reader import ParsedProgram, read_program
from machopt.programs.program_writer import list_assumptions, write_program
from machopt.verification.folder.programs.frames_and_axes import (
    compute_workpiece_frame,
    convert_external_joints,
    find_wrong_frames,
)
from machopt.verification.folder.programs.post_lookup import (
    build_short_program,
    compute_workpiece_in_base,
    get_workpiece_on_positioner,
    list_external_axes,
    select_controller,
)
from machopt.verification.motion.kinematics.urdf_kinematics import UrdfKinematics

PRINTED = 0.51e-4  # mm or deg: four decimals
KINDS = {"rail": {"rail": True}, "table": {"table": True}, "both": {"rail": True, "table": True, "tilt": True}}
POSTS = {
    "krl": "part.src",
    "krl_pos": "part.src",
    "krl_spline": "part.src",
    "rapid": "part.mod",
    "fanuc": "PART.ls",
    "fanuc_joint": "PART.ls",
    "jbi": "PART.JBI",
    "csv": "part.csv",
    "json": "part.json",
    "ros_json": "part.json",
    "compas_fab": "part.json",
    "ros_yaml": "part.yaml",
}


def drives(cell: Cell, **more: object) -> dict[str, ExternalAxisMap]:
    """Return external axes with numbers in another order; one has the opposite sign and an offset."""
    own = {
        "rail": ExternalAxisMap(number=4, sign=-1.0, offset=250.0, unit=None, machine=None),
        "tilt": ExternalAxisMap(number=3, sign=1.0, offset=-30.0, unit="STN2", machine=3),
        "turn": ExternalAxisMap(number=2, sign=-1.0, offset=90.0, unit="STN2", machine=3),
    }
    return {name: replace(own[name], **more) for name in cell.external_joints}  # type: ignore[arg-type]


def controller(cell: Cell, **more: object) -> RobotController:
    return RobotController(nonflip_j5="negative", T_world_root=pose(0.4, -0.3, 0.2), external=drives(cell, **more))


def program(cell: Cell, n: int = 7) -> RobotProgram:
    arm, share = UrdfKinematics(cell), np.linspace(0.0, 1.0, n)[:, None]
    low, high = cell.limits.lower, cell.limits.upper
    x = np.hstack([cell.home + 0.2 * share, low[6:] + (0.3 + 0.3 * share) * (high - low)[6:]])
    x[0, 6:] = cell.external_home
    made = build_short_program(cell, load_robot(cell), controller(cell))
    kind = np.array([PTP, PTP, *[LIN] * (n - 3), PTP], np.int8)
    return replace(
        made,
        kind=kind,
        q=x[:, :6],
        external=x[:, 6:],
        T_workpiece_tcp=arm.compute_tcp_in_workpiece(x[:, :6], x[:, 6:]),
        feed=np.where(kind == LIN, 0.02, np.nan),
        cutting=kind == LIN,
        operation=np.zeros(n, np.int32),
        move=np.where(kind == LIN, MoveKind.CUT, MoveKind.RAPID).astype(np.int8),
        time=np.arange(float(n)),
        wrist_behind=np.zeros(n, bool),
        elbow_up=np.ones(n, bool),
    )


def write_and_read_program(
    folder: Path, cell: Cell, post: str, c: RobotController, p: RobotProgram | None = None
) -> ParsedProgram:
    file = POSTS.get(post, "")
    write_program(folder, Path(file).stem, p or program(cell), post, c)
    return read_program(folder / file)


@pytest.mark.parametrize("kind", KINDS)
@pytest.mark.parametrize("post", POSTS)
def test_values_and_frames_are_read_back(tmp_path: Path, post: str, kind: str) -> None:
    cell = external_cell(tmp_path, **KINDS[kind])
    arm, c, p = UrdfKinematics(cell), controller(cell), program(cell)
    parsed = write_and_read_program(tmp_path, cell, post, c, p)
    found, spare = convert_external_joints(parsed, cell, arm, c)
    assert spare == 0
    unit = np.where(cell.external_prismatic, 1e3, 180.0 / np.pi)
    np.testing.assert_allclose(found * unit, p.external * unit, atol=PRINTED, rtol=0)
    given = compute_workpiece_frame(parsed, cell, arm, c, p.external[0])
    rides = find_language(parsed.dialect).couples_frames and kind != "rail"
    assert find_wrong_frames(parsed, c, given, cell.tool.T_flange_tcp, rides=rides) == []
    if parsed.has_pose.any():
        lines = parsed.has_pose
        np.testing.assert_allclose(parsed.T_base_tcp[lines], p.T_workpiece_tcp[lines], atol=2e-7)


def test_programs_have_the_words_of_each_maker(tmp_path: Path) -> None:
    """The statements that couple the axes are those in public programs of each maker."""
    both = external_cell(tmp_path, rail=True, table=True)
    c = controller(both)
    texts = {}
    for post, file in POSTS.items():
        write_and_read_program(tmp_path, both, post, c)
        texts[post] = (tmp_path / file).read_text().replace("\r\n", "\n")
    krl = texts["krl"]
    assert "$BASE=EK(MACHINE_DEF[3].ROOT,MACHINE_DEF[3].MECH_TYPE,MO_BASE)\n$ACT_EX_AX=3\n" in krl
    assert "$ROBROOT rides on E4: its $ERSYSROOT" in krl
    assert ",E2 90.0000,E4 250.0000}" in krl  # home: all joints at zero, offsets only
    assert 'PERS wobjdata w_part:=[FALSE,FALSE,"STN2",[[0,0,0],[1,0,0,0]],[[' in texts["rapid"]
    assert "    ActUnit STN2;\n" in texts["rapid"]
    assert "[9E9,90.0000,9E9,250.0000,9E9,9E9]" in texts["rapid"]
    assert "DEFAULT_GROUP	= 1,1,*,*,*;" in texts["fanuc"]
    assert "	E1= 250.0000 mm\n   GP2:\n	UF : 0, UT : 1,\n	J1= 90.0000 deg" in texts["fanuc"]
    assert "FINE COORD ;" in texts["fanuc"]
    jbi = texts["jbi"]
    assert "///NPOS 7,7,7,0,0,0" in jbi
    assert "///GROUP1 RB1,BS1\n///GROUP2 ST1\n" in jbi
    assert "MOVJ C00001 BC00001 VJ=80.00 PL=0 +MOVJ EC00001 VJ=80.00" in jbi
    assert "SMOVL C00003 BC00003 V=20.0 PL=0 +MOVJ EC00003 VJ=80.00" in jbi
    assert "BC00001=250.0000\n" in jbi
    assert '"a6", "rail", "turn"]' in texts["ros_json"]


def test_pulses_of_base_and_station(tmp_path: Path) -> None:
    cell = external_cell(tmp_path, rail=True, table=True)
    c, p = controller(cell, pulses=878.0), program(cell)
    parsed = write_and_read_program(tmp_path, cell, "jbi", c, p)
    assert "BC00001=219500\n" in (tmp_path / "PART.JBI").read_text()
    found, _ = convert_external_joints(parsed, cell, UrdfKinematics(cell), c)
    unit = np.where(cell.external_prismatic, 1e3, 180.0 / np.pi)
    np.testing.assert_allclose(found * unit, p.external * unit, atol=0.51 / 878.0, rtol=0)


def test_base_on_a_rail_alone_is_in_world(tmp_path: Path) -> None:
    cell = external_cell(tmp_path, rail=True)
    c = controller(cell)
    parsed = write_and_read_program(tmp_path, cell, "krl", c)
    assert c.T_world_root is not None
    wanted = np.linalg.inv(c.T_world_root) @ cell.workpiece.T_link_workpiece
    np.testing.assert_allclose(parsed.bases[-1].T, wanted, atol=1e-7)
    assumptions = list_assumptions(program(cell), "krl", replace(c, T_world_root=None, external={}))
    assert "no controller.world in the cell: the controller's WORLD is the cell's world" in assumptions
    assert any("controller.external.rail" in t for t in assumptions)


def test_wrong_or_moving_frame_is_reported(tmp_path: Path) -> None:
    cell = external_cell(tmp_path, table=True)
    c = controller(cell)
    write_and_read_program(tmp_path, cell, "rapid", c)
    file = tmp_path / "part.mod"
    file.write_text(
        file.read_text().replace('[FALSE,FALSE,"STN2",[[0,0,0],[1,0,0,0]],', '[FALSE,TRUE,"",[[0,0,0],[1,0,0,0]],')
    )
    parsed = read_program(file)
    arm = UrdfKinematics(cell)
    given = compute_workpiece_frame(parsed, cell, arm, c, cell.external_home)
    found = find_wrong_frames(parsed, c, given, cell.tool.T_flange_tcp, rides=True)
    assert "is at rest, the workpiece is carried" in found[0]


def test_languages_without_external_axes_refuse(tmp_path: Path) -> None:
    cell = external_cell(tmp_path, rail=True)
    p = program(cell)
    with pytest.raises(InputError, match=r"URScript has no external axes.*rail"):
        write_program(tmp_path, "part", p, "urscript", RobotController())
    with pytest.raises(InputError, match=r"VAL3 moves no rail or positioner.*mode locked"):
        write_program(tmp_path, "part", p, "val3", RobotController())
    table = external_cell(tmp_path, table=True)
    with pytest.raises(InputError, match="do not ride on a station here"):
        write_program(tmp_path, "PART", program(table), "jbi_rectan", controller(table))


def test_val3_states_the_required_rail_position(tmp_path: Path) -> None:
    cell = external_cell(tmp_path, rail=True)
    rested = np.full((7, 1), 0.8)
    arm, p = UrdfKinematics(cell), program(cell)
    T = arm.compute_tcp_in_workpiece(p.q, rested)
    p = replace(p, external=rested, T_workpiece_tcp=T, T_base_workpiece=compute_workpiece_in_base(cell, rested[0]))
    write_program(tmp_path, "part", p, "val3", controller(cell))
    parsed = read_program(tmp_path / "part" / "part.pjx")
    found, spare = convert_external_joints(parsed, cell, arm, controller(cell))
    np.testing.assert_allclose(found, rested, atol=1e-8)
    given = compute_workpiece_frame(parsed, cell, arm, controller(cell), rested[0])
    assert spare == 0
    assert find_wrong_frames(parsed, controller(cell), given, cell.tool.T_flange_tcp, rides=False) == []


def test_frames_follow_the_carrying_axis(tmp_path: Path) -> None:
    cell = external_cell(tmp_path, rail=True, table=True, tilt=True)
    assert [(a.joint, a.slides, a.carries_part) for a in list_external_axes(cell)] == [
        ("rail", True, False),
        ("tilt", False, True),
        ("turn", False, True),
    ]
    np.testing.assert_array_equal(get_workpiece_on_positioner(cell), cell.workpiece.T_link_workpiece)
    assert list_external_axes(replace(cell, external_joints=(), external_prismatic=())) == ()
    assert select_controller(cell, "krl").external == {}
