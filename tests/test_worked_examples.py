"""Worked examples of docs/examples run and give the stated results."""

from __future__ import annotations

import importlib.util
from pathlib import Path

import pytest

EXAMPLES = Path(__file__).resolve().parents[1] / "docs" / "examples"
LEAVES = {
    "own_cell": ("cell/cell.yaml", "cell.svg", "map.svg", "plan/result.json"),
    "compare_stiffness": ("stiffness/result.json", "stiffness_table2/result.json"),
    "custom_index": ("best/result.json",),
    "batch_on_dask": ("batch/batch.json", "batch/summary.csv"),
    "measured_to_plan": ("identified/stiffness.yaml", "before/result.json", "after/result.json"),
}


@pytest.mark.slow
@pytest.mark.parametrize("name", sorted(LEAVES))
def test_example_runs(name: str, tmp_path: Path) -> None:
    spec = importlib.util.spec_from_file_location(name, EXAMPLES / f"{name}.py")
    assert spec is not None
    assert spec.loader is not None
    module = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(module)
    module.main(tmp_path)
    assert [f for f in LEAVES[name] if not (tmp_path / f).is_file()] == []


def test_every_example_is_run() -> None:
    assert {p.stem for p in EXAMPLES.glob("*.py")} == {*LEAVES, "softening"}  # softening: of custom_index
