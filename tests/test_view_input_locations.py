"""Inputs of an output folder are found by their hashes."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import pytest

from machopt.data_types.manifest import FolderManifest
from machopt.output.file_hashes import build_manifest_file
from machopt.view import input_locations
from machopt.view.input_locations import list_changed_inputs, locate_inputs


@pytest.fixture
def job(tmp_path: Path) -> tuple[Path, FolderManifest]:
    (tmp_path / "shop" / "mycell").mkdir(parents=True)
    out = tmp_path / "shop" / "out" / "part"
    out.mkdir(parents=True)
    cell, part = tmp_path / "shop" / "mycell" / "cell.yaml", tmp_path / "shop" / "part.csv"
    cell.write_text("machopt_cell: 1\n")
    part.write_text("x_mm\n1\n")
    inputs = (build_manifest_file(cell, "cell.yaml", "cell"), build_manifest_file(part, "part.csv", "toolpath"))
    made = FolderManifest(command="optimize", verdict="done", exit_code=0, versions={}, inputs=inputs)
    return out, made


def test_cell_and_toolpath_are_found_after_moving_the_folders(job: tuple[Path, FolderManifest]) -> None:
    out, manifest = job
    found = locate_inputs(out, manifest)
    shop = out.parents[1]
    assert (found.cell, found.toolpath, found.missing) == (shop / "mycell/cell.yaml", shop / "part.csv", ())
    other = shop.parent / "elsewhere"
    (shop / "mycell").rename(other)
    assert locate_inputs(out, manifest).cell == other / "cell.yaml"


def test_file_with_the_same_name_and_other_content_is_rejected(job: tuple[Path, FolderManifest]) -> None:
    out, manifest = job
    (out.parents[1] / "part.csv").write_text("x_mm\n2\n")  # same length as before
    found = locate_inputs(out, manifest)
    assert found.toolpath is None
    assert found.missing == ("toolpath part.csv",)
    (out.parents[1] / "kept").mkdir()
    (out.parents[1] / "kept" / "part.csv").write_text("x_mm\n1\n")
    assert locate_inputs(out, manifest).toolpath == out.parents[1] / "kept" / "part.csv"


def test_search_terminates(job: tuple[Path, FolderManifest], monkeypatch: pytest.MonkeyPatch) -> None:
    out, manifest = job
    monkeypatch.setattr(input_locations, "MAX_ENTRIES", 1)
    assert locate_inputs(out, manifest).missing == ("cell cell.yaml", "toolpath part.csv")


def test_changed_inputs_are_named(job: tuple[Path, FolderManifest]) -> None:
    _, manifest = job
    now = (replace(manifest.inputs[0], sha256="0" * 64), manifest.inputs[1])
    assert list_changed_inputs(manifest.inputs, now) == ("cell.yaml",)
    assert list_changed_inputs(manifest.inputs, manifest.inputs) == ()
