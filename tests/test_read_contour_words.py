"""Corners, tangential and three-point arcs, mirrors, scales, polar words and absolute centres: exact positions."""

from __future__ import annotations

import re
from pathlib import Path

import numpy as np
import pytest

from machopt.errors import InputError
from machopt.toolpath.toolpath_reader import read_toolpath

FANUC = "G21 G90 G17\nG0 X0 Y0 Z5\nG1 Z0 F100\n"
SINUMERIK = "G71 G90 G17\nG0 X0 Y0 Z5\nG1 Z0 F100\n"
HEIDENHAIN = "0 BEGIN PGM A MM\n1 TOOL CALL 1 Z S1000\n2 L X+0 Y+0 Z+5 R0 FMAX\n3 L Z+0 F100\n"
COARSE = 1e-3  # m: with this tolerance an arc is divided into chords of 1/8 turn; their ends are exactly on the arc
ROUNDED = [(8, 0), (8 + 2**0.5, 2 - 2**0.5), (10, 2), (10, 9), (9, 10), (0, 10)]


def points(tmp_path: Path, text: str, name: str = "a.nc", **options: object) -> list[tuple[float, float, float]]:
    file = tmp_path / name
    file.write_text(text)
    return [tuple(p) for p in read_toolpath(file, arc_tolerance=COARSE, **options).position * 1e3]  # type: ignore[arg-type]


@pytest.mark.parametrize(
    ("text", "name"),
    [
        (FANUC + "X10 ,R2\nY10 ,C1\nX0\nM30\n", "a.nc"),
        (SINUMERIK + "X10 RND=2\nY10 CHR=1\nX0\nM30\n", "a.mpf"),
        (SINUMERIK + f"X10 RND=2\nY10 CHF={2**0.5:.12f}\nX0\nM30\n", "a.mpf"),
        (HEIDENHAIN + "4 L X+10\n5 RND R2\n6 L Y+10\n7 CHF 1\n8 L X+0\n9 M30\n99 END PGM A MM\n", "a.h"),
    ],
)
def test_corners_are_rounded_and_chamfered(tmp_path: Path, text: str, name: str) -> None:
    got = points(tmp_path, text, name)[2:]
    assert np.allclose(np.array(got)[:, :2], ROUNDED, atol=1e-9)


def test_rounding_is_tangent_to_the_adjacent_arc(tmp_path: Path) -> None:
    """A line along X, then an arc about (20, 0) upwards from (10, 0): the centre has the distance 1 from both."""
    got = np.array(points(tmp_path, FANUC + "X10 ,R1\nG2 X20 Y10 I10 J0\nM30\n"))[2:, :2]
    centre = np.array([20.0 - (11.0**2 - 1.0) ** 0.5, 1.0])  # to the left of both: outside the clockwise arc
    assert np.allclose(got[0], [centre[0], 0.0], atol=1e-9)
    on_rounding = np.linalg.norm(got - centre, axis=1) < 1.0 + 1e-6
    touching = got[on_rounding][-1]
    assert abs(np.linalg.norm(touching - centre) - 1.0) < 1e-9
    assert abs(np.linalg.norm(touching - [20.0, 0.0]) - 10.0) < 1e-9


@pytest.mark.parametrize(
    ("text", "what"),
    [
        (FANUC + "X10 ,R20\nY10\nM30\n", "line 4.*does not fit"),
        (FANUC + "X10 ,R2\nG0 Y10\nM30\n", "line 4.*without a contour element after it"),
        (FANUC + "X10 ,R2\nX0\nM30\n", "line 4.*turns back"),
        (FANUC + "X10 ,R2\nY10 Z-1\nM30\n", "line 4.*leaves the working plane"),
        (FANUC + "X10 ,R2\nM30\n", "line 4.*the program ends"),
        (SINUMERIK + "CT X10 Y10\nM30\n", "line 4.*CT"),
        (FANUC + "G51 X0 Y0 Z0 P2\nX5\nM30\n", "line 4.*decimal point"),
        (FANUC + "G51.1 Z0\nX5\nM30\n", "line 4.*mirrors Z"),
        (FANUC + "X-5.0E-1\nM30\n", "line 4.*exponent"),
        (FANUC + "X1.5Y-.5E3\nM30\n", "line 4.*exponent"),
        (SINUMERIK + "AR=30 X5 Y5\nM30\n", "line 4.*opening angle"),
        (SINUMERIK + "G2 X5 Y5 I5 J0 AR=30\nM30\n", "line 4.*one of the two"),
        (SINUMERIK + "G2 I5 J0 AR=360\nM30\n", "line 4.*between 0 and 360"),
        (FANUC + "G91\nG28 Z0\nG1 Z-1\nM30\n", "line 6.*G28"),
        (FANUC + "G53 Z0\nG2 X10 R5\nM30\n", "line 5.*cuts while Z is not known"),
    ],
)
def test_unreadable_content_is_refused_with_its_line(tmp_path: Path, text: str, what: str) -> None:
    with pytest.raises(InputError, match=re.compile(what)):
        points(tmp_path, text, "a.mpf" if text.startswith("G71") else "a.nc")


@pytest.mark.parametrize(
    ("text", "last"),
    [
        ("X=IC(5) Y=AC(3)\nG91 X1 Y=AC(0)\n", (6, 0, 0)),
        ("Z-5.0EX-1\n", (0, 0, -0.5)),
        ("G3 X10 Y0 I=AC(5) J=AC(0)\n", (10, 0, 0)),
        ("G91 G3 X10 Y0 I=AC(5) J=AC(0)\n", (10, 0, 0)),
        ("CIP X10 Y0 I1=5 J1=5\n", (10, 0, 0)),
        ("G2 I10 AR=90\n", (10, 10, 0)),
        ("G91 G3 I10 Z4 AR=180\n", (20, 0, 4)),
        ("G3 I=AC(0) J=AC(10) AR=90\n", (10, 10, 0)),
        ("WAITM(1,1,2)\nWAITP(X)\nX10\n", (10, 0, 0)),
        ("G111 X10 Y10\nG1 AP=0 RP=5\nG3 AP=90\n", (10, 15, 0)),
        ("MIRROR X0\nX10 Y5\nASCALE X2 Y2\nX10 Y5\n", (-20, 10, 0)),
        ("MIRROR X0\nX10 Y5\nMIRROR\nX10\n", (10, 5, 0)),
        ("X10 ANG=45\n", (10, 10, 0)),
    ],
)
def test_sinumerik_words_state_their_reference(tmp_path: Path, text: str, last: tuple[float, ...]) -> None:
    assert np.allclose(points(tmp_path, SINUMERIK + text + "M30\n", "a.mpf")[-1], last, atol=1e-9)


def test_absolute_centre_and_full_turns(tmp_path: Path) -> None:
    arc = np.array(points(tmp_path, SINUMERIK + "X10\nG3 X0 Y10 Z-9 I=AC(0) J=AC(0) TURN=2\nM30\n", "a.mpf"))[3:]
    angle = np.unwrap(np.arctan2(arc[:, 1], arc[:, 0]))
    assert angle[-1] == pytest.approx(np.pi / 2 + 4 * np.pi)
    assert np.allclose(np.hypot(arc[:, 0], arc[:, 1]), 10.0)
    assert np.allclose(arc[:, 2], -9.0 * angle / angle[-1])


@pytest.mark.parametrize(
    ("word", "degrees", "centre"), [("G2", 90.0, (10, 0)), ("G2", 270.0, (0, 10)), ("G3", 90.0, (0, 10))]
)
def test_arc_by_end_and_opening_angle(tmp_path: Path, word: str, degrees: float, centre: tuple[int, int]) -> None:
    arc = np.array(points(tmp_path, SINUMERIK + f"{word} X10 Y10 AR={degrees:g}\nM30\n", "a.mpf"))[1:]
    around = np.unwrap(np.arctan2(arc[:, 1] - centre[1], arc[:, 0] - centre[0]))
    assert np.allclose(np.hypot(*(arc[:, :2] - centre).T), 10.0)
    assert np.degrees(around[-1] - around[0]) == pytest.approx(degrees * (-1.0 if word == "G2" else 1.0))
    assert np.allclose(arc[-1], [10.0, 10.0, 0.0])


def test_tangential_arc_continues_the_line(tmp_path: Path) -> None:
    for text, name in (
        (SINUMERIK + "X10\nCT X20 Y10\nM30\n", "a.mpf"),
        (HEIDENHAIN + "4 L X+10\n5 CT X+20 Y+10\n9 M30\n99 END PGM A MM\n", "a.h"),
    ):
        got = np.array(points(tmp_path, text, name))[3:, :2]
        assert np.allclose(np.linalg.norm(got - [10.0, 10.0], axis=1), 10.0)
        assert np.allclose(got[-1], [20.0, 10.0])


@pytest.mark.parametrize(
    ("text", "last"),
    [
        ("G16\nX10 Y90\nY180\n", (-10, 0, 0)),
        ("G16\nX10 Y90\nG91 Y90\n", (-10, 0, 0)),
        ("G51.1 X5\nX10 Y5\n", (0, 5, 0)),
        ("G51.1 X0\nX10 Y5\nG50.1 X0\nX10\n", (10, 5, 0)),
        ("G51 X0 Y0 Z0 P2.5\nX10 Y4 Z-2\n", (25, 10, -5)),
        ("G51 X0 Y0 Z0 I-1.0 J1.0 K1.0\nX10 Y4\n", (-10, 4, 0)),
        ("G51.1 X0\nG68 X0 Y0 R90\nX10 Y0\n", (0, -10, 0)),
        ("X10 ,A45\n", (10, 10, 0)),
        ("G91 X0 Z0\nX5\n", (5, 0, 0)),
    ],
)
def test_fanuc_mirrors_scales_and_polar_words(tmp_path: Path, text: str, last: tuple[float, ...]) -> None:
    assert np.allclose(points(tmp_path, FANUC + text + "M30\n")[-1], last, atol=1e-9)


def test_arc_with_a_height(tmp_path: Path) -> None:
    got = np.array(points(tmp_path, "G21 G90\nG0 X0 Y0\nG2 X10 Z-3 R5 F100\nG1 X20\nM30\n"))
    assert np.allclose(got[-2:], [(10, 0, -3), (20, 0, -3)])


def test_two_tools_in_one_block(tmp_path: Path) -> None:
    file = tmp_path / "a.nc"
    file.write_text("G21\nT01 T02 M06\nG0 X0 Y0 Z5\nG1 Z-1 F100\nM6\nX5\nM30\n")
    assert [o.tool for o in read_toolpath(file).operations] == ["1", "2"]


def test_hole_patterns(tmp_path: Path) -> None:
    row = points(
        tmp_path, "G71 G90\nG0 X0 Y0 Z5\nF99\nMCALL CYCLE81(5,0,1,-3)\nHOLES1(1,2,90,3,10,3)\nMCALL\nM30\n", "a.mpf"
    )
    assert {(round(x, 9), round(y, 9)) for x, y, z in row if z < 0} == {(1, 5), (1, 15), (1, 25)}
    cycle = "4 CYCL DEF 200 DRILLING ~\n Q200=1 ~\n Q201=-3 ~\n Q206=100 ~\n Q202=3 ~\n Q203=+0 ~\n Q204=5\n"
    ring = cycle + "5 CYCL DEF 220 PATTERN ~\n Q216=+1 ~\n Q217=+2 ~\n Q244=20 ~\n Q245=+0 ~\n Q246=+360 ~\n Q241=4\n"
    got = points(tmp_path, HEIDENHAIN + ring + "90 M30\n99 END PGM A MM\n", "a.h")
    assert {(round(x), round(y)) for x, y, z in got if z < 0} == {(11, 2), (1, 12), (-9, 2), (1, -8)}
    rows = "Q225=+1 ~\n Q226=+2 ~\n Q237=+10 ~\n Q238=+5 ~\n Q242=2 ~\n Q243=2 ~\n Q224=+90\n"
    got = points(tmp_path, HEIDENHAIN + cycle + "5 CYCL DEF 221 ROWS ~\n " + rows + "90 M30\n99 END PGM A MM\n", "a.h")
    assert [(round(x), round(y)) for x, y, z in got if z < 0] == [(1, 2), (1, 12), (-4, 12), (-4, 2)]


@pytest.mark.parametrize(
    ("cycles", "last"),
    [
        ("4 CYCL DEF 8.0 MIRROR IMAGE\n5 CYCL DEF 8.1 X\n6 L X+10 Y+4\n", (-10, 4, 0)),
        ("4 CYCL DEF 8.0 M\n5 CYCL DEF 8.1 X\n6 CYCL DEF 8.0 M\n7 CYCL DEF 8.1\n8 L X+10 Y+4\n", (10, 4, 0)),
        ("4 CYCL DEF 11.0 SCALING\n5 CYCL DEF 11.1 SCL 2\n6 L X+10 Y+4 Z-1\n", (20, 8, -2)),
    ],
)
def test_heidenhain_mirrors_and_scales(tmp_path: Path, cycles: str, last: tuple[float, ...]) -> None:
    got = points(tmp_path, HEIDENHAIN + cycles + "90 M30\n99 END PGM A MM\n", "a.h")
    assert np.allclose(got[-1], last)


def test_decimals_are_asked_for(tmp_path: Path) -> None:
    for text in ("X0019685", "X-1500"):
        with pytest.raises(InputError, match="--decimals"):
            points(tmp_path, f"G21 G90\nG0 X0 Y0 Z5\nG1 {text} F100\nM30\n")
    got = points(tmp_path, "G21 G90\nG0 X0 Y0 Z50000\nG1 X0019685 F100\nY10.5\nM30\n", decimals=4)
    assert np.allclose(got, [(0, 0, 5), (1.9685, 0, 5), (1.9685, 10.5, 5)])
    assert points(tmp_path, "G21 G90\nG0 X0 Y0 Z5\nG1 X1500 F100\nM30\n", decimals=0)[-1] == (1500, 0, 5)


def test_absurd_extents_are_asked_for(tmp_path: Path) -> None:
    text = "G21 G90\nG0 X0. Y0. Z5.\nG1 X60000. F9000\nM30\n"
    with pytest.raises(InputError, match="--max-extent"):
        points(tmp_path, text)
    assert points(tmp_path, text, max_extent=100.0)[-1][0] == 60000


def test_trans_and_scale_of_apt_move_later_points(tmp_path: Path) -> None:
    text = (
        "UNITS/MM\nFEDRAT/100\nTRANS/10,0,0\nGOTO/1,2,3\nSCALE/2\nGOTO/1,2,3\nTRANS/0,0,0\nSCALE/1\nGOTO/1,2,3\nFINI\n"
    )
    assert np.allclose(points(tmp_path, text, "a.apt"), [(11, 2, 3), (12, 4, 6), (1, 2, 3)])


def test_several_work_offsets(tmp_path: Path) -> None:
    text = "G21 G90\nG54 G0 X0 Y0 Z5\nG1 Z0 F100\nG55 X1 Y0 Z0\nG56 X1 Y1 Z1\nM30\n"
    with pytest.raises(InputError, match="--offset G55=X,Y,Z"):
        points(tmp_path, text)
    got = points(tmp_path, text, offsets=["G55=100,0,0", "G56=0,5,0"])
    assert np.allclose(got[-2:], [(101, 0, 0), (1, 6, 1)])


def test_repeats_by_label(tmp_path: Path) -> None:
    text = SINUMERIK + "G91\nA1: X1\nY1\nREPEAT A1 P=2\nREPEATB A1 P=2\nM30\n"
    got = points(tmp_path, text, "a.mpf")[2:]
    assert got == [(1, 0, 0), (1, 1, 0), (2, 1, 0), (2, 2, 0), (3, 2, 0), (3, 3, 0), (4, 3, 0), (5, 3, 0)]
    with pytest.raises(InputError, match=r"line 4.*REPEAT B1"):
        points(tmp_path, SINUMERIK + "REPEAT B1\nX1\nM30\n", "a.mpf")


def test_axes_of_an_unchanged_plane(tmp_path: Path) -> None:
    head = "0 BEGIN PGM A MM\n1 TOOL CALL 1 Z S1000\n2 PLANE SPATIAL SPA+90 SPB+0 SPC+0 STAY\n"
    tail = "4 L X+1 Y+2 Z+5 R0 FMAX\n5 L Z+3 F100\n6 M30\n99 END PGM A MM\n"
    got = points(tmp_path, head + "3 L A+Q120 C+Q122 R0 FMAX\n" + tail, "a.h")
    assert np.allclose(got[-1], (1, -3, 2))
    with pytest.raises(InputError, match="not known"):
        points(tmp_path, head + tail, "a.h")


def test_linuxcnc_parameter_named_like_a_sinumerik_word(tmp_path: Path) -> None:
    with pytest.raises(InputError, match="a value of the running control"):
        points(
            tmp_path, "G21 G90\nM61 Q2\nG10 L20 P0 X-#<_hal[kins.x-rot-point]>\nG0 X0 Y0 Z5\nG1 Z0 F100\nM2\n", "a.ngc"
        )
