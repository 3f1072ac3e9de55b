"""Unusual and invalid process files in ``machopt optimize`` and the readers."""

from __future__ import annotations

import csv
import json
import re
import shutil
from dataclasses import replace
from pathlib import Path

import numpy as np
import pinocchio as pin
import pytest
import yaml

from machopt.cell.process_file.process_reader import load_process
from machopt.cli import main
from machopt.data_types.process import CuttingProcess
from machopt.errors import InputError
from machopt.process.binding.operation_matching import match_operations
from machopt.toolpath.toolpath_reader import read_toolpath

ROOT = Path(__file__).resolve().parents[1]
HEAD = """machopt_process: 1
materials:
  al:
    drilling: {kc1: 800, mc: 0.25, chisel_N_mm2: 300, thrust_spread_percent: 25, torque_spread_percent: 9, source: t}
    milling: {Ktc: 767, Krc: 169, Kac: 222, Kte: 27.7, Kre: 26.6, Kae: 0.7, spread_percent: 25, source: t}
operations:
"""
COLUMNS = "x_mm,y_mm,z_mm,i,j,k,move,feed_mm_min,operation\n"
DRILL = "cutter: {diameter_mm: 6, length_mm: 70, teeth: 2, point_deg: 135, web_mm: 0.9}"
BALL = "cutter: {diameter_mm: 10, length_mm: 30, teeth: 3, helix_deg: 30, corner_radius_mm: 5}"
Rows = list[dict[str, str]]


def write_rows(*moves: tuple[float, float, float, str, str], label: str = "holes") -> str:
    return COLUMNS + "".join(f"{x},{y},{z},0,0,1,{move},{feed},{label}\n" for x, y, z, move, feed in moves)


def list_hole_moves(*depths: tuple[float, str, str]) -> tuple[tuple[float, float, float, str, str], ...]:
    return tuple((-150.0, -200.0, z, move, feed) for z, move, feed in depths)


ONE_HOLE = write_rows(*list_hole_moves((40, "rapid", ""), (25, "rapid", ""), (0, "cut", "420"), (40, "retract", "")))
WALL = write_rows(
    (-100, -200, 20, "rapid", ""),
    (-100, -190, 20, "approach", "600"),
    (-50, -190, 20, "cut", "1200"),
    (0, -190, 20, "cut", "1200"),
    (0, -200, 20, "retract", ""),
    label="wall",
)


def drill(extra: str = "", *, tolerance: str = "position_mm: 0.4", rpm: str = "3000", depth: float = 12) -> str:
    return (
        f"  default: {{kind: drilling, spindle_rpm: {rpm}, material: al, depth_mm: {depth}, {extra}"
        f"tolerance: {{{tolerance}}}}}\n"
    )


def run_job(folder: Path, operations: str, rows: str = ONE_HOLE, *, cutter: str = DRILL, options: tuple[str, ...] = ()
            ) -> tuple[int, Rows, dict[str, object]]:  # fmt: skip
    cell = folder / "cell"
    shutil.copytree(ROOT / "cells" / "kr240_drilling", cell)
    text = re.sub(r"cutter: \{[^}]*\}", cutter, (cell / "cell.yaml").read_text())
    (cell / "cell.yaml").write_text(text + "process: process.yaml\n")
    (cell / "process.yaml").write_text(HEAD + operations)
    (folder / "path.csv").write_text(rows)
    out = folder / "out"
    code = main(["optimize", str(cell), str(folder / "path.csv"), "-o", str(out), "--quiet", *options])
    if not (out / "result.json").exists():
        return code, [], {}
    with (out / "points.csv").open(encoding="utf-8") as file:
        table = list(csv.DictReader(file))
    process = json.loads((out / "result.json").read_text())["process"]
    assert isinstance(process, dict)
    return code, table, process


def read_operations(tmp_path: Path, operations: str) -> CuttingProcess:
    file = tmp_path / "process.yaml"
    file.write_text(HEAD + operations)
    return load_process(file)


@pytest.mark.parametrize(
    ("operations", "words"),
    [
        (drill(tolerance="surface_mm: 0.5"), "surface_mm has no meaning for kind drilling"),
        (drill(tolerance="reference: relative"), "no limit is given"),
        (drill("points: [0, 3], "), "default names every other point"),
        (drill(rpm="1e300"), "spindle_rpm"),
        (
            "  a: {kind: milling, material: al, ae_mm: 1, ap_mm: 1, cut: up, tolerance: {position_mm: 1}}\n",
            "position_mm has no meaning for kind milling",
        ),
        ("  a: {kind: force, force_N: {axial: 3}, tolerance: {position_mm: 1, surface_mm: 1}}\n", "expected one"),
    ],
)
def test_unsupported_operations_are_refused(tmp_path: Path, operations: str, words: str) -> None:
    with pytest.raises(InputError, match=words):
        read_operations(tmp_path, operations)


@pytest.mark.parametrize(
    ("old", "new"), [("kc1: 800", "kc1: 8.0e+8"), ("Ktc: 767", "Ktc: 7.67e+8"), ("Kte: 27.7", "Kte: 27700")]
)
def test_coefficients_in_si_units_are_refused(tmp_path: Path, old: str, new: str) -> None:
    file = tmp_path / "process.yaml"
    file.write_text((HEAD + drill()).replace(old, new))
    with pytest.raises(InputError, match=new.split(":", maxsplit=1)[0]):
        load_process(file)


def test_points_beyond_the_toolpath_are_refused(tmp_path: Path) -> None:
    (tmp_path / "path.csv").write_text(ONE_HOLE)
    toolpath = read_toolpath(tmp_path / "path.csv")
    process = read_operations(tmp_path, drill("points: [0, 300], ").replace("default", "holes"))
    with pytest.raises(InputError, match="points between 0 and 3"):
        match_operations(process, toolpath)


@pytest.mark.parametrize(("word", "refused"), [("M3", False), ("M4", True)])
def test_opposite_spindle_direction_is_refused(tmp_path: Path, word: str, refused: bool) -> None:
    (tmp_path / "a.nc").write_text(
        f"G21 G90 G17\nS3000 {word}\nG0 X0 Y0 Z20\nG1 Z0 F300\nS2000\nG1 X50\nG0 Z20\nM5\nM30\n"
    )
    toolpath = read_toolpath(tmp_path / "a.nc")
    process = read_operations(tmp_path, "  default: {kind: milling, material: al, ae_mm: 1, ap_mm: 1, cut: up}\n")
    if not refused:
        assert (match_operations(process, toolpath) == 0).all()
        return
    with pytest.raises(InputError, match="spindle: ccw would work"):
        match_operations(process, toolpath)


def test_pecks_have_the_full_force_and_air_moves_none(tmp_path: Path) -> None:
    moves = ((40, "rapid", ""), (14, "rapid", ""), (6, "cut", "420"), (14, "cut", "2000"), (7, "cut", "2000"))
    rows = write_rows(*list_hole_moves(*moves, (0, "cut", "420"), (40, "retract", "")))
    code, table, process = run_job(tmp_path, drill(), rows)
    assert code == 0
    force = [float(row["f_axial_N"]) for row in table if row["move"] == "cut"]
    assert force[0] == pytest.approx(345, rel=0.02)
    assert force[3] == pytest.approx(force[0], rel=0.02)  # the second peck starts with the full diameter
    assert force[1] == force[2] == 0.0
    assert [row["outcome"] != "" for row in table].count(True) == 1
    assert process["in_tolerance"] is not None


def test_peck_below_the_stack_cuts_nothing(tmp_path: Path) -> None:
    moves = ((40, "rapid", ""), (14, "rapid", ""), (6, "cut", "420"), (14, "cut", "2000"), (0, "cut", "420"))
    layers = drill().replace("material: al", "layers: [{material: al, thickness_mm: 2}]")
    rows = write_rows(*list_hole_moves(*moves, (40, "retract", "")))
    code, table, _ = run_job(tmp_path, layers, rows.replace("0,cut,420", "0,cut,420"))
    assert code == 0
    force = [float(row["f_axial_N"]) for row in table if row["move"] == "cut"]
    assert force[0] > 100.0
    assert force[1] == 0.0


def compute_compliance(folder: Path, q_deg: list[float]) -> tuple[np.ndarray, np.ndarray]:
    """Return translational compliance (3, 3) and tool axis in base_link, by pinocchio and the stiffness file."""
    cell = yaml.safe_load((folder / "cell" / "cell.yaml").read_text())
    model = pin.buildModelFromUrdf(str(folder / "cell" / "robot.urdf"))
    data = model.createData()
    q = np.radians(q_deg)
    pin.forwardKinematics(model, data, q)
    pin.updateFramePlacements(model, data)
    frame = model.getFrameId("flange")
    J = pin.computeFrameJacobian(model, data, q, frame, pin.LOCAL_WORLD_ALIGNED)
    T = data.oMf[frame]
    arm = T.rotation @ (np.array(cell["tool"]["tcp"]["xyz_mm"]) / 1e3)
    moved = J[:3] - np.array([np.cross(arm, column) for column in J[3:].T]).T
    k = np.array(yaml.safe_load((folder / "cell" / "stiffness.yaml").read_text())["joints_Nm_per_rad"], float)
    base = data.oMf[model.getFrameId("base_link")].rotation
    return base.T @ (moved / k) @ moved.T @ base, base.T @ T.rotation[:, 2]


def test_given_force_on_a_point_operation_moves_the_hole_sideways(tmp_path: Path) -> None:
    text = "  holes: {kind: force, force_N: {axial: 300}, depth_mm: 12, spread_percent: 20, "
    code, table, process = run_job(
        tmp_path, text + "tolerance: {position_mm: 0.4, depth_mm: 3, reference: relative}}\n"
    )
    assert code == 0
    row = next(row for row in table if row["outcome"])
    C, axis = compute_compliance(tmp_path, [float(row[f"q{n}_deg"]) for n in range(1, 7)])
    assert abs(axis[2]) == pytest.approx(1.0, abs=1e-6)
    up = np.array([0.0, 0.0, 1.0])
    e = 300.0 * C @ up * 1e3
    assert float(row["error_along_mm"]) == pytest.approx(float(e @ up), rel=1e-4)
    across = float(np.linalg.norm(e - (e @ up) * up))
    assert float(row["error_across_mm"]) == pytest.approx(across, rel=0.15)  # at the entry, 11 mm above the bottom
    z = (np.log(0.4 / float(row["error_across_mm"]))) / np.log(1.2)  # from the force alone
    assert 0.5 < float(row["p_in"]) < 1.0
    assert z > 0
    assert str(process["headline"]).startswith("0 of 1 holes in tolerance, 1 marginal")


@pytest.mark.parametrize(("friction", "skids"), [(0.01, True), (5.0, False)])
def test_pressure_foot_with_low_friction_is_reported_to_slide(tmp_path: Path, friction: float, skids: bool) -> None:
    code, _, process = run_job(tmp_path, drill(f"clamp_N: 900, foot_friction: {friction}, "))
    assert code == 0
    notes = process["validity"]
    assert isinstance(notes, list)
    assert any("skids at 1 of 1 holes" in note for note in notes) == skids


@pytest.mark.parametrize(
    ("rpm", "depth", "words"),
    [("3", 12, "more than a lip"), ("60000", 12, "thinner than 5 µm"), ("3000", 30, "starts up to 5 mm below")],
)
def test_absurd_feed_or_depth_is_noted(tmp_path: Path, rpm: str, depth: float, words: str) -> None:
    _, _, process = run_job(tmp_path, drill(rpm=rpm, depth=depth))
    assert any(words in note for note in process["validity"])  # type: ignore[attr-defined]


def test_operation_without_force_is_refused(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    code, table, _ = run_job(tmp_path, "  default: {kind: force, force_N: {axial: 0}, tolerance: {surface_mm: 1}}\n")
    assert code == 2
    assert not table
    assert "no cut move has a cutting force" in capsys.readouterr().err


def test_orientation_tolerance_alone_is_in_degrees(tmp_path: Path) -> None:
    code, table, process = run_job(tmp_path, drill(tolerance="axis_deg: 0.5"))
    assert code == 0
    row = next(row for row in table if row["outcome"])
    assert row["tolerance_mm"] == ""
    stated = re.search(r"worst hole 1: ([\d.]+)°", str(process["headline"]))
    assert stated is not None
    assert float(stated[1]) == pytest.approx(float(row["error_axis_deg"]), rel=1e-2)


def test_compensated_hole_in_tolerance_has_a_largest_feed(tmp_path: Path) -> None:
    options = ("--compensate", "--set", "compensation_max_mm=4")
    code, table, _ = run_job(tmp_path, drill(), options=options)
    assert code == 0
    row = next(row for row in table if row["outcome"])
    assert row["outcome"] == "pass"
    assert float(row["feed_max_mm_min"]) >= 419.0


def test_ball_cutter_without_normals_is_unknown_and_verified(tmp_path: Path) -> None:
    wall = "  wall: {kind: milling, material: al, spindle_rpm: 12000, ae_mm: 1, ap_mm: 6, cut: down, "
    code, table, _ = run_job(tmp_path, wall + "tolerance: {surface_mm: 0.2}}\n", WALL, cutter=BALL)
    assert code == 0
    rows = [row for row in table if row["move"] == "cut"]
    assert {row["outcome"] for row in rows} == {"unknown"}
    assert all(not row["error_normal_mm"] and not row["p_in"] for row in rows)
    assert all(float(row["f_normal_N"]) > 50.0 for row in rows)


def test_partial_path_keeps_the_force_of_its_points(tmp_path: Path) -> None:
    from machopt.planning.stations.path_subset import select_path_runs
    from machopt.planning.stations.planning_path import build_planning_path

    moves = ((40, "rapid", ""), (25, "rapid", ""), (0, "cut", "420"), (40, "retract", ""))
    rows = [(x, -200.0, z, move, feed) for x in (-150.0, 150.0) for z, move, feed in moves]
    (tmp_path / "path.csv").write_text(write_rows(*rows))
    toolpath = read_toolpath(tmp_path / "path.csv")
    force = np.arange(3.0 * len(toolpath)).reshape(-1, 3)
    path = build_planning_path(replace(toolpath, force=force))
    part = select_path_runs(path, [len(path.runs) - 1], 10)
    assert part.force is not None
    assert part.force.shape == part.position.shape
    assert path.force is not None
    last = path.runs[-1]
    assert np.array_equal(part.force, path.force[last[0] : last[1] + 1])


@pytest.mark.parametrize(
    ("old", "new", "words"),
    [
        (", point_deg: 135", "", "no tool of the cell fits: the point angle"),
        ("(?m)^accuracy:.*$", "", "accuracy of cell.yaml is not stated"),
        ("xxx", "", "valid, 0 warnings"),
    ],
)
def test_validate_names_missing_process_entries(
    tmp_path: Path, capsys: pytest.CaptureFixture[str], old: str, new: str, words: str
) -> None:
    cell = tmp_path / "cell"
    shutil.copytree(ROOT / "cells" / "kr240_drilling", cell)
    text = (cell / "cell.yaml").read_text()
    (cell / "cell.yaml").write_text(re.sub(old, new, text) + "process: process.yaml\n")
    assert main(["validate", str(cell)]) == 0
    out, err = capsys.readouterr()
    assert words in out + err


def test_unknown_chisel_edge_and_unused_stock_are_noted(tmp_path: Path) -> None:
    material = (
        "  al: {drilling: {kc1: 800, mc: 0.25, thrust_spread_percent: 25, torque_spread_percent: 9, source: t}}\n"
    )
    assert run_job(tmp_path / "known", drill())[0] == 0
    known = json.loads((tmp_path / "known" / "out" / "result.json").read_text())["process"]["validity"]
    file = tmp_path / "process.yaml"
    file.write_text(
        "machopt_process: 1\nmaterials:\n" + material + "operations:\n" + drill() + "stock: {mesh: s.stl}\n"
    )
    cell, path, out = (str(tmp_path / name) for name in ("known/cell", "known/path.csv", "out"))
    assert main(["optimize", cell, path, "--process", str(file), "-o", out, "--quiet"]) == 0
    validity = json.loads((tmp_path / "out" / "result.json").read_text())["process"]["validity"]
    assert not any("chisel" in note for note in known)
    assert any("chisel_N_mm2 is not stated" in note for note in validity)
    assert not any(note.startswith("stock") for note in known)
    assert any(note.startswith("stock is not used") for note in validity)
