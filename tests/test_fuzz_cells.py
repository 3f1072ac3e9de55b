"""Part of ``benchmarks/fuzz_cells.py``: damaged cells and recordings are refused or valid; no crash occurs."""

from __future__ import annotations

import random
from pathlib import Path

import pytest
from cell_mutations import FORMATS, Case, run, sane_cell, sane_mesh

from machopt.errors import InputError
from machopt.measurement.recording import load_recording

CASES = {"urdf": 60, "mesh": 80, "cell": 60, "stiffness": 60, "recording": 80, "options": 150}


@pytest.mark.parametrize("name", FORMATS)
@pytest.mark.filterwarnings("ignore::RuntimeWarning")  # from numbers that libraries process before they are refused
def test_damaged_files_are_refused_or_valid(name: str, tmp_path: Path) -> None:
    found = run(Case(name, tmp_path), CASES[name], random.Random(f"7 {name}"))
    assert found["refused"] > 0.2 * CASES[name]  # most mutations are real faults
    assert found["read"] > 0  # not everything is refused


def test_intact_cell_passes_the_same_checks(tmp_path: Path) -> None:
    case = Case("urdf", tmp_path)
    sane_cell(case.folder)
    sane_mesh(case.folder)


def test_impossible_readings_are_refused_at_their_place(tmp_path: Path) -> None:
    case = Case("recording", tmp_path)
    for name, text in case.sound.items():
        (case.folder / name).write_text(text)
    lines = (case.folder / "data.csv").read_text().split("\n")
    cells = lines[2].split(",")
    cells[9] = "1e300"
    lines[2] = ",".join(cells)
    (case.folder / "data.csv").write_text("\n".join(lines))
    with pytest.raises(InputError, match=r"data\.csv: line 3, column fx_N: found 1e\+300; expected at most 1e\+07"):
        load_recording(case.folder)
