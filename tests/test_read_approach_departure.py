"""Heidenhain approach and departure blocks, TRANS, DIN/ISO corners; units of Sinumerik feeds."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from machopt.data_types.toolpath import Toolpath
from machopt.errors import InputError
from machopt.toolpath.toolpath_reader import read_toolpath

HEAD = "BEGIN PGM A MM\nTOOL CALL 1 Z S1000\nL X+0 Y+0 Z+5 R0 FMAX\n"
TAIL = "END PGM A MM\n"
CONTOUR = "L X+40 Y+0\nL X+40 Y+30\n"


def read(tmp_path: Path, text: str, name: str = "a.h", **options: object) -> Toolpath:
    file = tmp_path / name
    file.write_text(text, encoding="utf-8")
    return read_toolpath(file, **options)  # type: ignore[arg-type]


def mm(t: Toolpath) -> np.ndarray:  # type: ignore[type-arg]
    return np.round(t.position * 1e3, 6) + 0.0


@pytest.mark.parametrize(
    ("block", "helper", "centre"),
    [
        ("APPR LT X+20 Y+0 Z-3 LEN15 R0 F100", [5, 0], None),
        ("APPR LN X+20 Y+0 Z-3 LEN15 RL F100", [20, 15], None),
        ("APPR LN X+20 Y+0 Z-3 LEN15 RR F100", [20, -15], None),
        ("APPR CT X+20 Y+0 Z-3 CCA90 R+10 RL F100", [10, 10], [20, 10]),
        ("APPR CT X+20 Y+0 Z-3 CCA180 R+10 RR F100", [20, -20], [20, -10]),
        ("APPR CT X+20 Y+0 Z-3 CCA90 R-10 RR F100", [10, 10], [20, 10]),
    ],
)
def test_tool_approaches_through_an_auxiliary_point(
    tmp_path: Path, block: str, helper: list[float], centre: list[float] | None
) -> None:
    t = read(tmp_path, HEAD + block + "\n" + CONTOUR + TAIL)
    p = mm(t)
    assert p[1].tolist() == [*helper, 5]  # first in the plane, then down; rapid like the block before
    assert p[2].tolist() == [*helper, -3]
    assert t.move[1:3].tolist() == [1, 1]
    at = int(np.flatnonzero((p == [20, 0, -3]).all(axis=1))[0])
    assert p[at + 1 :].tolist() == [[40, 0, -3], [40, 30, -3]]
    assert np.allclose(t.feed[3:] * 60e3, 100)
    if centre is not None:
        assert np.allclose(np.linalg.norm(p[2 : at + 1, :2] - centre, axis=1), 10.0, atol=1e-6)
        before = (p[at] - p[at - 1])[:2]
        assert abs(before[1]) < 0.05 * before[0]  # the arc is tangential to the contour


def test_approach_on_line_and_arc_is_tangential_at_both_ends(tmp_path: Path) -> None:
    t = read(tmp_path, HEAD + "L Y+30\nAPPR LCT X+20 Y+0 Z-3 R10 RL F100\n" + CONTOUR + TAIL, default_feed=0.01)
    p = mm(t)[:, :2]
    first = next(k for k in range(2, len(p)) if abs(np.linalg.norm(p[k] - [20, 10]) - 10) < 1e-6)
    straight, spoke = p[first] - [0, 30], p[first] - [20, 10]
    assert abs(straight @ spoke) < 1e-4
    assert straight @ np.array([-spoke[1], spoke[0]]) > 0  # the arc continues in the direction of the line


@pytest.mark.parametrize(
    ("block", "end"),
    [
        ("DEP LT LEN12 F100", [40, 42, -3]),
        ("DEP LN LEN+7", [33, 30, -3]),
        ("DEP CT CCA90 R+5", [35, 35, -3]),
        ("DEP LCT X+10 Y+60 Z+20 R5", [10, 60, 20]),
    ],
)
def test_tool_leaves_the_contour(tmp_path: Path, block: str, end: list[float]) -> None:
    t = read(tmp_path, HEAD + "APPR LT X+20 Y+0 Z-3 LEN15 RL F100\n" + CONTOUR + block + "\n" + TAIL)
    p = mm(t)
    assert p[-1].tolist() == end
    if "CT" in block:
        at = int(np.flatnonzero((p == [40, 30, -3]).all(axis=1))[0])
        step = (p[at + 1] - p[at])[:2]
        assert abs(step[0]) < 0.1 * step[1]
        assert step[0] < 0.0  # RL: to the left of the contour


@pytest.mark.parametrize(
    ("blocks", "message"),
    [
        ("APPR CT X+20 Y+0 CCA90 R5 R0 F100\n" + CONTOUR, "the side is not stated"),
        ("APPR LT X+20 Y+0 F100\n" + CONTOUR, "expected LEN"),
        ("APPR PLT PR+20 PA+0 LEN5 RL F100\n" + CONTOUR, "LT, LN, CT and LCT"),
        ("APPR LT X+20 Y+0 LEN5 RL F100\nL Z+50 FMAX\n", "without a contour element after it"),
        ("DEP LT LEN5 F100\n", "without a contour element before it"),
        ("L X+10 RL F100\nDEP LCT X+20 Y-20 R5\n", "other side"),
        ("TRANS DATUM TABLE TABLINE5\n", "datum table"),
    ],
)
def test_undeterminable_contour_ends_are_refused(tmp_path: Path, blocks: str, message: str) -> None:
    with pytest.raises(InputError, match=message):
        read(tmp_path, HEAD + blocks + TAIL)


def test_trans_equals_the_datum_cycles(tmp_path: Path) -> None:
    def both(new: str, old: str) -> None:
        a = read(tmp_path, HEAD + "L Z+0 F100\n" + new + "L X+10 Y+2\n" + TAIL)
        b = read(tmp_path, HEAD + "L Z+0 F100\n" + old + "L X+10 Y+2\n" + TAIL)
        assert mm(a).tolist() == mm(b).tolist()
        assert not [w for w in a.ignored if not w.understood]

    both("TRANS DATUM AXIS X+10 Y-5 Z+1\n", "CYCL DEF 7.0\nCYCL DEF 7.1 X+10\nCYCL DEF 7.2 Y-5\nCYCL DEF 7.3 Z+1\n")
    both("TRANS MIRROR AXIS X\n", "CYCL DEF 8.0\nCYCL DEF 8.1 X\n")
    both("TRANS ROTATION ROT+30\nTRANS ROTATION IROT+15\n", "CYCL DEF 10.0\nCYCL DEF 10.1 ROT+45\n")
    both("TRANS SCALE SCL0.5\n", "CYCL DEF 11.0\nCYCL DEF 11.1 SCL 0.5\n")
    both("TRANS DATUM AXIS X+10\nTRANS DATUM RESET\nTRANS SCALE SCL2\nTRANS SCALE RESET\n", "")


def test_corners_of_din_iso(tmp_path: Path) -> None:
    head = "%A G71 *\nN1 G00 G90 X+0 Y+0 Z+0 *\nN2 G01 X+10 F100 *\n"
    p = mm(read(tmp_path, head + "N3 G25 R2 *\nN4 G01 Y+10 *\nN5 G24 R3 *\nN6 X+20 *\nN9999 %A G71 *\n", "a.i"))
    assert [8, 0, 0] in p.tolist()
    assert [10, 2, 0] in p.tolist()
    assert p[-3:].tolist() == [[10, 7, 0], [13, 10, 0], [20, 10, 0]]


SIEMENS = "{} G90 G17 G94\nR1=5\nG0 X0 Y0 Z0\nG1 X1 F{}\n"


@pytest.mark.parametrize(
    ("word", "unit", "x", "feed"),
    [
        ("G70", "inch", 25.4, 254.0),
        ("G70", "mm", 25.4, 10.0),
        ("G700", None, 25.4, 254.0),
        ("G71", None, 1.0, 10.0),
        ("G71", "inch", 1.0, 254.0),
        ("G710", None, 1.0, 10.0),
    ],
)
def test_sinumerik_feeds_keep_the_unit_of_the_control(
    tmp_path: Path, word: str, unit: str | None, x: float, feed: float
) -> None:
    t = read(tmp_path, SIEMENS.format(word, 10) + "M30\n", "a.mpf", unit=unit)
    assert mm(t)[-1, 0] == x
    assert t.feed[-1] * 60e3 == pytest.approx(feed)


def test_feed_under_g70_is_asked_for_and_an_earlier_one_remains(tmp_path: Path) -> None:
    with pytest.raises(InputError, match=r"line 4: F under G70.*--unit inch .*--unit mm"):
        read(tmp_path, SIEMENS.format("G70", 10) + "M30\n", "a.mpf")
    t = read(tmp_path, SIEMENS.format("G710", 10) + "G700\nG1 X2\nG1 X3 F1\nM30\n", "a.mpf")
    assert (np.round(t.feed[1:] * 60e3, 6)).tolist() == [10, 10, 25.4]


def test_programmed_shifts_of_sinumerik_are_named(tmp_path: Path) -> None:
    with pytest.raises(InputError, match=r"line 5: G58 .*write the shift as TRANS$"):
        read(tmp_path, SIEMENS.format("G71", 10) + "G58 X10\nG1 X2\nM30\n", "a.mpf")
    with pytest.raises(InputError, match=r"line 5: G59 .*TRANS, ATRANS"):
        read(tmp_path, SIEMENS.format("G71", 10) + "G59 X10\nG1 X2\nM30\n", "a.mpf")


def test_incremental_zero_behind_the_machine_frame_is_unknown(tmp_path: Path) -> None:
    text = "G21 G90\nG0 X1. Y1. Z5.\nG1 Z0. F100.\nG91 G28 Z0.\nG91 G0 X0. Z0.\nG90 X9.\nZ5.\nG1 Z0.\nM30\n"
    assert mm(read(tmp_path, text, "a.nc"))[-2:].tolist() == [[9, 1, 5], [9, 1, 0]]
    with pytest.raises(InputError, match=r"line 6: cuts while Z is not known: G28 moved it.*name it in a G0"):
        read(tmp_path, text.replace("G90 X9.\nZ5.", "G90 G1 X9."), "a.nc")
