"""Worst deflection along and perpendicular to the tool axis: equal in document, terminal and page, with intervals."""

from __future__ import annotations

import json
import shutil
from pathlib import Path

import pytest

from machopt.cli import main

CELLS, TOOLPATHS = Path(__file__).parents[1] / "cells", Path(__file__).parents[1] / "toolpaths"


@pytest.mark.slow
def test_deflection_is_split_with_its_interval(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    cell, table, out = tmp_path / "cell", tmp_path / "holes.csv", tmp_path / "out"
    shutil.copytree(CELLS / "kr240_drilling", cell)
    rows = [[(1e-8) ** 2 if i == j else 0.0 for j in range(6)] for i in range(6)]
    stiffness = cell / "stiffness.yaml"
    stiffness.write_text(f"{stiffness.read_text()}\ncovariance: {json.dumps(rows)}\n")
    table.write_text("\n".join((TOOLPATHS / "panel_holes.csv").read_text().splitlines()[:14]) + "\n")
    assert main(["optimize", str(cell), str(table), "-o", str(out)]) == 0
    message = capsys.readouterr().out
    worst = json.loads((out / "result.json").read_text())["worst_point"]
    along, across, whole = (worst[f"deflection_{k}mm"] for k in ("along_", "across_", ""))
    assert along**2 + across**2 == pytest.approx(whole**2, rel=1e-9)
    assert abs(along) > 0.9 * whole  # the drilling force acts along the tool axis
    half = {
        k: 0.5 * (worst[f"deflection_{k}ci90_mm"][1] - worst[f"deflection_{k}ci90_mm"][0])
        for k in ("", "along_", "across_")
    }
    # the gradients of both components add up to that of the total
    most = (abs(along) * half["along_"] + across * half["across_"]) / whole
    assert 0.0 < half[""] <= most * (1 + 1e-9)
    page = (out / "report.html").read_text()
    for value in (along, across, *worst["deflection_along_ci90_mm"]):
        text = f"{value:.3f}".replace("-", "−")
        assert text in message
        assert text in page
    assert main(["verify", str(cell), str(table), str(out), "--quiet"]) == 0
