"""benchmarks/cam_reading_table.py: one row per file, required options, counted reasons."""

from __future__ import annotations

import sys
from pathlib import Path

import pytest

sys.path.insert(0, str(Path(__file__).resolve().parents[1] / "benchmarks"))

import cam_reading_table

FILES = {
    "good.nc": "G21 G90\nG0 X0 Y0 Z5\nG1 Z-1 F300\nX50\nFOO\nM30\n",
    "unitless.nc": "G90\nG0 X0 Y0 Z5\nG1 Z-1 F300\nX50\nM30\n",
    "bare.csv": "x_mm,y_mm,z_mm\n0,0,0\n10,0,0\n",
    "fast.csv": "x_mm,y_mm,z_mm,feed_mm_min,kind\n0,0,0,4500000,path\n10,0,0,4500000,\n",
    "joints.src": "DEF a()\nPTP {A1 0,A2 -90,A3 90,A4 0,A5 0,A6 0}\nEND\n",
    "sub/index.csv": "not looked at\n",
}


@pytest.fixture
def folder(tmp_path: Path) -> Path:
    for name, text in FILES.items():
        (tmp_path / name).parent.mkdir(exist_ok=True)
        (tmp_path / name).write_text(text)
    return tmp_path


def test_table_lists_read_and_refused_files_with_reasons(
    folder: Path, capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    rows = {f.name: cam_reading_table.look(f, folder, {}, ask=False) for f in cam_reading_table.files_in(folder)}
    assert set(rows) == {"good.nc", "unitless.nc", "bare.csv", "fast.csv", "joints.src"}
    assert (rows["good.nc"].points, rows["good.nc"].cutting, rows["good.nc"].operations) == (3, 2, 1)
    assert "FOO" in rows["good.nc"].ignored
    assert "--unit" in rows["unitless.nc"].refused
    assert "--feed" in rows["bare.csv"].refused
    assert "2 cuts at up to 4.5e+06 mm/min" in rows["fast.csv"].doubts
    assert cam_reading_table.kind_of(rows["joints.src"].refused) == "robot program of joint moves only"
    requested = {f.name: cam_reading_table.look(f, folder, {}, ask=True) for f in cam_reading_table.files_in(folder)}
    assert requested["unitless.nc"].given == ["--unit mm"]
    assert requested["bare.csv"].given == ["--feed 1000", "--kind path"]
    assert (requested["unitless.nc"].points, requested["bare.csv"].points) == (3, 2)
    monkeypatch.setattr(
        sys, "argv", ["cam_reading_table.py", str(folder), "--ask", "--csv", str(folder / "sub" / "index.csv")]
    )
    assert cam_reading_table.main() == 0
    message = capsys.readouterr().out
    assert "5 files: 4 read (2 as they are), 1 refused" in message
    assert len((folder / "sub" / "index.csv").read_text().splitlines()) == 6
