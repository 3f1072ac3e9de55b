"""Statements of robot programs other than plain targets: executed, omitted with a message, or refused."""

from __future__ import annotations

import math
from pathlib import Path

import numpy as np
import pytest

from machopt.data_types.toolpath import MoveKind, Toolpath
from machopt.errors import InputError
from machopt.programs.universal_robots.expression_values import ScriptValueError, _ScriptParser, evaluate_expression
from machopt.toolpath.toolpath_reader import read_toolpath

HEAD = "DEF a()\n$VEL.CP=0.01\n"
START = "LIN {X 0,Y 0,Z 5,A 0,B 0,C 0}\n"
P0 = "[[0,0,5],[0,1,0,0],[0,0,0,0],[9E9,9E9,9E9,9E9,9E9,9E9]]"
MODULE = f"MODULE m\nCONST robtarget p0:={P0};\nPROC main()\n%s\nENDPROC\nENDMODULE\n"


def read(folder: Path, name: str, text: str) -> Toolpath:
    (folder / name).write_text(text)
    return read_toolpath(folder / name)


def krl(folder: Path, body: str) -> Toolpath:
    return read(folder, "a.src", HEAD + body + "\nEND\n")


def mm(t: Toolpath) -> list[list[float]]:
    return (np.round(t.position * 1e3, 9) + 0.0).tolist()  # the conversion to metres and back loses the last bits


@pytest.mark.parametrize(
    "here",
    [
        "PTP $AXIS_ACT",
        "PTP $POS_ACT",
        "LIN $POS_ACT C_DIS",
        "SPTP $AXIS_ACT",
        "PTP XHOME",
        "PTP  XHOME  C_PTP",
        "PTP HOME",
        "SPTP XHOME",
    ],
)
def test_krl_begins_at_the_robot_position(tmp_path: Path, here: str) -> None:
    t = krl(tmp_path, f"{here}\n{START}LIN {{X 10}}")
    assert mm(t) == [[0, 0, 5], [10, 0, 5]]
    assert any(w.startswith("line 3:") and "left out" in w for w in t.warnings)


def test_krl_home_of_the_data_list_is_used_and_another_name_is_refused(tmp_path: Path) -> None:
    (tmp_path / "a.dat").write_text("DEFDAT a\nDECL E6POS XHOME={X 1,Y 2,Z 3,A 0,B 0,C 0}\nENDDAT\n")
    t = krl(tmp_path, f"PTP XHOME\n{START}")
    assert mm(t) == [[1, 2, 3], [0, 0, 5]]
    with pytest.raises(InputError, match=r"line 3: XP7 is declared in none"):
        krl(tmp_path, f"PTP XP7\n{START}")


def test_cut_after_a_joint_move_to_an_unknown_place_is_refused(tmp_path: Path) -> None:
    """The joint move leads to a position that the file does not state, so the start of the next cut is unknown."""
    t = krl(
        tmp_path,
        START + "LIN {X 10}\nPTP {A1 0,A2 -90,A3 90,A4 0,A5 0,A6 0}\nLIN {X 90,Y 80,Z 5,A 0,B 0,C 0}\nLIN {X 95}",
    )
    assert t.move.tolist() == [MoveKind.CUT, MoveKind.CUT, MoveKind.RAPID, MoveKind.CUT]
    assert math.isnan(t.feed[2])
    assert any("line 6" in w and "joint moves without a known place (line 5)" in w for w in t.warnings)


def test_krl_relative_moves_add_to_the_last_target(tmp_path: Path) -> None:
    t = krl(
        tmp_path, "LIN {X 1,Y 2,Z 3,A 90,B 0,C 0}\nLIN_REL {X 10,Z -1}\nLIN_REL {X 5} #TOOL\nPTP_REL {Y 3}\nLIN {X 0}"
    )
    assert mm(t) == [[1, 2, 3], [11, 2, 2], [11, 7, 2], [11, 10, 2], [0, 10, 2]]
    assert t.move.tolist() == [0, 0, 0, 1, 0]
    with pytest.raises(InputError, match="line 3: LIN_REL starts at the current position"):
        krl(tmp_path, "LIN_REL {X 10}\n" + START)
    with pytest.raises(InputError, match="line 4: LIN_REL that turns the tool"):
        krl(tmp_path, START + "LIN_REL {A 10}")


def test_krl_arc_by_its_angle_follows_the_circle_of_its_points(tmp_path: Path) -> None:
    t = krl(tmp_path, START + "CIRC {X 5,Y 5,Z 5},{X 10,Y 0,Z 5},CA 360\nCIRC {X 5,Y 5,Z 5},{X 10,Y 0,Z 5},CA -90")
    p = t.position * 1e3
    assert np.allclose(np.linalg.norm(p[1:, :2] - [5, 0], axis=1), 5.0)
    assert np.allclose(p[t.line == 4][-1], [0, 0, 5])
    assert np.allclose(p[t.line == 5][-1], [5, -5, 5])  # opposite direction: away from the auxiliary point
    length = np.linalg.norm(np.diff(p[t.line <= 4], axis=0), axis=1).sum()
    assert length == pytest.approx(10 * math.pi, rel=2e-3)  # tolerance: chords


def test_krl_inline_forms_set_base_and_speed(tmp_path: Path) -> None:
    data = "".join(
        f"DECL E6POS XP{k}={{X {k},Y 0,Z 0,A 0,B 0,C 0,S 2,T 35}}\nDECL FDAT FP{k}={{TOOL_NO 1,BASE_NO {b}}}\n"
        for k, b in ((1, 2), (2, 2), (3, 3))
    )
    (tmp_path / "a.dat").write_text(f"DEFDAT a PUBLIC\n{data}ENDDAT\n")
    form = ";FOLD LIN P{0} Vel={1} m/s CPDAT1;%{{PE}}\nFDAT_ACT=FP{0}\nBAS(#CP_PARAMS,{1})\nLIN XP{0}\n;ENDFOLD\n"
    t = krl(tmp_path, form.format(1, 0.1) + form.format(2, 0.2))
    assert mm(t) == [[1, 0, 0], [2, 0, 0]]
    assert (t.feed * 60e3).tolist() == pytest.approx([6000, 12000])
    with pytest.raises(InputError, match=r"BASE_DATA\[2\], BASE_DATA\[3\]"):
        krl(tmp_path, form.format(1, 0.1) + form.format(3, 0.2))


def test_rapid_turns_and_present_positions(tmp_path: Path) -> None:
    body = "MoveL CRobT(\\Tool:=tool0),v10,fine,tool0;\nMoveL p0,v10,fine,tool0;\n"
    body += "MoveL RelTool(p0,0,0,2\\Rx:=30\\Ry:=20),v10,fine,tool0;"
    t = read(tmp_path, "a.mod", MODULE % body)
    assert mm(t)[0] == [0, 0, 5]
    assert np.allclose(t.position[1] * 1e3, [0, 0, 3])
    a, b = np.radians([30.0, 20.0])  # Rx(180) Rx(a) Ry(b): the negative of its z column
    assert np.allclose(t.axis[1], [-math.sin(b), -math.sin(a) * math.cos(b), math.cos(a) * math.cos(b)])
    with pytest.raises(InputError, match=r"line 4: crobt\(\) is the current position"):
        read(tmp_path, "a.mod", MODULE % "MoveL Offs(CRobT(),0,0,5),v10,fine,tool0;")
    with pytest.raises(InputError, match="line 4: PDISPSET: displacements"):
        read(tmp_path, "a.mod", MODULE % "PDispSet [[1,0,0],[1,0,0,0]];\nMoveL p0,v10,fine,tool0;")


def fanuc(folder: Path, lines: str, **positions: tuple[float, float]) -> Toolpath:
    at = "".join(
        f"{name[0].upper()}[{name[1:]}]{{\n GP1:\n UF : 1, UT : 1, CONFIG : 'N U T, 0, 0, 0',\n X = {x} mm, "
        f"Y = {y} mm, Z = 5 mm,\n W = 180 deg, P = 0 deg, R = 0 deg\n}};\n"
        for name, (x, y) in positions.items()
    )
    return read(folder, "a.ls", f"/PROG A\n/ATTR\n/MN\n{lines}/POS\n{at}/END\n")


def test_fanuc_arcs_by_single_points(tmp_path: Path) -> None:
    angles = np.radians([180, 120, 60, 0, -80])
    at = {f"p{k + 1}": (50 * math.cos(a), 50 * math.sin(a)) for k, a in enumerate(angles)}
    lines = "".join(f" {k}: A P[{k}] 100mm/sec CNT100 ;\n" for k in range(1, 6))
    t = fanuc(tmp_path, lines, **at)
    p = t.position * 1e3
    assert np.allclose(np.linalg.norm(p[:, :2], axis=1), 50.0, atol=1e-6)
    assert np.allclose(p[-1, :2], at["p5"])
    swept = np.degrees(np.unwrap(np.arctan2(p[:, 1], p[:, 0])))
    assert (np.diff(swept) < 0).all()  # one direction without reversal
    assert swept[0] - swept[-1] == pytest.approx(260.0)
    with pytest.raises(InputError, match="line 5: two moves A in a row"):
        fanuc(tmp_path, " 1: A P[1] 100mm/sec FINE ;\n 2: A P[2] 100mm/sec FINE ;\n", **at)


def test_fanuc_registers_are_refused_and_times_are_speeds(tmp_path: Path) -> None:
    at = {"p1": (0.0, 0.0), "p2": (30.0, 40.0)}
    first = " 1: L P[1] 100mm/sec FINE ;\n"
    t = fanuc(tmp_path, first + " 2: L P[2] 2.0sec FINE ;\n", **at)
    assert t.feed[1] * 60e3 == pytest.approx(50 / 2 * 60)
    for tail, cause in (("Offset,PR[1]", "a register that the controller holds"), ("INC", "INC that turns the tool")):
        with pytest.raises(InputError, match=f"line 5: .*{cause}"):
            fanuc(tmp_path, first + f" 2: L P[2] 100mm/sec FINE {tail} ;\n", **at)
    with pytest.raises(InputError, match=r"line 5: PR\[2\] is a position register"):
        fanuc(tmp_path, first + " 2: L PR[2] 100mm/sec FINE ;\n", **at)


def test_urscript_omits_a_move_to_the_current_position(tmp_path: Path) -> None:
    t = read(
        tmp_path,
        "a.script",
        "def a():\n  movel(get_actual_tcp_pose(),1.2,0.01)\n"
        "  movel(p[0,0,0.005,3.141592653589793,0,0],1.2,0.01)\n"
        "  movel(p[0.01,0,0.005,3.141592653589793,0,0],1.2,0.01)\n"
        "end\na()\n",
    )
    assert mm(t) == [[0, 0, 5], [10, 0, 5]]


LIN = START + "LIN {X 10}\n"
MOVE = "MoveL p0,v10,fine,tool0;\n"
JOB = (
    "/JOB\n//NAME A\n//POS\n///NPOS 2,0,0,0,0,0\n///TOOL 0\n///POSTYPE BASE\n///RECTAN\n///RCONF 0,0,0,0,0,0,0,0\n"
    "C00000=0.000,0.000,5.000,180.00,0.00,0.00\nP001=10.000,0.000,5.000,180.00,0.00,0.00\n//INST\nNOP\n{}END\n"
)
SCRIPT = "def a():\n{}end\na()\n"
UR = "  movel(p[{},0,0.005,3.141592653589793,0,0],1.2,0.01)\n"
AT = {"p1": (0.0, 0.0), "p2": (10.0, 0.0)}
L1, L2 = " 1: L P[1] 100mm/sec FINE ;\n", " 3: L P[2] 100mm/sec FINE ;\n"


@pytest.mark.parametrize(
    ("dialect", "text", "cause"),
    [
        ("a.src", HEAD + "$IPO_MODE=#TCP\n" + LIN + "END\n", r"line 3: \$IPO_MODE=#TCP: the robot carries"),
        ("a.src", HEAD + "$BASE.X=10\n" + LIN + "END\n", r"line 3: \$BASE.X moves one component of a frame"),
        ("a.src", HEAD + "$OV_PRO=MYSPEED\n" + LIN + "END\n", "line 3: the override is set to a value"),
        ("a.src", HEAD + START + "IF B THEN\nGOTO L1\nENDIF\nLIN {X 9}\nL1:\nEND\n", "line 4: IF decides about moves"),
        ("a.mod", MODULE % ("IF di1=1 " + MOVE), "line 4: IF decides about moves"),
        ("a.mod", MODULE % ("IF di1=1 GOTO a;\n" + MOVE + "a:\n"), "line 4: IF decides about moves"),
        ("a.mod", MODULE % ("IF di1=1 THEN\nGOTO a;\nENDIF\n" + MOVE + "a:\n"), "line 4: IF … ENDIF decides"),
        ("a.mod", MODULE % ("SpeedRefresh 50;\n" + MOVE), "line 4: SpeedRefresh"),
        (
            "a.mod",
            MODULE.replace("PROC", "PERS tooldata t1:=[FALSE,[[0,0,9],[1,0,0,0]],[1,[0,0,1],[1,0,0,0],0,0,0]];\nPROC")
            % "MoveL p0,v10,fine,t1;",
            r"line 5: tooldata t1 \(robhold\)",
        ),
        (
            "a.mod",
            MODULE.replace("PROC", 'PERS wobjdata w1:=[TRUE,TRUE,"",[[0,0,9],[1,0,0,0]],[[0,0,0],[1,0,0,0]]];\nPROC')
            % "MoveL p0,v10,fine,tool0\\WObj:=w1;",
            r"line 5: wobjdata w1 \(robhold\)",
        ),
        ("a.jbi", JOB.format("SFTON P000 BF\nMOVL C00000 V=10.0\n"), "SFTON shifts every point"),
        ("a.jbi", JOB.format("SETE P001 (1) 5000\nMOVL P001 V=10.0\n"), "changes the position P001"),
        ("a.jbi", JOB.format("MOVL C00000 V=10.0\nCALL JOB:B IF B000=1\n"), "decides while the robot runs"),
        (
            "a.script",
            SCRIPT.format("  force_mode(p[0,0,0,0,0,0],[0,0,1,0,0,0],[0,0,9,0,0,0],2,[1,1,1,1,1,1])\n" + UR.format(0)),
            "line 2: force_mode moves the tool off its targets",
        ),
    ],
)
def test_further_words_are_refused(tmp_path: Path, dialect: str, text: str, cause: str) -> None:
    with pytest.raises(InputError, match=cause):
        read(tmp_path, dialect, text)


@pytest.mark.parametrize(
    ("line", "cause"),
    [
        (" 2: L P[2] 100mm/sec FINE RTCP ;\n", "line 5: RTCP: the robot carries the workpiece"),
        (" 2: L P[R[1]] 100mm/sec FINE ;\n", "line 5: .*a position that the program does not hold"),
        (" 2: L PAL_1[BTM] 100mm/sec FINE ;\n", "line 5: .*a position that the program does not hold"),
        (" 2: S P[2] 100mm/sec FINE ;\n", "line 5: .*of a kind that is not read"),
        (" 2: OVERRIDE=R[3] ;\n", "line 5: the override is set"),
    ],
)
def test_fanuc_moves_are_complete(tmp_path: Path, line: str, cause: str) -> None:
    with pytest.raises(InputError, match=cause):
        fanuc(tmp_path, L1 + line + L2, **AT)


def test_overrides_and_default_speeds_are_applied(tmp_path: Path) -> None:
    def feeds(t: Toolpath) -> list[float]:
        return np.round(t.feed[t.cutting] * 60e3, 6).tolist()  # type: ignore[no-any-return]

    assert feeds(krl(tmp_path, START + "$OV_PRO=50\nLIN {X 10}\n$OV_PRO=100\nLIN {X 0}")) == [600, 300, 600]
    assert feeds(krl(tmp_path, START + "SPLINE WITH $VEL.CP=0.02\nSLIN {X 10}\nENDSPLINE\nLIN {X 0}")) == [
        600,
        1200,
        600,
    ]
    assert feeds(fanuc(tmp_path, L1 + " 2: OVERRIDE=50% ;\n" + L2, **AT)) == [6000, 3000]
    assert feeds(fanuc(tmp_path, L1 + " 2: //L P[9] 100mm/sec FINE ;\n" + L2, **AT)) == [6000, 6000]
    t = read(tmp_path, "a.mod", MODULE % "VelSet 100,6;\nMoveL p0,v10,fine,tool0;\nMoveL Offs(p0,9,0,0),v5,fine,tool0;")
    assert feeds(t) == [360, 300]
    assert feeds(read(tmp_path, "a.jbi", JOB.format("SPEED V=20.0\nMOVL C00000\nMOVL P001 V=10.0\n"))) == [1200, 600]


def test_moves_with_a_time_have_the_resulting_speed(tmp_path: Path) -> None:
    t = read(tmp_path, "a.mod", MODULE % (MOVE + "MoveL Offs(p0,30,40,0),v10\\T:=2,fine,tool0;"))
    assert t.feed[1] * 60e3 == pytest.approx(50 / 2 * 60)
    t = read(tmp_path, "a.script", SCRIPT.format(UR.format(0) + UR.format(0.03).replace("1.2,0.01", "t=2")))
    assert t.feed[1] * 60e3 == pytest.approx(30 / 2 * 60)


def test_routine_ends_at_its_return(tmp_path: Path) -> None:
    t = read(tmp_path, "a.mod", MODULE % (MOVE + "RETURN;\nMoveL Offs(p0,9,0,0),v5,fine,tool0;"))
    assert len(t) == 1
    assert len(read(tmp_path, "a.script", SCRIPT.format(UR.format(0) + "  return 1\n" + UR.format(1)))) == 1
    t = read(tmp_path, "b.mod", MODULE % ("IF n<0 THEN\nRETURN;\nENDIF\n" + MOVE))
    assert len(t) == 1
    assert any("may end the routine early" in w for w in t.warnings)


@pytest.mark.parametrize(
    "text", ["1.5", " -2", "+.5e-3", "[1, -2.5,3.]", "p[0.1,-.2,3e-1, 0,-0.5 , 1]", "[]", "[1,]", "-0.0"]
)
def test_urscript_bulk_numbers_equal_those_of_the_parser(text: str) -> None:
    assert repr(evaluate_expression(text, {})) == repr(_ScriptParser(text, {}).parse_expression())


@pytest.mark.parametrize("text", ["1.5.2", "[1 2]", "p[1,2]", "1e999", "[1_0]", "1,2", "p[1,2,3,4,5,inf]", "p [", "--"])
def test_urscript_invalid_numbers_are_refused(text: str) -> None:
    with pytest.raises(ScriptValueError):
        evaluate_expression(text, {})
