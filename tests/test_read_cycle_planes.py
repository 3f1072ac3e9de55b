"""Drilling cycles of Sinumerik in every plane, and of Heidenhain under rotations, cycle 19 and machine cycles."""

from __future__ import annotations

import random
from pathlib import Path

import numpy as np
import pytest

from machopt.data_types.toolpath import MoveKind, Toolpath
from machopt.errors import InputError
from machopt.toolpath.toolpath_reader import read_toolpath
from machopt.toolpath.unknown_words import refuse_unknown_words

LETTERS = {17: "XYZ", 18: "ZXY", 19: "YZX"}  # first and second axis of the plane, and the drilling axis of the cycles
CYCLES = (
    "CYCLE81(50,0,2,-10)",
    "CYCLE81(50,0,2,,10)",
    "CYCLE82(50,0,2,-10,,0.5)",
    "CYCLE83(50,0,2,-30,,-8,,3,0.1,,1,1)",
    "CYCLE83(50,0,2,-30,,,8,0,,,1,0,,,,1)",
    "CYCLE84(50,0,2,-10,,0,3,,1,0,300,300)",
    "CYCLE85(50,0,2,-10,,0,100,200)",
    "CYCLE86(50,0,2,-10,,0.2,3)",
    "CYCLE88(50,0,2,-10,,0.2,3)",
    "CYCLE89(50,0,2,-10,,0.2)",
)
PATTERNS = (
    "X5 Y7\nX9 Y-3\n",
    "HOLES1(10,20,30,5,12,4)\n",
    "HOLES2(0,0,25,15,60,5)\n",
    "HOLES2(0,0,25,0,0,7)\n",
    "X5 Y7\nG91 X3\nG90\n",
)


def read(folder: Path, text: str, name: str = "part.mpf", **options: object) -> Toolpath:
    (folder / name).write_text(text)
    return read_toolpath(folder / name, **options)  # type: ignore[arg-type]


def in_plane(text: str, plane: int) -> str:
    """Convert words of G17 to those of another plane."""
    return text.translate(str.maketrans("XYZ", LETTERS[plane]))


@pytest.mark.parametrize("cycle", CYCLES)
@pytest.mark.parametrize("pattern", PATTERNS)
def test_cycles_are_the_same_in_every_plane(tmp_path: Path, cycle: str, pattern: str) -> None:
    """50 programs in three planes: the points in G18 and G19 equal those in G17 with exchanged axes."""
    found = {}
    for plane in (17, 18, 19):
        moves = in_plane(f"G0 X0 Y0 Z60\nMCALL {{}}\n{pattern}MCALL\nG0 Z70\n", plane)
        moves = moves.replace("{}", cycle)
        t = read(tmp_path, f"%_N_PART_MPF\nG71 G90 G{plane} G54\nT1 M6\nS1000 M3 F120\n{moves}M30\n")
        order = ["XYZ".index(letter) for letter in LETTERS[plane]]
        found[plane] = (t.position[:, order], t.axis[:, order], t.move, t.feed)
        drilled = t.cutting
        assert np.allclose(t.axis[drilled][:, order], [0, 0, 1])
    for plane in (18, 19):
        assert np.allclose(found[plane][0], found[17][0], atol=1e-12)
        assert (found[plane][2] == found[17][2]).all()
        assert np.array_equal(found[plane][3], found[17][3], equal_nan=True)


def test_cycle_in_another_plane_is_noted(tmp_path: Path) -> None:
    text = "%_N_PART_MPF\nG71 G90 G18 G54\nT1 M6\nF120\nG0 X0 Y60 Z0\nCYCLE81(50,0,2,-10)\nM30\n"
    assert any("G18" in w for w in read(tmp_path, text).warnings)


# ---- Heidenhain


HEAD = "0 BEGIN PGM T MM\n1 TOOL CALL 1 Z S1000\n"


def heidenhain(lines: list[str]) -> str:
    return HEAD + "".join(f"{n} {line}\n" for n, line in enumerate([*lines, "L Z+90 FMAX M30", "END PGM T MM"], 2))


START = ["L X+0 Y+0 Z+50 R0 FMAX", "L Z+0 F200"]


def test_irot_adds_to_the_active_rotation(tmp_path: Path) -> None:
    rng = random.Random(5)
    for _ in range(12):
        turns = [(rng.choice("+-") + str(rng.randint(1, 80)), rng.random() < 0.6) for _ in range(3)]
        lines, total = list(START), 0.0
        for text, more in turns:
            lines += ["CYCL DEF 10.0 ROTATION", f"CYCL DEF 10.1 {'I' if more else ''}ROT{text}"]
            total = float(text) + (total if more else 0.0)
        t = read(tmp_path, heidenhain([*lines, "L X+10 Y+0"]), "part.h")
        place = t.position[t.cutting][-1] * 1e3
        assert np.allclose(place, [10 * np.cos(np.radians(total)), 10 * np.sin(np.radians(total)), 0], atol=1e-9)


def test_g73_under_g91_adds_to_the_active_rotation(tmp_path: Path) -> None:
    text = (
        "%ISO G71 *\nN20 T1 G17 S1000 *\nN30 G00 G40 G90 X+0 Y+0 Z+50 M3 *\nN40 G01 Z+0 F250 *\nN50 G73 G90 H+30 *\n"
        "N60 G73 G91 H+45 *\nN70 G90 G01 X+10 Y+0 *\nN80 G00 Z+50 *\nN140 M30 *\nN99999999 %ISO G71 *\n"
    )
    t = read(tmp_path, text, "part.i")
    assert np.allclose(t.position[t.cutting][-1] * 1e3, [10 * np.cos(np.radians(75)), 10 * np.sin(np.radians(75)), 0])


@pytest.mark.parametrize("word", ["XROT+30", "ROTA 30", "WROT+5"])
def test_unknown_word_in_cycle_10_is_refused(tmp_path: Path, word: str) -> None:
    with pytest.raises(InputError):
        read(tmp_path, heidenhain([*START, "CYCL DEF 10.0 ROTATION", f"CYCL DEF 10.1 {word}", "L X+10"]), "part.h")


@pytest.mark.parametrize("angles", ["A+0 B+30 C+0", "A+20 B+0 C+0", "A-15", "B+10 F9999", "A+0 B+45 C+0"])
def test_cycle_19_sets_the_parameters_of_the_rotary_axes(tmp_path: Path, angles: str) -> None:
    tilt = ["CYCL DEF 19.0 WORKING PLANE", f"CYCL DEF 19.1 {angles}"]
    cut = ["L X+0 Y+0 R0 FMAX M3", "L Z+20 R0 FMAX", "L Z-1 F300", "L X+40", "L Z+20 FMAX"]
    with_words = read(tmp_path, heidenhain([*tilt, "L A+Q120 B+Q121 C+Q122 R0 FMAX", *cut]), "part.h")
    plain = read(tmp_path, heidenhain([*tilt, *cut]), "part.h")
    assert np.allclose(with_words.position, plain.position)
    assert np.allclose(with_words.axis, plain.axis)
    assert with_words.axis[0, 2] < 0.99


def test_axes_are_zero_after_resetting_cycle_19(tmp_path: Path) -> None:
    lines = ["CYCL DEF 19.0 WORKING PLANE", "CYCL DEF 19.1 A+0 B+30 C+0", "L B+Q121 C+Q122 FMAX", "L X+0 Y+0 Z+20 FMAX"]
    lines += ["L Z+0 F100", "L Z+20 FMAX", "CYCL DEF 19.0 WORKING PLANE", "CYCL DEF 19.1 A+0 B+0 C+0"]
    lines += ["L B+Q121 C+Q122 FMAX", "L X+5 Y+5 Z+20 FMAX", "L Z+0 F100"]
    t = read(tmp_path, heidenhain(lines), "part.h")
    assert t.axis[t.cutting][-1] == pytest.approx([0, 0, 1])


def test_computed_axes_without_a_plane_are_refused(tmp_path: Path) -> None:
    with pytest.raises(InputError):
        read(tmp_path, heidenhain(["L B+Q121 C+Q122 R0 FMAX", *START, "L X+5"]), "part.h")


def q_cycle(number: int, depth: str) -> list[str]:
    return [
        f"CYCL DEF {number} ~\n Q200=2 ;SET-UP ~\n Q201={depth} ;DEPTH ~\n Q206=150 ;FEED ~\n Q202=4 ~\n Q203=+1 ~\n"
        " Q204=20 ~\n Q239=1",
        "L X+30 Y+30 FMAX M99",
    ]


@pytest.mark.parametrize("number", [200, 201, 202, 203, 205, 206, 207, 209, 240, 241])
def test_sign_of_the_depth_counts(tmp_path: Path, number: int) -> None:
    t = read(tmp_path, heidenhain([*START, "L Z+50 FMAX", *q_cycle(number, "-9")]), "part.h")
    assert t.position[t.cutting][-1, 2] * 1e3 == pytest.approx(-8.0)
    with pytest.raises(InputError) as refused:
        read(tmp_path, heidenhain([*START, "L Z+50 FMAX", *q_cycle(number, "+9")]), "part.h")
    assert "Q201" in refused.value.reason
    none = read(tmp_path, heidenhain([*START, "L X+5", "L Z+50 FMAX", *q_cycle(number, "+0")]), "part.h")
    assert not (none.move == MoveKind.RETRACT).any()
    assert none.warnings


@pytest.mark.parametrize("number", [238, 239, 332, 392])
def test_machine_tuning_cycles_are_left_out_with_a_note(tmp_path: Path, number: int) -> None:
    lines = [f"CYCL DEF {number} ATC ~\n Q240=1 ;MODE ~\n Q241=1 ;WEIGHT", *START, "L X+5"]
    t = read(tmp_path, heidenhain(lines), "part.h")
    assert any(f"cycle {number}" in w for w in t.warnings)
    refuse_unknown_words(t, tmp_path / "part.h")


@pytest.mark.parametrize("number", [300, 317, 350, 391, 399])
def test_manufacturer_cycles_stop_a_plan(tmp_path: Path, number: int) -> None:
    lines = [*START, f"CYCL DEF {number} OEM ~\n Q240=1 ;MODE", "L X+5"]
    t = read(tmp_path, heidenhain(lines), "part.h")
    with pytest.raises(InputError) as refused:
        refuse_unknown_words(t, tmp_path / "part.h")
    assert refused.value.where == "line 5"
    accepted = read(tmp_path, heidenhain(lines), "part.h", accept_unknown=(f"CYCL DEF {number}",))
    refuse_unknown_words(accepted, tmp_path / "part.h")
    with pytest.raises(InputError):  # its call does not repeat an earlier drilling cycle
        read(tmp_path, heidenhain([*START, *q_cycle(200, "-9"), lines[2], "L X+5 M99"]), "part.h")
