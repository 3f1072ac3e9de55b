"""Offset registers of APT and modifiers of FANUC moves are accepted without effect on points; else planning stops."""

from __future__ import annotations

from pathlib import Path

import pytest

from machopt.toolpath.toolpath_reader import read_toolpath

HEAD = "PARTNO T\nUNITS/MM\nFEDRAT/300,MMPM\n"
POINT, MORE = "GOTO/0,0,-1,0,0,1\n", "GOTO/9,0,-1,0,0,1\n"


@pytest.mark.parametrize(
    ("body", "stops"),
    [
        ("LOADTL/1\nSET/OFSETL,1\n" + POINT + MORE, False),
        ("SET/OFSETL,1\nLOADTL/1\n" + POINT + MORE, False),
        ("SET/OFSETL,1\n" + POINT + MORE, False),
        ("LOADTL/1\nSET/OFSETL,1\n" + POINT + "SET/OFSETL,1\n" + MORE, False),
        ("LOADTL/1\nSET/OFSETL,1\n" + POINT + "LOADTL/2\nSET/OFSETL,2\n" + MORE, False),
        ("LOADTL/1\nSET/ADJUST,1\n" + POINT + "LOADTL/2\nSET/ADJUST,2\n" + MORE, False),
        ("OFSTNO/1\n" + POINT + MORE, False),
        ("OFSTNO/1\n" + POINT + "OFSTNO/1\n" + MORE, False),
        ("SET/HOLDER,80\n" + POINT + MORE, False),
        (POINT + "SET/OFSETL,3\n" + MORE, True),
        ("SET/OFSETL,1\n" + POINT + "SET/OFSETL,2\n" + MORE, True),
        ("LOADTL/1\nSET/OFSETL,1\n" + POINT + "SET/OFSETL,2\n" + MORE, True),
        ("LOADTL/1\nSET/OFSETL,1\n" + POINT + "LOADTL/2\n" + MORE + "SET/OFSETL,2\n" + POINT, True),
        ("LOADTL/1\nSET/ADJUST,1\n" + POINT + "SET/ADJUST,4\n" + MORE, True),
        (POINT + "OFSTNO/2\n" + MORE, True),
        ("OFSTNO/1\n" + POINT + "OFSTNO/2\n" + MORE, True),
        ("LOADTL/1\nOFSTNO/1\n" + POINT + "LOADTL/2\nOFSTNO/2\n" + MORE, True),
    ],
)
def test_register_changed_within_the_path_stops_the_plan(body: str, stops: bool, tmp_path: Path) -> None:
    file = tmp_path / "x.apt"
    file.write_text(HEAD + body + "FINI\n")
    found = [w.word for w in read_toolpath(file).ignored if w.stops]
    assert bool(found) == stops
    if stops:
        assert not any(w.stops for w in read_toolpath(file, accept_unknown=tuple(found)).ignored)


@pytest.mark.parametrize(
    ("modifier", "stops"),
    [
        ("", False),
        ("ACC80", False),
        ("PTH", False),
        ("COORD", False),
        ("BREAK", False),
        ("Wjnt", True),
        ("WJNT", True),
        ("Wjnt ACC80", True),
    ],
)
def test_wrist_joint_motion_without_orientation_stops_the_plan(modifier: str, stops: bool, tmp_path: Path) -> None:
    point = (
        "P[{}]{{\n   GP1:\n UF : 1, UT : 1, CONFIG : 'N U T, 0, 0, 0',\n X = {}.0 mm, Y = 0.0 mm, Z = 500.0 mm,\n"
        " W = 180.0 deg, P = 0.0 deg, R = 0.0 deg\n}};\n"
    )
    file = tmp_path / "x.ls"
    file.write_text(
        "/PROG T\n/ATTR\n/MN\n   1:  UFRAME_NUM=1 ;\n   2:  UTOOL_NUM=1 ;\n   3:L P[1] 10mm/sec FINE ;\n"
        f"   4:L P[2] 10mm/sec FINE {modifier} ;\n/POS\n{point.format(1, 500)}{point.format(2, 510)}/END\n"
    )
    assert any(w.stops for w in read_toolpath(file).ignored) == stops
