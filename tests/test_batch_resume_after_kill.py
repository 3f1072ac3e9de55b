"""Killed or stopped batches that are resumed: no lost job, no repeated job, identical bytes."""

from __future__ import annotations

import json
import os
import re
import signal
import subprocess
import sys
from pathlib import Path

import psutil
import pytest
from batch_jobs_with_faults import GATED, JOBS, small_jobs
from batch_stub_jobs import CELL, contents, folder_of, request_for, times_run

from machopt.batch.request import BatchRequest
from machopt.batch.run import run_batch

ROOT = Path(__file__).resolve().parents[1]
PATIENCE = 300.0  # s; exceeded only by a blocked process, also on a busy machine

pytestmark = pytest.mark.skipif(sys.platform == "win32", reason="POSIX signals")

_DRIVE = """
import sys
from pathlib import Path
from machopt.batch.request import BatchRequest
from machopt.batch.run import run_batch
jobs, out, cell, entry = sys.argv[1:]
request = BatchRequest(
    jobs=(jobs,), out=Path(out), cell=Path(cell), entry=entry, version="test", workers=2
)
sys.exit(run_batch(request, lambda p: print(p.reused + p.done, flush=True)).exit_code)
"""


def driver(jobs: Path, out: Path, entry: str = "batch_stub_jobs") -> subprocess.Popen[str]:
    return subprocess.Popen(
        [sys.executable, "-c", _DRIVE, str(jobs), str(out), str(CELL), entry],
        stdout=subprocess.PIPE,
        text=True,
        env={**os.environ, "PYTHONPATH": f"{ROOT}{os.pathsep}{ROOT / 'tests'}"},
        start_new_session=True,
        preexec_fn=lambda: signal.signal(signal.SIGINT, signal.default_int_handler) and None,  # noqa: PLW1509
    )


def wait_for(process: subprocess.Popen[str], number: int) -> None:
    """Wait until the driver reports this number of finished jobs."""
    assert process.stdout is not None
    for line in process.stdout:
        if int(line) >= number:
            return
    raise AssertionError(f"the driver ended before {number} jobs, code {process.wait()}")


def list_finished_jobs(out: Path) -> set[str]:
    return {f.parent.name.partition("-")[0] for f in (out / "jobs").glob("*/job.json")}


@pytest.mark.slow
def test_sixty_jobs_killed_and_resumed_equal_an_undisturbed_run(scheduler: str, tmp_path: Path) -> None:
    """Gate files hold back jobs that must not be finished yet, so that the test does not depend on the machine's speed.

    The driver is killed during two jobs of the second third, a process server during one of the last third.
    """
    words = [*["sleep 0"] * 20, *["gate first"] * 20, *["gate second"] * 18]
    names = {f"job{n:02d}": word for n, word in enumerate(words)}
    jobs = folder_of(tmp_path, **names, no="infeasible", boom="segfault")
    first, second = tmp_path / "first", tmp_path / "second"
    whole, out = tmp_path / "whole", tmp_path / "out"
    first.touch()
    second.touch()
    undisturbed = run_batch(request_for(jobs, whole, scheduler=scheduler))
    assert (undisturbed.exit_code, undisturbed.done) == (1, 60)
    assert set(times_run(tmp_path).values()) == {1}
    for f in (first, second, *(tmp_path / "ran").iterdir()):
        f.unlink()

    with driver(jobs, out) as process:
        wait_for(process, 21)  # the crashed job and the first twenty
        servers = servers_of(process)
        process.kill()
    had = list_finished_jobs(out)
    assert had == {"boom", *(f"job{n:02d}" for n in range(20))}
    assert not (out / "summary.csv").exists()
    assert json.loads((out / "batch.json").read_text())["complete"] is False
    wait_until_gone(servers)

    first.touch()
    with driver(jobs, out) as process:
        wait_for(process, 41)
        next(
            p for p in psutil.Process(process.pid).children() if is_process_server(p)
        ).kill()  # a new server starts and takes its job again
        second.touch()
        assert process.wait(timeout=PATIENCE) == 1

    count = times_run(tmp_path)
    assert set(count) == {*names, "no", "boom"}
    twice = {name for name, times in count.items() if times > 1} - {"boom"}  # a crashed job is tried again
    assert twice.isdisjoint(had)
    assert len(twice) <= 3  # two jobs running at the first kill, and the job of the killed server
    assert max(count.values()) == 2
    assert contents(out) == contents(whole)
    assert run_batch(request_for(jobs, out, scheduler=scheduler, keep_failed=True)).done == 0


@pytest.mark.proof
def test_fifteen_real_jobs_on_two_workers_killed_and_resumed(scheduler: str, tmp_path: Path) -> None:
    """Shipped cells with small toolpaths, KRL programs, one crash, one job above its time limit; first undisturbed
    on its own scheduler, then killed halfway on a local cluster and resumed: the same bytes except for times."""
    jobs = small_jobs(tmp_path)
    gate, whole, out = tmp_path / "gate", tmp_path / "whole", tmp_path / "out"
    gate.touch()
    request = BatchRequest(
        jobs=(str(jobs),), out=whole, entry="batch_jobs_with_faults", version="test", scheduler=scheduler
    )
    undisturbed = run_batch(request)
    assert (undisturbed.exit_code, undisturbed.done) == (1, JOBS)
    counts = undisturbed.result.to_json_types()["counts"]
    assert isinstance(counts, dict)
    assert (counts["crashed"], counts["over time"]) == (1, 1)
    assert 3 * counts["done"] >= 2 * (JOBS - 2)  # the CAM default rotation is not feasible everywhere
    assert counts["done"] + counts.get("infeasible", 0) == JOBS - 2
    assert set(times_run(tmp_path).values()) == {1}
    for f in (gate, *(tmp_path / "ran").iterdir()):
        f.unlink()

    with driver(jobs, out, "batch_jobs_with_faults") as process:
        wait_for(process, GATED)
        servers = servers_of(process)
        process.kill()
    had = [f.parent.name for f in (out / "jobs").glob("*/job.json")]
    assert len(had) == GATED
    assert all((whole / "jobs" / name).is_dir() for name in had)
    wait_until_gone(servers)
    gate.touch()
    with driver(jobs, out, "batch_jobs_with_faults") as process:
        assert process.wait(timeout=PATIENCE) == 1

    count = {int(name): times for name, times in times_run(tmp_path).items()}
    assert sorted(count) == list(range(JOBS))
    twice = {number for number, times in count.items() if times > 1}
    assert {n for n in twice if n < GATED} == {3, 7}  # the crash and the job above its time limit are tried again
    assert len(twice) <= 4  # and the two jobs running at the kill
    mine, theirs = contents(out), contents(whole)
    assert sorted(mine) == sorted(theirs)
    assert sum(name.endswith(".src") for name in mine) == counts["done"]
    assert [name for name in mine if remove_times(name, mine[name]) != remove_times(name, theirs[name])] == []


def remove_times(name: str, data: bytes) -> bytes:
    """Return a job's file without its computing times."""
    if name.endswith("/result.json"):
        return json.dumps({k: v for k, v in json.loads(data).items() if k not in ("timings_s", "outputs")}).encode()
    if name.endswith("/manifest.json"):
        found = json.loads(data)
        retained = {k: v for k, v in found["files"].items() if k not in ("result.json", "report.html", "timing.json")}
        return json.dumps({**found, "files": retained, "seal": ""}).encode()
    if name.endswith("/report.html"):
        return re.sub(rb"<details><summary>Time per stage.*?</details>", b"", data, flags=re.S)
    return data


def is_process_server(process: psutil.Process) -> bool:
    try:
        return "machopt.batch.process_server" in process.cmdline()
    except psutil.Error:
        return False


def servers_of(process: subprocess.Popen[str]) -> list[psutil.Process]:
    """Return the process servers of a driver and the jobs that they run."""
    family = psutil.Process(process.pid).children(recursive=True)
    found = [p for p in family if is_process_server(p)]
    assert found
    return found


def wait_until_gone(servers: list[psutil.Process]) -> None:
    """Wait until all process servers and jobs have ended after their driver; about 10 ms, longer on a loaded
    machine."""
    _, alive = psutil.wait_procs(servers, timeout=60.0)
    assert alive == []


@pytest.mark.slow
def test_ctrl_c_keeps_finished_jobs_and_lists_the_others(tmp_path: Path) -> None:
    jobs = folder_of(tmp_path, **{f"a{n}": "sleep 0" for n in range(4)}, z0="hang", z1="hang", z2="sleep 0")
    out = tmp_path / "out"
    with driver(jobs, out) as process:
        wait_for(process, 4)
        servers = servers_of(process)
        os.killpg(process.pid, signal.SIGINT)
        assert process.wait(timeout=PATIENCE) == 130
    result = json.loads((out / "batch.json").read_text())
    assert result["complete"] is False
    assert result["counts"] == {"done": 4, "waiting": 3}
    assert "STOPPED" in (out / "summary.html").read_text()
    assert not (out / ".work").exists()
    wait_until_gone(servers)
