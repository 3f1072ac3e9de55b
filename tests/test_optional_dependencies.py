"""Planning needs no optional dependency; a missing package is named with its extra, and no output remains."""

from __future__ import annotations

import subprocess
import sys
import tomllib
from pathlib import Path

import numpy as np
import pytest

import machopt
from machopt.errors import InputError
from machopt.file_formats.parquet_tables import find_parquet_difference, refuse_without_pyarrow, write_parquet_copies
from machopt.toolpath.toolpath_reader import read_toolpath

ROOT = Path(__file__).resolve().parents[1]
HEAVY = ("dask", "distributed", "psutil", "pyarrow", "pandas", "xacro", "rosbags")
EXTRAS = tomllib.loads((ROOT / "pyproject.toml").read_text(encoding="utf-8"))["project"]["optional-dependencies"]


@pytest.fixture
def without(monkeypatch: pytest.MonkeyPatch) -> None:
    """Simulate an installation without extras."""
    for name in [m for m in sys.modules if m.partition(".")[0] in HEAVY] + list(HEAVY):
        monkeypatch.setitem(sys.modules, name, None)


def test_importing_the_library_and_the_planner_loads_no_extra() -> None:
    code = (
        "import sys, machopt, machopt.cli, machopt.commands.optimize.run, machopt.commands.verify\n"
        f"print(sorted({{m.partition('.')[0] for m in sys.modules}} & set({HEAVY!r})))"
    )
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True, cwd=ROOT)
    assert done.stdout.strip() == "[]"


def test_parquet_copy_equals_the_csv(tmp_path: Path) -> None:
    parquet = pytest.importorskip("pyarrow.parquet", reason="pyarrow is an optional dependency")
    table = tmp_path / "points.csv"
    table.write_text('point,operation,x_mm,reason\n0,1,0.1,\n1,2,,"a, b"\n', encoding="utf-8")
    assert write_parquet_copies([table]) == ["points.parquet"]
    copy = tmp_path / "points.parquet"
    assert parquet.read_table(copy).to_pydict() == {
        "point": [0.0, 1.0],
        "operation": ["1", "2"],  # labels, even if they look like numbers
        "x_mm": [0.1, None],
        "reason": ["", "a, b"],
    }
    assert find_parquet_difference(table, copy) == ""
    whole = table.read_text(encoding="utf-8")
    for old, new, message in (
        ("0.1", "0.11", "x_mm, row 1: 0.1, where points.csv has 0.11"),
        ("a, b", "a", "reason, row 2"),
        ("x_mm", "y_mm", "has the columns"),
        ('1,2,,"a, b"\n', "", "has 2 rows; points.csv has 1"),
    ):
        table.write_text(whole.replace(old, new), encoding="utf-8")
        assert message in find_parquet_difference(table, copy)
    copy.write_bytes(b"PAR1xxxxPAR1")
    assert "is not readable" in find_parquet_difference(table, copy)


@pytest.mark.usefixtures("without")
def test_missing_package_is_named_with_its_extra(tmp_path: Path) -> None:
    parquet = tmp_path / "part.parquet"
    parquet.write_bytes(b"PAR1xxxxPAR1")
    wanted = {
        "batch": lambda: machopt.batch(ROOT / "toolpaths" / "plain.csv", tmp_path / "out", cell="cell"),
        "parquet": lambda: read_toolpath(parquet),
        "parquet too": lambda: refuse_without_pyarrow("parquet"),
        "frames": lambda: machopt.Table({"x": np.zeros(2)}).frame(),
    }
    for extra, ask in wanted.items():
        name = extra.split()[0]
        with pytest.raises(InputError, match=rf"\[{name}\]"):
            ask()
        assert name in EXTRAS
    assert not (tmp_path / "out").exists()


def test_table_is_written_as_csv_and_parquet(tmp_path: Path) -> None:
    parquet = pytest.importorskip("pyarrow.parquet", reason="pyarrow is an optional dependency")
    columns = {"x_mm": np.array([0.1, np.nan]), "n": np.array([1, 2]), "reason": np.array(["a, b", ""])}
    table = machopt.Table(columns)
    table.write(tmp_path / "t.csv")
    assert (tmp_path / "t.csv").read_text() == 'x_mm,n,reason\n0.1,1,"a, b"\n,2,\n'
    table.write(str(tmp_path / "t.parquet"))
    found = parquet.read_table(tmp_path / "t.parquet").to_pydict()
    assert found["n"] == [1, 2]
    assert found["reason"] == ["a, b", ""]
    np.testing.assert_array_equal(found["x_mm"], columns["x_mm"])
    for name, message in (("t.xlsx", "tables are CSV or Parquet"), ("gone/t.csv", "cannot be written")):
        with pytest.raises(InputError, match=message):
            table.write(tmp_path / name)
