"""Speeds of FANUC moves: feeds in every unit, durations, rotation times and their switches."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from machopt.errors import InputError
from machopt.toolpath.toolpath_reader import read_toolpath

# x mm, y mm, rotation about z in degrees; P[4] rotates only
PLACES = [(0, 0, 0), (100, 0, 0), (100, 50, 0), (50, 50, 30)]


def write(tmp_path: Path, *moves: str) -> Path:
    positions = "".join(
        f"P[{n}]{{\n GP1:\n UF : 1, UT : 1, CONFIG : 'N U T, 0, 0, 0',\n X = {x}.0 mm, Y = {y}.0 mm, Z = 0.0 mm,\n"
        f" W = 180.0 deg, P = 0.0 deg, R = {turn}.0 deg\n}};\n"
        for n, (x, y, turn) in enumerate([*PLACES, (100, 50, 40)], 1)
    )
    lines = "".join(f" {k}:{move} ;\n" for k, move in enumerate(moves, 3))
    file = tmp_path / "a.ls"
    file.write_text(
        f"/PROG A\n/ATTR\n/MN\n 1: UFRAME_NUM=1 ;\n 2: UTOOL_NUM=1 ;\n{lines}/POS\n{positions}/END\n", encoding="utf-8"
    )
    return file


FEEDS = {  # words after P[2], which is 100 mm from P[1]; feed in mm/min
    "250mm/sec CNT100": 15000,
    "60cm/min FINE": 600,
    "12inch/min FINE": 304.8,
    "10sec FINE": 600,
    "2.5 sec FINE": 2400,
    "500msec FINE": 12000,
    "250mm/sec CNT100 TB .10sec,CALL A": 15000,
    "250mm/sec CNT100 ACC80 TB .10sec,CALL A(1,2)": 15000,
    "250mm/sec CNT100 TA   .50sec,DO[1]=ON": 15000,
    "250mm/sec FINE DB 10mm,CALL X": 15000,
    "250mm/sec CNT100 TIME BEFORE .10sec,CALL A": 15000,
    "250mm/sec CNT100 TB 2.00sec,P-SPS": 15000,
    "10sec CNT50 TB .20sec,POINT_LOGIC": 600,
    "TB .10sec,CALL A 250mm/sec FINE": 15000,
    "60cm/min CNT5 TB -.10sec,GO[2]=7": 600,
}


@pytest.mark.parametrize("words", FEEDS)
def test_feed_of_a_straight_move(tmp_path: Path, words: str) -> None:
    path = read_toolpath(write(tmp_path, "L P[1] 100mm/sec FINE", f"L P[2] {words}"))
    assert path.feed[-1] * 60e3 == pytest.approx(FEEDS[words])


REFUSED = [
    "L P[2] 90deg/sec FINE",
    "L P[2] 0sec FINE",
    "L P[2] R[5]sec FINE",
    "L P[2] R[5]mm/sec FINE",
    "L P[2] max_speed FINE",
    "L P[2] 50% FINE",
    "C P[2]\n    P[3] 2sec FINE",
    "C P[2]\n    P[3] 90deg/sec FINE",
    "A P[2] 100mm/sec FINE ;\n 9:A P[3] 500msec FINE",
]


@pytest.mark.parametrize("move", REFUSED)
def test_speed_missing_in_the_file_is_refused(tmp_path: Path, move: str) -> None:
    with pytest.raises(InputError, match=r"line \d+: "):
        read_toolpath(write(tmp_path, "L P[1] 100mm/sec FINE", move))


def test_rotation_on_the_spot_keeps_the_previous_feed(tmp_path: Path) -> None:
    path = read_toolpath(write(tmp_path, "L P[3] 100mm/sec FINE", "L P[5] 90deg/sec FINE", "L P[1] 10sec FINE"))
    np.testing.assert_allclose(path.feed[:2] * 60e3, 6000.0)
    assert path.feed[2] * 60e3 == pytest.approx(np.hypot(100, 50) * 6.0)


def test_duration_from_an_unknown_place_requires_a_feed(tmp_path: Path) -> None:
    file = write(tmp_path, "L P[1] 5sec FINE", "L P[2] 100mm/sec FINE")
    with pytest.raises(InputError, match="feed"):
        read_toolpath(file)
