"""Rotary words under tool-centre-point control: the tool axis follows the path of the rotary axes."""

from __future__ import annotations

import math
from pathlib import Path

import numpy as np
import pytest

from machopt.data_types.toolpath import MoveKind, Toolpath
from machopt.errors import InputError
from machopt.numerics.array_types import Array
from machopt.toolpath.toolpath_reader import read_toolpath

TOLERANCE_DEG = 0.02  # of the tool axis: twice the tolerance of the reader, since it samples only parts of a step
DIALECTS = ("gcode", "siemens", "heidenhain")


def turn(axis: str, degrees: float) -> Array:
    """Return the right-handed rotation about X, Y or Z from its elements."""
    c, s = math.cos(math.radians(degrees)), math.sin(math.radians(degrees))
    if axis == "X":
        return np.array([[1, 0, 0], [0, c, -s], [0, s, c]])
    if axis == "Y":
        return np.array([[c, 0, s], [0, 1, 0], [-s, 0, c]])
    return np.array([[c, -s, 0], [s, c, 0], [0, 0, 1.0]])


def tool_axis(machine: str, tilt: float, c: float) -> Array:
    """table-ac and table-bc: rotation C about Z after the tilt."""
    return np.asarray(turn("Z", c) @ turn("X" if machine.endswith("ac") else "Y", tilt) @ [0.0, 0.0, 1.0])


def program(dialect: str, machine: str, before: tuple[float, float], after: tuple[float, float], arc: bool) -> str:
    """Return one cut from (10, 0, 0) to (-10, 0, 0) in which both axes rotate; the angles are (tilt, C)."""
    t = machine[-2].upper()
    if dialect == "heidenhain":
        cut = (
            f"4 CC X0 Y0\n5 C X-10 Y0 {t}{after[0]:+.4f} C{after[1]:+.4f} DR+\n"
            if arc
            else f"5 L X-10 Y0 {t}{after[0]:+.4f} C{after[1]:+.4f}\n"
        )
        return (
            f"0 BEGIN PGM T MM\n1 TOOL CALL 1 Z S1000\n"
            f"2 L X10 Y0 Z0 {t}{before[0]:+.4f} C{before[1]:+.4f} R0 FMAX M128\n"
            f"3 L X10 F1000\n{cut}6 M129\n7 END PGM T MM\n"
        )
    words = f"{t}{after[0]:.4f} C{after[1]:.4f}"
    if dialect == "siemens":
        words = f"{t}={after[0]:.4f} C={after[1]:.4f}"
    cut = f"G3 X-10 Y0 I-10 J0 {words}" if arc else f"G1 X-10 {words}"
    on, off = ("TRAORI", "TRAFOOF") if dialect == "siemens" else ("G43.4 H1", "G49")
    return (
        f"G{71 if dialect == 'siemens' else 21} G90 G17\nG0 {t}{before[0]:.4f} C{before[1]:.4f}\n{on}\nG0 X10 Y0 Z0\n"
        f"F1000\n{cut}\n{off}\nM30\n"
    )


def read(tmp_path: Path, text: str, dialect: str, machine: str) -> Toolpath:
    file = tmp_path / {"gcode": "a.nc", "siemens": "a.mpf", "heidenhain": "a.h"}[dialect]
    file.write_text(text, encoding="ascii")
    return read_toolpath(file, machine=machine)


def check(t: Toolpath, machine: str, before: tuple[float, float], after: tuple[float, float], *, arc: bool) -> None:
    """Tip and axis of every point are on the path; between points the great circle equals the rotary path."""
    p, axis = t.position[t.cutting] * 1e3, t.axis[t.cutting]
    start = np.array([10.0, 0.0, 0.0])
    if not arc:
        share = np.linalg.norm(p - start, axis=1) / 20.0
        assert np.abs(p[:, 1:]).max() < 1e-9
    else:
        share = np.arctan2(p[:, 1], p[:, 0]) / math.pi
        share[-1] = 1.0
    keep = share > 1e-9
    shares = np.concatenate([[0.0], share[keep]])
    axes = np.vstack([t.axis[~t.cutting][-1], axis[keep]])

    def wanted(s: float) -> Array:
        return tool_axis(machine, *(a + s * (b - a) for a, b in zip(before, after, strict=True)))

    for s, found in zip(shares, axes, strict=True):
        assert found == pytest.approx(wanted(s), abs=1e-6)
    for k in range(len(shares) - 1):
        middle = axes[k] + axes[k + 1]
        middle /= np.linalg.norm(middle)
        off = np.linalg.norm(middle - wanted((shares[k] + shares[k + 1]) / 2.0))
        assert math.degrees(float(off)) < TOLERANCE_DEG


@pytest.mark.parametrize("arc", [False, True])
@pytest.mark.parametrize("dialect", DIALECTS)
@pytest.mark.parametrize("machine", ["table-ac", "table-bc"])
def test_tool_axis_follows_the_rotary_axes(tmp_path: Path, dialect: str, machine: str, arc: bool) -> None:
    """Quarter, half, whole and several turns, small angles, tilts through the vertical."""
    turns = [
        ((30.0, 90.0), (30.0, 270.0)),
        ((30.0, 0.0), (30.0, 360.0)),
        ((-40.0, 10.0), (25.0, 350.0)),
        ((20.0, 0.0), (20.0, -720.0)),
        ((0.0, 0.0), (45.0, 340.0)),
        ((60.0, 5.0), (60.0, 8.0)),
        ((5.0, 0.0), (6.0, 0.5)),
    ]
    rng = np.random.default_rng(4)
    for _ in range(8):
        a, b = rng.uniform(-70, 70, 2)
        c, d = rng.uniform(-400, 400, 2)
        turns.append(((round(a, 4), round(c, 4)), (round(b, 4), round(d, 4))))
    for before, after in turns:
        t = read(tmp_path, program(dialect, machine, before, after, arc), dialect, machine)
        check(t, machine, before, after, arc=arc)


def test_full_turn_on_the_spot_is_followed(tmp_path: Path) -> None:
    t = read(
        tmp_path,
        "G21 G90\nG0 A30 C0\nG43.4 H1\nG0 X0 Y0 Z0\nG1 C360. F500\nG49\nM30\n",
        "gcode",
        "table-ac",
    )
    i, j = t.axis[t.cutting, 0], t.axis[t.cutting, 1]
    swept = np.unwrap(np.arctan2(j, i))
    assert swept[-1] - swept[0] == pytest.approx(2 * math.pi * (1 - 1 / len(swept)), abs=1e-6)
    assert np.abs(t.position[t.cutting]).max() < 1e-12


@pytest.mark.parametrize(("word", "sweep"), [("DC(350)", -10.0), ("ACP(350)", 350.0), ("ACN(350)", -10.0)])
def test_sinumerik_states_the_direction_of_rotation(tmp_path: Path, word: str, sweep: float) -> None:
    text = f"G71 G90\nG0 A30 C0\nTRAORI\nG0 X0 Y0 Z0\nG1 X10 C={word} F500\nTRAFOOF\nM30\n"
    t = read(tmp_path, text, "siemens", "table-ac")
    swept = np.degrees(np.unwrap(np.arctan2(t.axis[1:, 1], t.axis[1:, 0])))
    assert swept[-1] - math.degrees(math.atan2(-1, 0)) == pytest.approx(sweep, abs=1e-6) or swept[-1] - swept[
        0
    ] == pytest.approx(sweep, abs=1e-6)


def test_rapids_and_small_rotations_are_not_divided(tmp_path: Path) -> None:
    text = "G21 G90\nG0 A30 C0\nG43.4 H1\nG0 X0 Y0 Z0\nG0 X10 C180\nG1 X20 C181 F500\nM30\n"
    t = read(tmp_path, text, "gcode", "table-ac")
    assert t.move.tolist() == [MoveKind.RAPID, MoveKind.RAPID, MoveKind.CUT]


def test_arc_with_rotation_without_tool_centre_point_control_is_refused(tmp_path: Path) -> None:
    text = "G21 G90\nG0 X10 Y0 Z0 C0\nG3 X-10 Y0 I-10 J0 C90 F500\nM30\n"
    with pytest.raises(InputError, match="line 3"):
        read(tmp_path, text, "gcode", "table-ac@0,0,0")


@pytest.mark.parametrize("words", ["ORIVECT", "ORIPLANE", "ORIVECT\nORIAXES\nORIVECT"])
@pytest.mark.parametrize("cut", ["G1 X-10", "G3 X-10 Y0 I-10 J0"])
def test_sinumerik_rotates_the_axis_in_one_plane_on_request(tmp_path: Path, words: str, cut: str) -> None:
    text = f"G71 G90 G17\nG0 A30 C0\nTRAORI\n{words}\nG0 X10 Y0 Z0\n{cut} A=30 C=90 F500\nTRAFOOF\nM30\n"
    t = read(tmp_path, text, "siemens", "table-ac")
    axis = t.axis[t.cutting]
    normal = np.cross(tool_axis("table-ac", 30, 0), tool_axis("table-ac", 30, 90))
    assert axis[-1] == pytest.approx(tool_axis("table-ac", 30, 90), abs=1e-9)
    assert np.abs(axis @ normal).max() < 1e-9
    if "G1" in cut:
        assert len(axis) == 1
    else:
        steps = np.degrees(np.arccos(np.clip((axis[1:] * axis[:-1]).sum(axis=1), -1, 1)))
        assert np.ptp(steps) < 1e-6  # uniform steps


def test_heidenhain_vector_path_control_is_not_divided(tmp_path: Path) -> None:
    text = (
        "0 BEGIN PGM T MM\n1 TOOL CALL 1 Z S1000\n"
        "2 FUNCTION TCPM F TCP AXIS POS PATHCTRL {}\n3 L X+10 Y+0 Z+0 A+30 C+0 R0 FMAX\n"
        "4 L X+10 F1000\n5 L X-10 A+30 C+90\n6 END PGM T MM\n"
    )
    assert read(tmp_path, text.format("VECTOR"), "heidenhain", "table-ac").cutting.sum() == 2
    assert read(tmp_path, text.format("AXIS"), "heidenhain", "table-ac").cutting.sum() > 5
