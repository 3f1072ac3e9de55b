"""Errors that no option can correct are reported before a missing option is requested."""

from __future__ import annotations

from pathlib import Path

import pytest

from machopt.errors import InputError
from machopt.toolpath.toolpath_reader import read_toolpath

APT = "PARTNO/1\n{feed}GOTO/0,0,0\n{fault}GOTO/10,0,0\nFINI\n"
H = (
    "0 BEGIN PGM T MM\n1 TOOL CALL 1 Z S1000\n2 L X+0 Y+0 Z+9 FMAX\n{fault}4 L X+9 {feed}\n"
    "5 L Z+9 FMAX M30\n6 END PGM T MM\n"
)
SRC = (
    "DEF p( )\n$BASE={{X 0,Y 0,Z 0,A 0,B 0,C 0}}\nPTP {{X 0,Y 0,Z 50,A 0,B 0,C 180}}\n{fault}"
    "LIN {{X 9,Y 0,Z 0,A 0,B 0,C 180}}\nLIN {{X 50,Y 0,Z 0,A 0,B 0,C 180}}\nEND\n"
)
CASES = [  # name, text, statement that no option corrects, its line
    *(
        ("x.apt", APT, fault, 3)
        for fault in (
            "COPY/1,SAME,2",
            "TRACUT/M1",
            "CALLSUB/3",
            "HELICAL/1",
            "ROTATE/TABLE,30",
            "CYCLE81/3",
            "CIRCLE/1,2",
            "MIRROR/YZPLAN",
            "GOFWD/C1,PAST,L2",
            "MATRIX/1,2",
        )
    ),
    *(
        ("x.h", H, fault, 4)
        for fault in ("FL IX+5", 'SEL TABLE "A"', "FPOL X+0 Y+0", "CYCL DEF 251 POCKET", "L X+5 X+6", "M89")
    ),
    *(
        ("x.src", SRC, fault, 4)
        for fault in (
            "GOTO M1",
            "$BASE.X=5",
            "$IPO_MODE=#TCP",
            "LIN_REL {X 1,A 5}",
            "CIRC_REL {X 1},{X 2}",
            "WHILE TRUE\nLIN {X 1}\nENDWHILE",
        )
    ),
]


@pytest.mark.parametrize(("name", "text", "fault", "line"), CASES)
def test_fault_is_reported_before_a_question(tmp_path: Path, name: str, text: str, fault: str, line: int) -> None:
    """The files state neither unit nor feeds, so both would be requested."""
    file = tmp_path / name
    file.write_text(text.format(feed="", fault=fault + "\n"))
    with pytest.raises(InputError) as refused:
        read_toolpath(file)
    assert refused.value.where is not None
    assert refused.value.where.startswith("line ")
    assert int(refused.value.where.split()[1].rstrip(",")) in range(line - 1, line + 3)
    assert not any(option in refused.value.reason for option in ("--unit", "--feed"))


@pytest.mark.parametrize(("name", "text"), [("x.apt", APT), ("x.h", H), ("x.src", SRC)])
def test_question_is_asked_without_a_fault(tmp_path: Path, name: str, text: str) -> None:
    file = tmp_path / name
    file.write_text(text.format(feed="", fault=""))
    with pytest.raises(InputError) as refused:
        read_toolpath(file)
    assert "--unit" in refused.value.reason or "--feed" in refused.value.reason
