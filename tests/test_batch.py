"""``machopt batch``: executed, refused, crashed and resumed jobs."""

from __future__ import annotations

import contextlib
import csv
import json
import os
import re
import shutil
import socket
import subprocess
import sys
from dataclasses import replace
from pathlib import Path

import psutil
import pytest
from batch_stub_jobs import CELL, contents, folder_of, request_for, times_run

from machopt.batch.job_supervisor import JobSpec, ProcessServer
from machopt.batch.request import BatchProgress, BatchRequest, BatchResult
from machopt.batch.run import run_batch
from machopt.errors import InputError
from machopt.output import read_manifest
from machopt.output.file_hashes import compute_sha256
from machopt.programs.program_writer import read_post_text

ROOT = Path(__file__).resolve().parents[1]
TOOLPATHS = ROOT / "toolpaths"

pytestmark = pytest.mark.skipif(sys.platform == "win32", reason="POSIX signals")


def rows(out: Path) -> dict[str, dict[str, str]]:
    with (out / "summary.csv").open(encoding="utf-8") as lines:
        return {row["toolpath"].partition(".")[0].removeprefix("jobs/"): row for row in csv.DictReader(lines)}


# ── errors of one job do not affect the others ───────────────────────────────────────────────────────────────────────


def test_crash_hang_or_memory_overrun_of_a_job_is_reported_and_isolated(scheduler: str, tmp_path: Path) -> None:
    bad = {"boom": "segfault", "gone": "exit", "error": "raise", "deaf": "hang", "fat": "eat 4000"}
    good = {f"good{n}": "sleep 0" for n in range(4)}
    jobs = folder_of(tmp_path, **bad, **good, no="infeasible", open="unverified")
    message: list[BatchProgress] = []
    listed = tmp_path / "list.csv"
    limits = {"deaf": "1,", "fat": ",150"}  # s, MiB; a stub job needs about 10 ms and 25 MiB
    listed.write_text(
        "toolpath,time_limit_s,memory_limit_MiB\n"
        + "".join(f"jobs/{f.name},{limits.get(f.stem, ',')}\n" for f in sorted(jobs.iterdir()))
    )
    request = request_for(listed, tmp_path / "out", scheduler=scheduler)
    outcome = run_batch(request, message.append)
    assert outcome.exit_code == 4  # a failed verification has priority over crashes
    found = rows(tmp_path / "out")
    assert {name for name, row in found.items() if row["verdict"] == "done"} == set(good)
    assert "killed by SIGSEGV" in found["boom"]["reason"]
    assert "code 0 and no result" in found["gone"]["reason"]
    assert "RuntimeError: the arm fell off" in found["error"]["reason"]
    assert found["deaf"]["reason"] == "was not finished after its time limit of 1 s"
    assert found["fat"]["reason"] == "needed more memory than 150 MiB"
    assert (found["no"]["exit_code"], found["open"]["exit_code"]) == ("3", "4")
    boom = next((tmp_path / "out" / "jobs").glob("jobs-boom-*"))
    assert "Segmentation fault" in (boom / "log.txt").read_text()
    assert times_run(tmp_path) == dict.fromkeys((*bad, *good, "no", "open"), 1)
    pids = {int((tmp_path / "ran" / f"{name}.nc").read_text()) for name in bad}
    left = [p for p in psutil.process_iter(["status"]) if _group(p.pid) in pids and p.info["status"] != "zombie"]
    assert left == []  # the child processes of the job that ignores signals have ended, too
    assert (message[0].done, message[-1].done, message[-1].total, message[-1].trouble) == (0, 11, 11, 7)
    assert message[-1].remaining_time == 0.0


def _group(pid: int) -> int:
    try:
        return os.getpgid(pid)
    except (ProcessLookupError, PermissionError):
        return -1


def test_finished_jobs_remain_and_failed_ones_are_retried(scheduler: str, tmp_path: Path) -> None:
    jobs = folder_of(tmp_path, a="sleep 0", b="sleep 0", broken="raise", no="infeasible")
    out = tmp_path / "out"
    request = request_for(jobs, out, scheduler=scheduler)
    first = run_batch(request)
    assert (first.exit_code, first.done, first.reused) == (1, 4, 0)
    before = contents(out)
    manifest, sealed = read_manifest(out)
    assert sealed
    assert {f.name for f in manifest.files} >= {"batch.json", "summary.csv", "summary.html", "timings.csv"}
    assert all(compute_sha256(out / f.name) == f.sha256 for f in manifest.files)
    assert {Path(f.name).name for f in manifest.inputs} >= {"a.nc", "b.nc", "cell.yaml", "robot.urdf"}
    again = run_batch(request)
    assert (again.done, again.reused) == (1, 3)
    assert times_run(tmp_path) == {"a": 1, "b": 1, "broken": 2, "no": 1}
    assert contents(out) == before
    assert run_batch(replace(request, keep_failed=True)).done == 0
    (jobs / "a.nc").write_text("#sleep 0\nanother shape")
    changed = run_batch(replace(request, keep_failed=True))
    assert (changed.done, changed.reused) == (1, 3)
    assert times_run(tmp_path) == {"a": 2, "b": 1, "broken": 2, "no": 1}
    # an option that changes all jobs recomputes all; an option with its default value recomputes none
    assert run_batch(replace(request, overrides=("seed=0",), keep_failed=True)).done == 0
    assert run_batch(replace(request, overrides=("seed=1",), keep_failed=True)).done == 4


def test_changed_cell_file_and_missing_result_are_detected(scheduler: str, tmp_path: Path) -> None:
    jobs = folder_of(tmp_path, a="sleep 0", b="sleep 0")
    cell = tmp_path / "cell"
    shutil.copytree(CELL, cell)
    request = request_for(jobs, tmp_path / "out", scheduler=scheduler, cell=cell)
    assert run_batch(request).done == 2
    next((tmp_path / "out" / "jobs").glob("a-*")).joinpath("points.csv").unlink()
    assert run_batch(request).done == 1
    stiffness = cell / "stiffness.yaml"
    stiffness.write_text(stiffness.read_text() + "# measured again\n")
    assert run_batch(request).done == 2
    moved = tmp_path / "moved"
    jobs.rename(moved)  # other labels, same jobs: results are reused
    assert run_batch(replace(request, jobs=(str(moved),))).done == 0
    assert len(list((tmp_path / "out" / "jobs").iterdir())) == 2


def test_one_process_per_job_where_forking_is_unsafe(tmp_path: Path) -> None:
    jobs = folder_of(tmp_path, good="sleep 0", boom="segfault", deaf="hang")
    for name, how in (("good", "ended"), ("boom", "crashed"), ("deaf", "time")):
        work = tmp_path / name
        work.mkdir()
        server = ProcessServer("test", "batch_stub_jobs", forks=False)
        job = {"request": {"toolpath": str(jobs / f"{name}.nc")}}
        try:
            # 60 s cover the start of an interpreter on a busy machine; the job that ignores signals gets 0.5 s
            limit = 0.5 if name == "deaf" else 60.0
            ended = server.run_job(
                JobSpec(
                    label=name,
                    key="key",
                    batch="test",
                    work=str(tmp_path),
                    entry="batch_stub_jobs",
                    job=job,
                    time_limit=limit,
                    memory_limit=None,
                ),
                str(work),
            )
        finally:
            server.close()
        assert ended.how == how
    assert (tmp_path / "good" / "out" / "points.csv").exists()


# ── concurrent batches ────────────────────────────────────────────────────────────────────────────────────────────────


def test_two_batches_at_once_are_independent(tmp_path: Path) -> None:
    """The port of Dask's status pages is in use; a warning would be an error here."""
    jobs = folder_of(tmp_path, a="sleep 0")
    with socket.socket() as taken:
        with contextlib.suppress(OSError):  # the port may be in use by another cluster on this machine
            taken.bind(("0.0.0.0", 8787))
            taken.listen()
        assert run_batch(request_for(jobs, tmp_path / "out", workers=1)).exit_code == 0


def test_two_batches_in_one_folder_are_refused(tmp_path: Path) -> None:
    import fcntl

    jobs = folder_of(tmp_path, a="sleep 0")
    out = tmp_path / "out"
    (out / "jobs").mkdir(parents=True)
    with (out / ".lock").open("w") as lock:
        fcntl.flock(lock, fcntl.LOCK_EX)
        with pytest.raises(InputError, match="another batch is at work"):
            run_batch(request_for(jobs, out))


# ── real jobs ───────────────────────────────────────────────────────────────────────────────────────────────────────


@pytest.mark.slow
def test_batch_jobs_equal_single_commands_and_batches_are_compared(scheduler: str, tmp_path: Path) -> None:
    from machopt.commands.optimize.request import OptimizeRequest as Single
    from machopt.commands.optimize.run import run_optimize
    from machopt.commands.verify import run_verify
    from machopt.verification.folder.options_in_force import VerifyRequest as Verify

    place = tmp_path / "parts"
    place.mkdir()
    rows_ = (TOOLPATHS / "castings.csv").read_text().splitlines(keepends=True)
    (place / "three.csv").write_text("".join(rows_[:13]))
    shutil.copytree(CELL, tmp_path / "softer")
    stiffness = tmp_path / "softer" / "stiffness.yaml"
    stiffness.write_text(re.sub(r"(joints_Nm_per_rad: \[[^,]*,)[^,]*", r"\1 1.0e6", stiffness.read_text()))
    broken = "".join(rows_[:5]).replace("cut", "mill")
    list_text = "machopt_batch: 1\ncells: [{}]\ntoolpaths: [parts/*.csv]\noptions:\n  all: {{rotation_step_deg: 10}}\n"
    (tmp_path / "mine.toml").write_text(read_post_text("urscript"))
    posts = ("krl", str(tmp_path / "mine.toml"))
    outs = []
    # on the workers of a cluster, and in a local process: each process that runs jobs takes seconds to start
    for name, cell, where in (("one", CELL, scheduler), ("two", tmp_path / "softer", None)):
        jobs = tmp_path / f"{name}.yaml"
        jobs.write_text(list_text.format(cell))
        request = BatchRequest(jobs=(str(jobs),), out=tmp_path / name, compare=outs[-1] if outs else None, posts=posts)
        outcome = run_batch(replace(request, version="test", scheduler=where, workers=1))
        outs.append(tmp_path / name)
        assert (outcome.exit_code, outcome.done) == ((0, 1) if where else (3, 2))
        (place / "broken.csv").write_text(broken)  # a second job for the second batch
    assert "expected one of cut, rapid" in rows(outs[-1])["parts/broken"]["reason"]
    single = Single(
        cell=CELL,
        toolpath=place / "three.csv",
        out=tmp_path / "single",
        direct={"rotation_step_deg": 10.0},
        posts=posts,
    )
    assert run_optimize(single).exit_code == 0
    made = next((tmp_path / "one" / "jobs").glob("parts-three-*"))
    programs = ("krl/three_csv.src", "krl/three_csv.dat", "mine/three_csv.script")
    for name in ("points.csv", "trajectory.csv", *programs):
        assert (made / name).read_bytes() == (tmp_path / "single" / name).read_bytes(), name
    checked = Verify(cell=CELL, toolpath=place / "three.csv", out=made)
    # the files that the batch adds to the result are in its manifest
    assert run_verify(checked).verification.failed == ()
    row = rows(tmp_path / "one")["parts/three"]
    assert row["programs"] == "krl/three_csv.src mine/three_csv.script"
    found = json.loads((tmp_path / "single" / "result.json").read_text())
    # written with %.6g
    assert float(row["gain_percent"]) == pytest.approx(found["objective"]["gain"][0]["mean_percent"], rel=1e-5)
    assert (tmp_path / "one" / row["report"]).exists()
    with (tmp_path / "two" / "compare.csv").open() as lines:
        differences = {r["toolpath"]: r for r in csv.DictReader(lines)}
    three = differences["parts/three.csv"]
    assert three["verdict_before"] == three["verdict"]
    assert three["verdict"].startswith("done")
    assert float(three["mean"]) < float(three["mean_before"])  # stiffness, with a softer joint 2


@pytest.mark.proof
def test_warm_up_compiles_all_kernels_that_jobs_use(tmp_path: Path) -> None:
    code = """
import sys, numba
from pathlib import Path
from machopt.batch.warm_up_job import run_warm_up_job
from machopt.commands.optimize.request import OptimizeRequest
from machopt.commands.optimize.run import run_optimize
from machopt.planning.kernel_precompilation import compile_all
def compiled():
    found = [v for name, m in list(sys.modules.items()) if name.startswith("machopt")
             for v in vars(m).values() if isinstance(v, numba.core.registry.CPUDispatcher)]
    return {(f.py_func.__qualname__, str(s)) for f in found for s in f.signatures}
place, root = Path(sys.argv[1]), Path(sys.argv[2])
kernels = compile_all()  # what a second process compiles ahead on the first run: just what a plan calls, and all of it
assert all(len(f.signatures) == 1 for f in kernels)
(place / "warm").mkdir()
assert run_warm_up_job(place / "warm") == 0
warm = compiled()
assert len(warm) > 10, warm
request = OptimizeRequest(
    cell=root / "cells/s420f_handling", toolpath=root / "toolpaths/castings.csv", out=place / "out"
)
assert run_optimize(request).exit_code == 0
assert compiled() == warm, compiled() - warm
assert all(len(f.signatures) == 1 for f in kernels), [f.signatures for f in kernels]
"""
    done = subprocess.run(
        [sys.executable, "-c", code, str(tmp_path), str(ROOT)],
        capture_output=True,
        text=True,
        check=False,
        env={**os.environ, "PYTHONPATH": str(ROOT)},
    )
    assert done.returncode == 0, done.stderr


# ── refused before the start ──────────────────────────────────────────────────────────────────────────────────────────


def test_invalid_jobs_are_refused_before_the_start(tmp_path: Path) -> None:
    jobs = folder_of(tmp_path, a="sleep 0")
    request = request_for(jobs, tmp_path / "out")
    bad_cell = tmp_path / "cell"
    shutil.copytree(CELL, bad_cell)
    (bad_cell / "stiffness.yaml").unlink()
    foreign = tmp_path / "mine"
    foreign.mkdir()
    (foreign / "thesis.txt").write_text("precious")
    cases = {
        "none of 1 jobs can start; the first: .*no such file: stiffness.yaml": {"cell": bad_cell},
        "exists and is no batch's output": {"out": foreign},
        "--jobs: found 0; more than zero": {"workers": 0},
        "--time-limit-s: found -1": {"time_limit": -1.0},
        "--compare: is no batch's output": {"compare": foreign},
        "--scheduler: no Dask scheduler answers at nonsense": {"scheduler": "nonsense"},
        "unknown key 'metod'": {"overrides": ("metod=jiao2022",)},
        "no such file or folder": {"jobs": (str(tmp_path / "nowhere"),)},
    }
    for words, change in cases.items():
        with pytest.raises(InputError, match=words):
            run_batch(replace(request, **change))  # type: ignore[arg-type]
        assert not (tmp_path / "out").exists(), words
    assert [f.name for f in foreign.iterdir()] == ["thesis.txt"]


@pytest.mark.proof
def test_broken_cell_of_one_job_does_not_affect_the_others(scheduler: str, tmp_path: Path) -> None:
    jobs = folder_of(tmp_path, a="sleep 0")
    (jobs / "other" / "cell").mkdir(parents=True)
    (jobs / "other" / "cell" / "cell.yaml").write_text("machopt_cell: 1\n")
    (jobs / "other" / "c.nc").write_text("#sleep 0")
    outcome: BatchResult = run_batch(request_for(jobs, tmp_path / "out", scheduler=scheduler))
    assert (outcome.exit_code, outcome.done) == (3, 1)
    found = rows(tmp_path / "out")
    assert found["other/c"]["verdict"] == "refused"
    assert "required key is missing" in found["other/c"]["reason"]
    page = (tmp_path / "out" / "summary.html").read_text()
    assert "SOME HAVE NO ANSWER" in page
    assert "required key is missing" in page
