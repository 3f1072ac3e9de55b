"""Words of robot and CAM programs that change the tool position are not ignored."""

from __future__ import annotations

from pathlib import Path

import pytest

from machopt.toolpath.toolpath_reader import read_toolpath

KRL = """&ACCESS RVP
DEF t( )
BAS(#INITMOV,0)
$BASE={{X 0,Y 0,Z 0,A 0,B 0,C 0}}
$TOOL={{X 0,Y 0,Z 100,A 0,B 0,C 0}}
$VEL.CP=0.01
PTP {{A1 0,A2 -90,A3 90,A4 0,A5 45,A6 0}}
LIN {{X 500,Y 0,Z 500,A 0,B 90,C 0}}
{word}
LIN {{X 510,Y 0,Z 500,A 0,B 60,C 0}}
END
"""
PRESETS = """0 BEGIN PGM T MM
1 TOOL CALL 1 Z S1000
{before}
4 L X+0 Y+0 Z+10 R0 FMAX
5 L Z-1 F200
6 {preset}
7 L X+10
8 L Z+10 FMAX M2
9 END PGM T MM
"""


@pytest.mark.parametrize(
    ("word", "stops"),
    [
        ("$ORI_TYPE=#CONSTANT", True),
        ("$ORI_TYPE = #constant", True),
        ("$ORI_TYPE=#IGNORE", True),
        ("$ORI_TYPE=#VAR", False),
        ("$ORI_TYPE=#JOINT", False),
        ("$CIRC_TYPE=#BASE", False),
    ],
)
def test_unsupported_orientation_mode_stops_the_plan(word: str, stops: bool, tmp_path: Path) -> None:
    file = tmp_path / "t.src"
    file.write_text(KRL.format(word=word), encoding="utf-8")
    ignored = read_toolpath(file).ignored
    assert any(w.stops and w.first_line == 9 for w in ignored) is stops


@pytest.mark.parametrize(
    ("before", "preset", "warned"),
    [
        ("", "PRESET SELECT #2", True),
        ("", "CYCL DEF 247 DATUM SETTING ~\n Q339=+2", True),
        ("3 PRESET SELECT #2", "PRESET SELECT #2", False),
        ("3 PRESET SELECT #2", ";", False),
    ],
)
def test_preset_after_points_of_an_unnamed_one_causes_a_warning(
    before: str, preset: str, warned: bool, tmp_path: Path
) -> None:
    file = tmp_path / "t.h"
    file.write_text(PRESETS.format(before=before, preset=preset).replace("\n\n", "\n"), encoding="utf-8")
    assert any("preset 2" in text for text in read_toolpath(file).warnings) is warned
