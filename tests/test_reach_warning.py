"""Cuts beyond the reach of the robot cause a warning as soon as a cell is known."""

from __future__ import annotations

import json
from pathlib import Path

import pytest

from machopt.cli import main

ROOT = Path(__file__).resolve().parents[1]


@pytest.mark.parametrize(("far", "count"), [("9000.", 1), ("90000.", 1), ("100.", 0)])
def test_inspect_compares_the_extent_with_the_reach(
    tmp_path: Path, capsys: pytest.CaptureFixture[str], far: str, count: int
) -> None:
    file = tmp_path / "far.nc"
    file.write_text(f"G21 G90\nG0 X0. Y0. Z50.\nG1 X{far} F6000\nG1 X0.\nM30\n")
    words = ["inspect", str(file), "--cell", str(ROOT / "cells" / "kr500_milling"), "--json", "--max-extent", "1000000"]
    assert main(words) == 0
    found = json.loads(capsys.readouterr().out)["warnings"]
    assert len([w for w in found if "reach" in w]) == count
