"""Problems that prevent production are listed first on terminal, document and page."""

from __future__ import annotations

import json
import re
from dataclasses import replace
from pathlib import Path

import pytest

from machopt.cell.cell_reader import load_cell
from machopt.cli import main
from machopt.data_types.cell import Cell
from machopt.data_types.documents.program_entries import RobotProgramEntry
from machopt.data_types.plan_options import PlanOptions
from machopt.verification.folder.verification_scope import list_production_blockers, list_unchecked

CELLS = Path(__file__).parents[1] / "cells"


@pytest.fixture(scope="module")
def cell() -> Cell:
    return load_cell(CELLS / "kr500_milling")


def program(
    *, left: tuple[str, ...] = (), assumed: tuple[str, ...] = (), files: tuple[str, ...] = ("a.src",)
) -> RobotProgramEntry:
    return RobotProgramEntry(
        post="krl",
        files=files,
        lines=3,
        tolerance_mm=0.05,
        moves_added=0,
        withheld=None if files else "verification failed",
        feed_model=None,
        assumed=assumed,
        not_in_program=left,
        checked=None,
        differences=(),
        tool=None,
    )


def test_most_severe_blocker_comes_first(cell: Cell) -> None:
    assert cell.stiffness is not None
    guessed = replace(cell, stiffness=replace(cell.stiffness, estimated=True))
    missing = list_unchecked(guessed, PlanOptions(collision=False))
    one = program(left=("the program starts no spindle",), assumed=("tool number 1",))
    out = list_production_blockers(guessed, missing, [one])
    found = [
        next(n for n, text in enumerate(out) if word in text)
        for word in ("collisions NOT checked", "starts no spindle", "a.src NOT checked", "tool number 1", "estimated")
    ]
    assert found == sorted(found) == list(range(5))


def test_no_blocker_is_an_empty_list(cell: Cell) -> None:
    assert list_production_blockers(cell, (), []) == ()
    assert list_production_blockers(cell, (), [program(left=("starts no spindle",), files=())]) == ()


@pytest.mark.slow
def test_blockers_are_first_on_terminal_and_page_and_recomputed(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    job, out = tmp_path / "job.nc", tmp_path / "out"
    job.write_text("G21 G90 G17\nT3 M6\nS9000 M3\nG0 X0 Y0 Z20\nG1 Z0 F800\nG1 X30 F1200\nG0 Z20\nM5\nM30\n")
    cell = CELLS / "kr500_milling"
    words = ["optimize", str(cell), str(job), "-o", str(out), "--post", "krl", "--set", "collision=false"]
    assert main(words) == 0
    lines = [line for line in capsys.readouterr().out.splitlines() if line]
    result = json.loads((out / "result.json").read_text())
    blockers = result["production_blockers"]
    assert lines[: len(blockers)] == [f"before production: {text}" for text in blockers]
    assert blockers[0] == "collisions NOT checked"
    assert any("starts no spindle" in text for text in blockers)
    page = (out / "report.html").read_text()
    box = page[page.index("<section id=verdict") :]
    assert box.index("class=blockers") < box.index("class=badge") < box.index("class=cards")
    assert re.findall("<li>", box[: box.index("class=badge")]) == ["<li>"] * len(blockers)
    assert main(["verify", str(cell), str(job), str(out), "--set", "collision=false", "--quiet"]) == 0
