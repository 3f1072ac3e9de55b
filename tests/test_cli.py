"""Complete commands with ``machopt.cli.main``: exit codes, messages, folders, determinism, an independent check."""

from __future__ import annotations

import contextlib
import csv
import io
import json
import os
import re
import runpy
import shutil
import signal
import subprocess
import sys
import warnings
from collections.abc import Sequence
from pathlib import Path

import pytest

from machopt.cli import main
from machopt.data_types.documents.inspect_documents import InspectedToolpathDocument
from machopt.data_types.documents.verify_document import VerifyDocument

ROOT = Path(__file__).resolve().parents[1]
CELLS, TOOLPATHS = ROOT / "cells", ROOT / "toolpaths"
KR500 = CELLS / "kr500_milling"
CHECK_PLAN = ROOT.parent / "shared" / "tools" / "check_plan.py"
HEADER = "x_mm,y_mm,z_mm,i,j,k,move,feed_mm_min"
Row = tuple[float, float, float, str, str]  # x, y, z, move, feed

# a short pass over the cylinder head, with approach and retract at feed
PASS: list[Row] = [
    (-100, 0, 60, "rapid", ""),
    (-100, 0, 5, "approach", "1000"),
    *((-100 + 2.0 * i, 0, -0.5, "cut", "1500") for i in range(12)),
    (-78, 0, 5, "retract", "1000"),
    (-78, 0, 60, "rapid", ""),
]


def toolpath(folder: Path, rows: Sequence[Row], name: str = "pass.csv") -> Path:
    file = folder / name
    file.write_text(HEADER + "\n" + "".join(f"{x},{y},{z},0,0,1,{move},{feed}\n" for x, y, z, move, feed in rows))
    return file


def changed_cell(folder: Path, *edits: tuple[str, str], base: Path = KR500) -> Path:
    """Copy a shipped cell and replace text in its cell.yaml."""
    cell = folder / "cell"
    shutil.copytree(base, cell)
    text = (cell / "cell.yaml").read_text()
    for old, new in edits:
        assert old in text, old
        text = text.replace(old, new)
    (cell / "cell.yaml").write_text(text)
    return cell


@pytest.fixture(scope="module")
def passed(tmp_path_factory: pytest.TempPathFactory) -> tuple[Path, Path]:
    """Return table and output folder of the short pass, planned once; a test that changes the folder copies it."""
    folder = tmp_path_factory.mktemp("passed")
    table = toolpath(folder, PASS)
    assert optimize(KR500, table, folder / "out") == 0
    return table, folder / "out"


def optimize(cell: Path, path: Path, out: Path, *options: str) -> int:
    return main(["optimize", str(cell), str(path), "-o", str(out), "--quiet", *options])


def result(out: Path) -> dict[str, object]:
    value = json.loads((out / "result.json").read_text())
    assert isinstance(value, dict)
    return value


def gammas(out: Path) -> list[float]:
    with (out / "points.csv").open() as lines:
        return [float(r["gamma_deg"]) for r in csv.DictReader(lines) if r["move"] == "cut"]


def true_points(table: Path, out: Path) -> Path:
    """Write the table for the independent program: moves are rapid or cut, and rows without a feed get the following
    one."""
    rows = list(csv.DictReader(line for line in table.read_text().splitlines() if not line.startswith("#")))
    feed = "1000"
    for row in reversed(rows):
        if row["move"] != "cut":
            row["move"] = "rapid"
            row["feed_mm_min"] = row["feed_mm_min"] or feed
        feed = row["feed_mm_min"]
    with out.open("w", newline="") as file:
        writer = csv.DictWriter(file, HEADER.split(","), extrasaction="ignore")
        writer.writeheader()
        writer.writerows(rows)
    return out


def check_plan(cell: Path, table: Path, out: Path) -> None:
    """Run the acceptance program, which shares no code with machopt."""
    if not CHECK_PLAN.exists():
        pytest.skip(f"{CHECK_PLAN} is not here: the acceptance program lies beside a development checkout only")
    pytest.importorskip("coal")
    points = true_points(table, out.parent / "true_points.csv")
    program = runpy.run_path(str(CHECK_PLAN))  # in this process, which has already loaded most of its imports
    stream = io.StringIO()
    with contextlib.redirect_stdout(stream), warnings.catch_warnings():
        warnings.simplefilter("ignore")  # warnings of the external program
        code = program["main"]([str(cell), str(points), str(out)])
    assert code == 0, stream.getvalue()


@pytest.mark.slow
@pytest.mark.parametrize(
    ("cell", "path"),
    [
        ("kr500_milling", "plain.csv"),
        ("kr240_drilling", "panel_holes.csv"),
        ("irb6700_drilling", "plate_holes.csv"),
        ("s420f_handling", "castings.csv"),
        ("cutting_cobot", "bone_tracks.csv"),
    ],
)
def test_every_shipped_cell_is_planned_and_independently_checked(
    cell: str, path: str, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    out = tmp_path / "out"
    assert optimize(CELLS / cell, TOOLPATHS / path, out, "--sample-ms", "36") == 0, capsys.readouterr().err
    message = capsys.readouterr()
    assert message.out == ""
    assert message.err == ""
    names = {f.name for f in out.iterdir()}
    assert {"trajectory.csv", "points.csv", "result.json", "report.html"} <= names
    written = [name for program in result(out)["programs"] for name in program["files"]]
    assert written
    assert set(written) <= names
    found = result(out)
    assert str(found["verdict"]).split(", ")[0] == "done"  # the verdict may also list omitted checks of the cell
    assert found["verification"]["passed"] is True  # type: ignore[index]
    check_plan(CELLS / cell, TOOLPATHS / path, out)


@pytest.mark.slow
def test_cam_export_runs_end_to_end(tmp_path: Path) -> None:
    """The first fifth of the groove with its changing tool axis; cylinder_head_face.cls is the job of `make run`."""
    lines = (TOOLPATHS / "contour_5axis.nc").read_text(encoding="utf-8").splitlines()
    place = re.search(r" X\S+ Y\S+ ", lines[490])
    assert place is not None
    program = [*lines[:491], f"N9999 G0{place[0]}Z60.0000 I0.0000000 J0.0000000 K1.0000000", *lines[-5:]]
    (tmp_path / "groove.nc").write_text("\n".join(program) + "\n", encoding="utf-8")
    assert optimize(KR500, tmp_path / "groove.nc", tmp_path / "out") == 0


def test_summary_names_the_report_and_json_is_one_object(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    table = toolpath(tmp_path, PASS)
    arguments = ["optimize", str(KR500), str(table), "-o", str(tmp_path / "out")]
    assert main(arguments) == 0
    message = capsys.readouterr()
    assert message.out.splitlines()[0].startswith("done: 12 cutting points of 16")
    assert message.out.splitlines()[-1] == f"report: {tmp_path / 'out' / 'report.html'}"
    assert "reading cell and toolpath" in message.err
    assert main([*arguments, "--json"]) == 0
    message = capsys.readouterr()
    assert json.loads(message.out)["exit_code"] == 0
    assert message.err == ""


def test_two_runs_write_the_same_tables_and_program(passed: tuple[Path, Path], tmp_path: Path) -> None:
    table, out = passed
    assert optimize(KR500, table, tmp_path / "out") == 0
    for name in ("trajectory.csv", "points.csv", "pass_csv.src", "pass_csv.dat"):
        assert (out / name).read_bytes() == (tmp_path / "out" / name).read_bytes(), name


def test_earlier_output_is_replaced_and_a_foreign_folder_is_not(
    passed: tuple[Path, Path], tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    table, out = passed[0], tmp_path / "out"
    shutil.copytree(passed[1], out)
    (out / "report.html").write_text("spoilt")
    assert optimize(KR500, table, out) == 2
    assert "report.html" in capsys.readouterr().err
    assert (out / "report.html").read_text() == "spoilt"
    assert optimize(KR500, table, out, "--force") == 0
    assert (out / "report.html").read_text() != "spoilt"
    (out / "notes.txt").write_text("the user's own")
    assert optimize(KR500, table, out) == 2
    assert "notes.txt, which machopt did not write" in capsys.readouterr().err
    assert (out / "notes.txt").read_text() == "the user's own"
    mine = tmp_path / "mine"
    mine.mkdir()
    (mine / "thesis.txt").write_text("precious")
    assert optimize(KR500, table, mine) == 2
    assert "is not an earlier machopt output" in capsys.readouterr().err
    assert [f.name for f in mine.iterdir()] == ["thesis.txt"]


def _heed_interrupts() -> None:
    """Restore the default SIGINT handler; a shell starts background jobs with SIGINT ignored, and child processes
    inherit that."""
    signal.signal(signal.SIGINT, signal.SIG_DFL)


def _run_until(stage: str, number: int, table: Path, out: Path) -> int:
    """Start the command in its own process and send it a signal when it announces a stage."""
    command = [sys.executable, "-m", "machopt.cli", "optimize", str(KR500), str(table), "-o", str(out)]
    with subprocess.Popen(
        command,
        cwd=ROOT,
        stdout=subprocess.DEVNULL,
        stderr=subprocess.PIPE,
        text=True,
        env={**os.environ, "PYTHONPATH": str(ROOT)},
        preexec_fn=_heed_interrupts,  # noqa: PLW1509 — no threads are running here
    ) as process:
        assert process.stderr is not None
        for line in process.stderr:
            if stage in line:
                break
        process.send_signal(number)
        process.stderr.read()
        return process.wait()


@pytest.mark.slow
@pytest.mark.skipif(sys.platform == "win32", reason="POSIX signals")
@pytest.mark.parametrize(
    ("number", "code", "stage"),
    [
        (signal.SIGTERM, 143, "verifying"),  # half of the output is written; for INT see tests/test_output_folder.py
        (signal.SIGKILL, -9, "verifying"),
    ],
)
def test_killed_run_leaves_no_partial_output(number: int, code: int, stage: str, tmp_path: Path) -> None:
    table, folder = toolpath(tmp_path, PASS), tmp_path / "results"
    folder.mkdir()
    assert _run_until(stage, number, table, folder / "out") == code
    assert not (folder / "out").exists()
    left = [f.name for f in folder.iterdir()]
    assert left == [] if number != signal.SIGKILL else all(name.startswith(".out.") for name in left)
    if left:
        assert optimize(KR500, table, folder / "out") == 0  # the remainder does not prevent a new run, and is deleted
        assert [f.name for f in folder.iterdir()] == ["out"]


def test_unreadable_toolpaths_are_refused_with_a_clear_message(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    good = toolpath(tmp_path, PASS).read_text()
    cases = {
        "empty.csv": ("", "is empty"),
        "header.csv": (HEADER + "\n", "no rows"),
        "half.csv": (good[: len(good) // 2].rsplit(",", 3)[0] + "\n", "expected 8 as in the header"),
        "nan.csv": (good.replace("-98.0,0", "nan,0", 1), "column x_mm: found 'nan'"),
        "rapid.csv": (good.replace("cut", "rapid").replace("approach", "rapid"), "no cutting move"),
        "nofeed.csv": (good.replace("cut,1500", "cut,"), "--feed"),
        "zero.csv": (good.replace("cut,1500", "cut,0"), "expected a feed above zero"),
        "far.csv": (good.replace("-98.0,0", "1e9,0", 1), "expected less than"),
        "word.csv": (good.replace("cut,", "mill,", 1), "expected one of cut, rapid"),
        "column.csv": (good.replace("feed_mm_min", "feed_mmmin"), "did you mean 'feed_mm_min'"),
    }
    for name, (text, words) in cases.items():
        file = tmp_path / name
        file.write_text(text)
        assert optimize(KR500, file, tmp_path / "out") == 2, name
        message = capsys.readouterr()
        assert words in message.err, name
        assert message.err.startswith(f"machopt: {file}"), name
        assert "Traceback" not in message.err
        assert not (tmp_path / "out").exists()
    assert optimize(KR500, tmp_path / "nowhere.csv", tmp_path / "out") == 2


@pytest.mark.parametrize(
    ("edit", "words"),
    [
        (("stiffness: stiffness.yaml", ""), "names no stiffness"),
        (("stiffness: stiffness.yaml", "stiffness: nope.yaml"), "no such file: nope.yaml"),
        (("[84, 79, 75, 81, 79, 124]", "[84, 79, 75, 81, 79]"), "expected 6"),
        (("home_deg: [0,", "home_deg: [500,"), "its range is"),
        (("xyz_mm: [2140.7,", "xyz_mm: [.nan,"), "expected a finite number"),
        (("meshes/workpiece.stl", "meshes/nope.stl"), "no such file: meshes/nope.stl"),
        (("external_joints: []", "external_joints: [rail]"), "joint 'rail' is not in robot.urdf"),
        (("machopt_cell: 1", "machopt_cell: 2"), "found 2; expected 1"),
    ],
)
def test_invalid_cells_are_refused_with_a_clear_message(
    edit: tuple[str, str], words: str, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    cell = changed_cell(tmp_path, edit)
    assert optimize(cell, toolpath(tmp_path, PASS), tmp_path / "out") == 2
    message = capsys.readouterr().err
    assert words in message
    assert str(cell) in message
    assert not (tmp_path / "out").exists()


@pytest.mark.parametrize(
    ("options", "words"),
    [
        (["--set", "rotation_stp_deg=3"], "did you mean 'rotation_step_deg'"),
        (["--set", "foo"], "expected key=value"),
        (["--set", "weights.men=1"], "did you mean 'mean'"),
        (["--set", "rotation_range_deg=[30,-30]"], "lowest < highest"),
        (["--set", "weights={mean: 0, worst: 0}"], "one of them above 0"),
        (["--set", "fixed=[{point: 500, gamma_deg: 10}]"], "has points 0 to 15"),
        (["--sample-ms", "0"], "sample_ms"),
        (["--feed", "-3"], "--feed"),
        (["--plan", "nope.yaml"], "nope.yaml"),
    ],
)
def test_invalid_options_are_refused_with_a_clear_message(
    options: list[str], words: str, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    assert optimize(KR500, toolpath(tmp_path, PASS), tmp_path / "out", *options) == 2
    assert words in capsys.readouterr().err


def test_unreachable_workpiece_is_exit_3_with_a_report_of_the_distance(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    cell = changed_cell(tmp_path, ("xyz_mm: [2140.7, -23.5, 784.3]", "xyz_mm: [5140.7, -23.5, 784.3]"))
    out = tmp_path / "out"
    assert optimize(cell, toolpath(tmp_path, PASS), out) == 3
    message = capsys.readouterr().err
    assert "out of reach at every rotation" in message
    assert "mm outside" in message
    assert not (out / "trajectory.csv").exists()
    with (out / "points.csv").open() as lines:
        assert {r["status"] for r in csv.DictReader(lines)} == {"unreachable"}
    page = (out / "report.html").read_text()
    assert "NO FEASIBLE ANSWER" in page
    assert "mm out of reach" in page


def test_frame_in_metres_is_suspected_in_a_message(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    cell = changed_cell(tmp_path, ("xyz_mm: [2140.7, -23.5, 784.3]", "xyz_mm: [2.1407, -0.0235, 0.7843]"))
    assert optimize(cell, toolpath(tmp_path, PASS), tmp_path / "out") == 3
    assert "looks like metres" in capsys.readouterr().err


def test_missing_bodies_are_reported(tmp_path: Path) -> None:
    cell = changed_cell(tmp_path, ("  geometry: [{name: workpiece, mesh: meshes/workpiece.stl}]\n", ""))
    assert optimize(cell, toolpath(tmp_path, PASS), tmp_path / "out") == 0
    assert any("workpiece.geometry" in str(w) for w in result(tmp_path / "out")["warnings"])  # type: ignore[attr-defined]


def test_allow_gaps_plans_the_reachable_rest(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    far: list[Row] = [(4000, 0, 60, "rapid", ""), (4000, 0, -0.5, "cut", "300"), (4000, 0, 60, "rapid", "")]
    table, out = toolpath(tmp_path, [*PASS, *far, *PASS]), tmp_path / "out"
    assert optimize(KR500, table, out) == 3
    assert optimize(KR500, table, out, "--allow-gaps") == 0
    assert str(result(out)["verdict"]).startswith("done with gaps: 1 point not cut")
    capsys.readouterr()
    verify = ["verify", str(KR500), str(table), str(out), "--quiet"]
    assert main(verify) == 0  # uses allow_gaps from the manifest; the verdict states the gap
    assert main([*verify, "--set", "allow_gaps=false"]) == 4  # with allow_gaps=false the gap is an error


@pytest.mark.parametrize(
    "options", [["--set", "rotation_range_deg=[80,100]"], ["--set", "rotation_range_deg=[150,180]"]]
)
def test_rotation_range_is_respected(options: list[str], tmp_path: Path) -> None:
    code = optimize(KR500, toolpath(tmp_path, PASS), tmp_path / "out", *options)
    assert code in (0, 3)
    low, high = json.loads(options[1].split("=")[1])
    if code == 0:
        assert all(low - 0.1 <= g <= high + 0.1 for g in gammas(tmp_path / "out"))


def test_fixed_rotations_are_respected(tmp_path: Path) -> None:
    assert (
        optimize(KR500, toolpath(tmp_path, PASS), tmp_path / "out", "--set", "fixed=[{point: 5, gamma_deg: 20}]") == 0
    )
    # deg; retiming smooths the rotation; 2 … 13 are cutting points
    assert gammas(tmp_path / "out")[3] == pytest.approx(20, abs=0.5)


@pytest.mark.parametrize(
    "options",
    [["--method", "jiao2022"], ["--index", "jiao2022"], ["--sample-ms", "4"], ["--set", "force_N={axial: 200}"]],
)
def test_valid_options_are_accepted(options: list[str], tmp_path: Path) -> None:
    table = toolpath(tmp_path, PASS)
    assert optimize(KR500, table, tmp_path / "out", *options) == 0
    check_plan(KR500, table, tmp_path / "out")


@pytest.mark.parametrize(
    "rows", [PASS[2:-2], [PASS[0], *PASS[2:-2], PASS[-1]]], ids=["cuts only", "rapid to and from the cut"]
)
def test_rapid_move_from_inside_a_cut_retracts_along_the_tool_axis(rows: list[Row], tmp_path: Path) -> None:
    """The rapid move starts with the cutter in the workpiece: it first retracts along the tool axis.

    The position is between two bores, where there is material: the pass of 22 mm starts 15 mm before the middle of the
    head.
    """
    deep = [(x + 85, y, z - 5 if move == "cut" else z, move, feed) for x, y, z, move, feed in rows]
    table = toolpath(tmp_path, deep)
    assert optimize(KR500, table, tmp_path / "out") == 0
    check_plan(KR500, table, tmp_path / "out")


def test_holes_drilled_at_feed_and_left_in_rapid(tmp_path: Path) -> None:
    rows: list[Row] = []
    for x in (-4.0, 4.0):  # the web between two bores
        rows += [(x, 0, 40, "rapid", ""), (x, 0, -10, "cut", "300"), (x, 0, 40, "rapid", "")]
    table = toolpath(tmp_path, rows)
    assert optimize(KR500, table, tmp_path / "out") == 0
    check_plan(KR500, table, tmp_path / "out")


def test_dense_points_with_tangential_lead_in_and_lead_out(tmp_path: Path) -> None:
    """Points 0.02 mm apart at 1500 mm/min: fifteen points per sample, and no corner that slows the change of the
    move type."""
    words = ["approach"] * 200 + ["cut"] * 300 + ["retract"] * 200
    rows: list[Row] = [(-100 + 0.02 * i, 0, -0.5, move, "1500") for i, move in enumerate(words)]
    table = toolpath(tmp_path, [(-100, 0, 60, "rapid", ""), *rows, (-86, 0, 60, "rapid", "")])
    assert optimize(KR500, table, tmp_path / "out") == 0
    check_plan(KR500, table, tmp_path / "out")


def test_verify_refuses_a_changed_trajectory(
    passed: tuple[Path, Path], tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    table, out = passed[0], tmp_path / "out"
    shutil.copytree(passed[1], out)
    verify = ["verify", str(KR500), str(table), str(out), "--quiet"]
    capsys.readouterr()
    assert main([*verify, "--json"]) == 0
    message = json.loads(capsys.readouterr().out)
    assert VerifyDocument.model_validate(message).to_json_types() == message
    assert message["passed"]
    assert message["checks"]
    assert message["verdict"].startswith("verification passed")
    file = out / "trajectory.csv"
    header, *lines = file.read_text().splitlines()
    cut = [k for k, line in enumerate(lines) if line.split(",")[3] == "cut"]

    def shifted(line: str) -> str:
        cells = line.split(",")
        cells[5] = f"{float(cells[5]) + 0.01:.9f}"  # q2 by 0.01°: about 0.4 mm at the tool
        return ",".join(cells)

    middle = cut[len(cut) // 2]
    tampered = {
        "path": [shifted(line) if k in cut else line for k, line in enumerate(lines)],
        "uniform time": [line for k, line in enumerate(lines) if k not in cut[20:60]],
        "joint": [shifted(line) if k == middle else line for k, line in enumerate(lines)],
        "moves of the samples": [line.replace(",cut,", ",rapid,") for line in lines],
    }
    for words, rows in tampered.items():
        file.write_text("\n".join([header, *rows]) + "\n")
        capsys.readouterr()
        assert main(verify) == 4, words
        assert words in capsys.readouterr().err
    assert main(["verify", str(KR500), str(table), str(tmp_path / "nowhere")]) == 2


@pytest.mark.parametrize(
    ("file", "points"), [("plain.csv", 201), ("panel_holes.aptsource", 480), ("contour_5axis.nc", 2403)]
)
def test_inspect_lists_the_content_of_a_file(file: str, points: int, capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["inspect", str(TOOLPATHS / file), "--json"]) == 0
    message = json.loads(capsys.readouterr().out)
    assert InspectedToolpathDocument.model_validate(message).to_json_types() == message
    assert message["points"] == points
    assert main(["inspect", str(TOOLPATHS / file)]) == 0
    assert f"points: {points}" in capsys.readouterr().out
