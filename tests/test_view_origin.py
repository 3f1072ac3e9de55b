"""What an output folder was made from is found by its hashes, and nothing else is taken for it."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import pytest

from machopt.domain.manifest import Manifest
from machopt.output.hashes import entry
from machopt.view import origin
from machopt.view.origin import changed, origin_of


@pytest.fixture
def job(tmp_path: Path) -> tuple[Path, Manifest]:
    (tmp_path / "shop" / "mycell").mkdir(parents=True)
    out = tmp_path / "shop" / "out" / "part"
    out.mkdir(parents=True)
    cell, part = tmp_path / "shop" / "mycell" / "cell.yaml", tmp_path / "shop" / "part.csv"
    cell.write_text("machopt_cell: 1\n")
    part.write_text("x_mm\n1\n")
    inputs = (entry(cell, "cell.yaml", "cell"), entry(part, "part.csv", "toolpath"))
    made = Manifest(command="optimize", verdict="done", exit_code=0, versions={}, inputs=inputs)
    return out, made


def test_cell_and_toolpath_are_found_wherever_the_folders_were_moved(job: tuple[Path, Manifest]) -> None:
    out, manifest = job
    found = origin_of(out, manifest)
    shop = out.parents[1]
    assert (found.cell, found.toolpath, found.missing) == (shop / "mycell/cell.yaml", shop / "part.csv", ())
    other = shop.parent / "elsewhere"
    (shop / "mycell").rename(other)
    assert origin_of(out, manifest).cell == other / "cell.yaml"


def test_a_file_of_that_name_that_holds_something_else_is_not_it(job: tuple[Path, Manifest]) -> None:
    out, manifest = job
    (out.parents[1] / "part.csv").write_text("x_mm\n2\n")  # as long as it was
    found = origin_of(out, manifest)
    assert found.toolpath is None
    assert found.missing == ("toolpath part.csv",)
    (out.parents[1] / "kept").mkdir()
    (out.parents[1] / "kept" / "part.csv").write_text("x_mm\n1\n")
    assert origin_of(out, manifest).toolpath == out.parents[1] / "kept" / "part.csv"


def test_the_search_ends(job: tuple[Path, Manifest], monkeypatch: pytest.MonkeyPatch) -> None:
    out, manifest = job
    monkeypatch.setattr(origin, "MOST", 1)
    assert origin_of(out, manifest).missing == ("cell cell.yaml", "toolpath part.csv")


def test_inputs_that_changed_since_are_named(job: tuple[Path, Manifest]) -> None:
    _, manifest = job
    now = (replace(manifest.inputs[0], sha256="0" * 64), manifest.inputs[1])
    assert changed(manifest.inputs, now) == ("cell.yaml",)
    assert changed(manifest.inputs, manifest.inputs) == ()
