"""Numbers of CAM files are plain decimals in every format."""

from __future__ import annotations

from pathlib import Path

import pytest

from machopt.data_types.toolpath import Toolpath
from machopt.errors import InputError
from machopt.file_formats.plain_decimals import parse_plain_decimal
from machopt.file_formats.source_file import parse_offsets
from machopt.toolpath.toolpath_reader import read_toolpath

NOT_PLAIN = [
    "1_0",
    "1_000",
    "nan",
    "NaN",
    "inf",
    "-inf",
    "infinity",
    "1e400",
    "1e16",
    "\u0661",
    "\uff11\uff10",
    "\u0967.5",
]
S = "G71 G90 G17 G54\nG0 X0 Y0 Z10\nF200 S500 M3\n"
M = S + "MCALL CYCLE81(5,0,1,-3)\n"
H = "BEGIN PGM A MM\nTOOL CALL 1 Z S1000\nL X+0 Y+0 Z+10 R0 FMAX\n"
APT = "UNITS/MM\nMULTAX/ON\nFEDRAT/100,MMPM\n"
ROW = "x_mm,y_mm,z_mm,i,j,k,move,feed_mm_min\n0,0,5,0,0,1,cut,100\n"
NCI = "1050\n1 2 3\n1012\n0 0 0\n1002\n1 100 10 7 0 0 0 0 0\n0\n0 0 0 10 -2\n"

# name → text with @ in place of a number, file suffix
PLACES: dict[str, tuple[str, str]] = {
    "HOLES1 number": (M + "HOLES1(0,0,0,10,10,@)\nMCALL\nM30\n", "mpf"),
    "HOLES1 place": (M + "HOLES1(@,0,0,10,10,2)\nMCALL\nM30\n", "mpf"),
    "HOLES2 radius": (M + "HOLES2(0,0,@,0,90,2)\nMCALL\nM30\n", "mpf"),
    "CYCLE801 rows": (M + "CYCLE801(0,0,0,10,10,2,@)\nMCALL\nM30\n", "mpf"),
    "CYCLE81 depth": (S + "CYCLE81(50,0,2,@)\nM30\n", "mpf"),
    "CYCLE83 peck": (S + "CYCLE83(50,0,2,-30,,,@,0,,,1,0)\nM30\n", "mpf"),
    "CYCLE800": (S + 'CYCLE800(1,"",0,57,0,0,0,@,0,0,0,0,0,-1)\nG1 X5 Z1\nM30\n', "mpf"),
    "Sinumerik X=": (S + "G1 X=@ Y5\nM30\n", "mpf"),
    "Sinumerik IC": (S + "G1 X=IC(@) Y5\nM30\n", "mpf"),
    "Sinumerik R": (S + "R1=@\nG1 X=R1 Y5\nM30\n", "mpf"),
    "Sinumerik index": (S + "DEF REAL A[3]\nG1 X=A[@] Y5\nM30\n", "mpf"),
    "Sinumerik size": ("DEF REAL A[@]\n" + S + "G1 X5\nM30\n", "mpf"),
    "Sinumerik repeats": (S + "G1 X5\nLA: G91 X1\nREPEATB LA P=@\nM30\n", "mpf"),
    "G-code X": ("G21 G90 G17\nG0 X0. Y0. Z5.\nG1 X@. F100.\nM30\n", "nc"),
    "G-code F": ("G21 G90 G17\nG0 X0. Y0. Z5.\nG1 X5. F@\nM30\n", "nc"),
    "G-code parameter": ("G21 G90 G17\nG0 X0. Y0. Z5.\n#1=@\nG1 X#1 F100.\nM30\n", "nc"),
    "G-code repeats": ("G21 G90 G17\nG0 X0. Y0. Z5.\nG91 G81 X5. R-2. Z-5. L@ F100.\nM30\n", "nc"),
    "Heidenhain X": (H + "L X+@ F100\nEND PGM A MM\n", "h"),
    "Heidenhain F": (H + "L X+5 F@\nEND PGM A MM\n", "h"),
    "Heidenhain Q": (H + "Q1 = @\nL X+Q1 F100\nEND PGM A MM\n", "h"),
    "Heidenhain FN": (H + "FN 0: Q1 = +@\nL X+Q1 F100\nEND PGM A MM\n", "h"),
    "Heidenhain cycle": (
        H
        + "CYCL DEF 200 DRILLING ~\nQ200=2 ~\nQ201=-@ ~\nQ206=150 ~\nQ202=5 ~\nQ210=0 ~\nQ203=+0 ~\nQ204=50 ~\nQ211=0\n"
        "L X+5 R0 FMAX M99\nEND PGM A MM\n",
        "h",
    ),
    "Heidenhain shift": (H + "CYCL DEF 7.0 DATUM SHIFT\nCYCL DEF 7.1 X+@\nL X+5 F100\nEND PGM A MM\n", "h"),
    "G-code macro argument": (
        "O1\nG21 G90 G17\nG0 X0. Y0. Z5.\nG65 P2 A@\nM30\nO2\nG1 X#1 F100.\nM99\n",
        "nc",
    ),
    "G-code bracket": ("G21 G90 G17\nG0 X0. Y0. Z5.\nG1 X[@+1] F100.\nM30\n", "nc"),
    "Heidenhain rotation": (H + "CYCL DEF 10.0 ROTATION\nCYCL DEF 10.1 ROT+@\nL X+5 F100\nEND PGM A MM\n", "h"),
    "Heidenhain scale": (H + "CYCL DEF 11.0 SCALING\nCYCL DEF 11.1 SCL@\nL X+5 F100\nEND PGM A MM\n", "h"),
    "Heidenhain tilt": (H + "PLANE SPATIAL SPA+0 SPB+@ SPC+0 TURN FMAX\nL X+5 F100\nEND PGM A MM\n", "h"),
    "Heidenhain circle": (H + "CC X+@ Y+0\nL X+5 F100\nEND PGM A MM\n", "h"),
    "Heidenhain ISO": (
        "%A G71 *\nN10 T1 G17 S1000*\nN20 G00 G90 X+0 Y+0 Z+10*\nN30 G01 X+@ F100*\nN99 %A G71 *\n",
        "i",
    ),
    "APT GOTO": (APT + "GOTO/0,0,5,0,0,1\nGOTO/@,0,5,0,0,1\nFINI\n", "apt"),
    "APT GOTO axis": (APT + "GOTO/0,0,5,0,0,1\nGOTO/1,0,5,0,0,@\nFINI\n", "apt"),
    "APT FEDRAT": (APT + "FEDRAT/@,MMPM\nGOTO/0,0,5,0,0,1\nGOTO/5,0,5,0,0,1\nFINI\n", "apt"),
    "APT CYCLE": (APT + "GOTO/0,0,5,0,0,1\nCYCLE/DRILL,DEPTH,@,MMPM,100,CLEAR,2\nGOTO/5,0,0\nCYCLE/OFF\nFINI\n", "apt"),
    "table x": (ROW + "@,0,5,0,0,1,cut,100\n", "csv"),
    "table feed": (ROW + "1,0,5,0,0,1,cut,@\n", "csv"),
    "list": ("1,2,3,180,0,0\n@,2,3,180,0,0\n", "csv"),
    "NCI place": (NCI + "1\n0 @ 0 5 100\n1003\n0\n", "nci"),
    "NCI feed": (NCI + "1\n0 5 0 5 @\n1003\n0\n", "nci"),
    "NCI feed of an arc": (NCI + "1\n0 10 0 5 100\n3\n0 0 10 5 0 0 5 @\n1003\n0\n", "nci"),
}


def read(tmp_path: Path, name: str, number: str) -> Toolpath:
    text, ending = PLACES[name]
    file = tmp_path / f"a.{ending}"
    file.write_text(text.replace("@", number), encoding="utf-8")
    if ending == "nci":
        return read_toolpath(file, unit="mm")
    return read_toolpath(file, default_feed=0.01, kind="path") if name == "list" else read_toolpath(file)


@pytest.mark.parametrize("name", PLACES)
def test_plain_decimal_is_read(tmp_path: Path, name: str) -> None:
    assert len(read(tmp_path, name, "1"))


@pytest.mark.parametrize("number", NOT_PLAIN)
@pytest.mark.parametrize("name", PLACES)
def test_other_numbers_are_refused(tmp_path: Path, name: str, number: str) -> None:
    try:
        path = read(tmp_path, name, number)
    except InputError:
        return
    assert [word.word for word in path.ignored if not word.understood and word.stops], "a plan would be made"


@pytest.mark.parametrize("number", NOT_PLAIN)
def test_part_of_a_text_is_not_read_as_a_number(number: str) -> None:
    with pytest.raises(ValueError):
        parse_plain_decimal(number)
    with pytest.raises(InputError):
        parse_offsets([f"G55=0,{number},0"])


@pytest.mark.parametrize(
    ("text", "value"), [(" 1.5 ", 1.5), ("-.5", -0.5), ("+2.", 2.0), ("1e-3", 1e-3), ("0010", 10.0)]
)
def test_notations_of_plain_decimals(text: str, value: float) -> None:
    assert parse_plain_decimal(text) == value
