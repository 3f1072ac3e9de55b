"""Stops required by the path are not reported as lost feed; limits of the axes are."""

from __future__ import annotations

import csv
import json
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from test_retiming import LIMITS, make

from machopt.cli import main
from machopt.data_types.cell import JointLimits
from machopt.data_types.slow_moves import RAMPS, TURN_BACK, is_turn_back
from machopt.planning.retiming.run_retiming import RunTrajectory, retime_run

UP = np.tile([0.0, 0.0, 1.0], (3, 1))
CELLS, TOOLPATHS = Path(__file__).parents[1] / "cells", Path(__file__).parents[1] / "toolpaths"


def corner(turn_deg: float, length: float = 0.03) -> np.ndarray:
    turn = np.radians(turn_deg)
    back = length * np.array([np.cos(turn), np.sin(turn), 0.0])
    return np.array([[0.0, 0, 0], [length, 0, 0], np.array([length, 0, 0]) + back])


@pytest.mark.parametrize("turn_deg", [0, 20, 45, 80, 90, 110, 119, 121, 130, 150, 170, 180])
def test_corner_is_a_stop_only_above_the_corner_limit(turn_deg: float) -> None:
    path = corner(turn_deg)
    back = bool(turn_deg > np.degrees(TURN_BACK))
    assert is_turn_back(path, UP, 1) is back
    out = retime_run(make(path, feed=0.025))
    assert isinstance(out, RunTrajectory)
    there = [d for d in out.dips if d.first <= 1.0 <= d.last]
    assert any(d.where == "reversal" for d in there) is back
    assert all(d.lost == (d.where not in RAMPS) for d in out.dips)
    if back:
        assert not any(d.lost for d in out.dips)


def test_coincident_points_do_not_hide_a_reversal() -> None:
    path = np.array([[0.0, 0, 0], [0.02, 0, 0], [0.02, 0, 1e-7], [0.02, 0, 0], [0.01, 0, 0]])
    assert [is_turn_back(path, np.tile([0.0, 0, 1], (5, 1)), k) for k in range(5)] == [False, True, True, True, False]


def test_reversal_of_the_tool_axis_rotation_is_a_reversal() -> None:
    tilt = np.radians([0.0, 10.0, 0.0])
    axis = np.column_stack([np.sin(tilt), np.zeros(3), np.cos(tilt)])
    assert is_turn_back(np.zeros((3, 3)), axis, 1)


@pytest.mark.parametrize("share", [0.1, 0.2, 0.3, 0.5, 0.7, 0.9])
def test_axis_too_slow_between_two_stops_is_a_lost_feed(share: float) -> None:
    """The whole stroke is one slow segment between two stops.

    Its acceleration ramps must not hide that the velocity of an axis limits it.
    """
    stroke = make(np.array([[0.0, 0, 0], [0.05, 0, 0], [0.0, 0, 0]]), feed=0.05)
    fast = retime_run(stroke)
    assert isinstance(fast, RunTrajectory)
    assert not [d for d in fast.dips if d.lost]
    needed = (np.abs(np.diff(fast.q, axis=0)) / stroke.sample).max(axis=0)
    slow = JointLimits(LIMITS.lower, LIMITS.upper, np.maximum(share * needed, 1e-3), LIMITS.acceleration, LIMITS.jerk)
    out = retime_run(replace(stroke, limits=slow))
    assert isinstance(out, RunTrajectory)
    lost = [d for d in out.dips if d.lost]
    assert lost
    assert {d.limit for d in lost} == {"velocity"}
    assert min(d.ratio for d in lost) == pytest.approx(share, abs=0.1)
    assert all(d.last - d.first > 0.5 for d in lost)


@pytest.mark.slow
def test_bottom_of_a_hole_gives_no_reason(tmp_path: Path) -> None:
    lines = (TOOLPATHS / "panel_holes.csv").read_text().splitlines()
    table, out = tmp_path / "holes.csv", tmp_path / "out"
    table.write_text("\n".join(lines[:14]) + "\n")
    cell = CELLS / "kr240_drilling"
    assert main(["optimize", str(cell), str(table), "-o", str(out), "--quiet"]) == 0
    with (out / "points.csv").open() as rows:
        assert not [row["reason"] for row in csv.DictReader(rows) if row["reason"]]
    result = json.loads((out / "result.json").read_text())
    assert result["feed_dips"] == []
    assert {stop["where"] for stop in result["feed_stops"]} == {"start", "stop", "reversal"}
    assert main(["verify", str(cell), str(table), str(out), "--quiet"]) == 0
