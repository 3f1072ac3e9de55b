"""Small programs of every dialect with points computed by hand: frames, increments, arcs, units, comments, flow."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from machopt.data_types.toolpath import Toolpath
from machopt.errors import InputError
from machopt.toolpath.toolpath_reader import read_toolpath

HEADS = {  # the tool is at 0, 0, 0 after it
    "G-code": "%\nO1\nG21 G90 G17 G94 G54\nG0 X0. Y0. Z10.\nG1 Z0. F200.\n",
    "Sinumerik": "%_N_X_MPF\nG71 G90 G17 G94 G54\nG0 X0 Y0 Z10\nG1 Z0 F200\n",
    "Heidenhain": "0 BEGIN PGM T MM\n1 TOOL CALL 1 Z S1000\n2 L X+0 Y+0 Z+10 R0 FMAX\n3 L Z+0 F200\n",
    "APT": "PARTNO T\nUNITS/MM\nFEDRAT/300,MMPM\nRAPID\nGOTO/0,0,10,0,0,1\nGOTO/0,0,0,0,0,1\n",
}
TAILS = {
    "G-code": "\nM30\n%\n",
    "Sinumerik": "\nM30\n",
    "Heidenhain": "\nL Z+10 FMAX M2\n99 END PGM T MM\n",
    "APT": "\nFINI\n",
}
FILES = {"G-code": "p.nc", "Sinumerik": "p.mpf", "Heidenhain": "p.h", "APT": "p.apt"}


def read(folder: Path, dialect: str, body: str) -> Toolpath:
    file = folder / FILES[dialect]
    file.write_text(HEADS[dialect] + body + TAILS[dialect], encoding="utf-8")
    return read_toolpath(file)


def list_points(path: Toolpath, dialect: str) -> list[list[float]]:
    points = np.round(path.position[2:] * 1e3, 6).tolist()
    return points[:-1] if dialect == "Heidenhain" else points  # the end of the program retracts the tool


POINTS = [  # dialect, blocks, points
    ("G-code", "#1=1\nIF[#1EQ1]THEN #2=5\nG1X#2", [(5, 0, 0)]),
    ("G-code", "#1=0\nWHILE[#1LT2]DO1\nG91X1.\n#1=#1+1\nEND1\nG90X9.", [(1, 0, 0), (2, 0, 0), (9, 0, 0)]),
    ("G-code", "X5. M98 P100\nX7.\nM30\nO100\nG1 Y5.\nM99", [(5, 0, 0), (5, 5, 0), (7, 5, 0)]),
    ("G-code", "M98 P100 L0\nX7.\nM30\nO100\nG91 G1 Y5.\nG90\nM99", [(7, 0, 0)]),
    ("G-code", "M98 P00030100\nX7.\nM30\nO100\nG91 G1 Y5.\nG90\nM99", [(0, 5, 0), (0, 10, 0), (0, 15, 0), (7, 15, 0)]),
    ("G-code", "M98 P100\nX7.\nN9 X8.\nM30\nO100\nG1 Y5.\nM99 P9", [(0, 5, 0), (8, 5, 0)]),
    ("G-code", "G65 P100 X5. Y6.\nM30\nO100\nG1 X#24 Y#25\nM99", [(5, 6, 0)]),
    ("G-code", "GOTO 7\nX3.\nN7 X4.", [(4, 0, 0)]),
    ("G-code", "/2 X5.\nX6.", [(5, 0, 0), (6, 0, 0)]),
    ("G-code", "X5. (X9.)\n(Y5.) Y2.", [(5, 0, 0), (5, 2, 0)]),
    ("G-code", "X5. ; Y3.\nY1.", [(5, 0, 0), (5, 1, 0)]),
    ("G-code", "G91 X1. Y1.\nX1. Y1.\nG90 X0.", [(1, 1, 0), (2, 2, 0), (0, 2, 0)]),
    ("G-code", "G91\nM98 P5\nX1.\nM30\nO5\nY1.\nM99", [(0, 1, 0), (1, 1, 0)]),
    ("G-code", "G4 X2.\nX5.", [(5, 0, 0)]),
    ("G-code", "G4 P500\nX5.", [(5, 0, 0)]),
    ("G-code", "G4 U1.\nX5.", [(5, 0, 0)]),
    ("G-code", "G52 X10.\nG1 X1.\nG52 X0.\nX2.", [(11, 0, 0), (2, 0, 0)]),
    ("G-code", "X10.\nG92 X0.\nX1.", [(10, 0, 0), (11, 0, 0)]),
    ("G-code", "G68 X0. Y0. R90.\nX5.\nG69\nX5.", [(0, 5, 0), (5, 5, 0)]),
    ("G-code", "G51 X0. Y0. Z0. P2.\nX5.\nG50\nX5.", [(10, 0, 0), (5, 0, 0)]),
    ("G-code", "G51.1 X0.\nX5.\nG50.1 X0.\nX5.", [(-5, 0, 0), (5, 0, 0)]),
    ("G-code", "G16\nX10. Y90.\nG15\nX5.", [(0, 10, 0), (5, 10, 0)]),
    ("G-code", "G5.1 Q1\nX5.", [(5, 0, 0)]),
    ("G-code", "G43 H1\nX5.\nG49", [(5, 0, 0)]),
    ("G-code", "G43 H1 Z5.\nX5.", [(0, 0, 5), (5, 0, 5)]),
    ("G-code", "G41 D1 X5.\nX9.\nG40", [(5, 0, 0), (9, 0, 0)]),
    ("G-code", "G61\nX5.\nG64 P0.01\nX6.", [(5, 0, 0), (6, 0, 0)]),
    ("G-code", "G1 X10. ,C2.\nY10.", [(8, 0, 0), (10, 2, 0), (10, 10, 0)]),
    ("G-code", "G95 S1000 M3 X10. F0.1", [(10, 0, 0)]),
    ("G-code", "M0 X5.", [(5, 0, 0)]),
    ("G-code", "N10\nN20 X5.", [(5, 0, 0)]),
    ("G-code", "g1 x5. y1.", [(5, 1, 0)]),
    ("G-code", "X5.\nM30\nO2\nG0 X50.\nG1 X60.", [(5, 0, 0)]),
    ("G-code", "X+5. Y-.5", [(5, -0.5, 0)]),
    ("G-code", "X[2+3*2] Y[-1.]\n", [(8, -1, 0)]),
    ("Sinumerik", "G91 X=AC(5) Y=IC(2)", [(5, 2, 0)]),
    ("Sinumerik", "X=IC(5)\nX=IC(5)", [(5, 0, 0), (10, 0, 0)]),
    ("Sinumerik", "G111 X0 Y0\nG1 AP=90 RP=10", [(0, 10, 0)]),
    ("Sinumerik", "TRANS X10\nX1\nATRANS X5\nX1\nTRANS\nX1", [(11, 0, 0), (16, 0, 0), (1, 0, 0)]),
    ("Sinumerik", "ROT RPL=90\nX5\nROT", [(0, 5, 0)]),
    ("Sinumerik", "SCALE X2\nX5\nSCALE\nX5", [(10, 0, 0), (5, 0, 0)]),
    ("Sinumerik", "MIRROR X0\nX5\nMIRROR\nX5", [(-5, 0, 0), (5, 0, 0)]),
    ("Sinumerik", "G642\nX5\nG60 X6", [(5, 0, 0), (6, 0, 0)]),
    ("Sinumerik", "X10 CHR=2\nY10", [(8, 0, 0), (10, 2, 0), (10, 10, 0)]),
    ("Sinumerik", "G4 F2\nX5", [(5, 0, 0)]),
    ("Sinumerik", "G95 S1000 M3\nX5 F0.1", [(5, 0, 0)]),
    ("Sinumerik", "G70\nX1\nG71", [(25.4, 0, 0)]),
    ("Sinumerik", "G700\nX1 F10", [(25.4, 0, 0)]),
    ("Sinumerik", "R1=5 R2=R1*2\nX=R2", [(10, 0, 0)]),
    ("Sinumerik", 'MSG("X5")\nX6', [(6, 0, 0)]),
    ("Sinumerik", "X5 ; Y7\nY1", [(5, 0, 0), (5, 1, 0)]),
    ("Sinumerik", "WAITM(1,1,2)\nX5", [(5, 0, 0)]),
    ("Sinumerik", "TRAORI\nG1 A3=0 B3=0 C3=1 X5", [(5, 0, 0)]),
    ("Sinumerik", "R1=1\nIF R1==1 GOTOF E1\nX9\nE1: X3", [(3, 0, 0)]),
    ("Heidenhain", "L IX+5\nL IX+5", [(5, 0, 0), (10, 0, 0)]),
    ("Heidenhain", "CC X+0 Y+0\nLP PR+10 PA+90", [(0, 10, 0)]),
    ("Heidenhain", "L X+10\nCHF 2\nL Y+10", [(8, 0, 0), (10, 2, 0), (10, 10, 0)]),
    (
        "Heidenhain",
        "CYCL DEF 7.0 DATUM\nCYCL DEF 7.1 X+10\nL X+1\nCYCL DEF 7.0\nCYCL DEF 7.1 X+0\nL X+1",
        [(11, 0, 0), (1, 0, 0)],
    ),
    ("Heidenhain", "CYCL DEF 7.0\nCYCL DEF 7.1 X+10\nCYCL DEF 7.0\nCYCL DEF 7.1 IX+5\nL X+1", [(16, 0, 0)]),
    ("Heidenhain", "CYCL DEF 10.0\nCYCL DEF 10.1 ROT+90\nL X+5", [(0, 5, 0)]),
    ("Heidenhain", "CYCL DEF 8.0\nCYCL DEF 8.1 X\nL X+5\nCYCL DEF 8.0\nCYCL DEF 8.1\nL X+5", [(-5, 0, 0), (5, 0, 0)]),
    ("Heidenhain", "CYCL DEF 11.0\nCYCL DEF 11.1 SCL 2\nL X+5", [(10, 0, 0)]),
    ("Heidenhain", "TRANS DATUM AXIS X+10\nL X+1\nTRANS DATUM RESET\nL X+1", [(11, 0, 0), (1, 0, 0)]),
    ("Heidenhain", "L X+5 FMAX\nL X+6", [(5, 0, 0), (6, 0, 0)]),
    ("Heidenhain", "Q1 = 5 + 2\nL X+Q1", [(7, 0, 0)]),
    ("Heidenhain", "Q1 = 5\nL X-Q1", [(-5, 0, 0)]),
    ("Heidenhain", "FN 0: Q1 = +5\nFN 1: Q2 = +Q1 + +2\nL X+Q2", [(7, 0, 0)]),
    ("Heidenhain", "L X+5 M97", [(5, 0, 0)]),
    ("Heidenhain", "L X+5 ; Y+7\nL Y+1", [(5, 0, 0), (5, 1, 0)]),
    ("Heidenhain", "/ L X+5\nL Y+1", [(5, 0, 0), (5, 1, 0)]),
    ("APT", "GODLTA/5,0,0\nGODLTA/0,3,0", [(5, 0, 0), (5, 3, 0)]),
    ("APT", "GODLTA/-2", [(0, 0, -2)]),
    ("APT", "TRANS/10,0,0\nGOTO/1,0,0", [(11, 0, 0)]),
    ("APT", "RAPID\nGOTO/5,0,0\nGOTO/6,0,0", [(5, 0, 0), (6, 0, 0)]),
    ("APT", "SPINDL/1000,RPM,CLW\nFEDRAT/0.1,MMPR\nGOTO/5,0,0", [(5, 0, 0)]),
    ("APT", "GOTO/5,$\n0,0", [(5, 0, 0)]),
    ("APT", "$$ GOTO/9,9,9\nGOTO/5,0,0", [(5, 0, 0)]),
    ("APT", "DELAY/2\nGOTO/5,0,0", [(5, 0, 0)]),
    ("APT", "UNITS/INCHES\nGOTO/1,0,0", [(25.4, 0, 0)]),
    ("Sinumerik", 'CYCLE800(0,"T",0,57,0,0,0,0,0,0,0,0,0,-1)\nX5', [(5, 0, 0)]),
    ("Heidenhain", "PLANE RESET STAY\nL X+5", [(5, 0, 0)]),
    ("Sinumerik", "G91 X5\nG90 X=IC(2)\nX1", [(5, 0, 0), (7, 0, 0), (1, 0, 0)]),
]


@pytest.mark.parametrize(("dialect", "body", "expected"), POINTS)
def test_points_equal_those_computed_by_hand(
    dialect: str, body: str, expected: list[tuple[float, ...]], tmp_path: Path
) -> None:
    path = read(tmp_path, dialect, body)
    assert not any(word.stops for word in path.ignored)
    assert np.allclose(list_points(path, dialect), expected, atol=1e-3)


ENDS = [  # dialect, blocks, last point, after arcs and rounded corners
    ("G-code", "G91 G2 X10. Y0. I5. J0.", (10, 0, 0)),
    ("G-code", "G18 G2 X10. Z0. I5. K0.", (10, 0, 0)),
    ("G-code", "G19 G3 Y10. Z0. J5. K0.", (0, 10, 0)),
    ("G-code", "G2 X0. Y0. I5. J0. Z-5.", (0, 0, -5)),
    ("G-code", "G2 X5. Y5. R-5.", (5, 5, 0)),
    ("G-code", "G1 X10. ,R2.\nY10.", (10, 10, 0)),
    ("Sinumerik", "G2 X10 Y0 CR=5", (10, 0, 0)),
    ("Sinumerik", "G2 X5 Y5 CR=-5", (5, 5, 0)),
    ("Sinumerik", "X1\nG2 X11 Y0 I=AC(6) J=AC(0)", (11, 0, 0)),
    ("Sinumerik", "G2 X10 Y0 AR=180", (10, 0, 0)),
    ("Sinumerik", "G2 X0 Y0 Z-5 I5 J0 TURN=2", (0, 0, -5)),
    ("Sinumerik", "X10 RND=2\nY10", (10, 10, 0)),
    ("Heidenhain", "CC X+5 Y+0\nC X+10 Y+0 DR-", (10, 0, 0)),
    ("Heidenhain", "CR X+10 Y+0 R+5 DR-", (10, 0, 0)),
    ("Heidenhain", "L X+5\nCT X+10 Y+5", (10, 5, 0)),
    ("Heidenhain", "CC X+5 Y+0\nCP IPA-180 DR-", (10, 0, 0)),
    ("Heidenhain", "CC X+5 Y+0\nCP IPA-720 IZ-4 DR-", (0, 0, -4)),
    ("Heidenhain", "L X+10\nRND R2\nL Y+10", (10, 10, 0)),
    ("Heidenhain", "APPR LT X+10 Y+0 LEN5 RL F100\nL X+20\nDEP LT LEN5", (25, 0, 0)),
    ("G-code", "G90.1\nG2 X10. Y0. I5. J0.\nG91.1\nG2 X0. Y0. I-5. J0.", (0, 0, 0)),
    ("G-code", "G18 G3 X0. Z-10. K-5.", (0, 0, -10)),
    ("G-code", "G2 X10. Y0. I5. J0.\nX0. Y0. I-5. J0.", (0, 0, 0)),
    ("Sinumerik", "CIP X10 Y0 I1=5 J1=5", (10, 0, 0)),
    ("Sinumerik", "X5\nCT X10 Y5", (10, 5, 0)),
    ("Sinumerik", "G91 G2 X10 Y0 CR=5\nG90", (10, 0, 0)),
    ("Heidenhain", "L X+5\nCC IX+5 IY+0\nCP IPA-180 DR-", (15, 0, 0)),
    ("Heidenhain", "CC X+5 Y+0\nC IX+10 IY+0 DR-", (10, 0, 0)),
]


@pytest.mark.parametrize(("dialect", "body", "expected"), ENDS)
def test_curves_end_at_their_end_points(dialect: str, body: str, expected: tuple[float, ...], tmp_path: Path) -> None:
    path = read(tmp_path, dialect, body)
    assert not any(word.stops for word in path.ignored)
    assert len(path) > 4
    assert np.allclose(list_points(path, dialect)[-1], expected, atol=1e-3)


REFUSED = [
    ("G-code", "IF[1EQ1]GOTO5 X9.\nX3.\nN5X4."),
    ("G-code", "X5.\nG10 L2 P1 X10.\nX5."),
    ("G-code", "G53 Z0.\nX5."),
    ("G-code", "G28 Z0.\nG1 X5."),
    ("G-code", "X5. X6."),
    ("G-code", "A30. X5."),
    ("G-code", "G43.4 H1 A30. X5."),
    ("Sinumerik", "$P_UIFR[1]=CTRANS(X,10)\nX5"),
    ("Sinumerik", "G33 Z-5 K1"),
    ("Sinumerik", "DIAMON\nX5"),
    ("Sinumerik", "POS[X]=5\nY5"),
    ("Sinumerik", "A1: G1 X5\nGOTOB A1"),
    ("Heidenhain", "FN 18: SYSREAD Q1 = ID270 NR1 IDX1\nL X+Q1"),
    ("Heidenhain", "L X+5 M89"),
    ("Heidenhain", 'SEL TABLE "A.D"\nCYCL DEF 7.0\nCYCL DEF 7.1 #5\nL X+5'),
    ("APT", "MODE/INCR\nGOTO/1,0,0"),
    ("G-code", "G112\nX5."),
    ("Sinumerik", "TRAILON(Y,X,1)\nX5"),
    ("Sinumerik", "$P_PFRAME=CTRANS(X,10)\nX5"),
    ("Sinumerik", "$P_PFRAME=$P_PFRAME:CROT(Z,90)\nX5"),
    ("Sinumerik", "PFRAME1=CTRANS(X,5)\nX5"),
    ("Sinumerik", "TOFRAME\nX5"),
    ("G-code", "G54.2 P1\nX5."),
    ("G-code", "X5.\nG10 L20 P1 X0.\nX5."),
    ("Heidenhain", "CYCL DEF 7.0\nCYCL DEF 7.1 #3\nL X+5"),
    ("Sinumerik", "POCKET3(5,0,1,-3,10,10,2,0,0,0,3)"),
    ("Sinumerik", "CYCLE61(5,0,1,-3,0,0,10,10,2)"),
    ("Sinumerik", "SLOT1(5,0,1,-3)"),
    (
        "Heidenhain",
        "CYCL DEF 200 Q200=2 Q201=-5 Q206=100 Q202=5 Q203=0 Q204=9"
        "\nPATTERN DEF POS1 (X+5 Y+5 Z+0) POS2 (X+9 Y+5 Z+0)\nCYCL CALL PAT FMAX",
    ),
    ("Heidenhain", "CYCL DEF 251 Q215=0\nCYCL CALL"),
    ("Heidenhain", "CYCL DEF 262 Q335=5\nCYCL CALL"),
    ("Heidenhain", 'CYCL DEF 225 ENGRAVE Q500="A"\nCYCL CALL'),
    ("Sinumerik", "TRAORI\nG1 A10 C20 X5"),
]


@pytest.mark.parametrize(("dialect", "body"), REFUSED)
def test_undeterminable_content_is_refused_with_its_line(dialect: str, body: str, tmp_path: Path) -> None:
    with pytest.raises(InputError, match=r"line \d+:"):
        read(tmp_path, dialect, body)


STOPS = [
    ("APT", "LOCALCS/1\nGOTO/1,0,0"),
    ("APT", "COORD/1,0,0\nGOTO/1,0,0"),
    ("APT", "WEIRDW/5\nGOTO/5,0,0"),
]


@pytest.mark.parametrize(("dialect", "body"), STOPS)
def test_words_that_may_move_points_stop_the_plan(dialect: str, body: str, tmp_path: Path) -> None:
    assert any(word.stops for word in read(tmp_path, dialect, body).ignored)


@pytest.mark.parametrize(
    ("text", "count"),
    [
        ("%_N_A_MPF\nG71 G90\nG0 X0 Y0 Z9\nG1 X5 F100\nM30\n%_N_B_MPF\nG0 X0 Y0 Z9\nG1 X8 F100\nM30\n", 2),
        ("%_N_A_MPF\nG71 G90\nG0 X0 Y0 Z9\nG1 X5 F100\n%_N_B_MPF\nG0 X0 Y0 Z9\nG1 X8 F100\nM30\n", 2),
        ("%_N_A_MPF\nG71 G90\nR1=5\nG0 X0 Y0 Z9\nG1 X=R1 F100\n%_N_B_MPF\nG0 X0 Y0 Z9\nG1 X8 F100\nM30\n", 2),
        ("%\nO1\nG21 G90\nG0 X0. Y0. Z9.\nG1 X5. F100.\nM30\nO2\nG0 X0.\nG1 X8. F100.\nM30\n%\n", 2),
    ],
)
def test_further_programs_of_a_file_are_named_and_not_read(text: str, count: int, tmp_path: Path) -> None:
    file = tmp_path / ("p.nc" if text.startswith("%\n") else "p.mpf")
    file.write_text(text)
    path = read_toolpath(file)
    assert len(path) == count
    assert path.position[-1, 0] * 1e3 == pytest.approx(5.0)
    assert any("program" in w for w in path.warnings)


def test_overlapping_programs_are_refused(tmp_path: Path) -> None:
    with pytest.raises(InputError, match="line 7"):
        read(tmp_path, "G-code", "X5.\nO2\nG1 X7.")
