"""Plunges and ramps of milling cutters: their force and outcome are unknown, in plan and verification."""

from __future__ import annotations

import csv
import json
import shutil
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from stock_jobs import PROCESS, write_stock_cell

from machopt.cell.cell_reader import load_cell
from machopt.cell.tool_selection import split_into_tool_segments
from machopt.cli import main
from machopt.data_types.stock import StockEngagement
from machopt.data_types.tool_segments import ToolSegment
from machopt.data_types.toolpath import Toolpath
from machopt.errors import ConfigurationKeyError
from machopt.process.binding.job_binding import attach_forces, compute_loads
from machopt.process.binding.operation_matching import attach_process
from machopt.process.stock.end_cutting import find_end_cuts
from machopt.toolpath.toolpath_reader import read_toolpath
from machopt.verification.motion.process.end_contact import find_descents
from machopt.verification.motion.process.stock_contact import check_stock_contact

LEVEL = np.column_stack([np.arange(0.0, 21.0, 4.0), np.zeros(6), np.full(6, -5.0)])  # mm, a slot
PLUNGE = np.array([[0.0, 0.0, 3.0], [0.0, 0.0, 1.0], [0.0, 0.0, -5.0]])
RAMP = np.column_stack([np.linspace(-30.0, 0.0, 8), np.zeros(8), np.linspace(0.0, -5.0, 8)])  # 9.5°
TILT = np.array([0.0, np.sin(0.1), np.cos(0.1)])


def write_job(
    folder: Path, points: np.ndarray, axes: np.ndarray | None = None, process: str = PROCESS, corner: float = 0.0
) -> tuple[Path, Path]:
    """Write a cell with a block of stock, and a path of cuts (N, 3) mm with their axes."""
    cell = write_stock_cell(folder / "cell", process)
    yaml = (cell / "cell.yaml").read_text()
    (cell / "cell.yaml").write_text(yaml.replace("diameter_mm: 17", f"diameter_mm: 17, corner_radius_mm: {corner}"))
    axes = np.tile([0.0, 0.0, 1.0], (len(points), 1)) if axes is None else axes
    lines = ["x_mm,y_mm,z_mm,i,j,k,move,feed_mm_min,operation"]
    above = [(points[0] + 60 * axes[0], axes[0], "rapid", ""), (points[0] + 8 * axes[0], axes[0], "rapid", "")]
    for p, a, move, feed in (*above, *((p, a, "cut", 600) for p, a in zip(points, axes, strict=True))):
        lines.append(",".join(f"{v:.9g}" for v in (*p, *a)) + f",{move},{feed},pocket")
    (folder / "path.csv").write_text("\n".join(lines) + "\n")
    return cell, folder / "path.csv"


def attach(cell_folder: Path, file: Path) -> tuple[ToolSegment, ...]:
    cell = load_cell(cell_folder)
    return attach_forces(split_into_tool_segments(cell, attach_process(cell.process, read_toolpath(file))))


def find_unknown(segments: tuple[ToolSegment, ...]) -> list[int]:
    """Return the cuts without a force, numbered from the first cut."""
    segment = segments[0]
    loads = compute_loads(segment.cell, segment.toolpath, segment.toolpath.feed)
    assert loads is not None
    return (np.flatnonzero(loads.is_unknown) - 2).tolist()


def lower(points: np.ndarray) -> np.ndarray:
    """Return the points, then the same points 4 mm lower in reverse order."""
    return np.concatenate([points, points[::-1] - [0.0, 0.0, 4.0]])


JOBS = {
    "plunge": (np.concatenate([PLUNGE, LEVEL[1:]]), [2]),
    "ramp": (np.concatenate([RAMP, LEVEL[1:]]), list(range(1, 8))),
    "ramp of 1° in short moves": (
        np.column_stack([np.arange(-40.0, 30.0, 0.25), np.zeros(280), -0.00436 * np.arange(280)]),
        list(range(1, 280)),
    ),
    "second layer": (lower(np.concatenate([PLUNGE, LEVEL[1:]])), [2, 8]),
    "approach beside the block": (
        np.array([[-75.0, 0.0, 3.0], [-75.0, 0.0, -5.0], [-60.0, 0.0, -5.0], [0, 0, -5.0]]),
        [],
    ),
    "ramp above the block": (
        np.concatenate([RAMP + np.array([0, 0, 5.0]), [[-75.0, 0, 3.0], [-75.0, 0, -5.0], [0, 0, -5.0]]]),
        [],
    ),
    "heights rounded to 1 µm": (
        np.column_stack([np.arange(-75.0, 0.0, 2.5), np.zeros(30), -5 + 0.001 * (np.arange(30) % 2)]),
        [],
    ),
    "upwards": (np.array([[-75.0, 0.0, -6.0], [-40.0, 0.0, -5.0], [0.0, 0.0, -4.0]]), []),
}


@pytest.mark.parametrize("name", list(JOBS))
@pytest.mark.parametrize("turns", [False, True])
def test_moves_that_remove_material_with_their_end_have_no_force(tmp_path: Path, name: str, turns: bool) -> None:
    points, wanted = JOBS[name]
    axes = None
    if turns:  # the last move ends outside the material and rotates the axis there
        points = np.vstack([points, points[-1] + [0, 0, 40.0], points[-1] + [0, 0, 41.0]])
        axes = np.tile([0.0, 0.0, 1.0], (len(points), 1))
        axes[-1] = TILT
    segments = attach(*write_job(tmp_path, points, axes))
    assert find_unknown(segments) == wanted
    assert all(check.passed for check in check_stock_contact(segments))


@pytest.mark.parametrize(("corner", "wanted"), [(0.0, [2]), (2.0, [2]), (8.5, [2])])
def test_every_cutter_shape_plunges_without_a_force(tmp_path: Path, corner: float, wanted: list[int]) -> None:
    segments = attach(*write_job(tmp_path, np.concatenate([PLUNGE, LEVEL[1:]]), corner=corner))
    assert find_unknown(segments) == wanted
    assert all(check.passed for check in check_stock_contact(segments))


def test_given_force_applies_to_a_plunge(tmp_path: Path) -> None:
    given = (
        "operations:\n  default: {kind: force, force_N: {travel: -80, normal: 150, axial: 40}, spread_percent: 20}\n"
    )
    process = PROCESS[: PROCESS.index("operations:")] + given + "modes: {damping_percent: 3, source: assumed}\n"
    segments = attach(*write_job(tmp_path, np.concatenate([PLUNGE, LEVEL[1:]]), process=process))
    assert find_unknown(segments) == []
    loads = compute_loads(segments[0].cell, segments[0].toolpath, segments[0].toolpath.feed)
    assert loads is not None
    assert (loads.force[2:] == [-80.0, 150.0, 40.0]).all()


@pytest.mark.parametrize("name", ["plunge", "ramp"])
def test_wrong_plunge_forces_fail_against_exact_shapes(tmp_path: Path, name: str) -> None:
    points, wanted = JOBS[name]
    segment = attach(*write_job(tmp_path, points))[0]
    found = segment.toolpath.engagement
    assert found is not None

    def is_passed(changed: StockEngagement) -> list[bool]:
        wrong = replace(segment, toolpath=replace(segment.toolpath, engagement=changed))
        return [bool(check.passed) for check in check_stock_contact((wrong,))]

    assert is_passed(found) == [True, True]
    assert is_passed(replace(found, is_end_cut=np.zeros_like(found.is_end_cut))) == [True, False]
    for row in (wanted[-1] + 2 + 1, 2):  # the level move after it, and the approach outside the material
        more = found.is_end_cut.copy()
        more[row] = True
        assert is_passed(replace(found, is_end_cut=more)) == [True, False]


@pytest.fixture(scope="module")
def planned(tmp_path_factory: pytest.TempPathFactory) -> tuple[Path, Path, Path]:
    """Plan a slot after a plunge, with a ramp at its end; return cell, toolpath and output."""
    folder = tmp_path_factory.mktemp("plunge")
    cell, file = write_job(folder, np.concatenate([PLUNGE, LEVEL[1:], [[25.0, 0.0, -6.0]]]))
    assert main(["optimize", str(cell), str(file), "-o", str(folder / "out"), "--set", "rotation_step_deg=20"]) == 0
    return cell, file, folder / "out"


def read_points(folder: Path) -> list[dict[str, str]]:
    with (folder / "points.csv").open() as table:
        return list(csv.DictReader(table))


NUMBERS = ("f_travel_N", "f_normal_N", "f_axial_N", "m_axial_Nm", "f_peak_N", "error_normal_mm", "p_in")
SHOWN_FOR_PLUNGES = (*NUMBERS, "p_in_deflection_only", "feed_max_mm_min", "cause", "deflection_mm")


def test_plunge_is_planned_with_an_unknown_outcome_and_verified(planned: tuple[Path, Path, Path]) -> None:
    cell, file, out = planned
    rows = read_points(out)
    for k in (4, 10):
        assert rows[k]["outcome"] == "unknown"
        assert [rows[k][name] for name in SHOWN_FOR_PLUNGES] == [""] * len(SHOWN_FOR_PLUNGES)
    for row in rows[5:10]:
        assert row["outcome"] in ("pass", "marginal", "fail")
        assert all(row[name] for name in NUMBERS)
    assert [rows[k]["outcome"] for k in (2, 3)] == ["pass", "pass"]  # no contact and no force
    assert [float(rows[k]["f_travel_N"]) for k in (2, 3)] == [0.0, 0.0]
    process = json.loads((out / "result.json").read_text())["process"]
    assert process["in_tolerance"]["after"]["unknown"] == 2
    assert main(["verify", str(cell), str(file), str(out)]) == 0


@pytest.mark.parametrize(("row", "value"), [(4, "0.0"), (6, "")])
def test_stated_force_of_a_plunge_fails_the_verification(
    planned: tuple[Path, Path, Path], tmp_path: Path, row: int, value: str, capsys: pytest.CaptureFixture[str]
) -> None:
    cell, file, out = planned
    shutil.copytree(out, tmp_path / "out")
    rows = read_points(out)
    for name in NUMBERS[:4]:
        rows[row][name] = value
    with (tmp_path / "out" / "points.csv").open("w") as table:
        writer = csv.DictWriter(table, rows[0].keys())
        writer.writeheader()
        writer.writerows(rows)
    capsys.readouterr()
    assert main(["verify", str(cell), str(file), str(tmp_path / "out")]) == 4
    failed = [line for line in capsys.readouterr().out.splitlines() if line.startswith("FAIL")]
    assert any("forces of plunges and ramps" in line for line in failed)


def test_job_of_plunges_alone_is_refused(tmp_path: Path) -> None:
    with pytest.raises(ConfigurationKeyError) as caught:
        attach(*write_job(tmp_path, np.concatenate([PLUNGE, PLUNGE[::-1]])))
    assert caught.value.key == "engagement"


def read_cuts(folder: Path, count: int) -> Toolpath:
    """Return a toolpath of cuts."""
    rows = [f"{n},0,0,0,0,1,cut,600,pocket" for n in range(count)]
    (folder / "cuts.csv").write_text("\n".join(["x_mm,y_mm,z_mm,i,j,k,move,feed_mm_min,operation", *rows]) + "\n")
    return read_toolpath(folder / "cuts.csv")


@pytest.mark.parametrize("axis", [[0.0, 0.0, 1.0], [0.3, -0.2, 0.9]])
@pytest.mark.parametrize("down", [0.005, 2.0])
def test_descents_at_a_threshold_agree_in_plan_and_verification(tmp_path: Path, axis: list[float], down: float) -> None:
    """Steps of 5 µm, or as far down as sideways, for any rounding of their coordinates."""
    a = np.array(axis) / np.linalg.norm(axis)
    u = np.cross(a, [0.6, 0.8, 0.0])
    u /= np.linalg.norm(u)
    sign = np.where(np.arange(60) % 2, 1.0, -1.0)
    travel = np.linspace(0.1, 2.0, 60) if down < 1.0 else np.full(60, 2.0)
    position = 1e-3 * np.cumsum(travel[:, None] * u + (down * sign)[:, None] * a, axis=0)
    flags, none, empty = np.ones(60, bool), np.zeros(60, bool), np.zeros(0)
    found = StockEngagement(
        point=np.zeros(0, np.int64),
        low=empty,
        high=empty,
        start=empty,
        end=empty,
        is_computed=flags,
        volume=np.full(60, 1e-9),
        is_end_cut=none,
        edge_sigma=0.0,
    )
    path = replace(read_cuts(tmp_path, 60), position=position, axis=np.tile(a, (60, 1)), engagement=found)
    planned = find_end_cuts(position, path.axis, path.cutting, found, np.ones(60), 0.0085)
    may, steep = find_descents(path).may, find_descents(path).is_steep
    assert (planned == may).all()
    assert (planned[2::2] == (down > 0.005)).all()
    assert (steep[2::2] == (down > 0.005)).all()


@pytest.mark.parametrize("depth", [0.3, 0.45, 0.8, 1.5])
def test_shallow_ball_passes_agree_with_exact_shapes(tmp_path: Path, depth: float) -> None:
    points = np.column_stack([np.arange(-75.0, -20.0, 9.0), np.zeros(7), np.full(7, -depth)])
    segments = attach(*write_job(tmp_path, points, corner=8.5))
    check = check_stock_contact(segments)[0]
    assert check.value is not None
    assert check.value < 0.5


def test_tilted_ball_cutter_agrees_with_exact_shapes(tmp_path: Path) -> None:
    """The cutter is tilted forwards and its lower end leaves the material: it does not cut behind the tip."""
    n = 10
    points = np.column_stack([np.linspace(-75.0, 15.0, n), np.zeros(n), np.full(n, -3.0)])
    axes = np.column_stack([np.linspace(-0.3, 0.3, n), np.linspace(0.0, 0.2, n), np.ones(n)])
    axes /= np.linalg.norm(axes, axis=1)[:, None]
    assert all(check.passed for check in check_stock_contact(attach(*write_job(tmp_path, points, axes, corner=8.5))))
