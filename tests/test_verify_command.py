"""``machopt verify``: use of the manifest, messages and exit codes."""

from __future__ import annotations

import json
import shutil
from collections.abc import Callable
from dataclasses import fields, replace
from pathlib import Path

import numpy as np
import pytest
from output_damage.damage_case import CELLS, HEADER, PASS, Job, copy_job, plan_table

from machopt.cell.cell_reader import load_cell
from machopt.cli import main
from machopt.commands.optimize.request import OptimizeRequest
from machopt.commands.optimize.run import run_optimize
from machopt.data_types.manifest import add_scope_to_verdict
from machopt.options.plan_option_reader import load_options
from machopt.output import read_manifest
from machopt.toolpath.toolpath_reader import read_toolpath
from machopt.verification import Verification, VerificationCheck
from machopt.verification.folder import verification_scope
from machopt.verification.folder.folder_checks import verify_folder
from machopt.verification.folder.result_json.result_checks import check_result_document
from machopt.verification.motion.tool_changes import verify_tool_segments
from machopt.verification.motion.worst_index_along_cuts import find_worst_index
from machopt.verification.tables.exported_tables import read_motion

PATHS = Path(__file__).resolve().parents[1] / "toolpaths"
KR500 = CELLS / "kr500_milling"
NOT_CHECKED = "collisions NOT checked"
SAMPLED = ("time", "point", "move", "q", "external", "gamma", "feed")  # arrays of a motion with one row per sample


@pytest.fixture(scope="module")
def without_collision(tmp_path_factory: pytest.TempPathFactory) -> Job:
    """A plan with wide tolerances, without collision checks and with gaps allowed."""
    wide = ("collision=false", "path_tolerance_mm=0.5", "axis_tolerance_deg=0.2", "allow_gaps=true")
    return plan_table(tmp_path_factory.mktemp("off"), KR500, PASS, overrides=wide)


@pytest.fixture(scope="module")
def plain(damage_job: Callable[[str], Job]) -> Job:
    return damage_job("pass")


def run_verify(job: Job, *options: str) -> int:
    return main(["verify", str(job.cell), str(job.toolpath), str(job.out), *options])


def test_disabled_checks_are_reported_everywhere_alike(
    without_collision: Job, capsys: pytest.CaptureFixture[str]
) -> None:
    words = (
        NOT_CHECKED,
        "path tolerance 0.5 mm instead of 0.02 mm",
        "tool axis tolerance 0.2 deg instead of 0.05 deg",
        "gaps allowed",
    )
    out = without_collision.out
    result = json.loads((out / "result.json").read_text())
    manifest, _ = read_manifest(out)
    assert tuple(result["unchecked"]) == manifest.unchecked == words
    assert result["verdict"] == manifest.verdict == add_scope_to_verdict("done", words)
    assert add_scope_to_verdict("VERIFIED", words) in (out / "report.html").read_text()
    assert "contacts" not in {c.what for c in manifest.checked}
    assert run_verify(without_collision) == 0
    assert capsys.readouterr().out.splitlines()[-1] == add_scope_to_verdict("verification passed", words)


def test_exclusions_of_a_cell_are_part_of_the_verdict(tmp_path: Path) -> None:
    shutil.copytree(KR500, tmp_path / "cell")
    text = (tmp_path / "cell" / "cell.yaml").read_text()
    cell = load_cell(tmp_path / "cell")
    assert verification_scope.list_unchecked(cell, load_options(cell.plan)) == ()
    half = replace(read_toolpath(PATHS / "plain.csv"), meta={"incomplete": "no FINI"})
    assert "after the end of the CAM file" in verification_scope.list_unchecked(cell, load_options(cell.plan), half)[0]
    lines = [line for line in text.splitlines() if not line.strip().startswith(("geometry:", "cutter:"))]
    retained = "\n".join(lines)
    start = retained.index("obstacles:")
    end = retained.index("stiffness:")
    (tmp_path / "cell" / "cell.yaml").write_text(retained[:start] + retained[end:])
    cell = load_cell(tmp_path / "cell")
    assert verification_scope.list_unchecked(cell, load_options(cell.plan)) == (
        "collisions with workpiece, tool, cutter and obstacles NOT checked (not in the cell)",
    )


def test_check_that_could_not_run_is_part_of_the_verdict() -> None:
    checks = [
        VerificationCheck(name="path", passed=True, value=0.0, limit=1.0, unit="mm", where=""),
        VerificationCheck(name="program a.src", passed=None, value=0.0, limit=0.0, unit="", where="no reader"),
    ]
    assert verification_scope.list_checks_not_run(checks) == ("program a.src NOT checked",)


def test_options_and_reading_come_from_the_manifest(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    """The table has no feed and the tolerances are wide: without the manifest the verification would fail."""
    toolpath = tmp_path / "pass.csv"
    toolpath.write_text("x_mm,y_mm,z_mm,i,j,k,move\n" + "".join(f"{x},{y},{z},0,0,1,{m}\n" for x, y, z, m, _ in PASS))
    wide = ("path_tolerance_mm=0.4", "rotation_step_deg=15")
    request = OptimizeRequest(
        cell=KR500, toolpath=toolpath, out=tmp_path / "out", overrides=wide, reading={"default_feed": 1100 / 60e3}
    )
    assert run_optimize(request).exit_code == 0
    assert read_manifest(tmp_path / "out")[0].reading == {"feed_mm_min": 1100.0}
    job = Job(KR500, toolpath, tmp_path / "out")
    assert run_verify(job) == 0
    message = capsys.readouterr().out
    assert "note:" not in message
    assert message.splitlines()[-1] == "verification passed, path tolerance 0.4 mm instead of 0.02 mm"
    assert run_verify(job, "--set", "collision=false", "--feed", "500") == 4  # the motion is faster than that feed
    message = capsys.readouterr().out
    assert "note: collision = False here, but the folder was made with True" in message
    assert "note: feed_mm_min = 500.0 here, but the folder was made with 1100.0" in message


def test_verify_names_the_inputs_of_the_folder(plain: Job, tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    job = copy_job(plain, tmp_path)
    file = job.cell / "stiffness.yaml"
    recorded = next(f for f in read_manifest(job.out)[0].inputs if f.role == "stiffness")
    file.write_text(file.read_text() + "# measured again\n")
    assert run_verify(job) == 4
    message = capsys.readouterr()
    assert "another stiffness: stiffness.yaml" in message.err
    assert recorded.sha256[:12] in message.err


def test_same_files_elsewhere_are_the_same_inputs(plain: Job, tmp_path: Path) -> None:
    job = copy_job(plain, tmp_path)
    renamed = job.toolpath.with_name("renamed.csv")
    job.toolpath.rename(renamed)
    assert run_verify(Job(job.cell, renamed, job.out)) == 0


def test_folder_without_manifest_is_checked_and_fails_by_name(
    plain: Job, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    job = copy_job(plain, tmp_path)
    (job.out / "manifest.json").unlink()
    assert run_verify(job, "--set", "rotation_step_deg=15") == 4
    message = capsys.readouterr()
    assert "was written by a version before manifests, or the file was removed" in message.err
    assert "ok   path" in message.out  # the checks of the tables are executed nevertheless


@pytest.mark.parametrize(
    "text", ["", "{", "null", "[]", '{"machopt_manifest": 1}', "\x00\x01", "{" * 5000, '{"files": {"x": NaN}}']
)
def test_invalid_manifest_is_a_named_failure(
    text: str, plain: Job, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    job = copy_job(plain, tmp_path)
    (job.out / "manifest.json").write_text(text)
    assert run_verify(job, "--quiet") == 4
    assert "manifest.json" in capsys.readouterr().err


def test_infeasible_plan_leaves_no_program_and_verifies_as_such(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    toolpath = tmp_path / "far.csv"
    toolpath.write_text(HEADER + "\n9000,0,0,0,0,1,cut,1000\n9010,0,0,0,0,1,cut,1000\n")
    out = tmp_path / "out"
    assert (
        main(["optimize", str(KR500), str(toolpath), "-o", str(out), "--quiet", "--post", "krl", "--post", "rapid"])
        == 3
    )
    assert {f.name for f in out.iterdir()} == {"manifest.json", "points.csv", "report.html", "result.json"}
    result = json.loads((out / "result.json").read_text())
    assert [(p["post"], p["files"]) for p in result["programs"]] == [("krl", []), ("rapid", [])]
    assert all("no motion" in p["withheld"] for p in result["programs"])
    assert "withheld" in (out / "report.html").read_text()
    assert read_manifest(out)[0].programs == ()
    capsys.readouterr()
    assert run_verify(Job(KR500, toolpath, out)) == 3
    assert "intact, but without a motion" in capsys.readouterr().out
    text = (out / "points.csv").read_text()
    (out / "points.csv").write_text(text.replace("unreachable", "ok", 1))
    assert run_verify(Job(KR500, toolpath, out)) == 4


def test_plan_that_fails_verification_leaves_no_program(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    def broken(*args: object, **options: object) -> Verification:
        found = verify_tool_segments(*args, **options)  # type: ignore[arg-type]
        return Verification(
            (
                *found.checks,
                VerificationCheck(name="weather", passed=False, value=1.0, limit=0.0, unit="drops", where="above"),
            ),
            found.samples,
            1.0,
        )

    monkeypatch.setattr("machopt.verification.folder.folder_checks.verify_tool_segments", broken)
    toolpath = tmp_path / "pass.csv"
    toolpath.write_text(HEADER + "\n" + "".join(f"{x},{y},{z},0,0,1,{move},{feed}\n" for x, y, z, move, feed in PASS))
    out = tmp_path / "out"
    done = run_optimize(
        OptimizeRequest(
            cell=KR500, toolpath=toolpath, out=out, overrides=("rotation_step_deg=15",), posts=("krl", "urscript")
        )
    )
    assert done.exit_code == 4
    assert {f.name for f in out.iterdir()} == {
        "manifest.json",
        "points.csv",
        "rapid_corners.csv",
        "report.html",
        "result.json",
        "trajectory.csv",
    }
    result = json.loads((out / "result.json").read_text())
    assert [p["withheld"] for p in result["programs"]] == ["verification failed", "verification failed"]
    assert read_manifest(out)[0].programs == ()
    assert "withheld: verification failed" in (out / "report.html").read_text()


def test_folders_of_other_commands_are_refused_by_name(
    plain: Job, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    assert (
        main(
            [
                "map",
                str(KR500),
                "-o",
                str(tmp_path / "map"),
                "--quiet",
                "--step",
                "800",
                "--collision",
                "none",
                "--rotation-step",
                "90",
            ]
        )
        == 0
    )
    manifest, sealed = read_manifest(tmp_path / "map")
    assert sealed
    assert manifest.unchecked == (NOT_CHECKED,)
    assert manifest.verdict.endswith(NOT_CHECKED)
    assert {f.role for f in manifest.inputs} >= {"cell", "urdf", "stiffness"}
    assert run_verify(Job(plain.cell, plain.toolpath, tmp_path / "map"), "--quiet") == 4
    assert "is of machopt map" in capsys.readouterr().err


def test_every_part_of_a_result_is_checked(plain: Job, tmp_path: Path) -> None:
    """If any key is removed from result.json, a check fails."""
    message: Callable[[Path], list[str]] = lambda out: [  # noqa: E731
        c.name
        for c in check_result_document(out, cell, toolpath, options, manifest.inputs, manifest, contents)
        if not c.passed
    ]
    cell = load_cell(plain.cell)
    manifest, _ = read_manifest(plain.out)
    options = load_options(dict(manifest.options))
    from machopt.toolpath.toolpath_reader import read_toolpath

    toolpath = read_toolpath(plain.toolpath)
    from machopt.verification.folder.folder_checks import check_contents

    contents = check_contents(cell, toolpath, plain.out, options=options, manifest=manifest)
    assert message(plain.out) == []
    job = copy_job(plain, tmp_path)
    whole = json.loads((job.out / "result.json").read_text())
    for key in whole:
        if key in {"tilt", "joint", "reentry"} and whole[key] is None:
            continue  # older results do not contain the key; a missing key is equivalent to null
        (job.out / "result.json").write_text(json.dumps({k: v for k, v in whole.items() if k != key}))
        assert message(job.out), key


def test_verdict_does_not_depend_on_cores_or_length(plain: Job, monkeypatch: pytest.MonkeyPatch) -> None:
    def found() -> list[str]:
        done = verify_folder(cell, toolpath, plain.out, options=options, inputs=manifest.inputs)
        return [repr(check) for check in done.checks]

    cell, toolpath = load_cell(plain.cell), read_toolpath(plain.toolpath)
    manifest, _ = read_manifest(plain.out)
    options = load_options(dict(manifest.options))
    monkeypatch.setattr("machopt.numerics.parallel_map.count_threads", lambda: 2)
    first = found()
    assert any(".src" in check for check in first)  # at least one check concerns a program
    monkeypatch.setattr("machopt.numerics.parallel_map.count_threads", lambda: 1)
    assert found() == first
    monkeypatch.setattr("machopt.numerics.parallel_map.count_threads", lambda: 2)
    monkeypatch.setattr("machopt.verification.folder.folder_checks.MAX_PARALLEL_SAMPLES", 1)
    assert found() == first


LONG: tuple[tuple[float, float, float, str, str], ...] = (
    (-300, 0, 60, "rapid", ""),
    (-300, 0, 5, "approach", "3000"),
    (-300, 0, 1, "cut", "3000"),
    (300, 0, 1, "cut", "9000"),
    (300, 0, 60, "rapid", ""),
)


def test_impossible_worst_index_is_detected(tmp_path: Path) -> None:
    """The index between two points 0.6 m apart is recomputed;
    a stated worst index 5 % above the true one is detected."""
    job = plan_table(tmp_path, KR500, LONG)
    cell, toolpath = load_cell(job.cell), read_toolpath(job.toolpath)
    manifest, _ = read_manifest(job.out)
    assert manifest is not None
    options = load_options(dict(manifest.options))
    message = json.loads((job.out / "result.json").read_text())
    motion = read_motion(job.out / "trajectory.csv", cell)
    along = find_worst_index(cell, toolpath, motion, "deflection", options)
    own = message["objective"]["chosen"]
    # here the worst index is at an end point
    assert along == pytest.approx(own["worst"] * message["index_scale"], rel=0.01)
    middle = np.abs(motion.point - 2.5) < 0.1
    rows = {f.name: getattr(motion, f.name)[middle] for f in fields(motion) if f.name in SAMPLED}
    assert find_worst_index(cell, toolpath, replace(motion, **rows), "deflection", options) < along

    def failing(factor: float) -> list[str]:
        more = (factor - 1.0) * own["worst"]
        chosen = {**own, "worst": own["worst"] + more, "total": own["total"] + options.weights.worst * more}
        (job.out / "result.json").write_text(
            json.dumps({**message, "objective": {**message["objective"], "chosen": chosen}})
        )
        found = check_result_document(
            job.out, cell, toolpath, options, manifest.inputs, manifest, Verification((), 0, 0.0)
        )
        return [c.where for c in found if not c.passed and "chosen.worst" in c.where]

    assert not failing(1.0)
    assert failing(1.05)
