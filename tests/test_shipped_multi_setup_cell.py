"""Shipped cell with three tools and two setups: generated, divided at the changes, planned and verified."""

from __future__ import annotations

import json
from pathlib import Path

import numpy as np
import pytest
from test_shipped_cells import ROOT, script

from machopt.cell.cell_reader import load_cell
from machopt.cell.tool_selection import select_job_tools, split_into_tool_segments
from machopt.cell.work_offsets import place_toolpath
from machopt.commands.optimize.request import OptimizeRequest
from machopt.commands.optimize.run import run_optimize
from machopt.data_types.plan_options import PlanOptions, ProcessForce
from machopt.errors import InputError
from machopt.planning.job.job_planner import plan_job
from machopt.planning.pipeline.planning_setup import StageTimings
from machopt.toolpath.toolpath_reader import read_toolpath

CELL, FILE = ROOT / "cells" / "kr240_setups", ROOT / "toolpaths" / "two_plates.nc"
POSTS = ("krl", "rapid", "fanuc_joint", "urscript", "val3", "csv")


def test_scripts_make_the_committed_files(tmp_path: Path) -> None:
    script("cells/make_setup_cells.py").write(tmp_path)
    own = {p.relative_to(CELL) for p in CELL.rglob("*") if p.is_file() and p.name != "README.md"}
    assert {p.relative_to(tmp_path / CELL.name) for p in (tmp_path / CELL.name).rglob("*") if p.is_file()} == own
    for name in ("cell.yaml", "stiffness.yaml"):
        assert (tmp_path / CELL.name / name).read_text() == (CELL / name).read_text()


def test_missing_tools_are_reported_without_the_cell() -> None:
    with pytest.raises(InputError, match=r"their relative position is not in the file; .*by the cell's offsets"):
        read_toolpath(FILE)


def test_job_is_planned_tool_after_tool(tmp_path: Path) -> None:
    cell = load_cell(CELL)
    assert cell.warnings == ()
    path = place_toolpath(read_toolpath(FILE, cell_offsets=tuple(cell.offsets)), cell)
    cell = select_job_tools(cell, path)
    segments = split_into_tool_segments(cell, path)
    assert [(s.tool, s.cell.controller.tool_number) for s in segments] == [("1", 1), ("2", 2), ("3", 3), ("2", 2)]
    assert np.allclose(path.axis[segments[3].first :], [-1, 0, 0])
    # into the face that points to the robot
    slot = path.position[segments[3].first :][path.cutting[segments[3].first :], 0]
    np.testing.assert_allclose([slot.min(), slot.max()], [-0.02, -0.017], atol=1e-9)
    options = PlanOptions(collision=False, rotation_step=np.radians(60.0), force=ProcessForce(axial=100.0), sample=0.1)
    done = plan_job(segments, path, options, StageTimings())
    assert done.timeline is not None
    assert done.timeline.trajectory is not None
    assert not len(done.plan.missing)
    assert [s.cell.tool.T_flange_tcp[2, 3] for s in segments] == [0.442, 0.484, 0.51, 0.484]


@pytest.mark.slow
def test_whole_command(tmp_path: Path) -> None:
    """One program per tool is read back; contacts include the bodies of the mounted tool
    and the fixtures of both setups."""
    done = run_optimize(OptimizeRequest(cell=CELL, toolpath=FILE, out=tmp_path / "out", posts=POSTS))
    assert done.exit_code == 0
    result = json.loads((tmp_path / "out" / "result.json").read_text())
    assert [t["tool"] for t in result["tools"]] == ["1", "2", "3", "2"]
    assert [(p["post"], p["tool"]) for p in result["programs"]] == [
        (post, tool) for post in POSTS for tool in ("1", "2", "3", "2")
    ]
    assert all(not p["differences"] for p in result["programs"])
    text = "".join(f.read_text() for f in sorted((tmp_path / "out").rglob("*.src")))
    assert [line for line in text.splitlines() if line.startswith("$TOOL=")] == [
        f"$TOOL=TOOL_DATA[{n}]" for n in (1, 2, 3, 2)
    ]
