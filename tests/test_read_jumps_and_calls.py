"""Jumps, calls and ends of every dialect: executed, or refused with the line."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from machopt.errors import InputError
from machopt.toolpath.toolpath_reader import read_toolpath

CONVERSATIONAL = "0 BEGIN PGM T MM\n1 TOOL CALL 1 Z S1000\n2 L X+0 Y+0 Z+10 R0 FMAX\n3 L Z-1 F200\n{}99 END PGM T MM\n"
DIN_ISO = "%T G71 *\nN10 T1 G17 S1000 *\nN20 G0 G40 G90 X+0 Y+0 Z+10 *\nN30 G1 Z-1 F200 *\n{}N99999999 %T G71 *\n"
FANUC_ROBOT = (
    "/PROG T\n/ATTR\n/MN\n   1:  UFRAME_NUM=1 ;\n   2:  UTOOL_NUM=1 ;\n   3:L P[1] 10mm/sec FINE ;\n{}/POS\n"
    + "".join(
        f"P[{n}]{{\n   GP1:\n UF : 1, UT : 1, CONFIG : 'N U T, 0, 0, 0',\n X = {x}.0 mm, Y = 0.0 mm, Z = 500.0 mm,\n"
        " W = 180.0 deg, P = 0.0 deg, R = 0.0 deg\n};\n"
        for n, x in ((1, 500), (2, 510))
    )
    + "/END\n"
)
KRL = (
    "&ACCESS RVP\nDEF t( )\nBAS(#INITMOV,0)\n$BASE={X 0,Y 0,Z 0,A 0,B 0,C 0}\n$TOOL={X 0,Y 0,Z 100,A 0,B 0,C 0}\n"
    "$VEL.CP=0.01\nLIN {X 500,Y 0,Z 500,A 0,B 90,C 0}\n{}END\n"
)
RAPID = "MODULE M\nPROC main()\nMoveL [[500,0,500],[0,1,0,0],[0,0,0,0],[9E9,9E9,9E9,9E9,9E9,9E9]],v10,fine,tool0;\n{}"
URSCRIPT = "def prog():\n  set_tcp(p[0,0,0.1,0,0,0])\n  movel(p[0.5,0,0.5,3.14159,0,0],a=1,v=0.01)\n{}end\nprog()\n"
YASKAWA = (
    "/JOB\n//NAME T\n//POS\n///NPOS 2,0,0,0,0,0\n///TOOL 0\n///POSTYPE BASE\n///RECTAN\n///RCONF 0,0,0,0,0,0,0,0\n"
    "C00000=500,0,500,180,0,0\nC00001=510,0,500,180,0,0\n//INST\n///DATE 2020/01/01 00:00\n///ATTR SC,RW,RJ\n"
    "///FRAME BASE\n///GROUP1 RB1\nNOP\nMOVL C00000 V=10.0\n{}END\n"
)
KRL_MOVE = "LIN {X 510,Y 0,Z 500,A 0,B 90,C 0}\n"
RAPID_MOVE = RAPID.splitlines()[2].replace("500,0,500", "510,0,500") + "\n"
UR_MOVE = "  movel(p[0.51,0,0.5,3.14159,0,0],a=1,v=0.01)\n"
LS_MOVE = "   9:L P[2] 10mm/sec FINE ;\n"

CARRIED_OUT = {  # head, file name, text, x of the points after the first ones
    "label by name": (CONVERSATIONAL, "a.h", 'CALL LBL "AB"\nL Z+9\nM2\nLBL "AB"\nL X+5\nLBL 0\n', [5, 5]),
    "zeros of a label": (CONVERSATIONAL, "a.h", "CALL LBL 01\nL Z+9\nM2\nLBL 1\nL X+5\nLBL 0\n", [5, 5]),
    "part twice more": (CONVERSATIONAL, "a.h", "LBL 1\nL IX+5\nCALL LBL 1 REP2/2\n", [5, 10, 15]),
    "part in a subprogram": (
        CONVERSATIONAL,
        "a.h",
        "CALL LBL 2\nCALL LBL 2\nM2\nLBL 2\nLBL 1\nL IX+5\nCALL LBL 1 REP1\nLBL 0\n",
        [5, 10, 15, 20],
    ),
    "jump ahead": (CONVERSATIONAL, "a.h", "FN 9: IF +1 EQU +1 GOTO LBL 5\nL X+3\nLBL 5\nL X+4\n", [4]),
    "DIN/ISO part": (DIN_ISO, "a.i", "N40 G98 L1 *\nN50 G1 G91 X+5 *\nN60 L1,1 *\n", [5, 10]),
    "FANUC END": (FANUC_ROBOT, "a.ls", "   4:  END ;\n" + LS_MOVE, []),
    "FANUC ABORT": (FANUC_ROBOT, "a.ls", "   4:  ABORT ;\n" + LS_MOVE, []),
    "FANUC PAUSE": (FANUC_ROBOT, "a.ls", "   4:  PAUSE ;\n" + LS_MOVE, [510]),
    "KRL RETURN": (KRL, "a.src", "RETURN\n" + KRL_MOVE, []),
    "KRL HALT": (KRL, "a.src", "HALT\n" + KRL_MOVE, [510]),
    "KRL subprogram": (KRL, "a.src", "S( )\nEND\nDEF S( )\n" + KRL_MOVE + "RETURN\n" + KRL_MOVE, [510]),
    "RAPID EXIT": (RAPID, "a.mod", f"EXIT;\n{RAPID_MOVE}ENDPROC\nENDMODULE\n", []),
    "RAPID EXIT in a call": (RAPID, "a.mod", f"S;\n{RAPID_MOVE}ENDPROC\nPROC S()\nEXIT;\nENDPROC\nENDMODULE\n", []),
    "RAPID RETURN in a call": (
        RAPID,
        "a.mod",
        f"S;\n{RAPID_MOVE}ENDPROC\nPROC S()\nRETURN;\nENDPROC\nENDMODULE\n",
        [510],
    ),
    "RAPID Stop": (RAPID, "a.mod", f"Stop;\n{RAPID_MOVE}ENDPROC\nENDMODULE\n", [510]),
    "URScript halt": (URSCRIPT, "a.script", "  halt\n" + UR_MOVE, []),
    "URScript return": (URSCRIPT, "a.script", "  return 1\n" + UR_MOVE, []),
    "Yaskawa ABORT": (YASKAWA, "a.jbi", "ABORT\nMOVL C00001 V=10.0\n", []),
    "Yaskawa PAUSE": (YASKAWA, "a.jbi", "PAUSE\nMOVL C00001 V=10.0\n", [510]),
}


@pytest.mark.parametrize("name", CARRIED_OUT)
def test_points_follow_the_program_flow(tmp_path: Path, name: str) -> None:
    head, file, text, expected = CARRIED_OUT[name]
    (tmp_path / file).write_text(head.replace("{}", text), encoding="utf-8")
    first = 2 if head in (CONVERSATIONAL, DIN_ISO) else 1
    got = read_toolpath(tmp_path / file).position[first:, 0] * 1e3
    assert np.allclose(got, expected)


REFUSED = {  # head, file name, text, line
    "part that is behind its call": (CONVERSATIONAL, "a.h", "CALL LBL 1 REP2\nM2\nLBL 1\nL X+5\nLBL 0\n", 5),
    "subprogram without end": (CONVERSATIONAL, "a.h", "CALL LBL 1\nL Z+9\nM2\nLBL 1\nL X+5\n", 10),
    "label that is not there": (CONVERSATIONAL, "a.h", "CALL LBL 7\n", 5),
    "label 0": (CONVERSATIONAL, "a.h", "CALL LBL 0\nLBL 0\n", 5),
    "label twice": (CONVERSATIONAL, "a.h", "CALL LBL 1\nM2\nLBL 1\nL X+5\nLBL 0\nLBL 1\nLBL 0\n", 5),
    "label in a variable": (CONVERSATIONAL, "a.h", "CALL LBL QS5\n", 5),
    "jump to a label in a variable": (CONVERSATIONAL, "a.h", "FN 9: IF +1 EQU +1 GOTO LBL QS6\n", 5),
    "jump to nothing": (CONVERSATIONAL, "a.h", "FN 9: IF +1 EQU +1 GOTO LBL 6\n", 5),
    "program as a cycle": (CONVERSATIONAL, "a.h", "CYCL DEF 12.0 PGM CALL\nCYCL DEF 12.1 PGM A.H\nL X+5 M99\n", 5),
    "selected program": (CONVERSATIONAL, "a.h", 'SEL PGM "A.H"\nCALL SELECTED PGM\n', 5),
    "program and a move behind it": (CONVERSATIONAL, "a.h", "CALL PGM A.H\nL X+5\n", 6),
    "DIN/ISO part behind its call": (DIN_ISO, "a.i", "N40 L1,2 *\nN50 M2 *\nN60 G98 L1 *\nN80 G98 L0 *\n", 5),
    "DIN/ISO without end": (DIN_ISO, "a.i", "N40 L1,0 *\nN50 M2 *\nN60 G98 L1 *\nN70 G1 X+5 *\n", 9),
    "DIN/ISO program": (DIN_ISO, "a.i", "N40 %P2 *\n", 5),
    "DIN/ISO program without block number": (DIN_ISO, "a.i", "%P2 *\n", 5),
    "DIN/ISO jump": (DIN_ISO, "a.i", "N40 D09 P01 +1 P02 +1 P03 5 *\nN50 G98 L5 *\n", 5),
    "FANUC jump": (FANUC_ROBOT, "a.ls", "   4:  JMP LBL[1] ;\n" + LS_MOVE, 7),
    "KRL jump": (KRL, "a.src", "GOTO L1\n" + KRL_MOVE + "L1:\n", 8),
    "RAPID jump": (RAPID, "a.mod", f"GOTO L1;\n{RAPID_MOVE}L1:\nENDPROC\nENDMODULE\n", 4),
    "Yaskawa jump": (YASKAWA, "a.jbi", "JUMP *A\nMOVL C00001 V=10.0\n*A\n", 18),
}


@pytest.mark.parametrize("name", REFUSED)
def test_unsupported_flow_is_refused_with_its_line(tmp_path: Path, name: str) -> None:
    head, file, text, line = REFUSED[name]
    (tmp_path / file).write_text(head.replace("{}", text), encoding="utf-8")
    with pytest.raises(InputError, match=f"line {line}:"):
        read_toolpath(tmp_path / file)


CALLS_OF_OTHER_FILES = {
    "KRL": (KRL, "a.src", "SUB9( )\n" + KRL_MOVE),
    "RAPID": (RAPID, "a.mod", f"Sub9;\n{RAPID_MOVE}ENDPROC\nENDMODULE\n"),
    "RAPID late binding": (RAPID, "a.mod", f'%"S"%;\n{RAPID_MOVE}ENDPROC\nENDMODULE\n'),
    "RAPID ExitCycle": (RAPID, "a.mod", f"ExitCycle;\n{RAPID_MOVE}ENDPROC\nENDMODULE\n"),
    "FANUC": (FANUC_ROBOT, "a.ls", "   4:  CALL SUB1 ;\n" + LS_MOVE),
    "FANUC RUN": (FANUC_ROBOT, "a.ls", "   4:  RUN SUB1 ;\n" + LS_MOVE),
    "URScript": (URSCRIPT, "a.script", "  sub1()\n" + UR_MOVE),
    "Yaskawa": (YASKAWA, "a.jbi", "CALL JOB:S\nMOVL C00001 V=10.0\n"),
    "Heidenhain": (CONVERSATIONAL, "a.h", "L X+5\nCALL PGM A.H\n"),
}


@pytest.mark.parametrize("name", CALLS_OF_OTHER_FILES)
def test_call_of_another_file_stops_the_plan(tmp_path: Path, name: str) -> None:
    head, file, text = CALLS_OF_OTHER_FILES[name]
    (tmp_path / file).write_text(head.replace("{}", text), encoding="utf-8")
    assert any(word.stops for word in read_toolpath(tmp_path / file).ignored)
