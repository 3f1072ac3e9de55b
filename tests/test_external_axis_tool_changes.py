"""Tool changes and placement in a cell with compliant rail and table."""

from __future__ import annotations

import csv
import json
from pathlib import Path

import pytest
from external_axis_cells import external_folder
from test_external_axis_stiffness import BLOCK, COVARIANCE

from machopt.cli import main

ONE = """tool:
  tcp: {xyz_mm: [0, 0, 350]}
  mass_kg: 20
  geometry: [{name: spindle, box_mm: [120, 120, 280], xyz_mm: [0, 0, 140]}]
  cutter: {diameter_mm: 12, length_mm: 60}
"""
TWO = """tools:
  "3":
    tcp: {xyz_mm: [0, 0, 350]}
    mass_kg: 20
    geometry: [{name: spindle, box_mm: [120, 120, 280], xyz_mm: [0, 0, 140]}]
    cutter: {diameter_mm: 12, length_mm: 60}
  LONG:
    tcp: {xyz_mm: [0, 0, 420]}
    mass_kg: 24
    geometry: [{name: spindle, box_mm: [120, 120, 280], xyz_mm: [0, 0, 140]}]
    cutter: {diameter_mm: 8, length_mm: 120}
"""
JOB = "x_mm,y_mm,z_mm,i,j,k,move,feed_mm_min,operation,tool\n" + "".join(
    f"{x},{y},60,0,0,1,rapid,,o{n},{tool}\n{x},{y},-2,0,0,1,cut,300,o{n},{tool}\n"
    f"{x},{y},60,0,0,1,retract,3000,o{n},{tool}\n"
    for n, (x, y, tool) in enumerate([(-60, -80, "3"), (40, 20, "3"), (60, 80, "LONG")])
)
QUICK = ["--quiet", "--set", "rotation_step_deg=30", "--set", "external.turn.mode=operation"]


@pytest.fixture(scope="module")
def soft(tmp_path_factory: pytest.TempPathFactory) -> Path:
    folder = external_folder(tmp_path_factory.mktemp("soft"), rail=True, table=True)
    (folder / "cell.yaml").write_text((folder / "cell.yaml").read_text().replace(ONE, TWO))
    (folder / "stiffness.yaml").write_text((folder / "stiffness.yaml").read_text() + COVARIANCE + BLOCK)
    (folder / "job.csv").write_text(JOB)
    return folder


@pytest.mark.slow
def test_two_tools_on_soft_axes_are_planned_and_verified(soft: Path, tmp_path: Path) -> None:
    """For both tools the plan includes the compliance of rail and table and its σ; the verifier has its own formulas
    for both."""
    out = tmp_path / "out"
    assert main(["optimize", str(soft), str(soft / "job.csv"), "-o", str(out), *QUICK]) == 0
    assert main(["verify", str(soft), str(soft / "job.csv"), str(out), "--quiet"]) == 0
    result = json.loads((out / "result.json").read_text())
    assert [t["tool"] for t in result["tools"]] == ["3", "LONG"]
    with (out / "points.csv").open() as file:
        rows = [r for r in csv.DictReader(file) if r["move"] == "cut"]
    bend, std = ([float(r[k]) for r in rows] for k in ("deflection_mm", "deflection_std_mm"))
    assert all(s > 1e-4 * b for s, b in zip(std, bend, strict=True))  # the contribution of the arm is a millionth


@pytest.mark.slow
def test_job_with_two_tools_on_soft_axes_is_placed(soft: Path, tmp_path: Path) -> None:
    """The best place is a complete plan with both tools and compliant axes, written and verified."""
    out = tmp_path / "placed"
    arguments = ["place", str(soft), str(soft / "job.csv"), "-o", str(out), "--places", "2", "--best", "1", "--quiet"]
    more = [
        "--x-mm",
        "-60",
        "60",
        "--y-mm",
        "0",
        "0",
        "--set",
        "rotation_step_deg=45",
        "--set",
        "external.turn.mode=locked",
        "--set",
        "external.rail.mode=locked",
    ]
    assert main([*arguments, *more]) == 0
    best = out / "best-1"
    cell = next(best.rglob("cell.yaml"))
    assert "LONG" in cell.read_text()
    assert "std_N_mm" in (cell.parent / "stiffness.yaml").read_text()
