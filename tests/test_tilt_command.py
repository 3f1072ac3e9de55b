"""``machopt optimize`` with ``tilt_deg``: files recomputed by pinocchio, refused cutters, ranges, and the gain."""

from __future__ import annotations

import csv
import json
import shutil
from pathlib import Path

import numpy as np
import pinocchio as pin
import pytest
from ruamel.yaml import YAML
from scipy.spatial.transform import Rotation
from test_cli import optimize

from machopt.cli import main
from machopt.commands.optimize.request import OptimizeRequest, load_optimize_inputs
from machopt.numerics.array_types import Array
from machopt.view.session import ViewSession

pytestmark = pytest.mark.slow

ROOT = Path(__file__).resolve().parent.parent
CELL = ROOT / "cells" / "kr500_milling"
RADIUS_MM = 8.5
HEADER = "x_mm,y_mm,z_mm,i,j,k,move,feed_mm_min,operation\n"
ROWS = (
    "-100,-60,40,0,0,1,rapid,,face",
    "-100,-60,5,0,0,1,approach,1000,face",
    "-100,-60,-0.5,0,0,1,cut,500,face",  # a plunge
    "0,-60,-0.5,0,0,1,cut,1500,face",
    "60,-60,-0.5,0,0,1,cut,1500,face",
    "60,0,-0.5,0,0,1,cut,1500,wall",
    "100,40,-0.5,0,0.05,1,cut,1500,wall",
    "100,40,40,0,0,1,retract,1000,wall",
    "100,40,60,0,0,1,rapid,,wall",
)
COARSE = ("--set", "rotation_step_deg=10")
FREE = "tilt_deg={lead: [-5, 5], side: [-5, 5]}"


@pytest.fixture(scope="module")
def job(tmp_path_factory: pytest.TempPathFactory) -> tuple[Path, Path]:
    """Return a cell with a ball cutter and a toolpath with a plunge and corners."""
    folder = tmp_path_factory.mktemp("tilt")
    cell = folder / "ball"
    shutil.copytree(CELL, cell)
    text = (cell / "cell.yaml").read_text(encoding="utf-8")
    (cell / "cell.yaml").write_text(text.replace("length_mm", f"corner_radius_mm: {RADIUS_MM}, length_mm", 1))
    path = folder / "corner.csv"
    path.write_text(HEADER + "\n".join(ROWS) + "\n")
    assert optimize(cell, path, folder / "plain", *COARSE) == 0
    assert optimize(cell, path, folder / "tilted", *COARSE, "--set", FREE) == 0
    return cell, path


def table(file: Path) -> dict[str, list[str]]:
    with file.open() as lines:
        rows = list(csv.DictReader(lines))
    return {name: [row[name] for row in rows] for name in rows[0]}


def numbers(columns: dict[str, list[str]], *names: str) -> Array:
    return np.array([[float(v) if v else np.nan for v in columns[name]] for name in names]).T


def compute_tool(cell: Path, q_deg: Array) -> tuple[Array, Array]:
    """Return the tip in mm and the axis (tip to shank) in the workpiece, by pinocchio from URDF and cell.yaml alone."""
    document = YAML(typ="safe").load((cell / "cell.yaml").read_text())
    model = pin.buildModelFromUrdf(str(cell / document["robot"]["urdf"]))
    data = model.createData()

    def pose(given: dict[str, list[float]]) -> Array:
        T = np.eye(4)
        T[:3, 3] = given["xyz_mm"]
        T[:3, :3] = Rotation.from_euler("xyz", given["rpy_deg"], degrees=True).as_matrix()
        return T

    flange = model.getFrameId(document["robot"]["flange_link"])
    to_part = np.linalg.inv(pose(document["workpiece"]["pose"])) @ pose(document["robot"]["pose"])
    tips, axes = [], []
    for q in np.radians(q_deg):
        pin.framesForwardKinematics(model, data, q)
        T = data.oMf[flange].homogeneous.copy()
        T[:3, 3] *= 1e3
        T = to_part @ T @ pose(document["tool"]["tcp"])
        tips.append(T[:3, 3])
        axes.append(-T[:3, 2])
    return np.array(tips), np.array(axes)


def cam(index: Array) -> tuple[Array, Array, Array]:
    """Return point in mm, axis and direction of travel of the toolpath at fractional indices, from its rows."""
    rows = np.array([[float(v) for v in row.split(",")[:6]] for row in ROWS])
    point, axis = rows[:, :3], rows[:, 3:] / np.linalg.norm(rows[:, 3:], axis=1, keepdims=True)
    k = np.clip(np.floor(index + 1e-9).astype(int), 0, len(rows) - 2)
    f = (index - k)[:, None]
    a = (1 - f) * axis[k] + f * axis[k + 1]
    a /= np.linalg.norm(a, axis=1, keepdims=True)
    move = np.diff(point, axis=0)
    move[1] = move[2]  # the plunge has the travel of the next cut
    t = move[k] - np.sum(move[k] * a, axis=1, keepdims=True) * a
    return (1 - f) * point[k] + f * point[k + 1], a, t / np.linalg.norm(t, axis=1, keepdims=True)


def test_samples_realise_their_stated_tilt(job: tuple[Path, Path]) -> None:
    cell, path = job
    found = table(path.parent / "tilted" / "trajectory.csv")
    cut = np.array(found["move"]) == "cut"
    index = numbers(found, "point")[cut, 0]
    lead, side = np.radians(numbers(found, "lead_deg", "side_deg")[cut]).T
    tip, axis = compute_tool(cell, numbers(found, *(f"q{n}_deg" for n in range(1, 7)))[cut])
    p, a, t = cam(index)
    wanted = a + np.tan(lead)[:, None] * t + np.tan(side)[:, None] * np.cross(a, t)
    wanted /= np.linalg.norm(wanted, axis=1, keepdims=True)
    inside = np.abs(index - np.round(index)) > 0.01  # corners are rounded
    angle = np.degrees(np.arccos(np.clip(np.sum(wanted * axis, axis=1), -1, 1)))
    assert angle[inside].max() < 0.05
    assert np.linalg.norm(tip - RADIUS_MM * (a - axis) - p, axis=1).max() < 0.02
    assert np.abs(np.degrees([lead, side])).max() <= 5 + 1e-6
    assert np.abs(np.degrees([lead, side])).max() > 2  # the tilt is used


def test_points_keep_the_axis_of_the_file_and_state_their_tilt(job: tuple[Path, Path]) -> None:
    cell, path = job
    found = table(path.parent / "tilted" / "points.csv")
    rows = slice(2, 6)  # from the first cut on; the moves at the other points are along the axis
    p, a, t = cam(numbers(found, "point")[rows, 0])
    assert np.allclose(numbers(found, "x_mm", "y_mm", "z_mm")[rows], p, atol=1e-6)
    assert np.allclose(numbers(found, "i", "j", "k")[rows], a, atol=1e-8)
    lead, side = np.radians(numbers(found, "lead_deg", "side_deg")[rows]).T
    tip, axis = compute_tool(cell, numbers(found, *(f"q{n}_deg" for n in range(1, 7)))[rows])
    wanted = a + np.tan(lead)[:, None] * t + np.tan(side)[:, None] * np.cross(a, t)
    wanted /= np.linalg.norm(wanted, axis=1, keepdims=True)
    assert np.allclose(axis, wanted, atol=1e-6)
    assert np.allclose(tip, p + RADIUS_MM * (a - axis), atol=1e-3)


def test_tilt_lowers_the_objective(job: tuple[Path, Path]) -> None:
    folder = job[1].parent
    both = [json.loads((folder / name / "result.json").read_text())["objective"] for name in ("plain", "tilted")]
    assert both[1]["chosen"]["total"] < both[0]["chosen"]["total"]
    assert both[1]["chosen"]["mean"] < both[0]["chosen"]["mean"]
    assert both[1]["jiao2022"] == both[0]["jiao2022"]  # the baselines have no tilt


def test_zero_ranges_change_no_byte(job: tuple[Path, Path]) -> None:
    cell, path = job
    out = path.parent / "zero"
    assert optimize(cell, path, out, *COARSE, "--set", "tilt_deg={lead: [0, 0], side: [0, 0]}") == 0
    assert not (out / "tilt.csv").exists()
    for name in ("points.csv", "trajectory.csv", "corner_csv.src"):
        assert (out / name).read_bytes() == (path.parent / "plain" / name).read_bytes()


def test_operation_has_its_own_range(job: tuple[Path, Path]) -> None:
    cell, path = job
    out = path.parent / "wall"
    assert (
        optimize(cell, path, out, *COARSE, "--set", "operations={wall: {tilt_deg: {lead: [-2, 8], side: [-3, 8]}}}")
        == 0
    )
    found = table(out / "trajectory.csv")
    cut = np.array(found["move"]) == "cut"
    label = np.array(found["operation"])
    lead, side = numbers(found, "lead_deg", "side_deg").T
    assert np.abs(lead[cut & (label == "face")]).max() < 0.05
    assert np.abs(side[cut & (label == "face")]).max() < 0.05
    for tilt, low, high in ((lead, -2.001, 8.001), (side, -3.001, 8.001)):
        assert tilt[cut & (label == "wall")].min() > low
        assert tilt[cut & (label == "wall")].max() < high
    assert np.hypot(lead, side)[cut & (label == "wall")].max() > 0.5


def test_compensated_path_may_tilt(job: tuple[Path, Path]) -> None:
    cell, path = job
    assert optimize(cell, path, path.parent / "both", *COARSE, "--set", FREE, "--compensate") == 0


@pytest.mark.parametrize(
    ("cutter", "option"),
    [
        ("length_mm", FREE),  # an end mill
        ("corner_radius_mm: 2, length_mm", FREE),  # a bull nose
        ("length_mm", "operations={wall: {tilt_deg: {side: [0, 1]}}}"),
    ],
)
def test_other_cutters_are_refused(
    job: tuple[Path, Path], tmp_path: Path, cutter: str, option: str, capsys: pytest.CaptureFixture[str]
) -> None:
    cell = tmp_path / "cell"
    shutil.copytree(CELL, cell)
    text = (cell / "cell.yaml").read_text(encoding="utf-8")
    (cell / "cell.yaml").write_text(text.replace("length_mm", cutter, 1))
    assert main(["optimize", str(cell), str(job[1]), "-o", str(tmp_path / "out"), "--set", option]) == 2
    assert "corner_radius_mm" in capsys.readouterr().err
    assert not (tmp_path / "out").exists()


@pytest.mark.parametrize(
    "option",
    [
        "tilt_deg={lead: [5, -5]}",
        "tilt_deg={lead: [-60, 5]}",
        "tilt_deg={lean: [0, 5]}",
        "tilt_deg={lead: [3, 8]}",  # no tilt satisfies it at the corner
        "operations={wal: {tilt_deg: {lead: [0, 5]}}}",
    ],
)
def test_invalid_ranges_are_refused(job: tuple[Path, Path], tmp_path: Path, option: str) -> None:
    cell, path = job
    assert main(["optimize", str(cell), str(path), "-o", str(tmp_path / "out"), "--quiet", "--set", option]) == 2


def test_methods_without_tilt_are_refused(job: tuple[Path, Path], tmp_path: Path) -> None:
    cell, path = job
    given = ["optimize", str(cell), str(path), "-o", str(tmp_path / "out"), "--set", FREE, "--method", "jiao2022"]
    assert main(given) == 2


def test_pin_in_the_view_is_planned_with_the_tilt(job: tuple[Path, Path], tmp_path: Path) -> None:
    cell, path = job
    request = OptimizeRequest(cell=cell, toolpath=path, out=tmp_path / "out", overrides=("rotation_step_deg=10", FREE))
    session = ViewSession.start(load_optimize_inputs(request), tmp_path / "plan.yaml", (), lambda _: None)
    first = session.current.job_result.plan
    assert first.path.lead is not None
    pinned = float(np.degrees(first.chosen.assignment.phi[3] + first.path.offset[3])) + 15.0
    wish = {"fixed": [{"point": 3, "gamma_deg": (pinned + 180.0) % 360.0 - 180.0}]}
    _, shown = session.replan({**session.list_wishes(), **wish}, lambda _: None)
    assert shown
    again = session.current.job_result.plan
    assert again.path.lead is not None
    assert np.hypot(again.path.lead, again.path.side).max() > 0.01
    assert session.verify(lambda _: None).good
