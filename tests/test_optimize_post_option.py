"""``machopt optimize --post``: programs for several makers, read back and compared, from one command."""

from __future__ import annotations

import json
import shutil
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from cells_without_controller import without_controller
from planned_program_output import write_and_compare_program

import machopt.program_export.exported_programs
from machopt.cell.cell_reader import load_cell
from machopt.cli import main
from machopt.data_types.plan_options import FixedRotation, PlanOptions
from machopt.data_types.robot_program import LIN
from machopt.errors import InputError
from machopt.planning.motion.trajectory_builder import build_timeline
from machopt.planning.pipeline.path_planner import plan_path
from machopt.program_export.program_moves import build_robot_program
from machopt.programs.program_reader import read_program
from machopt.programs.program_writer import read_post_text, write_program
from machopt.programs.writing.target_insertion import ProgramTolerance, measure_line_deviation
from machopt.toolpath.toolpath_reader import read_toolpath
from machopt.verification.folder.programs.post_lookup import build_tolerance

CELLS = Path(__file__).resolve().parents[1] / "cells"
# a pass over the head with all events that a program must contain at the correct position
APT = """UNITS/MM
PPRINT/Fräsen; Ø10 "fein" 100% <A&B> {x} [y] !
LOADTL/4
SPINDL/1500,RPM,CLW
RAPID
GOTO/-100,0,60
FEDRAT/1000,MMPM
GOTO/-100,0,5
COOLNT/ON
FEDRAT/1500,MMPM
GOTO/-100,0,-0.5
GOTO/-96,0,-0.5
DELAY/1.5
GOTO/-92,0,-0.5
GOTO/-88,4,-0.5
FEDRAT/900,MMPM
GOTO/-84,4,-0.5
GOTO/-80,4,-0.5
GOTO/-80,4,5
COOLNT/OFF
RAPID
GOTO/-80,4,60
SPINDL/OFF
FINI
"""
CONTROLLER = """
controller:
  post: krl
  joint_map: {sign: [-1, 1, 1, -1, 1, -1], offset_deg: [0, -90, 90, 0, 0, 0], coupling: {j3: {j2: 1}}}
  root: {xyz_mm: [0, 0, 450], rpy_deg: [0, 0, 180]}
  flange: {xyz_mm: [0, 0, 10], rpy_deg: [0, 0, 0]}
  pulses_per_deg: [1000, 1001, 1002, 1003, 1004, -1005]
  nonflip_j5: negative
  lines: {spindle_on: "SPINDLE(@{value:.0f})"}
"""
POSTS = ("krl", "rapid", "fanuc", "urscript", "val3", "jbi", "csv", "json", "ros_json")


def copy_cell(folder: Path, more: str = "") -> Path:
    shutil.copytree(CELLS / "kr500_milling", folder / "cell")
    file = without_controller(folder / "cell") / "cell.yaml"
    file.write_text(file.read_text(encoding="utf-8") + more, encoding="utf-8")
    (folder / "part.apt").write_text(APT, encoding="latin-1")
    return folder / "cell"


def optimize(folder: Path, *options: str) -> int:
    return main(
        [
            "optimize",
            str(folder / "cell"),
            str(folder / "part.apt"),
            "-o",
            str(folder / "out"),
            "--method",
            "default",
            *options,
        ]
    )


def result(folder: Path) -> dict[str, Any]:
    value = json.loads((folder / "out" / "result.json").read_text(encoding="utf-8"))
    assert isinstance(value, dict)
    return value


@pytest.fixture(scope="module")
def job(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """One job with a program for every maker and a user-defined post."""
    folder = tmp_path_factory.mktemp("posts")
    copy_cell(folder, CONTROLLER)
    mine = read_post_text("krl").replace("moves_per_part = 4000", "moves_per_part = 6").replace("C_DIS", "C_VEL")
    (folder / "mine.toml").write_text(mine, encoding="utf-8")
    values = [w for post in (*POSTS, str(folder / "mine.toml")) for w in ("--post", post)]
    assert optimize(folder, "--quiet", *values) == 0
    return folder


def test_every_program_is_written_read_back_and_reported(job: Path) -> None:
    programs = result(job)["programs"]
    assert [p["post"] for p in programs] == [*POSTS, "mine.toml"]
    for p in programs:
        checked = p["checked"]
        files = [job / "out" / f for f in p["files"]]
        assert all(f.is_file() for f in files), p
        assert p["lines"] == sum(f.read_bytes().count(b"\n") for f in files)
        assert p["differences"] == []
        assert checked["moves"] >= 12  # ten points, plus the moves from and to home
        # five printed decimals of a degree at three metres; Yaskawa has whole pulses of 1/1000 degree
        most = {"jbi": 0.05, "ros_json": 0.07}  # samples are away from a corner by up to half a step
        assert checked["positions_max_mm"] < most.get(p["post"], 5e-4), p
        assert p["post"] == "ros_json" or checked["path_max_mm"] < 0.05, p  # samples have no lines
        assert checked["events_equal"] is True
        with_words = p["post"] in ("krl", "rapid", "fanuc", "val3", "mine.toml")
        assert checked["configuration_equal"] is (True if with_words else None), p
        if p["post"] in ("fanuc", "jbi"):
            assert checked["joints_max_deg"] is not None


def test_maker_specific_words_are_present(job: Path) -> None:
    out = job / "out"
    assert "E6AXIS" not in (out / "krl" / "part_apt.src").read_text()  # axis PTP targets are aggregates
    assert "MoveAbsJ" in (out / "rapid" / "part_apt.mod").read_text()
    assert "CONFIG" in (out / "fanuc" / "PART_APT.ls").read_text()
    assert "movel(" in (out / "urscript" / "part_apt.script").read_text()
    assert "MOVJ" in (out / "jbi" / "PART_APT.JBI").read_text()
    assert json.loads((out / "ros_json" / "part_apt.json").read_text())["joint_names"]
    own = (out / "mine" / "part_apt.src").read_text()
    assert "part_apt_001( )" in own  # split into parts of six moves
    assert any(name.endswith("mine.toml") for name in result(job)["inputs"])  # included in the hash of the inputs
    assert own.count("DEF ") == 1 + -(-result(job)["programs"][-1]["checked"]["moves"] // 6)


@pytest.mark.parametrize("file", ["krl/part_apt.src", "mine/part_apt.src", "rapid/part_apt.mod", "csv/part_apt.csv"])
def test_spindle_coolant_and_feeds_are_at_the_places_of_the_cam_file(job: Path, file: str) -> None:
    """Positions identify the moves, not numbers: each event is between the same two points as in the toolpath."""
    program = read_program(job / "out" / file)
    by = {e.text: e.index for e in program.events}
    place = program.T_base_tcp[:, :3, 3] * 1e3

    def towards(text: str) -> list[float]:
        """Return the end of the first Cartesian move at or after an event."""
        rows = by[text] + np.flatnonzero(np.isfinite(place[by[text] :, 0]))
        return [round(float(v), 3) + 0.0 for v in place[rows[0]]]

    assert by["SPINDL/1500,RPM,CLW"] <= 1  # before every move except home
    assert towards("COOLNT/ON") == [-100, 0, -0.5]
    assert towards("DELAY/1.5") == [-92, 0, -0.5]
    last = next(k for k, p in enumerate(place) if np.allclose(p, [-80, 4, 5], atol=1e-3))
    assert by["COOLNT/OFF"] == last + 1
    assert by["SPINDL/OFF"] > by["COOLNT/OFF"]
    for point, feed in (([-92, 0, -0.5], 1500), ([-84, 4, -0.5], 900), ([-100, 0, -0.5], 1500)):
        row = next(k for k, p in enumerate(place) if np.allclose(p, point, atol=1e-3) and np.isfinite(program.feed[k]))
        assert program.feed[row] * 6e4 == pytest.approx(feed, abs=0.03)  # six decimals of m/s


def test_custom_lines_of_the_cell_are_used(job: Path) -> None:
    assert "SPINDLE(1500)" in (job / "out" / "krl" / "part_apt.src").read_text()
    assert "SPINDLE" not in (job / "out" / "csv" / "part_apt.csv").read_text()  # a table does not contain such lines


def test_single_post_is_written_into_the_output_folder(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    copy_cell(tmp_path, CONTROLLER.replace("post: krl", "post: rapid").replace("(@{value:.0f})", " @{value:.0f};"))
    assert optimize(tmp_path) == 0
    assert (tmp_path / "out" / "part_apt.mod").is_file()  # the post of the cell
    assert "program part_apt.mod: " in capsys.readouterr().out
    assert optimize(tmp_path, "--quiet", "--post", "krl") == 0
    assert {"part_apt.src", "part_apt.dat"} <= {f.name for f in (tmp_path / "out").iterdir()}
    assert not (tmp_path / "out" / "part_apt.mod").exists()


@pytest.mark.parametrize(
    ("options", "words"),
    [
        (["--post", "karel"], "no post is named 'karel'"),
        (["--post", "nowhere.toml"], "no such file"),
        (["--post", "fanuc"], "controller.nonflip_j5"),
        (["--post", "krl", "--post", "krl"], "twice"),
        (["--post", "FIELD"], "no field is named 'a7'"),
        (["--post", "TAKEN"], "result.json, which is a name of the output folder's own"),
        (["--post", "UNCALLED"], "does not define how to run one"),
        (["--program-tolerance-mm", "0.01"], "more than path_tolerance_mm = 0.015 would work"),
        (["--program-tolerance-mm", "nan"], "--program-tolerance-mm"),
    ],
)
def test_unwritable_program_is_refused_before_planning(
    options: list[str], words: str, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    copy_cell(tmp_path)
    krl = read_post_text("krl")
    made = {
        "FIELD": krl.replace("A6 @{a6:.5f}", "A6 @{a7:.5f}"),
        "TAKEN": read_post_text("json").replace("@{name}.json", "result.json"),
        "UNCALLED": krl.replace('call = "@{part}( )"\n', ""),
    }
    for name, text in made.items():
        (tmp_path / f"{name}.toml").write_text(text, encoding="utf-8")
    words_given = [str(tmp_path / f"{o}.toml") if o in made else o for o in options]
    assert optimize(tmp_path, *words_given) == 2
    message = capsys.readouterr()
    assert words in message.err
    assert "collisions" not in message.err  # no stage of the plan has started
    assert not (tmp_path / "out").exists()


OWN = """machopt_post = 1
dialect = "krl"
title = "a language of its own"
name = { pattern = "[a-z_]+", length = 40 }
[[file]]
name = "@{name}.own"
text = '''
@{body}
'''
[block.moves]
ptp = "GO @{a1:.3f} @{a2:.3f}"
lin = "CUT @{x:.3f} @{y:.3f} @{z:.3f}"
"""


def test_language_without_a_reader_is_written_unchecked(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    copy_cell(tmp_path)
    (tmp_path / "own.toml").write_text(OWN, encoding="utf-8")
    assert optimize(tmp_path, "--post", str(tmp_path / "own.toml")) == 0
    assert "program part_apt.own: NOT CHECKED" in capsys.readouterr().out
    found = result(tmp_path)["programs"][0]
    assert (found["checked"], found["differences"]) == (None, [])
    lines = (tmp_path / "out" / "part_apt.own").read_text().splitlines()
    assert sum(line.startswith("CUT ") for line in lines) == 8
    # in KRL syntax it is read, and missing parts are reported
    krl = OWN.replace("text = '''\n", "text = '''\nDEF @{name}( )\n").replace("@{body}\n", "@{body}\nEND\n")
    (tmp_path / "own.toml").write_text(krl, encoding="utf-8")
    assert optimize(tmp_path, "--quiet", "--post", str(tmp_path / "own.toml")) == 4
    assert "readable" in capsys.readouterr().err


def test_arm_of_unknown_configuration_type_has_no_status(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    tracks = Path(__file__).resolve().parents[1] / "toolpaths" / "bone_tracks.csv"
    job = ["optimize", str(CELLS / "cutting_cobot"), str(tracks), "-o", str(tmp_path / "out"), "--post", "krl_pos"]
    assert main(job) == 2
    message = capsys.readouterr().err
    assert "so there is no S; the post krl works without" in message
    assert "collisions" not in message  # before planning


@pytest.mark.parametrize(
    ("old", "new", "words"),
    [
        (b"LIN {X -9", b"LIN {X -8", "targets on the motion"),
        (b",T ", b",T 1", "names another one"),
        (b"; CAM: COOLNT/ON", b"; cam", "6 for 7"),
    ],
)
def test_program_that_differs_from_the_plan_is_exit_4(
    old: bytes,
    new: bytes,
    words: str,
    tmp_path: Path,
    monkeypatch: pytest.MonkeyPatch,
    capsys: pytest.CaptureFixture[str],
) -> None:
    copy_cell(tmp_path, "controller: {post: krl}\n")

    def faulty(folder: Path | None, *rest: Any, **more: Any) -> list[Path]:
        files = write_program(folder, *rest, **more)
        for file in files[:1]:
            data = file.read_bytes()
            assert old in data
            file.write_bytes(data.replace(old, new, 1))
        return files

    monkeypatch.setattr(machopt.program_export.exported_programs, "write_program", faulty)
    assert optimize(tmp_path, "--quiet") == 4
    message = capsys.readouterr().err
    assert words in message
    assert "part_apt.src: " in message
    found = result(tmp_path)
    assert found["exit_code"] == 4
    assert found["verification"]["passed"] is False  # the motion is correct, its program is not
    assert all(".src" in c["name"] for c in found["verification"]["checks"] if c["passed"] is False)
    assert any(words in d for d in found["programs"][0]["differences"])
    page = (tmp_path / "out" / "report.html").read_text(encoding="utf-8")
    assert "VERIFICATION FAILED: DO NOT RUN" in page
    assert words in page.partition("<section id=programs>")[2]


def test_tolerance_includes_the_allowance_of_the_cell() -> None:
    plain, wide = PlanOptions(), PlanOptions(path_tolerance=1e-4, axis_tolerance=np.radians(1.0))
    assert build_tolerance(None, plain).position == pytest.approx(5e-5)
    assert build_tolerance(0.02, plain).position == pytest.approx(2e-5)
    assert build_tolerance(None, wide).position == pytest.approx(2e-4)  # corners alone deviate by 0.1 mm
    assert build_tolerance(None, wide).axis > wide.axis_tolerance
    assert build_tolerance(None, wide).turn > wide.axis_tolerance
    with pytest.raises(InputError, match=r"0\.05 mm; more than path_tolerance_mm = 0\.1"):
        build_tolerance(0.05, wide)


def test_points_are_added_where_the_controller_line_would_leave_the_motion(tmp_path: Path) -> None:
    """The tool tilts by 50° and rotates by 60° on one long segment:
    a uniform rotation about one axis differs from that."""
    table = tmp_path / "tilt.csv"
    s, c = np.sin(np.radians(25)), np.cos(np.radians(25))
    table.write_text(
        f"x_mm,y_mm,z_mm,i,j,k,move,feed_mm_min\n-60,0,90,0,{-s},{c},rapid,\n-60,0,80,0,{-s},{c},cut,600\n"
        f"60,0,80,0,{s},{c},cut,600\n60,0,90,0,{s},{c},cut,600\n"
    )
    t = read_toolpath(table)
    fixed = (FixedRotation(1, np.radians(-30)), FixedRotation(2, np.radians(30)))
    the_plan = plan_path(load_cell(CELLS / "kr500_milling"), t, PlanOptions(collision=False, fixed=fixed))
    timeline = build_timeline(the_plan, t)
    assert timeline.trajectory is not None
    robot, motion = the_plan.setup.robot, timeline.trajectory.q
    tight = ProgramTolerance(axis=np.radians(0.05), turn=np.radians(0.25))  # the default
    loose, close = (build_robot_program(the_plan, t, timeline, x) for x in (ProgramTolerance(1.0, 3.0, 3.0), tight))
    assert loose.added_targets == 0
    assert 0 < close.added_targets < 40
    samples = np.linalg.inv(close.program.T_base_workpiece) @ robot.compute_fk(motion, close.program.T_flange_tcp)
    for made, inside in ((loose, False), (close, True)):
        off = measure_line_deviation(samples, made.program.T_workpiece_tcp, made.at, made.program.kind == LIN)
        assert (off.share(tight).max() <= 1.0) is np.bool_(inside)
        found = write_and_compare_program(tmp_path / str(inside), the_plan, t, timeline, made, tight, "krl")
        assert (not found.differences) is inside, found.differences
        assert inside or any("along lines" in d for d in found.differences)
    assert (np.diff(close.at) >= 0).all()
    cut = close.program.cutting
    assert close.program.feed[cut] == pytest.approx(0.01)
    x = close.program.T_workpiece_tcp[cut, 0, 3]
    assert (np.diff(x) >= -1e-6).all()  # in path order


def test_point_at_the_current_tool_position_needs_no_feed(tmp_path: Path) -> None:
    """An approach ends where the first cut begins, each with its own feed: there is no motion between them."""
    cell = copy_cell(tmp_path, "controller: {post: krl}\n")
    rows = [(60, "rapid", ""), (20, "rapid", ""), (-0.5, "approach", 600), (-0.5, "cut", 1500)]
    lines = [f"-100,0,{z},0,0,1,{move},{feed}" for z, move, feed in rows]
    lines += [f"{x},0,-0.5,0,0,1,cut,1500" for x in (-90, -80)]
    file = tmp_path / "part.csv"
    file.write_text("\n".join(["x_mm,y_mm,z_mm,i,j,k,move,feed_mm_min", *lines]) + "\n", encoding="utf-8")
    out = str(tmp_path / "out")
    assert main(["optimize", str(cell), str(file), "-o", out, "--method", "default", "--quiet"]) == 0
    assert result(tmp_path)["programs"][0]["differences"] == []
