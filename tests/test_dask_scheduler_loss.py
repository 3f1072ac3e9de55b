"""Dask scheduler that ends during a batch: exit 2, named by its address, resumable."""

from __future__ import annotations

import os
import re
import subprocess
import sys
import time
from pathlib import Path

import pytest
from batch_stub_jobs import folder_of, request_for

from machopt.batch import dask_executor
from machopt.batch.dask_executor import SchedulerLostError
from machopt.batch.run import run_batch

ROOT = Path(__file__).resolve().parents[1]


def _process(log: Path, *words: str) -> subprocess.Popen[bytes]:
    env = {**os.environ, "PYTHONPATH": f"{ROOT}{os.pathsep}{ROOT / 'tests'}"}
    code = "import sys; from distributed.cli import dask_scheduler, dask_worker; " + words[0]
    with log.open("wb") as out:
        return subprocess.Popen([sys.executable, "-c", code, *words[1:]], env=env, stderr=out, stdout=out)


def _address(log: Path) -> str:
    for _ in range(600):
        found = re.search(r"Scheduler at:\s+(tcp://\S+)", log.read_text())
        if found:
            return found[1]
        time.sleep(0.1)
    raise AssertionError("the scheduler did not start")


@pytest.mark.slow
def test_killed_scheduler_is_reported_and_the_batch_resumable(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(dask_executor, "POLL_INTERVAL_S", 0.5)
    monkeypatch.setattr(dask_executor, "CONNECT_TIMEOUT_S", 5.0)
    jobs = folder_of(tmp_path, a="sleep 0", b="sleep 60", c="sleep 60")
    out = tmp_path / "out"
    scheduler = _process(
        tmp_path / "scheduler.log",
        "dask_scheduler.main()",
        "--port",
        "0",
        "--host",
        "127.0.0.1",
        "--no-dashboard",
        "--no-jupyter",
    )
    worker = None
    try:
        address = _address(tmp_path / "scheduler.log")
        worker = _process(
            tmp_path / "worker.log",
            "dask_worker.main()",
            address,
            "--nworkers",
            "1",
            "--nthreads",
            "1",
            "--no-dashboard",
            "--no-nanny",
        )

        def on_progress(progress: object) -> None:
            if getattr(progress, "done", 0) >= 1:
                scheduler.kill()

        begun = time.monotonic()
        with pytest.raises(SchedulerLostError) as lost:
            run_batch(request_for(jobs, out, scheduler=address), on_progress)
        assert time.monotonic() - begun < 60
        assert lost.value.exit_code == 2
        assert lost.value.address == address
        assert address in str(lost.value)
        assert len(list((out / "jobs").iterdir())) == 1
    finally:
        for process in (scheduler, worker):
            if process is not None:
                process.kill()
                process.wait()
    for job, text in (("b", "sleep 0"), ("c", "sleep 0")):
        next(p for p in jobs.rglob(f"{job}.*")).write_text(f"# {text}\n")
    resumed = run_batch(request_for(jobs, out, workers=1))
    assert (resumed.exit_code, resumed.reused, resumed.done) == (0, 1, 2)
