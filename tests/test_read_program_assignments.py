"""Assignments in robot programs are executed as on the controller, or refused with the line."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from test_unknown_words import JBI, KRL, RAPID, SCRIPT, TP, VAL3, put_in, refused_at, write
from toolpath_file_samples import Sample

from machopt.data_types.toolpath import Toolpath
from machopt.toolpath.toolpath_reader import read_toolpath


def read(folder: Path, sample: Sample, statement: str, before: str, nth: int = 0) -> Toolpath:
    text, _ = put_in(sample, statement, before, nth)
    return read_toolpath(write(folder, sample, text))


def mm(t: Toolpath) -> list[list[float]]:
    return np.round(t.position * 1e3, 6).tolist()  # type: ignore[no-any-return]


REFUSED: list[tuple[Sample, str, str]] = [  # file, statement before a move, beginning of the line it is inserted before
    *(
        (RAPID, s, "MoveL p1")
        for s in (
            "wobj1.uframe:=unknown1;",
            "wobj1:=wobjOther;",
            "wobj1.oframe.trans.z:=reg1;",
            "p1:=CRobT();",
            "p1.trans.z:=p1.trans.z+reg1;",
            "p1:=Offs(p1,reg1,0,0);",
            "IF DI1=1 THEN\np1:=p2;\nENDIF",
            "IF DI1=1 p1:=p2;",
            "FOR i FROM 1 TO 3 DO\nwobj1.oframe.trans.x:=10;\nENDFOR",
            "PDispOn p1,p2,tool0;",
            "IF DI1=1 THEN\nPDispOn p1,p2,tool0;\nENDIF",
            "WHILE DI1=0 DO\nVelSet 50,100;\nENDWHILE",
            "TEST reg1\nCASE 1:\np1.rot.q1:=0.5;\nENDTEST",
        )
    ),
    *(
        (TP, f"9: {s} ;", "5:L")
        for s in (
            "P[1]=PR[3]",
            "P[1]=LPOS",
            "UFRAME[1]=PR[2]",
            "UTOOL[1]=PR[2]",
            "UFRAME_NUM=R[3]",
            "UTOOL_NUM=AR[1]",
            "$MNUFRAME[1,1]=PR[1]",
            "IF R[1]=1,UFRAME_NUM=2",
            "IF R[1]=1,P[1]=PR[2]",
            "IF (R[1]=1) THEN",
            "L PR[2] 20mm/sec FINE",
            "L P[2] 20mm/sec FINE Offset,PR[1]",
        )
    ),
    *(
        (KRL, s, "LIN {X 50")
        for s in (
            "$BASE.X=10",
            "$BASE=$WORLD_OTHER",
            "$TOOL.Z=5",
            "$ROBROOT={X 1,Y 0,Z 0,A 0,B 0,C 0}",
            "$WORLD={X 1,Y 0,Z 0,A 0,B 0,C 0}",
            "IF $IN[1] THEN\n$BASE={X 10,Y 0,Z 0,A 0,B 0,C 0}\nENDIF",
            "IF $IN[1] THEN\nBAS(#BASE,2)\nENDIF",
            "IF $IN[1] THEN\n$TOOL=TOOL_DATA[2]\nENDIF",
            "WHILE TRUE\n$OV_PRO=50\nENDWHILE",
            "$SOFTN_END[1]=5",
        )
    ),
    *(
        (SCRIPT, s, "movel(p[0.2")
        for s in (
            "set_reference(p[0,0,1,0,0,0])",
            "force_mode(p[0,0,0,0,0,0],[0,0,1,0,0,0],[0,0,0,0,0,0],2,[0,0,0,0,0,0])",
            "if True:\nset_tcp(p[0,0,1,0,0,0])\nend",
            "movel(q2,1,0.1)",
            "q[2]=get_analog_in(0)\nmovel(q,1,0.1)",
            "if True:\nq[2]=0.5\nend\nmovel(q,1,0.1)",
            "if True:\nq=p[0,0,0,0,0,0]\nend\nmovel(q,1,0.1)",
            "movel([0,-1.5,1.5,0,1.5,0],1,0.1)",
            "movec([0,-1.5,1.5,0,1.5,0],[0,-1.5,1.4,0,1.5,0],1,0.1)",
            "freedrive_mode()",
        )
    ),
    *(
        (VAL3, s, "movel(p[0]")
        for s in (
            "p[0].trsf.x=5",
            "p[0]=here(t,world)",
            "t.trsf.z=10",
            "p=appro(p,{0,0,-5,0,0,0})",
            "m.tmax=3",
            "setFrame(p[0],p[1],p[0],world)",
            "if n==1\np[0].trsf.x=5\nendIf",
            "q=herej()",
            "unknown.x=3",
            "movel(p[0]+dx,t[0],m[0])",
        )
    ),
    *(
        (JBI, s, "MOVL C00000")
        for s in (
            "MFRAME UF#(1) C00000 C00001",
            "SFTON P001",
            "MSHIFT P001 UF#(1) C00000 C00001",
            "CALL JOB:OTHER",
            "MOVL C00001 V=10.0 UNTIL IN#(1)=ON",
            "IMOV P001 V=10.0",
            "MOVL P00099 V=10.0",
            "SETUF 3",
            "CONVUF C00000",
            "MOVC C00001 V=10.0",
        )
    ),
]


@pytest.mark.parametrize(("sample", "statement", "before"), REFUSED, ids=lambda v: v if isinstance(v, str) else v.name)
def test_values_known_only_to_the_running_robot_are_refused(
    tmp_path: Path, sample: Sample, statement: str, before: str
) -> None:
    text, line = put_in(sample, statement, before, 0)
    where = refused_at(write(tmp_path, sample, text), {})
    assert where is not None
    last = line + statement.count("\n") + 1  # the statement, or the later move that needs it
    assert int(where.removeprefix("line ").partition(",")[0]) in range(line, last + 1)


P2 = "MoveL p2"


@pytest.mark.parametrize(
    ("statement", "place"),
    [
        ("p2.trans.z:=-7;", [0, 0, -7]),
        ("p2.trans:=[1,2,3];", [1, 2, 3]),
        ("p2:=Offs(p1,5,0,-50);", [5, 0, 0]),
        ("p2:=p1;", [0, 0, 50]),
        ("wobj1.oframe.trans.x:=10;", [10, 0, 0]),
        ("wobj1.uframe.trans:=[0,20,0];", [0, 20, 0]),
        ("wobj1.uframe:=[[0,0,9],[1,0,0,0]];", [0, 0, 9]),
        ('wobj1:=[FALSE,TRUE,"",[[0,0,0],[0.7071068,0,0,0.7071068]],[[3,0,0],[1,0,0,0]]];', [0, 3, 0]),
        ("p2.rot.q1:=0;", [0, 0, 0]),
        ("p2.extax.eax_a:=5;", [0, 0, 0]),
    ],
)
def test_rapid_assignments_are_executed(tmp_path: Path, statement: str, place: list[float]) -> None:
    t = read(tmp_path, RAPID, statement, P2)
    assert mm(t)[0] == [0, 0, 50]
    assert np.allclose(mm(t)[1], place, atol=1e-4)


def test_rapid_offsets_have_the_value_at_the_assignment(tmp_path: Path) -> None:
    t = read(tmp_path, RAPID, "p2:=Offs(p1,0,0,-1);\np1.trans.x:=80;", P2)
    assert mm(t) == [[0, 0, 50], [0, 0, 49], [80, 0, 50]]


def test_rapid_elements_of_arrays(tmp_path: Path) -> None:
    rest = "[0,1,0,0],[0,0,0,0],[9E9,9E9,9E9,9E9,9E9,9E9]]"
    text = RAPID.text.replace("PROC main()", f"VAR robtarget pts{{2}}:=[[[1,0,0],{rest},[[2,0,0],{rest}];\nPROC main()")
    sample = Sample("part.mod", text)
    assert mm(read(tmp_path, sample, "MoveL pts{2},v100,fine,tool0\\WObj:=wobj1;", P2))[1] == [2, 0, 0]
    moved = read(tmp_path, sample, "pts{2}:=Offs(p1,0,7,0);\nMoveL pts{2},v100,fine,tool0\\WObj:=wobj1;", P2)
    assert mm(moved)[1] == [0, 7, 50]
    for statement in ("pts{2}.trans.x:=reg1;", "pts{i}:=p1;", "IF DI1=1 THEN\npts{2}:=p1;\nENDIF"):
        text, _ = put_in(sample, f"{statement}\nMoveL pts{{2}},v100,fine,tool0\\WObj:=wobj1;", P2, 0)
        assert refused_at(write(tmp_path, sample, text), {}) is not None


def test_urscript_elements_are_assigned(tmp_path: Path) -> None:
    t = read(tmp_path, SCRIPT, "a=[0,-1.5,1.5,0,1.5,0]\na[0]=0.5\nmovej(a,1,1)", "movel(p[0.2")
    assert len(t) == 2  # the position of the joint move is unknown; it is a rapid move
    assert mm(t)[-1] == [200, 200, 300]


@pytest.mark.parametrize(
    ("sample", "statement", "before"),
    [
        (KRL, '$LOOP_MSG[]="Tool change"', "LIN"),
        (KRL, 'configFileName[]="C:\\\\KRC\\\\x.cfg"', "LIN"),
        (KRL, "WAIT FOR StrClear($LOOP_MSG[])", "LIN"),
        (KRL, "$LOOP_CONT=TRUE", "LIN"),
        (KRL, "IF $IN[1] THEN\n$OUT[2]=TRUE\nENDIF", "LIN"),
        (TP, "9:L P[2] 20mm/sec FINE TB .50sec,DO[1]=ON ;", "5:L"),
        (TP, "9: IF (R[1]=1) THEN ;\n9: DO[1]=ON ;\n9: ENDIF ;", "5:L"),
        (RAPID, "IF DI1=1 SetDO do1,1;", "MoveL"),
        (RAPID, 'IF DI1=1 AND NOT (reg1>3) OR reg2=5 TPWrite "x";', "MoveL"),
        (RAPID, "IF DI1=1 RETURN;", "MoveL p1"),
        (RAPID, "IF DI1=1 THEN\nSetDO do1,1;\nreg1:=5;\nENDIF", "MoveL"),
        (RAPID, "reg1:=reg1+1;", "MoveL"),
        (SCRIPT, "if True:\nset_digital_out(1,True)\nend", "movel"),
        (SCRIPT, "n=get_analog_in(0)", "movel"),
        (VAL3, "n=n+1", "movel"),
        (JBI, "SET B001 5", "MOVL"),
        (JBI, "SETE P00095 (1) 100", "MOVL"),
    ],
)
def test_statements_without_motion_are_skipped(tmp_path: Path, sample: Sample, statement: str, before: str) -> None:
    text, _ = put_in(sample, statement, before, 0)
    assert refused_at(write(tmp_path, sample, text), {}) is None


ROBODK = """&ACCESS RVP
&REL 1
&COMMENT Generated by RoboDK
DEF Prog1 ( )
;FOLD Declarations
GLOBAL INTERRUPT DECL 3 WHEN $STOPMESS==TRUE DO IR_STOPM ( )
INTERRUPT ON 3
BAS (#INITMOV,0 )
$BWDSTART = FALSE
PDAT_ACT = {VEL 15,ACC 100,APO_DIST 50}
FDAT_ACT = {TOOL_NO 0,BASE_NO 0,IPO_FRAME #BASE}
BAS (#PTP_PARAMS,100 )
$ADVANCE = 5
$VEL.ORI1 = 200
$ACC.CP = 2
;ENDFOLD
$TOOL = {FRAME: X 0,Y 0,Z 200,A 0,B 0,C 0}
$BASE = {FRAME: X 1000,Y 0,Z 500,A 0,B 0,C 0}
PTP {A1 0,A2 -90,A3 90,A4 0,A5 45,A6 0}
$VEL.CP = 0.2
LIN {X 0,Y 0,Z 10,A 0,B 0,C 180} C_DIS
$LOOP_MSG[] = "Start milling"
$LOOP_CONT = TRUE
Wait FOR StrClear($LOOP_MSG[])
configFileName[] = "C:\\KRC\\ROBOTER\\x.cfg"
$OUT[1] = TRUE
Wait FOR $IN[2]
$VEL.CP = 0.01
LIN {X 100,Y 0,Z 10,A 0,B 0,C 180}
HALT
END
"""


def test_standard_program_of_robodk_is_read(tmp_path: Path) -> None:
    path = tmp_path / "Prog1.src"
    path.write_text(ROBODK)
    assert refused_at(path, {}) is None
    assert mm(read_toolpath(path))[-1] == [100, 0, 10]
