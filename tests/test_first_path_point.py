"""A path may begin with any kind of row: the first point is reached from home."""

from __future__ import annotations

from pathlib import Path

import pytest

from machopt.commands.optimize.request import OptimizeRequest
from machopt.commands.optimize.run import run_optimize

CELL = Path(__file__).resolve().parents[1] / "cells" / "kr240_drilling"
REST = "".join(f"{x},-60,0,0,0,1,cut,600\n" for x in (-60, -40, -20))


@pytest.mark.slow
@pytest.mark.parametrize("first", ["cut", "approach", "retract"])
def test_path_with_any_first_row_is_planned_programmed_and_verified(first: str, tmp_path: Path) -> None:
    """Rows without a kind of move are cuts: the shortest table that a user writes begins with one."""
    table = tmp_path / "path.csv"
    table.write_text(f"x_mm,y_mm,z_mm,i,j,k,move,feed_mm_min\n-80,-60,0,0,0,1,{first},600\n{REST}")
    done = run_optimize(
        OptimizeRequest(cell=CELL, toolpath=table, out=tmp_path / "out", posts=("krl", "rapid", "fanuc_joint"))
    )
    assert done.exit_code == 0, done.result.verdict
    assert len(done.result.programs) == 3
