"""Complete drilling input: every hole has an outcome on the first run."""

from __future__ import annotations

import csv
import shutil
from pathlib import Path

import numpy as np
import pytest
import yaml

from machopt.cli import main

ROOT = Path(__file__).resolve().parents[1]
SPRINGS = [1.41e6, 4.01e5, 9.35e5, 3.60e5, 3.70e5, 3.80e5]
COVARIANCE = np.diag([(0.1 / k) ** 2 for k in SPRINGS]).tolist()
PROCESS = """machopt_process: 1
materials:
  al: {drilling: {kc1: 800, mc: 0.25, chisel_N_mm2: 300,
    thrust_spread_percent: 30, torque_spread_percent: 25, source: t}}
operations:
  default: {kind: drilling, spindle_rpm: 3000, layers: [{material: al, thickness_mm: 5}], depth_mm: 8,
    tolerance: {position_mm: 0.5}}
"""
CYCLES = {
    "G81": "G98 G81 Z-8. R2. F240",
    "G82": "G99 G82 Z-8. R2. P200 F240",
    "G83": "G98 G83 Z-8. R2. Q3. F240",  # the last peck begins below the material that the previous peck left
    "G73": "G98 G73 Z-8. R2. Q2.9 F240",
}


def write_grid(origin: list[float], *, with_std: bool) -> dict[str, object]:
    grid = {"origin_mm": origin, "cell_mm": 400, "shape": [2, 2, 2], "joints_Nm_per_rad": [SPRINGS] * 8}
    return {**grid, "std_Nm_per_rad": [[0.1 * k for k in SPRINGS]] * 8} if with_std else grid


NEAR, FAR = [1400, -400, 400], [5000, 5000, 5000]
STIFFNESS: dict[str, dict[str, object]] = {
    "percent": {"spread_percent": 10},
    "covariance": {"covariance": COVARIANCE},
    "covariance and grid": {"covariance": COVARIANCE, "grid": write_grid(NEAR, with_std=False)},
    "percent and grid": {"spread_percent": 10, "grid": write_grid(NEAR, with_std=False)},
    "covariance outside the grid": {"covariance": COVARIANCE, "grid": write_grid(FAR, with_std=True)},
    "percent outside the grid": {"spread_percent": 10, "grid": write_grid(FAR, with_std=True)},
    "grid": {"grid": write_grid(NEAR, with_std=True)},
}


def drill(folder: Path, cycle: str, stiffness: dict[str, object]) -> list[dict[str, str]]:
    """Plan the first drilling job of a new cell, and return its holes."""
    cell = folder / "cell"
    shutil.copytree(ROOT / "cells" / "kr240_drilling", cell)
    document = {"machopt_stiffness": 1, "joints_Nm_per_rad": SPRINGS, "source": "t", **stiffness}
    (cell / "stiffness.yaml").write_text(yaml.safe_dump(document), encoding="utf-8")
    (cell / "process.yaml").write_text(PROCESS, encoding="utf-8")
    places = "".join(f"X{x}. Y{y}.\n" for x, y in ((-150, -200), (-50, -200), (50, 200)))
    head = "%\nO1\nG21 G90 G17 G54\nT1 M6\nS3000 M3\nG0 X-150. Y-200.\nG43 H1 Z50.\n"
    (folder / "job.nc").write_text(f"{head}{CYCLES[cycle]} {places}G80\nM30\n", encoding="utf-8")
    words = ["--process", str(cell / "process.yaml"), "--set", "rotation_step_deg=15", "--quiet"]
    assert main(["optimize", str(cell), str(folder / "job.nc"), "-o", str(folder / "out"), *words]) == 0
    with (folder / "out" / "points.csv").open(encoding="utf-8") as file:
        return [row for row in csv.DictReader(file) if row["outcome"]]


@pytest.mark.slow
@pytest.mark.parametrize("cycle", CYCLES)
def test_every_hole_of_a_cycle_has_an_outcome(tmp_path: Path, cycle: str) -> None:
    holes = drill(tmp_path, cycle, STIFFNESS["percent"])
    assert len(holes) == 3
    assert not [hole for hole in holes if hole["outcome"] == "unknown"]


@pytest.mark.slow
@pytest.mark.parametrize("name", STIFFNESS)
def test_every_form_of_a_stated_spread_gives_an_outcome(tmp_path: Path, name: str) -> None:
    """All forms state 10 % of each spring: the probabilities are those of the percentage."""
    holes = drill(tmp_path, "G81", STIFFNESS[name])
    assert len(holes) == 3
    reference = drill(tmp_path / "reference", "G81", STIFFNESS["percent"])
    for hole, other in zip(holes, reference, strict=True):
        assert float(hole["p_in"]) == pytest.approx(float(other["p_in"]), abs=0.02)


@pytest.mark.slow
def test_no_stiffness_is_assumed_outside_a_grid(tmp_path: Path) -> None:
    holes = drill(tmp_path, "G81", {"grid": write_grid(FAR, with_std=True)})
    assert {hole["outcome"] for hole in holes} == {"unknown"}
    assert all(hole["p_in"] == "" and float(hole["error_across_mm"]) > 0 for hole in holes)
