"""The G-code reader, compared with LinuxCNC's interpreter: a small part of benchmarks/linuxcnc_compare.py."""

from __future__ import annotations

import sys
from pathlib import Path

import pytest

from machopt.toolpath.toolpath_reader import read_toolpath

BENCHMARKS = Path(__file__).resolve().parents[1] / "benchmarks"
sys.path.insert(0, str(BENCHMARKS))

from linuxcnc.canonical_commands import COMMAND, interpret  # noqa: E402  # benchmarks is no package
from linuxcnc.point_comparison import compare, difference  # noqa: E402
from linuxcnc.random_programs import program  # noqa: E402

needs_rs274 = pytest.mark.skipif(COMMAND is None, reason="rs274 (linuxcnc-uspace) is not installed")
SEEDS = range(400_000, 400_060)


@pytest.mark.proof
@needs_rs274
@pytest.mark.parametrize("seed", SEEDS)
def test_random_programs_are_read_equally(seed: int) -> None:
    found = compare(program(seed))
    assert found.kind in ("agree", "agree but for rapids between holes", "both refuse"), found.why


@pytest.mark.proof
@needs_rs274
@pytest.mark.parametrize(
    ("line", "instead"),
    [("G1 X5", "G1 X5.01"), ("G1 X5", "G0 X5"), ("G3 X0 Y5 I-5 J0", "G2 X0 Y5 I-5 J0"), ("G80", "X7\nG80")],
)
def test_comparison_detects_differences(tmp_path: Path, line: str, instead: str) -> None:
    """A cut with another length, a rapid instead of a cut, an arc in the other direction, an additional hole."""
    text = "G21 G90 G98\nG0 X0 Y0 Z10\nF300\nG1 X5\nG3 X0 Y5 I-5 J0\nG81 X1 Y1 Z-1 R2\nG80\nG1 X9\nM2\n"
    assert compare(text).kind == "agree"
    file = tmp_path / "a.ngc"
    file.write_text(text.replace(line, instead, 1), encoding="ascii")
    assert difference(read_toolpath(file), interpret(text), 1e-3)


def test_random_programs_contain_every_kind_of_block() -> None:
    """The programs of the test contain every type of block, so that no difference means agreement."""
    text = "\n".join(program(s) for s in SEEDS).upper()
    words = [
        "G52",
        "G92",
        "G10 L2",
        "R0",
        "G18",
        "G19",
        "G83",
        "G73",
        "WHILE",
        "REPEAT",
        "CALL",
        "M73",
        "M72",
        "@",
        "G20",
    ]
    assert [w for w in words if w not in text] == []
