"""A band of rotations that a contact closes all along a cut: swings over it are looked at together, not one a round."""

from __future__ import annotations

import shutil
from pathlib import Path

import numpy as np
import pytest
from test_cli import ROOT
from test_search import assert_closed_by_themselves

from machopt.formats.cell import load_cell
from machopt.formats.options import load_options
from machopt.formats.toolpath import read_toolpath
from machopt.plan.pipeline import search
from machopt.plan.pipeline.run import plan

BOXES = """
  - {name: box_0, box_mm: [78.5, 83.1, 85.3], xyz_mm: [416.8, -113.8, 809.5]}
  - {name: box_2, box_mm: [137.4, 82.1, 85.3], xyz_mm: [290.3, 162.9, 821.8]}
  - {name: box_4, box_mm: [90.5, 127.7, 67.9], xyz_mm: [544.6, -133.8, 777.6]}
"""


def test_swings_over_a_closed_band_are_looked_at_together(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """A cobot that asks for 12 mm of clearance along one pass; round by round this had no end after a minute."""
    monkeypatch.setattr(search, "ROUNDS", 60)
    folder = shutil.copytree(ROOT / "cells" / "cutting_cobot", tmp_path / "cell")
    text = (folder / "cell.yaml").read_text()
    head = text[: text.index("obstacles:")].replace("xyz_mm: [470, 110, 900]", "xyz_mm: [540, 163, 796]")
    (folder / "cell.yaml").write_text(f"{head}obstacles:{BOXES}stiffness: stiffness.yaml\n")
    begin, step = np.array([-24.21083, 98.981462]), np.array([-3.129047, -7.618662])
    rows = ["x_mm,y_mm,z_mm,i,j,k,move,feed_mm_min"]
    for k in range(21):
        x, y = begin + k * step
        for z, move, feed in (
            ((40, "rapid", ""), (3, "approach", 1500), (0, "cut", 600)) if not k else ((0, "cut", 600),)
        ):
            rows.append(f"{x:.6f},{y:.6f},{z},0,0,1,{move},{feed}")
    rows.append(f"{x:.6f},{y:.6f},40,0,0,1,retract,3000")
    (tmp_path / "pass.csv").write_text("\n".join(rows) + "\n")
    options = load_options({}, None, ["clearance_mm=12", "force_N={axial: 460}"])
    p = plan(load_cell(folder), read_toolpath(tmp_path / "pass.csv"), options)
    assert p.found is not None
    assert p.found.check.free
    assert p.found.rounds < 30
    assert len(p.found.edges.closed) > 100
    assert_closed_by_themselves(p)
