"""Rules of G-code controls that readers easily violate: points, requested options and refusals."""

from __future__ import annotations

import math
from pathlib import Path

import numpy as np
import pytest

from machopt.data_types.toolpath import Toolpath
from machopt.errors import InputError
from machopt.file_formats.source_file import OptionNeededError
from machopt.toolpath.toolpath_reader import read_toolpath

HEAD = "G21 G90 G17 G94 G98\nG0 X0 Y0 Z10\nF300\n"


def read(tmp_path: Path, text: str, name: str = "part.nc", **options: object) -> Toolpath:
    file = tmp_path / name
    file.write_text(text, encoding="utf-8")
    return read_toolpath(file, **options)  # type: ignore[arg-type]


def end(t: Toolpath) -> list[float]:
    return [float(v) + 0.0 for v in np.round(t.position[-1] * 1e3, 6)]


def cut_length(t: Toolpath) -> float:
    step = np.linalg.norm(np.diff(t.position, axis=0), axis=1) * 1e3
    return float(step[t.cutting[1:]].sum())


@pytest.mark.parametrize(
    ("body", "place"),
    [
        # comments
        ("(depth; rough) G1 X10\nG1 Y5", (10, 5, 10)),
        ("G1 X10 ; (open\nG1 Y5", (10, 5, 10)),
        ("G1 X4 (a) Y3 (b; c) Z2", (4, 3, 2)),
        ("G1 X4 ; a ) b ( c", (4, 0, 10)),
        # numbers in expressions
        ("G1 X[ROUND[0.5]] Y[ROUND[2.5]] Z[ROUND[-0.5]]", (1, 3, -1)),
        ("G1 X[ROUND[1.5]] Y[ROUND[-2.5]] Z[ROUND[-1.49]]", (2, -3, -1)),
        ("G1 X[7 MOD -3] Y[-7 MOD 3] Z[8 MOD 3]", (1, 2, 2)),
        ("#1=-3\nG1 X-#1\nG1 Y-[2-5]", (3, 3, 10)),
        ("#1=-3\nG1 X - #1 Y+#1 Z--#1", (3, -3, -3)),
        ("G1 XSIN[30] YABS[-5]", (0.5, 5, 10)),
        ("G1 X-COS[60] YATAN[1]/[1] ZSQRT[9]", (-0.5, 45, 3)),
        ("#3=9\n#4=3\nG1 X##4\n#[1+4]=8\nG1 Y#5", (9, 8, 10)),
        ("#7=2\n#8=7\n#9=8\nG1 X###9", (2, 0, 10)),
        ("#01=6\nG1 X#1 Y#001", (6, 6, 10)),
        # subroutines
        ("O1 sub\n#31=7\n#5=9\nO1 endsub\n#31=3\n#5=4\nO1 call\nG1 X#31 Y#5", (7, 4, 10)),
        ("O1 sub\nO1 endsub [7]\nO1 call\nG1 X#<_value>", (7, 0, 10)),
        ("O1 sub\nO1 return [#1*2]\nG1 X99\nO001 endsub\nO1 call [4]\nG1 X#<_value>", (8, 0, 10)),
        ("O3 sub\nG1 X#1\nO3 endsub\n#1=3\no[#1] call [5]", (5, 0, 10)),
        ("G1 X4\nG1 X[#5420+1] Y[#<_x>*2] Z[#5422-1]", (5, 8, 9)),
        ("O1 sub\nM73\nG91\nG1 X2\nO1 endsub\nO1 call\nG1 X5", (5, 0, 10)),
        ("G91\nM70\nG90 G1 X5\nM72\nG1 X5 Y5", (10, 5, 10)),
        ("M70\nG20\nG91\nM72\nG1 X5 Y5", (5, 5, 10)),
        (
            "O1 sub\nG91 G1 X1\nG90\nO1 endsub\n#<i>=0\nO2 while [#<i> LT 3]\nO1 call\n#<i>=[#<i>+1]\nO2 endwhile",
            (3, 0, 10),
        ),
        ("O2 while [#5420 LT 3]\nG91 G1 X1\nG90\nO2 endwhile", (3, 0, 10)),
        # end of program
        ("G1 X5\nM2\nG1 X#7", (5, 0, 10)),
        ("G1 X5\nM30\nG1 X[", (5, 0, 10)),
        # polar words
        ("G1 @10 ^30\nG1 @10 ^60", (5, 8.660254, 10)),
        ("G1 @10 ^0\n^90\n@5", (0, 5, 10)),
        ("G1 @10 ^0\nG91 @2 ^90", (0, 12, 10)),
        # offsets
        ("G1 X5\nG92 X0\nG1 X1", (6, 0, 10)),
        ("G52 X5\nG1 X1\nG92.1\nG1 X1 Y1", (1, 1, 10)),
        ("G52 X5\nG1 X1\nG92 X0\nG1 X2", (8, 0, 10)),
        ("G92 X7\nG1 X9\nG92.2\nG1 X1\nG92.3\nG1 X9", (2, 0, 10)),
        ("G10 L2 P1 X0 Y0 Z0\nG1 X1\nG10 L2 P1 X5 Y0 Z0\nG1 X1", None),
        # words that do not move the tool
        ("G1 X5\nG28.1\nG1 X7", (7, 0, 10)),
        ("G43.1 Z5\nG1 X7", (7, 0, 10)),
        ("S100 M3\nG81 X5 Y5 Z-5 R2\nM19 R3\nX10\nG80", (10, 5, 10)),
        ("G5.1 Q1\nG1 X3\nG5.1 Q0", (3, 0, 10)),
    ],
)
def test_end_position_of_a_program(tmp_path: Path, body: str, place: tuple[float, float, float] | None) -> None:
    text = HEAD + body + ("" if "M30" in body or "M2\n" in body else "\nM2") + "\n"
    if place is None:
        with pytest.raises(InputError):
            read(tmp_path, text)
        return
    assert end(read(tmp_path, text)) == pytest.approx(list(place), abs=1e-6)


def test_percent_sign_ends_the_program(tmp_path: Path) -> None:
    body = "G21 G90\nG0 X0 Y0 Z10\nF300\nG1 X5\n"
    for behind in ("G1 X50\n", "\n\nG1 X50\n", "X50 Y50\nM30\n%\n"):
        assert end(read(tmp_path, f"%\n{body}%\n{behind}")) == [5, 0, 10]
    two = "%\nO1\nG21 G90\nG0 X0 Y0 Z10\nM98 P2\nM30\n%\n%\nO2\nG1 X7 F300\nM99\n%\n"
    assert end(read(tmp_path, two)) == [7, 0, 10]
    header = "(TOOL LIST)\n(MILL 1)\n%\n" + body + "%\n"
    assert end(read(tmp_path, header)) == [5, 0, 10]


@pytest.mark.parametrize(
    "text",
    [
        "G90 G17\nG0 X0 Y0 Z0\nF300\nG1 X10\nM2\nG20\n",
        "G90\nG0 X0 Y0 Z0\nG1 X10 F100\nG20 F10\nG1 X1\nM2\n",
        "F100\nG21 G90\nG1 X1\nM2\n",
        "G90 G0 X5\nG21\nG1 X1 F100\nM2\n",
        "G90\no1 if [1 EQ 2]\nG20\no1 endif\nG0 X1\nG1 X2 F9\nM2\n",
        "%\nG90 G0 X1\nG1 X2 F9\n%\nG21\n",
        "G90 G1 Z5 F9\nG20\nM2\n",
        "O1 sub\nG21\nO1 endsub\nG0 X1 Y0 Z0\nO1 call\nG1 X2 F9\nM2\n",
        "G0 Z5 (G21)\nG1 X1 F9\nG21\nM2\n",
        "G91 G1 X1 F9\nG71\nX2\nM2\n",
    ],
)
def test_length_before_the_first_unit_word_asks_for_the_unit(tmp_path: Path, text: str) -> None:
    with pytest.raises(OptionNeededError) as requested:
        read(tmp_path, text)
    assert requested.value.option == "unit"


def test_option_is_the_unit_before_the_first_unit_word(tmp_path: Path) -> None:
    text = "G90\nG0 X0 Y0 Z0\nG1 X10 F100\nG20 F10\nG1 X1\nM2\n"
    x = read(tmp_path, text, unit="mm").position[:, 0] * 1e3
    assert x.tolist() == pytest.approx([0, 10, 25.4])
    with pytest.raises(InputError, match="line 1"):
        read(tmp_path, "G21 G90\nG0 X0 Y0 Z0\nG1 X10 F100\nM2\n", unit="inch")
    zeros = read(tmp_path, "G90 G0 X0 Y0 Z0\nG28 Z50\nG53 X9\nG21\nG0 X1 Y1 Z1\nG1 X2 F9\nM2\n")
    assert end(zeros) == [2, 1, 1]  # zeros and machine positions need no unit


@pytest.mark.parametrize("lost", ["G53 G0 X50 Y50", "G28 X0 Y0", "G28 G91 X0 Y0\nG90", "G30 X0 Y0", "G53 X1 Y1 Z1"])
@pytest.mark.parametrize("cut", ["G1 X5 Y5 Z0", "G1 X5 Y5 Z5\nX9", "G2 X5 Y5 R9", "G91 G1 X1"])
def test_cut_from_an_unknown_place_is_refused(tmp_path: Path, lost: str, cut: str) -> None:
    with pytest.raises(InputError, match="not known"):
        read(tmp_path, f"{HEAD}G1 X5\nG0 Z20\n{lost}\n{cut}\nM2\n")
    back = read(tmp_path, f"{HEAD}G1 X5\nG0 Z20\n{lost}\nG0 X1 Y1 Z5\nG1 X5 Y5 Z0\nM2\n")
    assert end(back) == [5, 5, 0]


def test_work_offsets_need_both_places(tmp_path: Path) -> None:
    text = "G21 G90\n{}G54 G0 X0 Y0 Z10\nF300\nG54 G1 X10\nG55 G1 X10 Y0 Z10\nM2\n"
    for lines in ("G10 L2 P2 X50 Y0 Z0\n", "G10 L2 P2 X50\n", "G10 L2 P1 X1 Y1\nG10 L2 P2 X50 Y0 Z0\n", ""):
        with pytest.raises(InputError, match="--offset G55"):
            read(tmp_path, text.format(lines))
    both = read(tmp_path, text.format("G10 L2 P1 X20 Y1 Z0\nG10 L2 P2 X50 Y0 Z0\n"))
    assert end(both) == [40, -1, 10]
    turned = read(tmp_path, text.format("G10 L2 P1 X0 Y0 Z0\nG10 L2 P2 X50 Y0 Z0 R90\n"))
    assert end(turned) == pytest.approx([50, 10, 10])
    assert end(read(tmp_path, text.format(""), offsets=("G55=7,0,0",))) == [17, 0, 10]
    with pytest.raises(InputError, match="--offset G57"):
        read(tmp_path, text.format(""), offsets=("G55=7,0,0", "G57=1,1,1"))


@pytest.mark.parametrize("word", ["G10 L2 P1 R90", "G10 L2 P1 X5", "G10 L20 P1 X0", "G10 L2 P0 X1", "G10 L2 X3"])
def test_offset_changed_within_the_path_is_refused(tmp_path: Path, word: str) -> None:
    with pytest.raises(InputError, match="line 5"):
        read(tmp_path, f"{HEAD}G1 X5\n{word}\nG1 X10 Y0\nM2\n")


def test_g92_at_the_start_defines_the_tool_position(tmp_path: Path) -> None:
    begin = "G21 G90 G17\n"
    relative = read(tmp_path, begin + "G92 X10 Y20 Z30\nF300\nG91 G1 X5 Y0 Z0\nY5\nG90 G1 X10\nM2\n")
    assert np.round(relative.position * 1e3, 6).tolist() == [[10, 20, 30], [15, 20, 30], [15, 25, 30], [10, 25, 30]]
    arc = read(tmp_path, begin + "G92 X0 Y0 Z0\nF300\nG2 X10 Y0 I5 J0\nM2\n")
    assert cut_length(arc) == pytest.approx(5 * math.pi, abs=0.02)
    part = read(tmp_path, begin + "F300\nG0 Z5\nG92 X0 Y0\nG1 X5 Y5\nM2\n")
    assert np.round(part.position * 1e3, 6).tolist() == [[0, 0, 5], [5, 5, 5]]
    with pytest.raises(InputError, match=r"G92\.1"):
        read(tmp_path, begin + "G92 X0 Y0 Z0\nF300\nG1 X5\nG92.1\nG1 X9 Y0 Z0\nM2\n")
    ended = read(tmp_path, begin + "G92 X0 Y0 Z0\nF300\nG1 X5\nG92.1\nM2\n")
    assert end(ended) == [5, 0, 0]


@pytest.mark.parametrize(
    "body",
    [
        "G1 X5\nG92 X0\nG52 X3\nG1 X1",  # LinuxCNC replaces the shift, Fanuc adds it
        "G7\nG1 X5",
        "G5.1 X5 Y5 I1 J1",
        "G28.1 X5",
        "G2 X10 Y0 I5 P1.5",
        "G2 X10 Y0 I5 P0",
        "G2 X10 Y0 I5 P-1",
        "G92.3\nG1 X1",
        "M72\nG1 X1",
        "#5221=5\nG1 X1",
        "#5212=5\nG55\nG1 X1",
        "O1 sub\nG1 X1\nO1 endsub G1 X2\nO1 call",
        "G1 X2 O1 call",
        "O1 if [1 EQ 1] G1 X5\nO1 endif",
        "G1 X１0",
        "G1 X−5",
        "G1 Ｘ5",
        "IF [1 EQ 1] THEN\nG1 X1\nENDIF",
        "G65 P5 A1 G90\nM2\nO5\nG1 X1\nM99",
        "M98 P5 Q10\nM2\nO5\nG1 X1\nM99",
        "G2 X10 Y0 I5\nG33 Z1 K1",
    ],
)
def test_unsupported_point_transformations_are_refused(tmp_path: Path, body: str) -> None:
    with pytest.raises(InputError, match=r"line \d"):
        read(tmp_path, HEAD + body + "\nM2\n")


@pytest.mark.parametrize(
    ("body", "place"),
    [
        ("M98 P100\nG90 G1 X30\nM30\nO100\nG91 G1 Z-12\nX10\nG90 G0 Z10 M99", (30, 0, 10)),
        ("M98 P100\nX5\nM30\nO100\nG81 X1 Y1 Z-1 R2\nG80 M99", None),
        ("G1 Y0\nM98 P100\nG1 X50\nN200 G1 Y6\nM30\nO100\nX10\nM99 P200", (10, 6, 10)),
        ("#1=2\nIF [#1 EQ 2] THEN G1 X5\nM30", (5, 0, 10)),
        ("#1=3\nIF [#1 EQ 2] THEN G1 X5\nG1 Y1\nM30", (0, 1, 10)),
        ("#1=2\nN5 IF [#1 EQ 2] THEN #1=9\nG1 X#1\nM30", (9, 0, 10)),
        ("G1 X1 M98 P100\nM30\nO100\nY[2+2]\nM99", (1, 4, 10)),
        ("M98 P100 L2\nM30\nO100\nG91 G1 X1\nY1 M99", (2, 2, 10)),
        ("#5=0\nWHILE [#5 LT 3] DO1\nG65 P100 A1.\n#5=#5+1\nEND1\nM30\nO100\nG91 G1 X#1\nG90\nM99", (3, 0, 10)),
        ("G1 X1\nM98 P100\nM30\nO100\nG1 X5 Y5 Z-2 M99\nG1 X99", (5, 5, -2)),
        ("G1 X1\nG0 Z50 M30\nG1 X9", (1, 0, 50)),
        ("#1=0\nN10 #1=#1+1\nG1 X#1\nIF [#1 LT 3] GOTO 10\nM30\nO2\nN10 G1 X99\nM99", (3, 0, 10)),
        ("M98 P100\nG1 Y2\nM30\nO100\nIF [1 EQ 1] THEN G0 X8 M99\nG1 Y9\nM99", (8, 2, 10)),
        ("G90 G0 X2 G65 P100 A1.\nM30\nO100\nG91 G1 X#1\nG90\nM99", (3, 0, 10)),
        ("G1 X5\nM99 P5\nX6\nN5 Y7\nM30", (5, 7, 10)),
        ("N5 G1 X5\nY2 P5 M99", (5, 2, 10)),
        ("N1 M97 P50\nG1 Y3\nM30\nN50 G1 X4\nZ1 M99", (4, 3, 1)),
    ],
)
def test_words_beside_a_flow_word_are_executed(
    tmp_path: Path, body: str, place: tuple[float, float, float] | None
) -> None:
    text = "%\nO1\nG21 G90 G94 G17 G54\nG0 X0 Y0 Z10\nG1 F100\n" + body + "\n%\n"
    t = read(tmp_path, text)
    if place is not None:
        assert end(t) == pytest.approx(list(place))
    else:  # one hole: G80 ended the cycle
        assert end(t) == [5, 1, 10]
        assert (t.position[:, 2] < 0.0).sum() == 1


@pytest.mark.parametrize("word", ["M17", "RET", "M99"])
@pytest.mark.parametrize("line", ["G90 G0 Z10 {}", "G0 Z10 G90 {}", "N40 G90 Z10 {}", "G90 Z=10 {}"])
def test_sinumerik_returns_after_the_motion_of_its_block(tmp_path: Path, word: str, line: str) -> None:
    text = (
        "%_N_MAIN_MPF\nG17 G90 G94 G71 G54\nG0 X0 Y0 Z10\nL100\nG0 X30 Y0\nL100\nG0 Z50\nM30\n%_N_L100_SPF\n"
        "G91 G1 Z-12 F100\nX10\nX-10\n" + line.format(word) + "\n"
    )
    t = read(tmp_path, text, "part.mpf")
    assert t.position[t.cutting].min(axis=0)[2] == pytest.approx(-2e-3)
    assert end(t) == [30, 0, 50]


@pytest.mark.parametrize(("plane", "along"), [("G17", 2), ("G18", 1), ("G19", 0)])
@pytest.mark.parametrize("cycle", ["G81", "G82 P0.5", "G83 Q2", "G73 Q2", "G85", "G86 P0.5", "G89 P0.5"])
def test_cycles_drill_along_the_plane_normal(tmp_path: Path, plane: str, along: int, cycle: str) -> None:
    a, b = ("XYZ"[k] for k in range(3) if k != along)
    depth = "XYZ"[along]
    text = f"G21 G90 G94 G98\nG0 X10 Y10 Z10\nF300\n{plane} {cycle} {a}3 {b}4 {depth}-5 R2\n{a}7\nG80 G17\nM2\n"
    t = read(tmp_path, text)
    holes = np.round(t.position[t.cutting][np.isclose(t.position[t.cutting][:, along], -5e-3)] * 1e3, 6)
    across = [k for k in range(3) if k != along]
    assert holes[:, across].tolist() == [[3, 4], [7, 4]]
    assert np.allclose(t.axis[t.cutting][:, along], 1.0)
    assert end(t)[along] == 10


def test_repeated_polar_increments_rotate(tmp_path: Path) -> None:
    t = read(tmp_path, "G21 G90 G98\nG0 X10 Y0 Z10\nG91 G81 R-8 Z-3 ^60 L6 F99\nG80\nM2\n")
    holes = t.position[t.cutting] * 1e3
    angle = np.radians(60.0 * np.arange(1, 7))
    assert holes[:, :2] == pytest.approx(10 * np.column_stack([np.cos(angle), np.sin(angle)]), abs=1e-6)


@pytest.mark.parametrize(
    ("head", "line", "seconds"),
    [
        ("O1234\n", "G82 X0 Y0 Z-10. R4. P50 F100.", 0.05),
        ("O1234\n", "G89 X0 Y0 Z-10. R4. P99 F100.", 0.099),
        ("O1234\n", "G82 X0 Y0 Z-10. R4. P0.5 F100.", 0.5),
        ("O1234\n", "G4 X500", 0.5),
        ("O1234\n", "G4 P20", 0.02),
        ("O1234\n", "G4 X1.5", 1.5),
        ("#<a>=1\n", "G4 P2", 2.0),
        ("#<a>=1\n", "G82 X0 Y0 Z-10. R4. P2 F100.", 2.0),
        ("", "G4 P1500", 1.5),
        ("", "G4 P5", math.nan),
        ("", "G82 X0 Y0 Z-10. R4. P5 F100.", math.nan),
    ],
)
def test_units_of_dwells(tmp_path: Path, head: str, line: str, seconds: float) -> None:
    t = read(tmp_path, f"%\n{head}G21 G90 G94 G54 G98\nG0 X0. Y0. Z10.\n{line}\nG80\nG1 X1. F50\nM30\n%\n")
    found = [e.value for e in t.events if e.kind == "dwell"]
    assert found == pytest.approx([seconds], nan_ok=True)


@pytest.mark.parametrize(
    "line", ["G4 P500.", "G4 X900.", "G82 X0 Y0 Z-10. R4. P90. F100.", "G89 X0 Y0 Z-10. R4. P500. F100.", "G4 P900000"]
)
def test_absurd_dwell_is_refused(tmp_path: Path, line: str) -> None:
    with pytest.raises(InputError, match="line 5"):
        read(tmp_path, f"%\nO1\nG21 G90 G94 G54 G98\nG0 X0. Y0. Z10.\n{line}\nG80\nG1 X1 F50\nM30\n%\n")


@pytest.mark.parametrize(
    ("body", "count"),
    [
        ("O1 if [1 EQ 1.00005]\nG1 X5\nO1 endif\nG1 Y1", 1),
        ("G1 X[FIX[-1.2]]", 1),
        ("G1 X[FUP[-1.2]]", 1),
        ("G1 X[-7 MOD 3]", 1),
        ("G1 X[7 MOD 3] Y[FIX[1.2]]", 0),
        ("G89 X5 Y5 Z-10 R2 P0.1\nG80", 1),
        ("G99 G89 X5 Y5 Z-10 R2 P0.1\nG80", 0),
        ("G99 G81 X5 Y5 Z-5 R2\nG91 X5\nG80 G90", 1),
        ("G99 G81 X5 Y5 Z-5 R2\nX7\nG80 G90", 0),
        ("G1 X5.0\nG2 X5.0 Y-0.001 I50.0", 2),
        ("G1 X5.0\nG3 X5.0001 Y0.0001 I1.0", 2),
        ("G1 X5\nG2 X5 Y0 I50", 0),
        ("G1 X5 (open\nG1 Y2", 1),
        ("G81 X1 Y1 Z-1 R2\nG0 X3\nG81 F100\nG80", 1),
        ("G81 X1 Y1 Z-1 R2\nG80", 0),
    ],
)
def test_differences_between_controls_are_noted(tmp_path: Path, body: str, count: int) -> None:
    assert len(read(tmp_path, HEAD + body + "\nM2\n").warnings) == count


def test_cycle_before_g98_or_g99_and_initial_cut_are_noted(tmp_path: Path) -> None:
    assert len(read(tmp_path, "G21 G90\nG0 X0 Y0 Z10\nG81 X5 Y5 Z-5 R2 F9\nX10\nG80\nM2\n").warnings) == 1
    assert len(read(tmp_path, "G21 G90 G17\nF300\nG1 X1 Y1 Z1\nX2\nM2\n").warnings) == 1


@pytest.mark.parametrize(
    ("body", "line"),
    [("G1 X0\nG2 X9", 4), ("G55 G68.3 X1", 3), ("G1 X5\nG12.1", 4), ("G81 X1 Y1 Z-3", 3), ("M98 P77", 3)],
)
def test_questions_come_last(tmp_path: Path, body: str, line: int) -> None:
    """The file states no unit and no feed, but neither option corrects the later error."""
    with pytest.raises(InputError) as refused:
        read(tmp_path, f"G90 G98\nG0 X10 Y5 Z1\n{body}\nM2\n")
    assert not isinstance(refused.value, OptionNeededError)
    assert refused.value.where == f"line {line}"


@pytest.mark.parametrize(
    "body",
    [
        "G1 X100 F0.15",
        "G1 X100 F0.5",
        "G95\nS1 M3\nG1 X100 F0.1",
        "G81 X5 Y5 Z-10 R2 F0.08\nG80",
        "G1 X20 F0.1",
        "G1 X9 F0.2\nX0\nX9\nX0",
        "G2 X50 Y0 I25 F0.3",
        "G93 G1 X10 F0.001",
        "G1 X3000 F10",
        "G20\nG1 X1 F0.005",
    ],
)
def test_feed_that_takes_hours_is_refused(tmp_path: Path, body: str) -> None:
    with pytest.raises(InputError, match=r"line \d"):
        read(tmp_path, HEAD + body + "\nM2\n")


@pytest.mark.parametrize("body", ["G1 X1 F0.5", "G1 X100 F5", "G95\nS3000 M3\nG1 X100 F0.15", "G1 X5000.0 F60"])
def test_plausible_slow_feeds_are_read(tmp_path: Path, body: str) -> None:
    assert len(read(tmp_path, HEAD + body + "\nM2\n")) == 2


def test_rigid_tapping_goes_down_and_back(tmp_path: Path) -> None:
    t = read(tmp_path, HEAD + "S500 M3\nG33.1 X2 Z5 K0.5\nG1 X5\nM2\n")
    assert np.round(t.position * 1e3, 6).tolist() == [[0, 0, 10], [2, 0, 5], [0, 0, 10], [5, 0, 10]]
    assert t.feed[1] * 60e3 == pytest.approx(250.0)
    with pytest.raises(InputError, match="without K"):
        read(tmp_path, HEAD + "S500 M3\nG33.1 Z5\nM2\n")


# files whose numbers depend on a parameter of the control; the letter and position of one with 3 implied decimals
IMPLIED = [
    ("G71 G90\nG00X0000000Y0000000Z0005\nG01X0019685Y-0008937Z0005F100\nM30\n", "X", 19.685),
    ("N1G21G90\nN2G0X0Y0Z5\nN3G1F100Z0\nN4X45000\nM30\n", "X", 45.0),
    ("N1G21G90G0X0Y0Z5.\nN3G1F100Z0.\nN4X45000Y0\nM30\n", "X", 45.0),
    ("G21 G90\nG0 X0. Y0. Z5.\nG1 Z-.1 F10.\nX1.5\nX0019685Y0008937\nM30\n", "Y", 8.937),
    ("G21 G90\nG0 X0. Y0. Z5.\nG1 Z-.1 F10.\nN7X15000Y20000\nM30\n", "Y", 20.0),
    ("G21 G90\nG0 X0 Y0 Z5\nG1 X0100 F100\nM30\n", "X", 0.1),
    ("G21 G90\nG0 X0. Y0. Z5.\nG2 X10. Y0. I0005000 J0.F100\nM30\n", "X", 10.0),
    ("N1G21G90\nN2G0X-0012000Y0Z5000\nN3G1X12000F100\nM30\n", "X", 12.0),
    ("G21 G90 G98\nG0X0Y0Z5000\nG81X1000Y2000Z-3000R1000F100K2\nX2000K1\nG80\nM30\n", "X", 2.0),
    ("G21 G90\nG0X0Y0Z5(X5.)\nG1X1500F100;X1.\nM30\n", "X", 1.5),
    ("G21 G90\nG0X 0Y 0Z 00500\nG1X- 01500F100\nM30\n", "X", -1.5),
    ("G21G90G0X0Y0Z5.\nG1F100Z0.X1.\nG1X2.Y12000\nM30\n", "Y", 12.0),
    # whole numbers with a point at their end and others without
    ("G21 G90\nG0 X0 Y0 Z5\nG1 Z-1 F100\nX10\nX20.\nY30\nM30\n", "Y", 0.03),
    ("O1\nG21 G90\nG0 X0 Y0 Z5\nG1 Z-1. F100\nX10\nM30\n", "X", 0.01),
    ("G21 G90\nG0 X0. Y0. Z5.5\nG1 Z-1.5 F100\nX10.\nX12\nY8\nX9\nM30\n", "X", 0.009),
    ("O1\nG21 G90\nG0 X0 Y0 Z5.5\nG1 Z-1.5 F100\nG2 X10. I5. J0\nG1 Y4\nM30\n", "Y", 0.004),
    ("G21 G90\nG0 X0 Y0 Z10.\nG81 X1.5 Y2 Z-3 R2 F100\nG80\nM30\n", "Y", 0.002),
    ("G20 G90\nG0 X0 Y0 Z1.\nG1 Z-.1 F10\nX2\nM30\n", "X", 0.002 * 25.4),
]


@pytest.mark.parametrize(("text", "letter", "place"), IMPLIED)
def test_implied_decimals_are_asked_for_and_apply_everywhere(
    tmp_path: Path, text: str, letter: str, place: float
) -> None:
    with pytest.raises(OptionNeededError) as requested:
        read(tmp_path, text)
    assert requested.value.option == "decimals"
    t = read(tmp_path, text, decimals=3)
    assert end(t)["XYZ".index(letter)] == pytest.approx(place)
    assert sum("--decimals 3" in w for w in t.warnings) == 1


@pytest.mark.parametrize(
    "text",
    [
        "G21 G90\nG0 X0. Y0. Z5\nG1 Z-1 F100\nX10\nM30\n",  # a point after zero does not indicate the convention
        "O1\nG21 G90\nG0 X0 Y0 Z5\nG1 Z-1.5 F100\nX10 Y12.25\nM30\n",  # points only where the fraction needs them
        "o<a> sub\no<a> endsub\nG21 G90\nG0 X0 Y0 Z5.\nG1 Z-1 F100\nX10\nM2\n",  # LinuxCNC
        "G21 G90\nM428\nM429\nG0 X0 Y0 Z5.\nG1 Z-1 F100\nX10\nM2\n",  # LinuxCNC's five-axis switches
        "O1\nG21 G90\nG0 X0. Y0. Z5.\nG1 Z-1. F100\nG4 P500\nX10.\nM30\n",  # G4 P500 is not a length
    ],
)
def test_unambiguous_lengths_are_read_without_the_option(tmp_path: Path, text: str) -> None:
    assert end(read(tmp_path, text))[0] == 10


@pytest.mark.parametrize(
    ("text", "name"),
    [
        ("G21 G90\n(X0019685)\nG0 X0. Y0. Z5.\nG1 X1. F100\nM30\n", "a.nc"),
        ("G21 G90\n;X0019685\nG0 X0. Y0. Z5.\nG1 X1. F100\nG4 X0500\nM30\n", "a.nc"),
        ("G21 G90\n#1=1500\nG0 X0 Y0 Z5\nG1 X#1 F100\nM30\n", "a.nc"),
        ("G71 G90 G17\nTRANS X0\nG0 X0 Y0 Z5\nG1 X1500 F100\nM30\n", "a.mpf"),
        ("BEGIN PGM A MM\nL X+0 Y+0 Z+5 R0 FMAX\nL X+1500 F100\nEND PGM A MM\n", "a.h"),
        ("x_mm,y_mm,z_mm,i,j,k\n0,0,0,0,0,1\n1,0,0,0,0,1\n", "a.csv"),
    ],
)
def test_decimals_option_without_effect_is_refused(tmp_path: Path, text: str, name: str) -> None:
    with pytest.raises(InputError, match="--decimals"):
        read(tmp_path, text, name, decimals=3)


@pytest.mark.parametrize("options", [{"tool_axis": "+x"}, {"cycle_order": ("clear", "depth")}])
def test_options_without_effect_on_g_code_are_refused(tmp_path: Path, options: dict[str, object]) -> None:
    with pytest.raises(InputError, match="no effect"):
        read(tmp_path, HEAD + "G1 X1\nM2\n", **options)
    assert len(read(tmp_path, HEAD + "G1 X1\nM2\n", machine="table-ac").warnings) == 1


def test_increments_from_the_start_count_from_zero(tmp_path: Path) -> None:
    for first in ("G91\nG0 X0 Y0 Z5", "G0 Z5\nG91"):
        t = read(tmp_path, f"G21 G90\n{first}\nG1 X5 F50\nY2\nX3\nM2\n")
        assert cut_length(t) == pytest.approx(10.0)
        assert end(t) == [8, 2, 5]


@pytest.mark.parametrize(
    ("body", "said"),
    [
        ("G1 Z-1.5 F200.\nX15 Y10\nX25 Y20\nX12.5", True),
        ("G1 Z-1.0 F200.\nX15\nX25\nX30", True),
        ("G1 Z-1.5\nX15", True),
        ("G1 Z-1.5\nG2 X10.0 I5 J0", True),
        ("G1 Z-1.5\nX15.", False),
        ("G1 Z-1.5\nX15.0", False),
        ("#<a>=1.5\nG1 Z-1.5\nX15", False),
    ],
)
def test_words_with_and_without_a_point_are_whole_units_with_a_note(tmp_path: Path, body: str, said: bool) -> None:
    t = read(tmp_path, f"%\nO1\nG21 G90 G17 G94 G54\nG0 X0 Y0 Z10.5\nF200.\n{body}\nM30\n%\n")
    assert any("--decimals" in text for text in t.warnings) == said
    if "X25" in body and "X12.5" in body:
        assert t.position[2, 0] * 1e3 == pytest.approx(15.0)


DIRECTIONS = {  # blocks after G43.5 and the last axis; directions have no implied decimals
    "a point in one of three": ("X10000 Y5. Z1. I0.5 J0 K1", (0.5, 0.0, 1.0)),
    "points in none": ("X10000 Y5000 Z1000 I1 J0 K2", (1.0, 0.0, 2.0)),
    "a point in K": ("X10000 I1 J2 K2.", (1.0, 2.0, 2.0)),
    "no K": ("X10000 I0 J1", (0.0, 1.0, 0.0)),
    "in a later block": ("X5000 I0 J0 K1\nX10000\nY5000 I3 J0 K4.0", (3.0, 0.0, 4.0)),
}


@pytest.mark.parametrize("name", DIRECTIONS)
def test_directions_have_no_implied_decimals(tmp_path: Path, name: str) -> None:
    text, axis = DIRECTIONS[name]
    t = read(tmp_path, f"G21 G90\nG43.5 H1\nG0 X0 Y0 Z5000 I0 J0 K1\nG1 F100\n{text}\nM30\n", decimals=3)
    np.testing.assert_allclose(t.axis[-1], np.array(axis) / np.linalg.norm(axis), atol=1e-12)
    assert end(t)[0] == pytest.approx(10.0)


@pytest.mark.parametrize("end_word", ["G49", "G43.4 H1"])
def test_lengths_after_directions_have_implied_decimals(tmp_path: Path, end_word: str) -> None:
    text = f"G21 G90\nG43.5 H1\nG0 X0 Y0 Z5000 I0 J0 K1\n{end_word}\nG1 Z0 F100\nG2 X10000 I5000 J0\nM30\n"
    t = read(tmp_path, text, decimals=3)
    assert np.ptp(t.position[:, 1]) * 1e3 == pytest.approx(5.0, abs=0.02)


@pytest.mark.parametrize("decimals", [3, 4])
def test_factors_have_no_implied_decimals(tmp_path: Path, decimals: int) -> None:
    text = "G21 G90\nG0 X0 Y0 Z5000\nG51 X0 Y0 Z0 I-1000 J1000 K1000\nG1 X20000 F100\nM30\n"
    assert end(read(tmp_path, text, decimals=decimals))[0] == pytest.approx(-20.0 * 10.0 ** (3 - decimals))
