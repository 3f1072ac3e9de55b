"""Sinumerik cycles: further words in the block of a call, and hole patterns with all arguments."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from machopt.data_types.toolpath import MoveKind
from machopt.errors import InputError
from machopt.toolpath.toolpath_reader import read_toolpath

HEAD = "G71 G90 G17 G54\nG0 X0 Y0 Z10\nF200 S500 M3\n"
CYCLE = "CYCLE81(5,0,1,-3)"


def write(tmp_path: Path, text: str) -> Path:
    file = tmp_path / "a.mpf"
    file.write_text(HEAD + text + "\nM30\n", encoding="utf-8")
    return file


MOTION_BESIDE = [
    f"X10 {CYCLE}",
    f"{CYCLE} X10",
    f"MCALL {CYCLE} X10 Y5",
    f"G0 X10 MCALL {CYCLE}",
    f"X=IC(5) {CYCLE}",
    f"AP=30 RP=20 {CYCLE}",
    f"G2 X10 CR=5 {CYCLE}",
    f"C90 {CYCLE}",
    f"MCALL {CYCLE}\nHOLES1(0,0,0,10,10,3) X50",
    f"MCALL {CYCLE}\nY50 HOLES2(0,0,20,0,0,3)",
    f"MCALL {CYCLE}\nZ3 CYCLE801(0,0,0,10,10,2,2)",
    f"MCALL {CYCLE}\nX10 MCALL",
    "X10 CYCLE800(0,,0,57,0,0,0,0,0,0,0,0,0,0)",
]


@pytest.mark.parametrize("text", MOTION_BESIDE)
def test_motion_beside_a_cycle_is_refused_with_its_line(tmp_path: Path, text: str) -> None:
    with pytest.raises(InputError) as caught:
        read_toolpath(write(tmp_path, text))
    assert f"line {4 + text.count(chr(10))}:" in str(caught.value)
    assert "block" in str(caught.value)


@pytest.mark.parametrize("text", [f"F300 {CYCLE}", f"G17 {CYCLE}", f"M8 {CYCLE}", f"N10 {CYCLE}", f"S900 M3 {CYCLE}"])
def test_words_without_motion_may_be_beside_a_cycle(tmp_path: Path, text: str) -> None:
    path = read_toolpath(write(tmp_path, text))
    assert np.sum(path.move == MoveKind.CUT) == 1


GRIDS = {
    "three by two": ("CYCLE801(10,20,0,5,7,3,2)", [(10, 20), (15, 20), (20, 20), (20, 27), (15, 27), (10, 27)]),
    "one row": ("CYCLE801(0,0,0,5,7,3,1)", [(0, 0), (5, 0), (10, 0)]),
    "turned": ("CYCLE801(0,0,90,5,7,2,2)", [(0, 0), (0, 5), (-7, 5), (-7, 0)]),
    "no further words": ("CYCLE801(1,2,0,5,7,2,1,,,,,,,)", [(1, 2), (6, 2)]),
    "zeros behind": ('CYCLE801(1,2,0,5,7,2,1,0,0,0,0,"",0,0)', [(1, 2), (6, 2)]),
    "row with zeros behind": ("HOLES1(1,2,0,3,5,2,0,0,,0)", [(4, 2), (9, 2)]),
    "row in the plane in force": ("HOLES1(1,2,0,3,5,2,,,,,1)", [(4, 2), (9, 2)]),
    "circle in the plane in force": ("HOLES2(0,0,10,0,90,2,,,,,1)", [(10, 0), (0, 10)]),
    "grid in the plane in force": ("CYCLE801(1,2,0,5,7,2,1,,,,,,,1)", [(1, 2), (6, 2)]),
    "circle with blanks behind": ("HOLES2(0,0,10,0,90,2,,,,)", [(10, 0), (0, 10)]),
}


@pytest.mark.parametrize("name", GRIDS)
def test_holes_of_a_pattern(tmp_path: Path, name: str) -> None:
    text, expected = GRIDS[name]
    path = read_toolpath(write(tmp_path, f"MCALL {CYCLE}\n{text}\nMCALL"))
    np.testing.assert_allclose(path.position[path.move == MoveKind.CUT][:, :2] * 1e3, expected, atol=1e-9)


REFUSED = {
    "frame": ("CYCLE801(0,0,0,5,7,3,2,1)", "argument 8"),
    "shear": ("CYCLE801(0,0,0,5,7,3,2,0,0,15)", "argument 10"),
    "hidden": ('CYCLE801(0,0,0,5,7,3,2,0,0,0,0,"3")', "argument 12"),
    "too few": ("CYCLE801(0,0,0,5,7,3)", "rows"),
    "no rows": ("CYCLE801(0,0,0,5,7,3,0)", "rows"),
    "a share of a column": ("CYCLE801(0,0,0,5,7,1.5,2)", "columns"),
    "too many": ("CYCLE801(0,0,0,5,7,200,200)", "10000"),
    "text": ("CYCLE801(0,0,0,5,7,A,2)", "A"),
    "row with a mode": ("HOLES1(1,2,0,3,5,2,1000)", "argument 7"),
    "circle with a mode": ("HOLES2(0,0,10,0,90,2,1000)", "argument 7"),
    "row in another plane": ("HOLES1(1,2,0,3,5,2,,,,,2)", "_DMODE"),
    "circle in another plane": ("HOLES2(0,0,10,0,90,2,,,,,3)", "_DMODE"),
    "grid in another plane": ("CYCLE801(0,0,0,5,7,3,2,,,,,,,3)", "_DMODE"),
    "grid in no plane": ("CYCLE801(0,0,0,5,7,3,2,,,,,,,4)", "argument 14"),
    "row in no plane": ("HOLES1(1,2,0,3,5,2,,,,,1.5)", "argument 11"),
    "row with a hidden hole": ('HOLES1(1,2,0,3,5,2,,,"2",,1)', "argument 9"),
    "places": ("CYCLE802(111111111,111111111,0,0,10,10)", "MCALL"),
}


@pytest.mark.parametrize("name", REFUSED)
def test_unsupported_arguments_are_refused(tmp_path: Path, name: str) -> None:
    text, word = REFUSED[name]
    with pytest.raises(InputError) as caught:
        read_toolpath(write(tmp_path, f"MCALL {CYCLE}\n{text}\nMCALL"))
    assert word in str(caught.value)
    assert "line 5:" in str(caught.value)


DEPTH_MODES = {
    "shank": ("CYCLE82(5,0,1,-3,,0,10)", "GMODE"),
    "diameter": ("CYCLE81(5,0,1,6,,0,10,1,12)", "GMODE"),
    "shank of deep holes": ("CYCLE83(5,0,1,-30,,-5,,0,0,0,1,0,0,0,0,0,0,10)", "GMODE"),
    "incremental with DP": ("CYCLE81(5,0,1,-3,,0,0,1,11)", "AMODE"),
    "another plane": ("CYCLE81(5,0,1,-3,,0,0,2,12)", "_DMODE"),
    "another plane of deep holes": ("CYCLE83(5,0,1,-30,,-5,,0,0,0,1,0,0,0,0,0,0,0,3)", "_DMODE"),
    "another plane of a thread": ('CYCLE84(5,0,1,-3,,0,3,,1,0,500,500,0,1,0,0,0,0,"","","",0,2,0)', "_DMODE"),
    "another plane with a floating chuck": ("CYCLE840(5,0,1,-3,,0,3,3,0,,1,0,1,0,,,,0,1003,0)", "_DMODE"),
    "another plane of reaming": ("CYCLE85(5,0,1,-3,,0,100,200,0,3,12)", "_DMODE"),
    "another plane of boring": ("CYCLE86(5,0,1,-3,,0,3,0,0,0,45,0,12,0)", "_DMODE"),
    "another plane of a drilled bottom": ("CYCLE89(5,0,1,-3,,0,0,2,0)", "_DMODE"),
    "absolute with DPR of a thread": ("CYCLE84(5,0,1,,3,0,3,,1,0,500,500,0,1,0,0,0,0,,,,0,1,2001002)", "AMODE"),
    "thread without a pitch": ('CYCLE84(5,0,1,-3,,0,3,,,0,500,500,0,1,0,0,0,0,"ISO_METRIC","M10","",0,1,0)', "M10"),
    "text in place of a number": ('CYCLE81(5,0,1,"-3")', "not a number"),
    "DP and DPR differ": ("CYCLE81(5,0,1,-3,5)", "DPR"),
    "DP and DPR differ on a raised plane": ("CYCLE82(15,10,1,-3,12)", "DPR"),
    "DP and DPR of a thread differ": ("CYCLE840(5,0,1,-3,5,0,4,3,1)", "DPR"),
    "DP and DPR of deep holes differ": ("CYCLE83(5,0,1,-30,20,-5,,0,0,0,1,0)", "DPR"),
    "FDEP and FDPR differ": ("CYCLE83(5,0,1,-30,,-5,8,0,0,0,1,0)", "FDPR"),
    "absolute with DPR": ("CYCLE82(5,0,1,,3,0,0,1,12)", "AMODE"),
}


@pytest.mark.parametrize("name", DEPTH_MODES)
def test_modes_that_change_the_depth_are_refused(tmp_path: Path, name: str) -> None:
    text, word = DEPTH_MODES[name]
    with pytest.raises(InputError) as caught:
        read_toolpath(write(tmp_path, f"MCALL {text}\nX10\nMCALL"))
    assert word in str(caught.value)


@pytest.mark.parametrize(
    "text",
    [
        "CYCLE81(5,0,1,-3,,0,0,1,12)",
        "CYCLE82(5,0,1,,3,0,0,1,11)",
        "CYCLE82(5,0,1,-3,,0,0,1,0)",
        "CYCLE81(5,0,1,-3,0)",
        "CYCLE81(5,0,1,-3,3)",
        "CYCLE81(5,0,1,-3,-3,0,0,1,0)",
        "CYCLE81(5,0,1,-3,7,0,0,1,12)",
        'CYCLE84(5,0,1,,3,0.6,3,,1.5,0,500,500,0,1,0,0,5,1.4,"ISO_METRIC","M10",,,1001,2001001)',
        'CYCLE840(5,0,1,-3,,0,3,3,0,,1.5,0,1,0,"","","",,1001,2)',
        "CYCLE85(5,0,1,-3,,0,100,200,1,1001,2)",
        "CYCLE86(5,0,1,-3,,0,3,0,0,0,45,0,1,12)",
        "CYCLE89(5,0,1,,3,0,0,1,11)",
    ],
)
def test_modes_of_the_given_depth(tmp_path: Path, text: str) -> None:
    path = read_toolpath(write(tmp_path, f"MCALL {text}\nX10\nMCALL"))
    np.testing.assert_allclose(path.position[path.move == MoveKind.CUT] * 1e3, [[10, 0, -3]], atol=1e-9)


@pytest.mark.parametrize(("distance", "height"), [("0.4", -9.6), ("2.5", -7.5), ("", -9.0), ("0", -9.0)])
def test_distance_before_the_feed_of_a_peck(tmp_path: Path, distance: str, height: float) -> None:
    cycle = f"CYCLE83(5,0,1,-20,,-10,,0,0,0,1,1,3,0,0,0,{distance},0,1,11211112)"
    path = read_toolpath(write(tmp_path, f"MCALL {cycle}\nX10\nMCALL"))
    approach = path.position[path.move == MoveKind.APPROACH][:, 2] * 1e3
    np.testing.assert_allclose(approach[approach < 0.0], [height], atol=1e-9)


@pytest.mark.parametrize(("word", "mode"), [("G17", 1), ("G18", 2), ("G19", 3)])
def test_plane_of_a_cycle_may_be_in_its_block(tmp_path: Path, word: str, mode: int) -> None:
    path = read_toolpath(write(tmp_path, f"{word} CYCLE81(5,0,1,-3,,0,0,{mode},12)\nG17"))
    assert np.sum(path.move == MoveKind.CUT) == 1


@pytest.mark.parametrize("distance", ["10", "11", "12", "40"])
def test_peck_from_the_clearance_height_has_no_duplicate_point(tmp_path: Path, distance: str) -> None:
    cycle = f"CYCLE83(5,0,1,-20,,-10,,0,0,0,1,1,3,0,0,0,{distance},0,1,11211112)"
    path = read_toolpath(write(tmp_path, f"MCALL {cycle}\nX10\nMCALL"))
    assert (np.linalg.norm(np.diff(path.position, axis=0), axis=1) > 1e-9).all()
    np.testing.assert_allclose(path.position[path.move == MoveKind.CUT][:, 2] * 1e3, [-10, -20], atol=1e-9)
