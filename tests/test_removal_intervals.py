"""Intervals of the remaining error after compensation, from the spread of springs and force."""

from __future__ import annotations

import json
import shutil
from pathlib import Path

import pytest

from machopt.cli import main

ROOT = Path(__file__).resolve().parents[1]
PROCESS = """machopt_process: 1
operations:
  default: {kind: force, force_N: {axial: 150}, spread_percent: SPREAD, depth_mm: 8, tolerance: {position_mm: 0.5}}
"""
ROWS = "x_mm,y_mm,z_mm,i,j,k,move,feed_mm_min,operation\n" + "\n".join(
    f"{x},-200,{z},0,0,1,{move},{feed},holes"
    for x in (-150, -50)
    for z, move, feed in ((40, "rapid", ""), (2, "rapid", ""), (-8, "cut", 420), (40, "retract", ""))
)


def compensate(folder: Path, percent: float) -> dict[str, object]:
    """Return the compensation of a drilling job whose force has a spread of ``percent`` percent."""
    shutil.copytree(ROOT / "cells" / "kr240_drilling", folder / "cell")
    (folder / "process.yaml").write_text(PROCESS.replace("SPREAD", f"{percent:g}"), encoding="utf-8")
    (folder / "holes.csv").write_text(ROWS, encoding="utf-8")
    words = ["optimize", str(folder / "cell"), str(folder / "holes.csv"), "-o", str(folder / "out"), "--quiet"]
    words += ["--process", str(folder / "process.yaml"), "--compensate", "--set", "rotation_step_deg=15"]
    assert main(words) == 0
    removed: dict[str, object] = json.loads((folder / "out" / "result.json").read_text())["compensation"]["removed"]
    return removed


@pytest.mark.slow
def test_both_spreads_widen_the_remaining_error(tmp_path: Path) -> None:
    """10 % of each spring alone, and with 30 % of the force in addition:
    the upper ends are about 1.6 times these values."""
    upper = {}
    for percent in (0.1, 30.0):
        removed = compensate(tmp_path / f"{percent:g}", percent)
        low, high = removed["residual_mean_ci90_mm"]  # type: ignore[misc]
        own, share = float(removed["residual_mean_mm"]), float(removed["removed_percent"])  # type: ignore[arg-type]
        bent = own / (1.0 - share / 100.0)
        assert low <= own + 1e-5
        assert removed["residual_max_ci90_mm"] is not None
        upper[percent] = float(high) / bent
    assert 0.05 < upper[0.1] < 0.25
    assert 0.4 < upper[30.0] < 0.75
