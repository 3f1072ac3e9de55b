"""``machopt inspect`` of a cell and of a bare robot."""

from __future__ import annotations

import json
from pathlib import Path

import pytest
from parallel_linkage_arm import linked_urdf

from machopt.cli import main
from machopt.data_types.documents.inspect_documents import InspectedCellDocument, InspectedRobotDocument

CELL = """\
machopt_cell: 1
name: looked at
robot:
  urdf: robot.urdf
  base_link: base_link
  flange_link: flange
  pose: {xyz_mm: [0, 0, 3000], rpy_deg: [180, 0, 0]}
  home_deg: [0, -90, 0, 0, 45, 0]
  limits:
    acceleration_deg_s2: [300, 300, 300, 500, 500, 800]
    jerk_deg_s3: [2000, 2000, 2000, 4000, 4000, 6000]
tool: {tcp: {xyz_mm: [0, 0, 350]}}
workpiece: {pose: {xyz_mm: [1500, 0, 600]}}
plan: {collision: false}
"""


@pytest.fixture
def folder(tmp_path: Path) -> Path:
    (tmp_path / "cell.yaml").write_text(CELL)
    (tmp_path / "robot.urdf").write_text(linked_urdf())
    return tmp_path


def read_printed_json(capsys: pytest.CaptureFixture[str], *words: str) -> dict[str, object]:
    assert main(["inspect", *words, "--json"]) == 0
    found: dict[str, object] = json.loads(capsys.readouterr().out)
    model = InspectedCellDocument if "cell" in found else InspectedRobotDocument
    assert model.model_validate(found).to_json_types() == found
    return found


def test_cell_is_listed_with_mounting_joints_and_followers(folder: Path, capsys: pytest.CaptureFixture[str]) -> None:
    found = read_printed_json(capsys, str(folder))
    assert found["mounting"] == {
        "stands": "from the ceiling",
        "tilt_deg": 180.0,
        "xyz_mm": [0.0, 0.0, 3000.0],
        "down_in_base": [0.0, 0.0, 1.0],
    }
    assert found["followers"] == [{"name": "m3", "mimics": "a2", "multiplier": -1.0, "offset": 0.2}]
    assert found["joints"][0] == {  # type: ignore[index]
        "name": "a1",
        "lower_deg": -185.0,
        "upper_deg": 185.0,
        "home_deg": 0.0,
        "velocity_deg_s": 114.592,
        "acceleration_deg_s2": 300.0,
        "jerk_deg_s3": 2000.0,
    }
    assert "velocity_deg_s is not given" in str(found["notes"])
    assert "closed form" in str(found["inverse_kinematics"])


def test_reasons_against_planning_are_listed_with_the_readable_content(
    folder: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    (folder / "robot.urdf").write_text(linked_urdf(shift="0.02 0 0"))
    assert "a line of its own" in str(read_printed_json(capsys, str(folder / "cell.yaml"))["cannot_be_planned"])


def test_bare_robot_is_listed_joint_by_joint(folder: Path, capsys: pytest.CaptureFixture[str]) -> None:
    found = read_printed_json(capsys, str(folder / "robot.urdf"))
    assert [j["name"] for j in found["joints"]] == ["a1", "a2", "a3", "a4", "a5", "a6", "m3"]  # type: ignore[attr-defined]
    assert found["joints"][6]["mimics"] == "a2"  # type: ignore[index]
    assert found["collision_bodies"] == 7
