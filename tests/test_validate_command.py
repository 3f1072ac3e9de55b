"""``machopt validate``: all problems at once, including those that a planner does not notice."""

from __future__ import annotations

import json
import shutil
from collections.abc import Callable
from pathlib import Path

import pytest
from small_cell import urdf_text

from machopt.cell.cell_reader import load_cell
from machopt.cell_setup.template.init_request import InitRequest
from machopt.cell_setup.validation.planning_checks import list_remarks
from machopt.cell_setup.validation.reader_errors import read_all
from machopt.cli import main
from machopt.commands.init import run_init
from machopt.commands.validate import run_validate
from machopt.data_types.documents.cell_documents import ValidateDocument
from machopt.errors import InputError
from machopt.kinematics.urdf_loading import load_robot
from machopt.options.plan_option_reader import load_options
from machopt.planning.external_axes.axis_modes import resolve_axis_options
from machopt.planning.job.request_checks import check_fixed_rotation_method

CELLS = Path(__file__).resolve().parents[1] / "cells"
Make = Callable[..., Path]


@pytest.fixture(scope="module")
def good(tmp_path_factory: pytest.TempPathFactory) -> Path:
    folder = tmp_path_factory.mktemp("cell")
    (folder / "arm.urdf").write_text(urdf_text())
    run_init(InitRequest(robot=folder / "arm.urdf", out=folder / "cell", post="krl", tool_angle_deg=0.0))
    return folder / "cell"


@pytest.fixture
def changed(good: Path, tmp_path: Path) -> Make:
    """Return the valid cell with replaced texts in cell.yaml."""

    def make(*pairs: tuple[str, str], file: str = "cell.yaml") -> Path:
        folder = tmp_path / "cell"
        if not folder.exists():
            shutil.copytree(good, folder)
        text = (folder / file).read_text()
        for old, new in pairs:
            assert old in text, old
            text = text.replace(old, new)
        (folder / file).write_text(text)
        return folder

    return make


def line_of(folder: Path, start: str) -> str:
    """Return the number of the line of cell.yaml that begins with this."""
    return next(x for x in (folder / "cell.yaml").read_text().splitlines() if x.lstrip().startswith(start))


def texts(folder: Path) -> str:
    return "\n".join(f"{f.level} {f.where}: {f.text}" for f in run_validate(folder).findings)


@pytest.mark.parametrize("name", ["kr240_drilling", "kr500_milling"])
def test_shipped_cell_is_valid_and_drawn(name: str, tmp_path: Path) -> None:
    done = run_validate(CELLS / name, picture_file=tmp_path / "cell.svg")
    assert (done.findings, done.exit_code) == ((), 0)
    svg = (tmp_path / "cell.svg").read_text()
    assert svg.startswith("<svg")
    assert svg.count("from ") == 3
    assert "nan" not in svg


def test_cells_written_by_init_are_valid(good: Path) -> None:
    done = run_validate(good)
    assert done.errors == ()
    assert "estimated" in texts(good)


def test_sideways_tool_is_reported(good: Path, changed: Make) -> None:
    """flange instead of tool0: the planner accepts such a cell, and the spindle collides with the side of the arm."""
    tcp = line_of(good, "tcp:")
    folder = changed((tcp, "  tcp: {xyz_mm: [200, 0, 0], rpy_deg: [0, 90, 0]}"))
    assert "warning tool.tcp: the TCP lies 200 mm from the flange axis and 0 mm out of it" in texts(folder)
    assert "looks along [0, 0, 1] of its own frame" in texts(folder)
    folder = changed(("xyz_mm: [200, 0, 0], rpy_deg: [0, 90, 0]", "xyz_mm: [0, 0, -200]"))
    assert "200 mm behind the flange" in texts(folder)


def test_inconsistent_tool_body_and_tip_are_reported(good: Path, changed: Make) -> None:
    folder = changed(("cylinder_mm: [40, 160]", "cylinder_mm: [40, 300]"))
    assert "spindle reaches 30 mm beyond the TCP" in texts(folder)
    assert "warning tool.tcp: the TCP lies inside spindle" in texts(folder)
    folder = changed(("cylinder_mm: [40, 300]", "cylinder_mm: [40, 60]"))
    assert "the cutter's upper end (40 mm behind the TCP) is 50 mm from the nearest body" in texts(folder)


def test_unreachable_part_and_home_in_contact_are_errors(good: Path, changed: Make) -> None:
    lines = (good / "cell.yaml").read_text().splitlines()
    pose = next(x for x in lines[lines.index("workpiece:") :] if x.strip().startswith("pose:"))
    cell = load_cell(good)
    x, y, z = (float(v) for v in 1e3 * load_robot(cell).compute_fk(cell.home)[:3, 3])
    post = f"obstacles: [{{name: post, sphere_mm: 100, xyz_mm: [{x:.0f}, {y:.0f}, {z:.0f}]}}]"
    folder = changed((pose, "  pose: {xyz_mm: [9000, 0, 500]}"), ("obstacles: []", post))
    message = texts(folder)
    assert "error workpiece.pose: none of the corners of 100 mm around the workpiece's frame can be reached" in message
    assert "mm of reach" in message
    assert "error robot.home_deg: " in message
    assert "touch at home" in message
    assert run_validate(folder).exit_code == 2


def test_every_mistake_is_reported_at_once(changed: Make, capsys: pytest.CaptureFixture[str]) -> None:
    folder = changed(
        ("mass_kg: 0", "mass_kg: -4"),
        (
            "obstacles: []",
            "foo: 3\nobstacles: [{box_mm: [1, 2]}, {name: b, mesh: gone.stl}, {name: c, mesh: lost.stl}]",
        ),
        ("post: krl", "post: krll"),
    )
    changed(("joints_Nm_per_rad", "joint_Nm_per_rad"), file="stiffness.yaml")
    assert main(["validate", str(folder), "--json"]) == 2
    message = json.loads(capsys.readouterr().out)
    assert ValidateDocument.model_validate(message).to_json_types() == message
    assert message["errors"] + message["warnings"] == len(message["findings"])
    every = "\n".join(f["text"] for f in message["findings"] if f["level"] == "error")
    for part in (
        "unknown key 'foo'",
        "tool.mass_kg: found -4",
        "expected 3 values: edge lengths",
        "no such file: gone.stl",
        "no such file: lost.stl",
        "did you mean 'joints_Nm_per_rad'",
        "did you mean 'krl'",
    ):
        assert part in every, part
    assert message["errors"] == 7
    assert main(["validate", str(folder)]) == 2
    assert capsys.readouterr().err.count("machopt: ") == 7


def test_mistakes_in_the_robot_are_reported_with_all_others(good: Path, changed: Make) -> None:
    """After each mistake, reading continues with the probable meaning."""
    home, jerk = line_of(good, "home_deg:"), line_of(good, "jerk_deg_s3:")
    folder = changed(
        ("base_link: base_link", "base_link: base_lnk"),
        ("flange_link: flange", "flange_link: flansch"),
        (home, "  home_deg: [0, -90, 9000, 0, 0, 0]"),
        (jerk, "    jerk_deg_s3: [1, 2]"),
        ("obstacles: []", "obstacles: [{name: b, mesh: gone.stl}]"),
    )
    output = [str(p) for p in read_all(folder).problems]
    parts = (
        "did you mean 'base_link'",
        "'flansch' is not in",
        "jerk_deg_s3",
        "home_deg[2]",
        "no such file: gone.stl",
    )
    assert all(sum(part in one for one in output) == 1 for part in parts), output
    assert len(output) == len(parts)
    assert run_validate(folder).exit_code == 2


def test_files_beside_an_unreadable_robot_are_checked(good: Path, changed: Make) -> None:
    jerk = line_of(good, "jerk_deg_s3:")
    folder = changed(
        ("obstacles: []", "obstacles: [{name: b, mesh: gone.stl}]"), (jerk, "    jerk_deg_s3: [1, 2, 3, 4, 5, 6, 7]")
    )
    (folder / "robot.urdf").write_text('<robot name="r">\n<link name="l">\n</robot>')
    changed(("joints_Nm_per_rad", "joint_Nm_per_rad"), file="stiffness.yaml")
    read = read_all(folder)
    assert read.cell is None
    output = "\n".join(map(str, read.problems))
    assert "robot.urdf: line 3, column 3: is not XML: mismatched tag; expected </link>, which line 2 opens" in output
    assert "robot.limits.jerk_deg_s3: found 7 values, expected 6" in output
    assert "no such file: gone.stl" in output
    assert "did you mean 'joints_Nm_per_rad'" in output


def test_options_refused_by_the_planner_are_errors_with_the_same_text(tmp_path: Path) -> None:
    shutil.copytree(CELLS / "kr500_rail", tmp_path / "cell")
    file = tmp_path / "cell" / "cell.yaml"
    text = file.read_text()
    start = text.index("plan:\n")
    options = "plan: {external: {rail: {preferred_mm: 90000}}, method: default, fixed: [{point: 0, gamma_deg: 0}]}\n"
    file.write_text(text[:start] + options)
    cell = load_cell(tmp_path / "cell")
    wanted = []
    for refuse in (
        lambda: resolve_axis_options(cell, load_options(cell.plan)),
        lambda: check_fixed_rotation_method(load_options(cell.plan)),
    ):
        with pytest.raises(InputError) as refused:
            refuse()
        wanted.append(f"error {refused.value!s}")
    output = [f"{f.level} {f.text}" for f in list_remarks(cell)]
    assert set(wanted) <= set(output)


def test_missing_cell_and_picture_are_refused(good: Path, tmp_path: Path) -> None:
    with pytest.raises(InputError, match=r"no cell\.yaml in this folder"):
        run_validate(tmp_path)
    with pytest.raises(InputError, match=r"pictures are SVG; a\.svg would work"):
        run_validate(good, picture_file=tmp_path / "a.png")
