"""CL conventions of CAM systems: stated sweeps, RTRCTO,AUTO, increments, feeds without a unit."""

from __future__ import annotations

import math
from pathlib import Path

import numpy as np
import pytest

from machopt.data_types.toolpath import MoveKind, Toolpath
from machopt.errors import InputError
from machopt.toolpath.toolpath_reader import read_toolpath
from machopt.toolpath.unknown_words import refuse_unknown_words


def read(folder: Path, text: str, name: str = "part.apt", **options: object) -> Toolpath:
    (folder / name).write_text(text)
    return read_toolpath(folder / name, **options)  # type: ignore[arg-type]


def read_refused(folder: Path, text: str, name: str = "part.apt", **options: object) -> InputError:
    with pytest.raises(InputError) as found:
        read(folder, text, name, **options)
    return found.value


# ---- arcs with a stated sweep (CAMplete)


@pytest.mark.parametrize("up", [1, -1])
@pytest.mark.parametrize("left", [True, False])
@pytest.mark.parametrize("sweep", [10.0, 45.0, 90.0, 135.0, 179.0, 181.0, 200.0, 270.0, 350.0])
def test_stated_sweep_decides_the_direction(tmp_path: Path, up: int, left: bool, sweep: float) -> None:
    """36 arcs: the arc has the stated sweep for every axis in the record."""
    turn = math.radians(sweep) * (1.0 if left else -1.0)
    x, y = 30.0 + 20.0 * math.cos(turn), 40.0 + 20.0 * math.sin(turn)
    text = (
        "UNITS/MM\nFEDRAT/500,MMPM\nGOTO/50,40,0\n"
        f"CIRCLE/30,40,0,0,0,{up},20,{sweep:g},0.0,0.0,0.0\nGOTO/{x:.9f},{y:.9f},0\nFINI\n"
    )
    t = read(tmp_path, text)
    p = t.position[:, :2] * 1e3 - [30.0, 40.0]
    angle = np.unwrap(np.arctan2(p[:, 1], p[:, 0]))
    assert angle[-1] - angle[0] == pytest.approx(turn, abs=1e-6)


def test_full_and_half_turns_follow_the_clockwise_axis(tmp_path: Path) -> None:
    for sweep, x in ((360.0, 50.0), (180.0, 10.0)):
        text = f"UNITS/MM\nFEDRAT/500,MMPM\nGOTO/50,40,0\nCIRCLE/30,40,0,0,0,1,20,{sweep},0,0,0\nGOTO/{x},40,0\nFINI\n"
        p = read(tmp_path, text).position[:, :2] * 1e3 - [30.0, 40.0]
        angle = np.unwrap(np.arctan2(p[:, 1], p[:, 0]))
        assert math.degrees(angle[-1] - angle[0]) == pytest.approx(-sweep, abs=1e-6)


@pytest.mark.parametrize("sweep", [0.03, 60.0, 88.0, 120.0, 272.0, 0.0])
def test_sweep_that_contradicts_its_points_is_refused(tmp_path: Path, sweep: float) -> None:
    text = f"UNITS/MM\nFEDRAT/500,MMPM\nGOTO/50,40,0\nCIRCLE/30,40,0,0,0,1,20,{sweep},0,0,0\nGOTO/30,60,0\nFINI\n"
    assert read_refused(tmp_path, text).where in ("line 4", "line 5")


def test_movarc_with_words_before_its_numbers(tmp_path: Path) -> None:
    text = (
        "UNITS/MM\nFEDRAT/500,MMPM\nGOTO/10,0,0\nMOVARC/ CENTER, 10, 10, 0, AXIS, 0, 0, 1, RADIUS, 10\nGOTO/20,10,0\n"
        "GOTO/20,30,0\nMOVARC/ CENTER, 30, 30, 0, AXIS, 0, 0, -1, RADIUS, 10\nGOTO/30,40,0\nFINI\n"
    )
    t = read(tmp_path, text)
    length = float(np.linalg.norm(np.diff(t.position, axis=0), axis=1).sum()) * 1e3
    assert length == pytest.approx(20.0 + 2 * 5.0 * math.pi, abs=1e-2)


# ---- RTRCTO,AUTO


def cycle(axis: str, holes: list[str], start: str = "20,100,60", words: str = "RTRCTO,AUTO,MMPM,250.") -> str:
    points = "".join(f"GOTO/{h}\n" for h in holes)
    return (
        "TOOL PATH/D,TOOL,T8\nTLDATA/DRILL,MILL,8.0,0.0,80.0,118.0,35.0\nMSYS/0.,0.,0.,1.,0.,0.,0.,1.,0.\n"
        f"RAPID\nGOTO/{start},{axis}\nCYCLE/DRILL,RAPTO,3.0,FEDTO,-10.0,{words}\n{points}CYCLE/OFF\nEND-OF-PATH\n"
    )


def test_tool_retracts_to_the_previous_plane(tmp_path: Path) -> None:
    for heights in ([10.0, 10.0, 10.0], [10.0, 4.0, 25.0]):
        t = read(tmp_path, cycle("0,0,1", [f"{20 + 40 * k},100,{z}" for k, z in enumerate(heights)]), "part.cls")
        assert t.position[t.move == MoveKind.RETRACT, 2] * 1e3 == pytest.approx([60.0] * 3)
        assert t.position[t.cutting, 2] * 1e3 == pytest.approx([z - 10.0 for z in heights])


def test_retract_plane_is_normal_to_a_tilted_axis(tmp_path: Path) -> None:
    axis = np.array([0.6, 0.0, 0.8])
    t = read(tmp_path, cycle("0.6,0,0.8", ["0,0,0", "0,50,0"], start="60,0,80"), "part.cls")
    assert (t.position[t.move == MoveKind.RETRACT] * 1e3) @ axis == pytest.approx([100.0, 100.0])


@pytest.mark.parametrize("holes", [["20,100,10", "60,100,10,0,0.6,0.8"], ["60,100,10,0.6,0,0.8"]])
def test_other_axis_has_no_such_plane(tmp_path: Path, holes: list[str]) -> None:
    assert (read_refused(tmp_path, cycle("0,0,1", holes), "part.cls").where or "").startswith("line ")


def test_unknown_word_after_rtrcto_stops_a_plan(tmp_path: Path) -> None:
    t = read(tmp_path, cycle("0,0,1", ["20,100,10"], words="RTRCTO,HALF,MMPM,250."), "part.cls")
    with pytest.raises(InputError):
        refuse_unknown_words(t, tmp_path / "part.cls")


# ---- feeds


@pytest.mark.parametrize("value", ["0.15", "0.02", ".1", "0.5", "1.2", "2", "3.5", "4.9", "0.001", "0.08"])
def test_small_feed_without_a_unit_is_asked_for(tmp_path: Path, value: str) -> None:
    text = f"UNITS/MM\nSPINDL/1000,RPM,CLW\nFEDRAT/{value}\nGOTO/0,0,0\nGOTO/0.03,0,0\nFINI\n"
    problem = read_refused(tmp_path, text)
    assert problem.where == "line 3"
    assert "--feed" in problem.reason
    assert read(tmp_path, text, default_feed=0.005).feed == pytest.approx(0.005)
    per_minute = read(tmp_path, text.replace(f"/{value}", f"/{value},MMPM"))
    assert per_minute.feed == pytest.approx(float(value) / 60e3)
    per_turn = read(tmp_path, text.replace(f"/{value}", f"/{value},MMPR"))
    assert per_turn.feed == pytest.approx(float(value) * 1000.0 / 60e3)


@pytest.mark.parametrize(("unit", "value"), [("MM", "5"), ("MM", "150"), ("INCHES", "0.2"), ("INCHES", "12")])
def test_other_feeds_without_a_unit_are_per_minute(tmp_path: Path, unit: str, value: str) -> None:
    t = read(tmp_path, f"UNITS/{unit}\nFEDRAT/{value}\nGOTO/0,0,0\nGOTO/10,0,0\nFINI\n")
    assert t.feed == pytest.approx(float(value) * (25.4 if unit == "INCHES" else 1.0) / 60e3)


# ---- positions that the file does not state


@pytest.mark.parametrize("after", ["GOTO/10,0,0\n", "GODLTA/1,0,0\n", "CIRCLE/0,0,0,0,0,1\nGOTO/5,0,0\n"])
def test_cut_after_gohome_has_no_start(tmp_path: Path, after: str) -> None:
    text = f"UNITS/MM\nFEDRAT/100,MMPM\nGOTO/0,0,0\nGOTO/5,0,0\nGOHOME\n{after}FINI\n"
    assert (read_refused(tmp_path, text).where or "").startswith("line ")
    assert len(read(tmp_path, text.replace("GOHOME\n", "GOHOME\nRAPID\nGOTO/5,0,0\n"))) >= 3


@pytest.mark.parametrize(
    "text",
    [
        "G0 Z100",
        "G54",
        "N10 G68 X0 Y0 R30",
        "X100. Y0",
        "(home) G28 Z0",
        "M98 P100",
        "TRANS X10",
        "CYCLE800(1)",
        "CYCL DEF 7.0",
        "M128",
        "PLANE RESET STAY",
        "Z-5.",
    ],
)
def test_inserted_nc_code_stops_a_plan(tmp_path: Path, text: str) -> None:
    t = read(tmp_path, f"UNITS/MM\nFEDRAT/100,MMPM\nGOTO/0,0,0\nINSERT/{text}\nGOTO/5,0,0\nFINI\n")
    assert [w.first_line for w in t.ignored if w.stops] == [4]


@pytest.mark.parametrize(
    "text",
    ["Stock Size X40. Y267. Z40.", "[HOLDER=C40] 10MM DRILL", "M8", "N10 M8 (FLOOD)", "(G54 IS SET)", "T5 ON BOARD"],
)
def test_other_inserted_text_is_a_comment(tmp_path: Path, text: str) -> None:
    t = read(tmp_path, f"UNITS/MM\nFEDRAT/100,MMPM\nGOTO/0,0,0\nINSERT/{text}\nGOTO/5,0,0\nFINI\n")
    assert not [w for w in t.ignored if w.stops]


@pytest.mark.parametrize(
    ("words", "stops"),
    [
        ("PREFUN/54", True),
        ("PREFUN/68", True),
        ("AUXFUN/98", True),
        ("AUXFUN/8", False),
        ("AUXFUN/41", False),
        ("ROTATE/AAXIS,0", False),
        ("TRNTYP/LOCAL", True),
        ("TRNTYP/WORLD", False),
    ],
)
def test_codes_and_rotations(tmp_path: Path, words: str, stops: bool) -> None:
    t = read(tmp_path, f"UNITS/MM\nFEDRAT/100,MMPM\nGOTO/0,0,0\n{words}\nGOTO/5,0,0\nFINI\n")
    assert bool([w for w in t.ignored if w.stops]) is stops
