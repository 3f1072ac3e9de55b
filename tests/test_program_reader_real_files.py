"""Real robot programs from the team's local test data; skipped if absent (they may not be published)."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from machopt.data_types.toolpath import MoveKind
from machopt.errors import InputError
from machopt.file_formats.source_file import ReadOptions
from machopt.programs.program_reader import is_program, read_program, read_program_as_toolpath
from machopt.programs.reading.called_files import try_read_source

DATA = Path(__file__).resolve().parents[2] / "shared" / "data" / "cam"
pytestmark = pytest.mark.skipif(not (DATA / "index.csv").exists(), reason="../shared/data/cam is not here")

# file: number of toolpath points, cut points, events; None if the program has no feed and one must be given
READ = {
    "robot_abb/Clement-RACINET__Mod_Traj_sphere05mm.mod": (7289, 7289, 0),
    "robot_abb/Clement-RACINET__mod_exemple.mod": (17, 17, 0),
    "robot_abb/TPHugo__MainModule.mod": (296, 133, 264),
    "robot_abb/TPHugo__T_ROB1.mod": (351, 339, 35),
    "robot_abb/TPHugo__test_3.prg": (83, 36, 81),
    "robot_fanuc/Creearc__cub.ls": (999, 999, 48),
    "robot_fanuc/Creearc__cub_2.ls": (642, 642, 28),
    "robot_fanuc/Surfacerobot__surface_cartesian.ls": (21, 20, 0),
    "robot_kuka/HugoDanielson__CNCTEST.src": (779, 779, 0),
    "robot_kuka/HugoDanielson__CNCTEST.dat": (779, 779, 0),
    "robot_other/RoboDK__PROGRAM.JBI": (4, 4, 5),
    "robot_ur/RoboDK__UniveralRobots.script": (8, 8, 2),
}
REFUSED = {
    "robot_abb/0-robinson-1__005_home_corner_square_v2.mod": "line 7: pHome is declared in none of the modules read",
    "robot_abb/0-robinson-1__008_circle_track_v2.mod": "line 24: pHome is declared in none of the modules read",
    "robot_abb/0-robinson-1__010_conical_helix_v2.mod": "line 48: pHome is declared in none of the modules read",
    "robot_abb/ebruun__SheetformingTODAY_T_ROB1.mod": "76 joint moves and no linear one",
    "robot_abb/ebruun__SheetformingTODAY_T_ROB2.mod": "76 joint moves and no linear one",
    "robot_fanuc/kobbled__rdk_cell1_hs.ls": "holds no moves",
    "robot_fanuc/Surfacerobot__surface.ls": "line 24: Tool_Offset,PR[15] shifts the point",
    "robot_kuka/HugoDanielson__CNC6.dat": "is a data list without a program; give the .src",
    "robot_kuka/HugoDanielson__CNC_LOOP.src": "GFCNCPOINT1 is declared in none of the files read",
    "robot_kuka/ros-industrial__i_hw_interface_krl_KR_C4__ros_rsi.src": "2 joint moves and no linear one",
    "robot_kuka/ros-industrial__kuka_eki_hw_interface.src": "JOINT_POS_TGT gets its value only while the robot runs",
    "robot_ur/RoboDK__UniveralRobots.urp": "is a PolyScope program",
    "robot_ur/UniversalRobots__dmgmori_simple.script": "holds no moves",
    "robot_ur/UniversalRobots__joint_impedance_cartesian_circle_motion.script": "holds no moves",
}


def test_every_robot_program_is_covered() -> None:
    found = {f.relative_to(DATA).as_posix() for f in DATA.glob("robot_*/*") if f.is_file()}
    assert found == set(READ) | set(REFUSED)


@pytest.mark.parametrize("name", READ)
def test_real_programs_are_read(name: str) -> None:
    t = read_program_as_toolpath(DATA / name, ReadOptions(default_feed=0.02))
    points, cut, events = READ[name]
    assert (len(t), int(t.cutting.sum()), len(t.events)) == (points, cut, events)
    assert np.isfinite(t.position).all()
    np.testing.assert_allclose(np.linalg.norm(t.axis, axis=1), 1.0, atol=1e-12)
    # the x axis of the tool is perpendicular to the tool axis
    assert np.abs(np.sum(t.axis * t.reference, axis=1)).max() < 1e-9
    assert t.format.startswith("robot/")


@pytest.mark.parametrize("name", REFUSED)
def test_other_programs_are_refused_with_a_reason(name: str) -> None:
    with pytest.raises(InputError) as caught:
        read_program_as_toolpath(DATA / name, ReadOptions(default_feed=0.02))
    assert REFUSED[name] in str(caught.value)


def test_numbers_of_known_lines() -> None:
    """Read manually from the files."""
    t = read_program_as_toolpath(DATA / "robot_abb/TPHugo__T_ROB1.mod")
    np.testing.assert_allclose(t.position[0] * 1e3, [60.1, 556, 162.5], atol=1e-9)
    np.testing.assert_allclose(t.axis[0], [0, 0, 1], atol=1e-12)  # quaternion 0,0,1,0: z down, so the shank points up
    assert t.feed[0] == pytest.approx(0.15)  # v150
    assert t.move[3] == MoveKind.RAPID  # MoveJ
    assert [e.text for e in t.events][:3] == [
        "WaitTime 1.5",
        "SetDO Stavbar_Gripper_close , 0",
        "SetDO Stavbar_Gripper_open , 1",
    ]
    assert t.events[0].kind == "dwell"
    assert t.events[0].value == 1.5
    arcs = read_program(DATA / "robot_abb/TPHugo__T_ROB1.mod")
    counts = np.bincount(arcs.line)
    assert (counts > 1).any()  # MoveC as chords
    f = read_program(DATA / "robot_fanuc/Surfacerobot__surface_cartesian.ls")
    assert f.configuration[0] == {"config": "NUT", "turns": (0, 0, 0), "cnt": 60}
    assert f.feed[1] == pytest.approx(0.2)
    assert f.bases[f.base[0]].name == "UFRAME 0"
    welding = read_program(DATA / "robot_fanuc/Creearc__cub.ls")
    assert welding.feed[0] == pytest.approx(0.04)  # 240 cm/min
    assert welding.external.shape == (999, 2)  # GP2, a positioner that does not move
    ur = read_program(DATA / "robot_ur/RoboDK__UniveralRobots.script")
    assert ur.kind.tolist() == [0, 0, 0, *[1] * 8, 0]
    np.testing.assert_allclose(
        ur.axes_deg[0], np.degrees([-2.652653, -1.365240, -1.512183, -1.127522, 1.275170, 1.920416])
    )
    assert ur.feed[3] == pytest.approx(0.05)  # speed_ms was changed before
    assert ur.blend[3] == pytest.approx(0.001)
    jbi = read_program(DATA / "robot_other/RoboDK__PROGRAM.JBI")
    assert jbi.configuration[1]["pulses"] == (0, -4474, -711, 0, -51077, 0)
    np.testing.assert_allclose(jbi.T_base_tcp[2, :3, 3] * 1e3, [418.57, 147.321, 251.179])
    assert (jbi.events[0].kind, jbi.events[0].value) == ("dwell", 0.5)
    krl = read_program(DATA / "robot_kuka/HugoDanielson__CNCTEST.src")
    np.testing.assert_allclose(krl.T_base_tcp[0, :3, 3] * 1e3, [13.228, 351.691, -0.2])
    assert np.isnan(krl.feed).all()


def test_no_cam_file_is_read_as_a_robot_program() -> None:
    for file in DATA.glob("*/*"):
        if file.parent.name.startswith("robot_") or not file.is_file():
            continue
        source = try_read_source(file)
        assert source is None or not is_program(source), file.name


def test_missing_feed_is_asked_for() -> None:
    with pytest.raises(InputError, match="--feed"):
        read_program_as_toolpath(DATA / "robot_kuka/HugoDanielson__CNCTEST.src")
