"""Engagement from the stock in whole jobs: forces, outcomes, verification, and refused input."""

from __future__ import annotations

import csv
import json
import sys
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from stock_jobs import (
    DEPTH,
    HALF,
    PROCESS,
    RADIUS,
    build_block,
    build_pocket_path,
    build_pocketed_block,
    write_stock_cell,
    write_toolpath,
)

from machopt.cell.cell_reader import load_cell
from machopt.cell.tool_selection import split_into_tool_segments
from machopt.cli import main
from machopt.data_types.stock import StockEngagement
from machopt.data_types.tool_segments import ToolSegment
from machopt.errors import InputError
from machopt.process.binding.cutting_tools import build_milling_cutter
from machopt.process.binding.job_binding import attach_forces, compute_loads
from machopt.process.binding.operation_matching import attach_process
from machopt.process.milling.mean_force import compute_mean_load
from machopt.process.milling.milling_cut import MillingCut
from machopt.toolpath.toolpath_reader import read_toolpath
from machopt.verification.motion.process.stock_contact import check_stock_contact

sys.path.insert(0, str(Path(__file__).resolve().parents[1] / "benchmarks"))
from tilted_wall_job import TiltedWall

COARSE = ("--set", "rotation_step_deg=20")  # the engagement is independent of the rotation


def write_job(folder: Path, points: np.ndarray, process: str = PROCESS) -> tuple[Path, Path]:
    write_stock_cell(folder / "cell", process)
    write_toolpath(folder / "pocket.csv", points)
    return folder / "cell", folder / "pocket.csv"


def attach(cell_folder: Path, file: Path) -> tuple[ToolSegment, ...]:
    cell = load_cell(cell_folder)
    toolpath = attach_process(cell.process, read_toolpath(file))
    return attach_forces(split_into_tool_segments(cell, toolpath))


def build_pass(ae: float, ap: float) -> np.ndarray:
    """Return a pass along the front of the block, with the material on its left."""
    x = np.arange(-0.09, 0.09, 0.002)
    return np.column_stack([x, np.full_like(x, -0.04 - RADIUS + ae), np.full_like(x, -ap)])


@pytest.mark.parametrize("spindle", ["cw", "ccw"])
def test_force_of_a_straight_pass_equals_that_of_given_depths(tmp_path: Path, spindle: str) -> None:
    process = PROCESS.replace("spindle_rpm: 12000", f"spindle_rpm: 12000, spindle: {spindle}")
    segment = attach(*write_job(tmp_path, build_pass(3e-3, 5e-3), process))[0]
    loads = compute_loads(segment.cell, segment.toolpath, segment.toolpath.feed)
    assert loads is not None
    assert segment.cell.process is not None
    coefficients = segment.cell.process.materials["al7075"].milling
    assert coefficients is not None
    cutter = build_milling_cutter(segment.cell.tool.cutter)
    cut = MillingCut("up" if spindle == "cw" else "down", spindle)  # type: ignore[arg-type]
    wanted = compute_mean_load(coefficients, cutter, cut, 3e-3, 5e-3).compute_load(1500 / 12000 / 2 / 1e3)[0]
    inside = np.abs(segment.toolpath.position[:, 0]) < 0.04
    size = np.linalg.norm(wanted[:3])
    assert np.abs(loads.force[inside] - wanted[:3]).max() < 0.01 * size
    assert loads.moment[inside] == pytest.approx(wanted[3], rel=0.01)
    assert (loads.side[inside] == (1 if spindle == "cw" else -1)).all()
    air = np.abs(segment.toolpath.position[:, 0]) > 0.06 + RADIUS + 1e-3
    assert not loads.force[air].any()
    assert np.isnan(loads.ae[air]).all()
    assert any("remove nothing" in note for note in loads.notes)


@pytest.mark.parametrize(
    ("old", "new", "words"),
    [
        ("cell_mm: 0.5", "cell_mm: 0.0005", ["stock.cell_mm", "at most"]),
        ("cell_mm: 0.5", "cell_mm: 0.5, scale: 0.001", ["stock.cell_mm", "cells across the stock", "scale"]),
        ("stock.stl", "open.stl", ["stock.mesh", "not closed"]),
        ("stock.stl", "far.stl", ["stock.mesh", "no cut move meets the stock", "CAM frame"]),
        ("stock.stl", "none.stl", ["none.stl"]),
        ("engagement: stock", "engagement: stock, ae_mm: 3", ["ae_mm", "engagement: stock"]),
        ("stock: {mesh: meshes/stock.stl, cell_mm: 0.5}\n", "", ["engagement", "stock: {mesh: FILE"]),
        ("surface: floor", "surface: side", ["cut is missing"]),
    ],
)
def test_unusable_stock_is_refused_with_its_key(tmp_path: Path, old: str, new: str, words: list[str]) -> None:
    cell, file = write_job(tmp_path, build_pass(3e-3, 5e-3), PROCESS.replace(old, new))
    mesh = build_block()
    mesh.update_faces(np.arange(len(mesh.faces)) > 0)
    mesh.export(cell / "meshes" / "open.stl")
    mesh = build_block()
    mesh.apply_translation([0, 0, 0.5])
    mesh.export(cell / "meshes" / "far.stl")
    with pytest.raises(InputError) as caught:
        attach(cell, file)
    for word in words:
        assert word in str(caught.value)


def write_wall(folder: Path, **sizes: float) -> tuple[Path, Path, TiltedWall]:
    wall = TiltedWall(points=31, **sizes)  # type: ignore[arg-type]
    wall.write_cell(folder / "cell")
    wall.write_toolpath(folder / "wall.csv")
    return folder / "cell", folder / "wall.csv", wall


@pytest.mark.slow
@pytest.mark.parametrize("sizes", [{}, {"corner": 2e-3, "below": 4e-3}, {"corner": 8.5e-3, "below": 10e-3}])
def test_cutter_turning_along_a_wall_has_the_contact_of_its_allowance(tmp_path: Path, sizes: dict[str, float]) -> None:
    cell, file, wall = write_wall(tmp_path, **sizes)
    segments = attach(cell, file)
    segment = segments[0]
    loads = compute_loads(segment.cell, segment.toolpath, segment.toolpath.feed)
    assert loads is not None
    steady = np.flatnonzero(segment.toolpath.cutting)[5:-5]
    bend = (wall.foot - wall.height * np.tan(wall.lean)) / np.cos(wall.lean), wall.foot / np.cos(wall.lean)
    for radius in bend:  # radius of curvature of the wall perpendicular to the generator, at its top and foot
        d = radius + wall.radius
        cosine = (d**2 + wall.radius**2 - (radius + wall.allowance) ** 2) / (2 * d * wall.radius)
        assert np.abs(np.degrees(loads.entry_angle[steady]) - 180 + np.degrees(np.arccos(cosine))).max() < 2.5
    assert np.degrees(loads.exit_angle[steady]) == pytest.approx(180.0)
    assert (loads.side[steady] == -1).all()
    assert np.abs(loads.ap[steady] - wall.height / np.cos(wall.lean)).max() < 0.25e-3


@pytest.mark.slow
def test_wrong_arcs_of_a_turning_axis_fail_against_exact_shapes(tmp_path: Path) -> None:
    segments = attach(*write_wall(tmp_path)[:2])
    segment = segments[0]
    assert [check.passed for check in check_stock_contact(segments)] == [True, True]
    found = segment.toolpath.engagement
    assert found is not None
    for change in ({"start": found.start - 0.35}, {"high": 0.5 * (found.low + found.high)}):
        wrong = replace(segment, toolpath=replace(segment.toolpath, engagement=replace(found, **change)))
        assert [check.passed for check in check_stock_contact((wrong,))] == [False, True]


@pytest.mark.parametrize("place", [0, 0.5, 1])
@pytest.mark.parametrize("reverse", [False, True])
def test_arcs_off_by_10_degrees_or_a_fifth_fail_anywhere(tmp_path: Path, place: float, reverse: bool) -> None:
    path = build_pass(5e-3, 5e-3)
    segment = attach(*write_job(tmp_path, path[::-1] if reverse else path))[0]
    found = segment.toolpath.engagement
    assert found is not None
    points = np.unique(found.point)
    wide = points[2:-3]  # at the last points of a cut, a fifth of the width is a thin chip
    k = int(wide[round(place * (len(wide) - 1))])
    rows = found.point == k
    name = "start" if reverse else "end"
    angle = getattr(found, name)[rows]
    inner = np.pi - angle if reverse else angle

    def is_passed(changed: np.ndarray) -> bool:
        value = getattr(found, name).copy()
        value[rows] = np.pi - changed if reverse else changed
        only = replace(found, is_computed=np.arange(len(found.volume)) == k, **{name: value})
        wrong = replace(segment, toolpath=replace(segment.toolpath, engagement=only))
        return bool(check_stock_contact((wrong,))[0].passed)

    assert is_passed(inner)
    for change in (-10.0, 10.0):
        assert not is_passed(inner + np.radians(change))
    for factor in (0.8, 1.2):
        assert not is_passed(np.arccos(1.0 - factor * (1.0 - np.cos(inner))))


def list_arcs(contact: StockEngagement, point: int) -> tuple[np.ndarray, np.ndarray]:
    """Return (n,) rad the arcs of the slices of a point, and (n,) m their heights."""
    mine = contact.point == point
    return (contact.end - contact.start)[mine], (contact.high - contact.low)[mine]


def test_small_axis_rotation_changes_the_contact_slightly(tmp_path: Path) -> None:
    cell, file = write_job(tmp_path, build_pass(3e-3, 5e-3))
    level = attach(cell, file)[0].toolpath.engagement
    text = file.read_text().splitlines()
    file.write_text("\n".join([*text[:-1], text[-1].replace(",0,0,1,cut", ",0,0.1,0.995,cut")]) + "\n")
    turned = attach(cell, file)[0].toolpath.engagement
    assert level is not None
    assert turned is not None
    inside = slice(20, 60)
    assert turned.volume[inside] == pytest.approx(level.volume[inside], rel=3e-3)
    for point in range(20, 60):  # the rotated one may have several slices
        for name, choose in (("low", np.min), ("high", np.max), ("start", np.min), ("end", np.max)):
            a, b = (choose(getattr(e, name)[e.point == point]) for e in (level, turned))
            assert abs(a - b) < (0.05e-3 if name in ("low", "high") else 0.03)
        a, b = (np.average(arc, weights=height) for arc, height in (list_arcs(e, point) for e in (level, turned)))
        assert abs(a - b) < 0.03


def test_too_many_cells_with_a_turning_axis_name_the_cell_size(tmp_path: Path) -> None:
    cell, file, _ = write_wall(tmp_path)
    process = cell / "process.yaml"
    process.write_text(process.read_text().replace("cell_mm: 0.25", "cell_mm: 0.001"))
    with pytest.raises(InputError, match="cell_mm of") as caught:
        attach(cell, file)
    assert "stock.cell_mm" in str(caught.value)


@pytest.mark.slow
def test_tilted_finish_of_a_curved_wall_is_planned_and_verified(tmp_path: Path) -> None:
    cell, file, wall = write_wall(tmp_path)
    assert main(["optimize", str(cell), str(file), "-o", str(tmp_path / "out"), *COARSE]) == 0
    assert main(["verify", str(cell), str(file), str(tmp_path / "out")]) == 0
    stock = json.loads((tmp_path / "out" / "result.json").read_text())["process"]["stock"]
    assert stock["removed_mm3"] > 1e9 * wall.find_removed_volume()
    assert stock["finished"]["gouge_depth_mm"] == 0
    assert stock["finished"]["left_depth_mm"] == pytest.approx(1e3 * wall.allowance, abs=0.02)  # next to the sector


@pytest.fixture(scope="module")
def pocket(tmp_path_factory: pytest.TempPathFactory) -> tuple[Path, Path, Path]:
    """Plan a roughed pocket; return cell, toolpath and output."""
    folder = tmp_path_factory.mktemp("pocket")
    cell, file = write_job(folder, build_pocket_path())
    assert main(["optimize", str(cell), str(file), "-o", str(folder / "out"), *COARSE]) == 0
    return cell, file, folder / "out"


def test_roughed_pocket_is_planned_and_verified(pocket: tuple[Path, Path, Path]) -> None:
    cell, file, out = pocket
    assert main(["verify", str(cell), str(file), str(out)]) == 0
    stock = json.loads((out / "result.json").read_text())["process"]["stock"]
    exact = (4 * HALF[0] * HALF[1] - (4 - np.pi) * RADIUS**2) * DEPTH * 1e9
    assert stock["removed_mm3"] == pytest.approx(exact, rel=1e-3)
    assert stock["finished"]["gouge_depth_mm"] == 0
    assert stock["finished"]["left_depth_mm"] == 0
    assert stock["finished"]["gouge_volume_mm3"] < 1e-3 * exact
    with (out / "points.csv").open() as table:
        rows = list(csv.DictReader(table))
    cut = [row for row in rows if row["move"] == "cut"]
    assert max(float(row["ae_mm"] or 0) for row in cut) == pytest.approx(2e3 * RADIUS, abs=0.1)  # the first ring
    level = [a for a, b in zip(cut[1:], cut[:-1], strict=True) if a["z_mm"] == b["z_mm"] == "-6.000000"]
    assert {row["ap_mm"] for row in level} - {""} == {"6.0000"}
    assert max(float(row["ap_mm"] or 0) for row in cut) == 6.0  # the finished wall of the layer above has no contact
    widths = np.array([float(row["ae_mm"] or "nan") for row in cut])
    assert np.nanstd(widths) > 3  # mm: corners, rings and entries differ
    assert "Stock and finished part" in (out / "report.html").read_text()


def test_report_shows_stock_and_finished_part(pocket: tuple[Path, Path, Path]) -> None:
    page = (pocket[2] / "report.html").read_text()
    assert '"kind":"stock"' in page.replace(" ", "")
    assert '"kind":"workpiece"' in page.replace(" ", "")


@pytest.mark.parametrize(("column", "change"), [("phi_in_deg", -20.0), ("high_mm", 1.0)])
def test_wrong_arcs_fail_the_verification(
    pocket: tuple[Path, Path, Path], tmp_path: Path, column: str, change: float, capsys: pytest.CaptureFixture[str]
) -> None:
    import shutil

    cell, file, out = pocket
    shutil.copytree(out, tmp_path / "out")
    with (tmp_path / "out" / "engagement.csv").open() as table:
        rows = list(csv.DictReader(table))
    for row in rows:
        row[column] = str(max(float(row[column]) + change, 0.0))
    with (tmp_path / "out" / "engagement.csv").open("w") as table:
        writer = csv.DictWriter(table, rows[0].keys())
        writer.writeheader()
        writer.writerows(rows)
    capsys.readouterr()
    assert main(["verify", str(cell), str(file), str(tmp_path / "out")]) == 4
    failed = [line for line in capsys.readouterr().out.splitlines() if line.startswith("FAIL")]
    assert any("engagement.csv against exact shapes" in line for line in failed)
    assert any("f_normal_N" in line for line in failed)


def test_deeper_finished_part_shows_remaining_material(tmp_path: Path) -> None:
    cell, file = write_job(tmp_path, build_pocket_path())
    build_pocketed_block(DEPTH + 0.5e-3).export(cell / "meshes" / "finished.stl")
    assert main(["optimize", str(cell), str(file), "-o", str(tmp_path / "out"), *COARSE]) == 0
    found = json.loads((tmp_path / "out" / "result.json").read_text())["process"]["stock"]["finished"]
    assert found["left_depth_mm"] == pytest.approx(0.5, abs=1e-3)
    assert found["gouge_depth_mm"] == 0
