"""Feeds, dwells and positions in the arguments of drilling cycles of Sinumerik and Heidenhain."""

from __future__ import annotations

from pathlib import Path

import pytest

from machopt.data_types.toolpath import MoveKind, Toolpath
from machopt.errors import InputError
from machopt.toolpath.toolpath_reader import read_toolpath


def _read_siemens(folder: Path, *lines: str) -> Toolpath:
    file = folder / "x.mpf"
    head = ["%_N_X_MPF", ";$PATH=/_N_MPF_DIR", "G71 G90 G17 G94 G54", "G0 X0 Y0 Z10 F100"]
    file.write_text("\n".join([*head, *lines, "M30"]) + "\n", encoding="utf-8")
    return read_toolpath(file)


def _read_heidenhain(folder: Path, number: int, call: str, **q: float) -> Toolpath:
    words = {"Q200": 2, "Q201": -12, "Q206": 150, "Q202": 5, "Q203": 0, "Q204": 20, "Q211": 0} | q
    lines = [
        "0 BEGIN PGM T MM",
        "1 TOOL CALL 1 Z S1000",
        "2 L X+0 Y+0 Z+50 R0 FMAX",
        f"3 CYCL DEF {number} DRILLING ~",
        " ~\n".join(f" {name}={value}" for name, value in words.items()),
        f"4 {call}",
        "5 L Z+60 FMAX M2",
        "6 END PGM T MM",
    ]
    file = folder / "x.h"
    file.write_text("\n".join(lines) + "\n", encoding="utf-8")
    return read_toolpath(file)


def _feeds(path: Toolpath) -> list[float]:
    """Return the feeds in mm/min of the strokes down and of the retracts at a feed."""
    fed = (path.move == MoveKind.CUT) | ((path.move == MoveKind.RETRACT) & (path.feed > 0.0))
    return [round(6e4 * float(feed), 6) for feed in path.feed[fed]]


@pytest.mark.parametrize(
    ("call", "feeds", "dwell"),
    [
        ("CYCLE85(10,0,2,-5,,0.7,150,200)", [150.0, 200.0], 0.7),
        ("CYCLE85(10,0,2,-5,,0.7,150)", [150.0, 150.0], 0.7),
        ("CYCLE85(10,0,2,-5)", [100.0, 100.0], 0.0),
        ("CYCLE84(10,0,2,-5,,0.5,3,,2,0,100,150)", [200.0, 300.0], 0.5),
        ("CYCLE84(10,0,2,-5,,0,3,,-1.5,0,200)", [300.0, 300.0], 0.0),
        ("CYCLE84(10,0,2,-5)", [100.0, 100.0], 0.0),
        ("CYCLE84(10,0,2,-5,,0,3,,1.5,0,200,200,3,0)", [300.0, 300.0], 0.0),  # PITA 0: unit as in the program
        ("CYCLE84(10,0,2,-5,,0,3,,1.5,0,200,200,3,1)", [300.0, 300.0], 0.0),
        ("CYCLE84(10,0,2,-5,,0,3,,20,0,300,300,3,2)", [381.0, 381.0], 0.0),  # 20 threads per inch
        ("CYCLE84(10,0,2,-5,,0,3,,0.05,0,300,300,3,3)", [381.0, 381.0], 0.0),
        ("S300 M3\nCYCLE840(10,0,2,-5,,0,4,3,1,,20,3,2)", [381.0, 381.0], 0.0),
        ("CYCLE84(10,0,2,-5,,0,3,6,,0,100)", [100.0, 100.0], 0.0),
        ("S500 M3\nCYCLE84(10,0,2,-5,,0,3,8)", [625.0, 625.0], 0.0),
        ("S500 M3\nCYCLE84(10,0,2,-5,,0,3,,0.8)", [400.0, 400.0], 0.0),
        ("S500 M3\nCYCLE840(10,0,2,-5,,0,0,3,0,10)", [750.0, 750.0], 0.0),
        ("S500 M3\nCYCLE840(10,0,2,-5,,0,0,3,0,,2)", [1000.0, 1000.0], 0.0),
        ("CYCLE84(10,0,2,-5,,0,3,,1,0,200,,,,,1,4,0.5)", [200.0, 200.0, 200.0, 200.0], 0.0),
        ("CYCLE81(10,0,2,-5)", [100.0], 0.0),
    ],
)
def test_feeds_in_the_arguments_of_a_cycle_apply(call: str, feeds: list[float], dwell: float, tmp_path: Path) -> None:
    path = _read_siemens(tmp_path, "X5 Y5", call)
    assert _feeds(path) == feeds
    assert path.dwells.sum() == pytest.approx(dwell)


@pytest.mark.parametrize(
    "block",
    [
        "G0 X5 Y7 Z50 CYCLE81(10,0,2,-5)",
        "Z30 CYCLE82(10,0,2,-5,,1)",
        "G1 Z40 CYCLE83(10,0,2,-5,,-2,,0,0,0,1,0)",
        "Z0 MCALL CYCLE81(10,0,2,-5)",
        "X1 CYCLE85(10,0,2,-5)",
        "Y1 CYCLE86(10,0,2,-5)",
    ],
)
def test_motion_in_the_block_of_a_cycle_is_refused(block: str, tmp_path: Path) -> None:
    with pytest.raises(InputError) as found:
        _read_siemens(tmp_path, block)
    assert ":5" in str(found.value) or "line 5" in str(found.value)


@pytest.mark.parametrize(
    ("number", "q", "feeds"),
    [
        (201, {"Q208": 250}, [150.0, 250.0]),
        (201, {"Q208": 0}, [150.0, 150.0]),
        (202, {"Q208": 250}, [150.0, 250.0]),
        (202, {}, [150.0, 150.0]),
        (200, {"Q208": 250, "Q202": 20}, [150.0]),
    ],
)
def test_feed_of_the_retract_applies(number: int, q: dict[str, float], feeds: list[float], tmp_path: Path) -> None:
    assert _feeds(_read_heidenhain(tmp_path, number, "CYCL CALL", **q)) == feeds


@pytest.mark.parametrize(
    ("call", "places"),
    [
        ("CYCL CALL POS X+20 Y+5 Z+3 FMAX", [(20.0, 5.0, 50.0), (20.0, 5.0, 3.0)]),
        ("CYCL CALL POS X+20 Y+5 Z+70 FMAX", [(0.0, 0.0, 70.0), (20.0, 5.0, 70.0)]),
        ("CYCL CALL POS X+20 Y+5 FMAX", [(20.0, 5.0, 50.0)]),
        ("CYCL CALL POS Z+8 FMAX", [(0.0, 0.0, 8.0)]),
    ],
)
def test_call_at_a_place_never_moves_diagonally(
    call: str, places: list[tuple[float, float, float]], tmp_path: Path
) -> None:
    path = _read_heidenhain(tmp_path, 200, call, Q202=20)
    found = [tuple(round(1e3 * float(v), 6) for v in p) for p in path.position[1 : 1 + len(places)]]
    assert found == places


@pytest.mark.parametrize(
    ("cycle", "asked"),
    [
        ("G98 G83 X5. Y5. Z-6. R2. Q3000 F100.", True),
        ("G98 G73 X5. Y5. Z-6. R2. Q2000 F100.", True),
        ("N5G83X5.Y5.Z-6.R2.Q0500F100.", True),
        ("G98 G83 X5. Y5. Z-6. R2. Q3.0 F100.", False),
        ("G98 G83 X5. Y5. Z-6. R2. Q3 F100.", False),
        ("G98 G83 X5. Y5. Z-6. R2. Q50 F100. (Q3000)", False),
    ],
)
def test_peck_possibly_in_micrometres_is_asked_for(cycle: str, asked: bool, tmp_path: Path) -> None:
    file = tmp_path / "x.nc"
    file.write_text("\n".join(["%", "O1", "G21 G90 G17 G94 G54", "G0 X0. Y0. Z10.", cycle, "G80", "M30", "%"]) + "\n")
    if not asked:
        read_toolpath(file)
        return
    with pytest.raises(InputError, match="--decimals") as found:
        read_toolpath(file)
    assert "5" in str(found.value)
