"""A number with one damaged character is refused or has no effect; it never changes a point."""

from __future__ import annotations

import re
from pathlib import Path

import numpy as np
import pytest

from machopt.data_types.toolpath import Toolpath
from machopt.errors import InputError
from machopt.toolpath.toolpath_reader import read_toolpath
from machopt.toolpath.unknown_words import refuse_unknown_words

DAMAGE = ("\N{FULLWIDTH DIGIT ONE}", "\N{ARABIC-INDIC DIGIT FIVE}", "O", "?", "#!")

FANUC = """/PROG  SMALL
/ATTR
/MN
   1:  UFRAME_NUM=1 ;
   2:  UTOOL_NUM=2 ;
   3:J P[1] 20% FINE ;
   4:L P[2] 15mm/sec CNT50 ;
   5:C P[3]
    :  P[4] 15mm/sec FINE ;
/POS
P[1]{
   GP1:
	UF : 1, UT : 2,		CONFIG : 'N U T, 0, 0, 0',
	X =   812.500  mm,	Y =   -21.250  mm,	Z =   640.000  mm,
	W =   179.000 deg,	P =     1.500 deg,	R =   -30.250 deg,
	E1=    12.500  mm
};
P[2]{
   GP1:
	UF : 1, UT : 2,		CONFIG : 'N U T, 0, 0, 0',
	X =   812.500  mm,	Y =   -21.250  mm,	Z =   540.000  mm,
	W =   179.000 deg,	P =     1.500 deg,	R =   -30.250 deg,
	E1=    12.500  mm
};
P[3]{
   GP1:
	UF : 1, UT : 2,		CONFIG : 'N U T, 0, 0, 0',
	X =   832.500  mm,	Y =    -1.250  mm,	Z =   540.000  mm,
	W =   179.000 deg,	P =     1.500 deg,	R =   -30.250 deg,
	E1=    12.500  mm
};
P[4]{
   GP1:
	UF : 1, UT : 2,		CONFIG : 'N U T, 0, 0, 0',
	X =   852.500  mm,	Y =   -21.250  mm,	Z =   540.000  mm,
	W =   179.000 deg,	P =     1.500 deg,	R =   -30.250 deg,
	E1=    12.500  mm
};
/END
"""
KUKA = """DEF small()
$BASE = {X 1500,Y 20,Z 600,A 30,B 0,C 0}
$TOOL = {X 0,Y 0,Z 250,A 0,B 90,C 0}
$VEL.CP = 0.025
PTP {A1 0,A2 -90,A3 90,A4 0,A5 45,A6 0}
LIN {X 10.5,Y 20.25,Z 30,A 0,B 5,C 180}
LIN {X 110.5,Y 20.25,Z 30,A 0,B 5,C 180} C_DIS
CIRC {X 130.5,Y 40.25,Z 30,A 0,B 5,C 180},{X 150.5,Y 20.25,Z 30,A 0,B 5,C 180}
END
"""
ABB = """MODULE small
PERS tooldata t1:=[TRUE,[[0,0,250],[1,0,0,0]],[5,[0,0,100],[1,0,0,0],0,0,0]];
PERS wobjdata w1:=[FALSE,TRUE,"",[[1500,20,600],[1,0,0,0]],[[0,0,0],[1,0,0,0]]];
CONST robtarget p1:=[[10.5,20.25,30],[0,0,1,0],[0,0,0,0],[9E9,9E9,9E9,9E9,9E9,9E9]];
PROC main()
MoveL p1,v100,fine,t1\\WObj:=w1;
MoveL [[110.5,20.25,30],[0,0,1,0],[0,0,0,0],[9E9,9E9,9E9,9E9,9E9,9E9]],v25,z1,t1\\WObj:=w1;
MoveC Offs(p1,120,20,0),Offs(p1,140,0,0),v25,fine,t1\\WObj:=w1;
ENDPROC
ENDMODULE
"""
UR = """def small():
  set_tcp(p[0,0,0.25,0,0,0])
  movel(p[0.5105,0.2025,0.3,0,3.1,0], a=1.2, v=0.25)
  movel(p[0.6105,0.2025,0.3,0,3.1,0], a=1.2, v=0.025, r=0.001)
  movep(p[0.6205,0.2025,0.3,0,3.1,0], a=1.2, v=0.025, r=0.001)
end
small()
"""
YASKAWA = """/JOB
//NAME SMALL
//POS
///NPOS 2,0,0,2,0,0
///TOOL 1
///POSTYPE ROBOT
///RECTAN
///RCONF 0,0,0,0,0,0,0,0
C00000=810.500,20.250,300.000,180.0000,5.0000,0.0000
C00001=910.500,20.250,300.000,180.0000,5.0000,0.0000
P00001=810.500,20.250,350.000,180.0000,5.0000,0.0000
P00002=910.500,20.250,350.000,180.0000,5.0000,0.0000
//INST
///DATE 2026/01/01 10:00
///ATTR SC,RW
///GROUP1 RB1
NOP
MOVL C00000 V=250.0
MOVL C00001 V=25.0 PL=0
MOVL P00001 V=25.0
MOVL P00002 V=25.0
END
"""
GCODE = """%
O1000
G21 G90 G17
T3 M6
S9000 M3
G0 X10.5 Y20.25 Z30.
G1 Z-1.5 F250.
X110.5 F600.
G2 X130.5 Y20.25 I10. J0.
G3 X150.5 Y20.25 R10.
G81 X160. Y25. Z-5. R2. F120.
G80
G0 Z30.
M30
%
"""
SIEMENS = """G17 G71 G90 G94
T3 M6
S9000 M3
G0 X10.5 Y20.25 Z30
G1 Z-1.5 F250
X110.5 F600
G2 X130.5 Y20.25 I10 J0
G3 X150.5 Y20.25 CR=10
TRANS X5 Y2.5
G1 X160 Y25
TRANS
G0 Z30
M30
"""
HEIDENHAIN = """0 BEGIN PGM SMALL MM
1 TOOL CALL 3 Z S9000
2 L X+10.5 Y+20.25 Z+30 R0 FMAX M3
3 L Z-1.5 F250
4 L X+110.5 F600
5 CC X+120.5 Y+20.25
6 C X+130.5 Y+20.25 DR-
7 CYCL DEF 7.0 DATUM SHIFT
8 CYCL DEF 7.1 X+5
9 L X+150 Y+25 F600
10 L Z+30 FMAX
11 M30
12 END PGM SMALL MM
"""
APT = """PARTNO SMALL
UNITS/MM
LOADTL/3
SPINDL/9000,RPM,CLW
FEDRAT/250.5,MMPM
GOTO/10.5,20.25,30.0
FEDRAT/600.0,MMPM
GOTO/110.5,20.25,30.0,0.0,0.0,1.0
CIRCLE/120.5,20.25,30.0,0.0,0.0,1.0,10.0
GOTO/130.5,20.25,30.0
CIRCLE/120.5,20.25,30.0,0.0,0.0,1.0,10.0
GOTO/130.5,20.25,30.0
CYCLE/DRILL,FEDTO,12.5,RAPTO,3.0,MMPM,120.0
GOTO/160.0,25.0,30.0
CYCLE/OFF
GOHOME/0.0,0.0,250.0
FINI
"""
PROGRAMS = {
    "small.ls": FANUC,
    "small.src": KUKA,
    "small.mod": ABB,
    "small.script": UR,
    "small.jbi": YASKAWA,
    "small.nc": GCODE,
    "small.mpf": SIEMENS,
    "small.h": HEIDENHAIN,
    "small.apt": APT,
}


def read(file: Path, text: str) -> Toolpath:
    file.write_text(text, encoding="utf-8")
    return refuse_unknown_words(read_toolpath(file), file)


def list_digits(text: str) -> list[int]:
    """Return the positions of the digits in numbers with a decimal point, and of every fourth other digit."""
    pointed = {k for m in re.finditer(r"\d*\.\d+", text) for k in range(m.start(), m.end()) if text[k].isdigit()}
    return [m.start() for n, m in enumerate(re.finditer(r"\d", text)) if m.start() in pointed or n % 4 == 0]


@pytest.mark.slow
@pytest.mark.parametrize("name", PROGRAMS)
def test_no_damaged_digit_moves_a_point(tmp_path: Path, name: str) -> None:
    text, file = PROGRAMS[name], tmp_path / name
    right = read(file, text)
    tried = refused = 0
    for at in list_digits(text):
        for put in DAMAGE:
            tried += 1
            try:
                found = read(file, text[:at] + put + text[at + 1 :])
            except InputError:
                refused += 1
                continue
            line = text[:at].count("\n") + 1
            assert len(found) == len(right), (put, line, text.splitlines()[line - 1])
            for ours, theirs in ((found.position, right.position), (found.axis, right.axis), (found.feed, right.feed)):
                np.testing.assert_array_equal(ours, theirs, err_msg=f"{put} in line {line}")
    assert tried > 100
    assert refused > 0.6 * tried


@pytest.mark.parametrize(
    ("name", "old", "new"),
    [
        ("small.ls", "Y =   -21.250", "Y =   -21,250"),
        ("small.ls", "Y =   -21.250", "Y =   -21 .250"),
        ("small.ls", "Z =   540.000  mm,", "Z =   540.000  mm,  Z =   541.000  mm,"),
        ("small.apt", "FEDRAT/600.0", "FEDRAT/60,0.0"),
        ("small.apt", "CIRCLE/120.5", "CIRCLE/12,0.5"),
        ("small.apt", "GOHOME/0.0,0.0", "GOHOME/0.0,0.x"),
        ("small.nc", "X110.5", "X11O.5"),
        ("small.src", "Y 20.25", "Y 20,25"),
        ("small.mod", "20.25", "20,25"),
        ("small.script", "0.2025", "0,2025"),
        ("small.jbi", "C00001=910.500", "C00001=910,500"),
    ],
)
def test_number_in_two_parts_is_refused(tmp_path: Path, name: str, old: str, new: str) -> None:
    assert old in PROGRAMS[name]
    with pytest.raises(InputError):
        read(tmp_path / name, PROGRAMS[name].replace(old, new, 1))


def test_full_circle_begins_at_its_stated_radius(tmp_path: Path) -> None:
    """Start and end are equal, so a wrong centre changes the radius only."""
    wrong = APT.replace("CIRCLE/120.5,20.25,30.0,0.0,0.0,1.0,10.0\nGOTO/130.5,20.25,30.0\nCYCLE", "CIRCLE/125.5,20.25,"
                        "30.0,0.0,0.0,1.0,10.0\nGOTO/130.5,20.25,30.0\nCYCLE")  # fmt: skip
    assert wrong != APT
    with pytest.raises(InputError, match="radius"):
        read(tmp_path / "a.apt", wrong)


def test_patterns_accept_ascii_digits_only() -> None:
    r"""``\d`` matches digits of every script, and ``float`` would read them."""
    package = Path(__file__).resolve().parent.parent / "machopt"
    code = {path: re.sub(r"#.*", "", path.read_text(encoding="utf-8")) for path in package.rglob("*.py")}
    assert len(code) > 500
    assert [path for path, text in code.items() if r"\d" in text] == []
