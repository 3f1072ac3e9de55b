"""Dwells and stops: the motion rests at the exact point, and the verification checks it."""

from __future__ import annotations

import csv
import json
from dataclasses import replace
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest
from external_axis_cells import external_folder
from test_retiming import make

from machopt.cli import main
from machopt.data_types.toolpath import MoveKind, Toolpath, ToolpathEvent, ToolpathOperation
from machopt.errors import InputError
from machopt.planning.motion.motion_segment import BEFORE_ALL, MotionSegment, count_rest_samples
from machopt.planning.retiming.run_retiming import RunTrajectory, retime_run
from machopt.program_export.program_moves import _place_events
from machopt.verification.motion.checks.dwells_and_stops import check_dwells_and_stops

H = 0.012


def toolpath(*events: ToolpathEvent, n: int = 4) -> Toolpath:
    x = np.linspace(0.0, 0.03, n)
    return Toolpath(
        position=np.column_stack([x, 0.0 * x, 0.0 * x]),
        axis=np.tile([0.0, 0.0, 1.0], (n, 1)),
        move=np.array([MoveKind.RAPID] + [MoveKind.CUT] * (n - 1), np.int8),
        feed=np.array([np.nan] + [0.02] * (n - 1)),
        operation=np.zeros(n, np.int32),
        operations=(ToolpathOperation("cut", "trajectory"),),
        reference=np.full((n, 3), np.nan),
        tolerance=np.full(n, np.nan),
        line=np.arange(n, dtype=np.int32) + 1,
        source="a.nc",
        format="gcode",
        sha256="",
        events=events,
    )


def test_samples_of_every_dwell() -> None:
    t = toolpath(
        ToolpathEvent(0, "dwell", "G4 a", 0.1),
        ToolpathEvent(2, "dwell", "G4 b", 0.024),
        ToolpathEvent(2, "dwell", "G4 c", 0.001),
        ToolpathEvent(3, "stop", "M0"),
        ToolpathEvent(3, "spindle", "M5", 0.0),
        ToolpathEvent(4, "dwell", "G4 S3"),
    )
    assert count_rest_samples(t, H) == {BEFORE_ALL: 9, 1: 3, 2: 0, 3: 0}
    with pytest.raises(InputError, match="longest dwell is 600 s"):
        count_rest_samples(toolpath(ToolpathEvent(1, "dwell", "G4 P700000", 700.0)), H)


def test_run_stops_at_its_point_and_continues() -> None:
    run = make([[0.0, 0, 0], [0.006, 0, 0], [0.013, 0.001, 0], [0.02, 0, 0]], feed=0.05)
    through, done = retime_run(run), retime_run(replace(run, rests=(2,)))
    assert isinstance(through, RunTrajectory)
    assert isinstance(done, RunTrajectory)
    (n,) = done.rests
    assert done.point[n] == 2.0
    assert done.speed[n] == pytest.approx(0.0, abs=1e-6)
    assert through.speed[np.argmin(np.abs(through.point - 2.0))] > 0.01
    assert len(done.q) > len(through.q)
    assert {d.where for d in done.dips} == {"start", "path", "rest", "stop"}
    assert np.abs(np.diff(done.q[n - 1 : n + 2], axis=0)).max() < 1e-5


def test_joint_segment_may_dwell() -> None:
    rows = np.arange(3.0)
    leg = MotionSegment(
        name="run",
        q=np.tile(rows[:, None], 6),
        index=rows,
        move=np.zeros(3, np.int8),
        operation=np.zeros(3, np.int32),
        gamma=rows,
        waypoints=np.zeros((1, 6)),
        waypoint_index=rows[-1:],
        waypoint_feed=rows[-1:],
        external=np.zeros((3, 0)),
        waypoint_external=np.zeros((1, 0)),
    )
    assert leg.standing(1, 2).index.tolist() == [0, 1, 1, 1, 2]
    assert leg.standing(-1, 1).q[:, 5].tolist() == [0, 1, 2, 2]


def test_dwell_is_at_the_point_and_later_events_after_the_lift() -> None:
    """After point 3 a retract is added that is not in the file: M5 alone is placed after it, the dwell is not."""
    index = np.array([np.nan, 0.0, 1.0, 2.0, 3.0, 3.0, np.nan])
    drawn = np.array([False, False, False, False, False, True, False])
    off, dwell = ToolpathEvent(4, "spindle", "M5", 0.0), ToolpathEvent(4, "dwell", "G4", 0.5)

    def at(*events: ToolpathEvent) -> list[int]:
        return [e.index for e in _place_events(toolpath(*events), index, drawn)]

    assert at(off) == [6]
    assert at(dwell, off) == [5, 6]
    assert at(off, dwell) == [5, 5]  # in the order of the file
    assert at(ToolpathEvent(2, "dwell", "G4", 0.5)) == [3]


def check_dwell(
    point: np.ndarray[Any, Any], x: np.ndarray[Any, Any], *events: ToolpathEvent
) -> tuple[bool | None, str]:
    """Return the check result for a machine whose axis 1 (rad) moves the tool (m) along x."""
    q = np.zeros((len(x), 6))
    q[:, 0] = x
    tcp = np.tile(np.eye(4), (len(x), 1, 1))
    tcp[:, 0, 3] = x
    t = toolpath(*events)
    stub = SimpleNamespace(q=q, external=np.empty((len(x), 0)), joints=q, point=point, sample_time=H)
    cell = SimpleNamespace(limits=SimpleNamespace(jerk=np.full(6, 10.0)))
    ride = SimpleNamespace(tcp=tcp, path_limit=2e-5)
    points = SimpleNamespace(point=np.arange(4), ok=np.ones(4, bool))
    place = (np.arange(4.0), t.position)
    (check,) = check_dwells_and_stops(stub, t, points, ride, place, cell)  # type: ignore[arg-type]
    return check.passed, check.where


def build_dwell_motion(stand: int) -> np.ndarray[Any, Any]:
    """Return the position of a tool that moves 30 mm and rests at 10 mm for ``stand`` samples."""
    ramp = np.array([1e-7, 1e-6, 1e-5, 5e-5, 1e-4])
    up = np.concatenate([ramp, np.full(60, 1.6e-4), ramp[::-1]])
    up *= 0.01 / up.sum()
    on = np.concatenate([ramp, np.full(120, 1.6e-4), ramp[::-1]])
    on *= 0.02 / on.sum()
    return np.concatenate([[0.0], np.cumsum(np.concatenate([up, np.zeros(stand), on]))])


def test_verification_checks_place_and_duration() -> None:
    dwell, stop = ToolpathEvent(2, "dwell", "G4", 0.6), ToolpathEvent(2, "stop", "M0")
    x = build_dwell_motion(50)
    assert check_dwell(x / 0.01, x, dwell) == (True, "none")
    assert check_dwell(x / 0.01, x, stop) == (True, "none")
    short = build_dwell_motion(40)
    passed, why = check_dwell(short / 0.01, short, dwell)
    assert not passed
    assert "at point 1 the file dwells 0.6 s, and the motion rests there 0.480 s" in why
    passed, why = check_dwell(x / 0.01, x, ToolpathEvent(3, "dwell", "G4", 0.6))
    assert not passed
    assert "at point 2 the file dwells or stops, and the motion is not at rest there" in why
    through = np.concatenate([[0.0], np.cumsum(np.full(200, 1.5e-4))])
    assert not check_dwell(through / 0.01, through, stop)[0]
    passed, why = check_dwell(x / 0.01, x, ToolpathEvent(0, "dwell", "G4", 0.6))
    assert not passed
    assert "before the first point" in why


def test_no_check_without_dwells_and_stops() -> None:
    t = toolpath(ToolpathEvent(2, "spindle", "M3", 100.0))
    none: Any = None
    assert check_dwells_and_stops(none, t, none, none, none, none) == []


def test_dwell_between_moves_without_displacement(tmp_path: Path) -> None:
    """G0, G1 to the same point, a dwell, another such move, and a real move: the dwell is listed at its own point."""
    folder, job = external_folder(tmp_path, rail=True), tmp_path / "job.nc"
    job.write_text("G21 G90 G17\nG0 X60 Y0 Z0\nG1 X60 F1200\nG4 P0.5\nG1 X60\nG1 X90\nG0 Z20\nM30\n")
    arguments = ["optimize", str(folder), str(job), "-o", str(tmp_path / "out"), "--quiet", "--post", "krl"]
    assert main([*arguments, "--set", "external.e1.mode=locked"]) == 0
    program = (tmp_path / "out" / "job_nc.src").read_text()
    assert program.index("WAIT SEC 0.5") < program.index("LIN {X 90.0000")
    with (tmp_path / "out" / "points.csv").open() as file:
        assert [float(row["dwell_s"]) for row in csv.DictReader(file)] == [0.0, 0.5, 0.0, 0.0, 0.0]
    assert json.loads((tmp_path / "out" / "result.json").read_text())["dwell_s"] == 0.5
