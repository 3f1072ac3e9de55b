"""Re-entries in closed contours: positions, effects, refusals."""

from __future__ import annotations

import csv
import itertools
import json
import math
import shutil
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
import yaml
from output_damage.damage_case import CELLS, HEADER, Job
from output_damage.reentry_damage import STIFFER, write_ring

from machopt.commands.optimize.request import OptimizeRequest
from machopt.commands.optimize.run import OptimizeResult, run_optimize
from machopt.data_types.documents.optimize_document import OptimizeDocument
from machopt.data_types.plan_options import PlanOptions, SteeringRule
from machopt.data_types.steering_rules import resolve_steering
from machopt.data_types.toolpath import MoveKind, Toolpath
from machopt.errors import CellError
from machopt.numerics.rigid_transforms import wrap_angle
from machopt.planning.motion.retract_moves import RetractMoves
from machopt.planning.reentry import reentry_planning
from machopt.planning.reentry.closed_contours import find_reentry_points
from machopt.planning.stations.fixed_rotations import find_fixed_rotations
from machopt.planning.stations.planning_path import build_planning_path
from machopt.toolpath.toolpath_reader import read_toolpath

CELL = CELLS / "kr500_milling"


def _read(folder: Path, rows: list[str]) -> Toolpath:
    file = folder / "path.csv"
    file.write_text("\n".join([HEADER, *rows]) + "\n", encoding="utf-8")
    return read_toolpath(file)


def _cuts(places: list[tuple[float, float]]) -> list[str]:
    (x, y), (u, v) = places[0], places[-1]
    inner = [f"{a:.5f},{b:.5f},-1,0,0,1,cut,1500" for a, b in places]
    return [f"{x},{y},50,0,0,1,rapid,", *inner, f"{u},{v},50,0,0,1,retract,1000"]


def _arc(turn_deg: float, points: int = 40, radius: float = 50.0) -> list[tuple[float, float]]:
    angles = np.radians(np.linspace(0.0, turn_deg, points))
    return [(radius * math.cos(a), radius * math.sin(a)) for a in angles]


@pytest.mark.parametrize(
    ("places", "closed"),
    [
        (_arc(360.0), True),
        (_arc(345.0), True),  # closed around the centre, although it ends before its start
        (_arc(300.0), False),
        ([(0, 0), (40, 0), (40, 30), (0, 30), (0, 0)], True),
        ([(0, 0), (40, 0), (40, 30), (0, 30), (0, 1.5)], True),
        ([(0, 0), (40, 0), (40, 30), (0, 30), (0, 5)], False),
        ([(4.0 * n, 0.0) for n in range(20)], False),
    ],
)
def test_only_closed_contours_have_reentry_places(
    places: list[tuple[float, float]], closed: bool, tmp_path: Path
) -> None:
    toolpath = _read(tmp_path, _cuts(places))
    points = find_reentry_points(build_planning_path(toolpath), toolpath)
    assert bool(len(points)) is closed
    assert (toolpath.move[points] == MoveKind.CUT).all()
    assert (toolpath.move[points + 1] == MoveKind.CUT).all()


def test_no_reentry_at_a_change_of_operation(tmp_path: Path) -> None:
    rows = _cuts(_arc(360.0))
    labels = ["a" if n < 20 else "b" for n in range(len(rows))]
    file = tmp_path / "path.csv"
    file.write_text("\n".join([f"{HEADER},operation", *map(",".join, zip(rows, labels, strict=True))]) + "\n")
    toolpath = read_toolpath(file)
    points = find_reentry_points(build_planning_path(toolpath), toolpath)
    assert {18, 20} <= set(points.tolist())
    assert 19 not in points


def test_both_copies_of_a_point_keep_a_fixed_rotation(tmp_path: Path) -> None:
    """Also between two fixed points: phi in both runs gives the requested rotation."""
    toolpath = replace(_read(tmp_path, _cuts(_arc(360.0))), reentries=(12,))
    path = build_planning_path(toolpath)
    rule = SteeringRule(points=(10, 14), gamma=0.3)
    options = resolve_steering(PlanOptions(steer=(rule,)), toolpath)
    fixed = find_fixed_rotations(path, options)
    rows = np.flatnonzero((path.index >= 10.0) & (path.index <= 14.0) & (path.is_point | path.is_reentry))
    gamma = [fixed[row] + path.offset[row] for row in rows.tolist()]
    assert len(rows) == 6
    np.testing.assert_allclose(np.cos(np.array(gamma) - 0.3), 1.0, atol=1e-12)
    between = np.flatnonzero((path.index > 10.0) & (path.index < 14.0) & ~path.is_point & ~path.is_reentry)
    for row in between.tolist():
        left = max(n for n in rows.tolist() if n < row)
        assert abs(wrap_angle(np.array(fixed[row] - fixed[left]))) < np.radians(10.0)


@pytest.mark.parametrize("points", [(12,), (9, 20)])
def test_reentry_does_not_change_the_cost_of_motion(points: tuple[int, ...], tmp_path: Path) -> None:
    toolpath = _read(tmp_path, _cuts(_arc(360.0)))
    plain, divided = build_planning_path(toolpath), build_planning_path(replace(toolpath, reentries=points))
    assert np.allclose(divided.motion_share[~divided.is_reentry], plain.motion_share)


def test_holes_have_no_reentry_places(tmp_path: Path) -> None:
    rows = []
    for x, y in _arc(360.0, 12):
        rows += [f"{x:.4f},{y:.4f},5,0,0,1,rapid,", f"{x:.4f},{y:.4f},-5,0,0,1,cut,200"]
        rows += [f"{x:.4f},{y:.4f},5,0,0,1,retract,1000"]
    toolpath = _read(tmp_path, rows)
    assert not len(find_reentry_points(build_planning_path(toolpath), toolpath))


def test_reentry_point_occurs_twice(tmp_path: Path) -> None:
    toolpath = _read(tmp_path, _cuts(_arc(360.0)))
    plain, divided = build_planning_path(toolpath), build_planning_path(replace(toolpath, reentries=(11, 20)))
    assert len(divided.index) == len(plain.index) + 2
    assert len(divided.runs) == len(plain.runs) + 2
    again = np.flatnonzero(divided.is_reentry)
    assert divided.index[again].tolist() == [11.0, 20.0]
    assert np.array_equal(divided.position[again], divided.position[again - 1])
    assert np.allclose(divided.travel[again], divided.travel[again - 1])
    # the counted points and their weights equal those of the path without re-entries
    retained = ~divided.is_reentry
    assert np.array_equal(divided.index[retained], plain.index)
    assert np.allclose(divided.weight[retained], plain.weight, atol=1e-12)
    assert divided.weight[again].tolist() == [0.0, 0.0]
    assert divided.time[-1] == pytest.approx(plain.time[-1])
    assert np.flatnonzero(divided.is_point).size == len(toolpath)


def _plan(folder: Path, *overrides: str, step_deg: int = 15) -> OptimizeResult:
    toolpath = folder / "ring.csv"
    write_ring(toolpath)
    if not (folder / "cell").exists():
        shutil.copytree(CELL, folder / "cell")
    options = (f"rotation_step_deg={step_deg}", *overrides)
    return run_optimize(
        OptimizeRequest(
            cell=folder / "cell",
            toolpath=toolpath,
            out=folder / f"out{len(list(folder.iterdir()))}",
            overrides=options,
            posts=("rapid", "ros_json"),
        )
    )


@pytest.mark.slow
def test_ring_has_a_lower_cost_with_one_reentry(tmp_path: Path, damage_job: Callable[[str], Job]) -> None:
    without, lifted = _plan(tmp_path, STIFFER), damage_job("re-entered").out
    assert without.exit_code == 0
    assert without.result.reentry is None
    result = OptimizeDocument.model_validate(json.loads((lifted / "result.json").read_text(encoding="utf-8")))
    assert result.reentry is not None
    (entry,) = result.reentry
    assert len(entry.points) == 1
    before, after = without.result.objective.chosen.total, result.objective.chosen.total
    assert before is not None
    assert after is not None
    assert entry.objective_without == pytest.approx(before, rel=0.005)  # of the plan before its corners are rounded
    assert entry.objective == pytest.approx(after, rel=1e-12)
    assert after < 0.995 * before
    assert entry.mean_percent is not None
    assert entry.mean_percent < -3.0
    with (lifted / "trajectory.csv").open(encoding="utf-8") as file:
        rows = list(csv.DictReader(file))
    moves = [row["move"] for row in rows if row["point"] and float(row["point"]) == entry.points[0]]
    order = [move for n, move in enumerate(moves) if n == 0 or move != moves[n - 1]]
    start = order.index("retract")
    assert order[start : start + 3] == ["retract", "link", "approach"]
    link = [n for n, row in enumerate(rows) if row["move"] == "link"]
    joints = np.array([[float(rows[n][f"q{j}_deg"]) for j in range(1, 7)] for n in (link[0], link[-1])])
    assert np.abs(np.diff(joints, axis=0)).max() > 20.0  # another configuration, so the lift is needed
    cut = [float(row["point"]) for row in rows if row["move"] == "cut"]
    assert max(b - a for a, b in itertools.pairwise(cut)) < 0.5  # every part of the cut is executed


def _try_few_places(monkeypatch: pytest.MonkeyPatch) -> None:
    """Test three positions of a contour instead of ten, where the best position is not needed."""
    monkeypatch.setattr(reentry_planning, "COARSE", 3)
    monkeypatch.setattr(reentry_planning, "HALVINGS", 0)


@pytest.mark.slow
def test_each_tool_of_a_job_has_its_own_reentries(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """The points in result.json and trajectory.csv are numbered over the whole job."""
    _try_few_places(monkeypatch)
    shutil.copytree(CELL, tmp_path / "cell")
    file = tmp_path / "cell" / "cell.yaml"
    cell = yaml.safe_load(file.read_text(encoding="utf-8"))
    tool = cell.pop("tool")
    file.write_text(yaml.safe_dump(cell | {"tools": {"1": tool, "2": tool}}), encoding="utf-8")
    write_ring(tmp_path / "ring.csv")
    header, *ring = (tmp_path / "ring.csv").read_text(encoding="utf-8").split()
    rows = [f"{row},{number}" for number in (1, 2) for row in ring]
    toolpath = tmp_path / "rings.csv"
    toolpath.write_text("\n".join([f"{header},tool", *rows]) + "\n", encoding="utf-8")
    request = OptimizeRequest(
        cell=tmp_path / "cell",
        toolpath=toolpath,
        out=tmp_path / "out",
        overrides=("rotation_step_deg=30", "max_reentries=1", STIFFER),  # the lift has a way point
        posts=("krl", "ros_json"),
    )
    outcome = run_optimize(request)
    assert outcome.exit_code == 0
    assert outcome.result.reentry is not None
    (first,), (second,) = (entry.points for entry in outcome.result.reentry)
    assert 0 < first < len(ring) < second < 2 * len(ring)


@pytest.mark.parametrize(
    "other",
    ["compensate=true", "method=jiao2022", "allow_gaps=true", "tilt_deg={lead: [-3, 3]}"],
)
def test_unsupported_methods_refuse_reentry(other: str, tmp_path: Path) -> None:
    with pytest.raises(CellError) as found:
        _plan(tmp_path, "max_reentries=1", "force_N={normal: 100}", other)
    assert found.value.where in ("max_reentries", "tilt_deg")


@pytest.mark.slow
def test_reentry_without_room_is_not_made(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    _try_few_places(monkeypatch)
    monkeypatch.setattr(RetractMoves, "gap", lambda self, row: float("nan"))
    outcome = _plan(tmp_path, STIFFER, "max_reentries=1", step_deg=30)
    assert outcome.exit_code == 0
    assert outcome.result.reentry is not None
    assert outcome.result.reentry[0].points == ()
    assert outcome.result.reentry[0].reason
