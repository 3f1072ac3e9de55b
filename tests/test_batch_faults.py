"""Batch under machine faults: killed process servers and workers, full disks, edited files."""

from __future__ import annotations

import contextlib
import errno
import os
import random
import shutil
import signal
import sys
import threading
from collections.abc import Callable, Iterator
from dataclasses import replace
from pathlib import Path

import psutil
import pytest
from batch_stub_jobs import CELL, contents, folder_of, request_for, times_run

import machopt
from machopt.batch import dask_executor, job_process, job_store, job_supervisor
from machopt.batch.job_key import JobKeyBuilder, ReadyJob, compute_package_hash
from machopt.batch.job_supervisor import JobSpec, ProcessServer
from machopt.batch.process_messages import JobStartedMessage
from machopt.batch.run import run_batch
from machopt.errors import InputError, MachoptError

pytestmark = pytest.mark.skipif(sys.platform != "linux", reason="POSIX signals")


def servers() -> list[psutil.Process]:
    """Return the process servers that this process has started."""
    out = []
    for p in psutil.Process().children():
        with contextlib.suppress(psutil.Error):
            if "machopt.batch.process_server" in p.cmdline():
                out.append(p)
    return out


@contextlib.contextmanager
def repeat_meanwhile(action: Callable[[], None], pause: Callable[[], float]) -> Iterator[None]:
    """Repeat an action in a thread while the block runs."""
    over = threading.Event()

    def loop() -> None:
        while not over.wait(pause()):
            action()

    thread = threading.Thread(target=loop)
    thread.start()
    try:
        yield
    finally:
        over.set()
        thread.join()


# ── processes ────────────────────────────────────────────────────────────────────────────────────────────────────────


@pytest.mark.parametrize("seed", range(2))
def test_randomly_killed_servers_and_jobs_never_hang_a_batch(seed: int, tmp_path: Path) -> None:
    draw = random.Random(seed)
    jobs = folder_of(tmp_path, **{f"j{n:02d}": "sleep 0.2" for n in range(8)})
    request = request_for(jobs, tmp_path / "out", workers=2)
    killed = []

    def kill() -> None:
        with contextlib.suppress(psutil.Error):  # it may just have ended
            victims = [p for server in servers() for p in (server, *server.children(recursive=True))]
            if victims and len(killed) < 5:
                victim = draw.choice(victims)
                victim.kill()
                killed.append(victim.pid)

    with repeat_meanwhile(kill, lambda: draw.uniform(0.05, 0.5)):
        outcome = run_batch(request)
    counts = outcome.result.to_json_types()["counts"]
    assert isinstance(counts, dict)
    assert sum(counts.values()) == 8
    assert set(counts) <= {"done", "crashed"}
    assert len(killed) >= 3
    assert run_batch(request).exit_code == 0
    undisturbed = request_for(jobs, tmp_path / "whole", workers=2)
    assert run_batch(undisturbed).exit_code == 0
    assert contents(tmp_path / "out") == contents(tmp_path / "whole")


def spec_of(tmp_path: Path, words: str, limit: float = 60.0) -> JobSpec:
    jobs = folder_of(tmp_path, a=words)
    job = {"request": {"toolpath": str(jobs / "a.nc")}}
    return JobSpec(
        label="a",
        key="key",
        batch="test",
        work=str(tmp_path),
        entry="batch_stub_jobs",
        job=job,
        time_limit=limit,
        memory_limit=None,
    )


def test_dead_server_is_reported_on_every_request(tmp_path: Path) -> None:
    """The system closes the pipe of a killed process before it reports that the process has ended."""
    server = ProcessServer("test", "batch_stub_jobs", forks=True)
    (tmp_path / "work").mkdir()
    try:
        assert server.run_job(spec_of(tmp_path, "sleep 0"), str(tmp_path / "work")).how == "ended"
        server._process.send_signal(signal.SIGKILL)  # the exit status has not been read yet
        assert [server._wait_for_answer(JobStartedMessage, 60.0) for _ in range(3)] == [None] * 3
        assert not server.is_alive
    finally:
        server.close()


def test_time_limit_holds_without_an_answer_of_the_server(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(job_supervisor, "GRACE_PERIOD_S", 0.2)
    server = ProcessServer("test", "batch_stub_jobs", forks=True)
    work = tmp_path / "work"
    work.mkdir()

    def stop_at_work() -> None:
        process = psutil.Process(server._process.pid)
        with contextlib.suppress(psutil.Error):
            if process.children() and (tmp_path / "ran" / "a.nc").exists():
                process.suspend()

    try:
        with repeat_meanwhile(stop_at_work, lambda: 0.02):
            ended = server.run_job(spec_of(tmp_path, "hang", limit=1.0), str(work))
    finally:
        server.close()
    assert ended.how == "time"
    (pid,) = map(int, (tmp_path / "ran" / "a.nc").read_text().split())
    until_gone(pid)


def until_gone(pid: int) -> None:
    """Wait until a killed process has ended; it may remain as a zombie until its exit status is read."""
    with contextlib.suppress(psutil.NoSuchProcess):
        process = psutil.Process(pid)
        while process.status() != psutil.STATUS_ZOMBIE:
            assert process.is_running()
            with contextlib.suppress(psutil.TimeoutExpired):
                process.wait(0.05)


def test_local_batch_opens_no_port(tmp_path: Path) -> None:
    def listening() -> set[object]:
        return {c.laddr for c in psutil.Process().net_connections() if c.status == psutil.CONN_LISTEN}

    before = listening()
    with dask_executor.DaskExecutor("test", scheduler=None, workers=2, version="test") as running:
        running.check_workers(tmp_path)
        assert listening() == before


def test_batch_without_workers_ends_and_can_be_resumed(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    from distributed import LocalCluster

    monkeypatch.setattr(dask_executor, "POLL_INTERVAL_S", 0.1)
    monkeypatch.setattr(dask_executor, "WORKER_TIMEOUT_S", 1.0)
    jobs = folder_of(tmp_path, a="sleep 0", b="gate open")
    pages = {"dashboard": False, "dashboard_address": "127.0.0.1:0"}
    with LocalCluster(
        n_workers=1, threads_per_worker=1, scheduler_kwargs=pages, memory_limit=0, silence_logs=50
    ) as cluster:
        request = request_for(jobs, tmp_path / "out", scheduler=cluster.scheduler_address)

        def take_away() -> None:
            if "b" in times_run(tmp_path):
                cluster.scale(0)

        with (
            repeat_meanwhile(take_away, lambda: 0.1),
            pytest.raises(MachoptError, match=r"no Dask worker has been there .* the same command resumes"),
        ):
            run_batch(request)
    (tmp_path / "open").touch()
    outcome = run_batch(replace(request, scheduler=None, workers=1))
    assert (outcome.exit_code, outcome.reused) == (0, 1)


# ── disk ──────────────────────────────────────────────────────────────────────────────────────────────────────────────


@pytest.mark.parametrize("step", ["_list_in_manifest", "sync_tree", "sync_folder"])
def test_batch_killed_while_moving_a_result_resumes_to_the_same_bytes(
    step: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    class Killed(BaseException):
        pass

    def die(*_: object) -> None:
        raise Killed

    jobs = folder_of(tmp_path, a="sleep 0", b="sleep 0")
    assert run_batch(request_for(jobs, tmp_path / "whole", workers=1)).exit_code == 0
    request = request_for(jobs, tmp_path / "out", workers=1)
    with monkeypatch.context() as patch:
        patch.setattr(job_store, step, die)
        # a killed process does not delete its temporary files
        patch.setattr(job_store.shutil, "rmtree", lambda *_, **__: None)
        with pytest.raises(Killed):
            run_batch(request)
    assert run_batch(request).exit_code == 0
    assert contents(tmp_path / "out") == contents(tmp_path / "whole")
    assert not (tmp_path / "out" / ".work").exists()


def test_full_disk_is_reported_and_the_batch_resumes(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    def full(*_: object) -> None:
        raise OSError(errno.ENOSPC, os.strerror(errno.ENOSPC))

    jobs = folder_of(tmp_path, a="sleep 0", b="sleep 0")
    request = request_for(jobs, tmp_path / "out", workers=1)
    with monkeypatch.context() as patch:
        patch.setattr(job_store, "sync_tree", full)
        with pytest.raises(InputError, match=r"cannot be written: No space left .* the same command goes on"):
            run_batch(request)
    assert run_batch(request).exit_code == 0


def test_job_lost_to_a_full_disk_is_retried(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    def full(_: object) -> None:
        raise InputError("the output folder cannot be written") from OSError(errno.ENOSPC, "full")

    monkeypatch.setattr("machopt.commands.optimize.run.run_optimize", full)
    found = job_process.run({"request": {"cell": ".", "toolpath": "a.nc", "plan_file": None}}, tmp_path / "out")
    # exit code 1 is tried again, 2 is a final result
    assert (found["exit_code"], found["verdict"]) == (1, job_process.NOT_WRITTEN)


def test_batch_manifest_contains_the_summary_and_is_absent_while_running(tmp_path: Path) -> None:
    from machopt.output.manifest_file import find_differences, read_manifest

    jobs = folder_of(tmp_path, a="sleep 0", broken="raise")
    out = tmp_path / "out"
    observed: list[bool] = []
    request = request_for(jobs, out, workers=1)
    for _ in range(2):
        assert run_batch(request, lambda _: observed.append((out / "manifest.json").exists())).exit_code == 1
    assert not any(observed)
    manifest, sealed = read_manifest(out)
    assert (manifest.command, manifest.exit_code, sealed) == ("batch", 1, True)
    assert {Path(f.name).name for f in manifest.inputs} >= {"a.nc", "broken.nc", "cell.yaml"}
    assert not [d for d in find_differences(out, manifest) if d.description != "is not in the manifest"]
    (out / "summary.csv").write_text("nothing went wrong\n")
    changed = [d.name for d in find_differences(out, manifest) if d.description != "is not in the manifest"]
    assert changed == ["summary.csv"]


def test_edited_result_is_recomputed_only_with_force(tmp_path: Path) -> None:
    """The check needs a manifest; these stub jobs have none, so the test writes one."""
    from machopt.data_types.manifest import FolderManifest
    from machopt.output import write_manifest

    jobs = folder_of(tmp_path, a="sleep 0", b="sleep 0")
    request = request_for(jobs, tmp_path / "out", workers=1)
    assert run_batch(request).done == 2
    empty = FolderManifest(command="optimize", verdict="done", exit_code=0, versions={}, inputs=())
    folders = sorted((tmp_path / "out" / "jobs").iterdir())
    for folder in folders:
        write_manifest(folder, empty, {})
    assert run_batch(request).done == 0
    with (folders[0] / "points.csv").open("a") as file:
        file.write("# touched\n")
    with pytest.raises(InputError, match=r"points\.csv"):
        run_batch(request)
    assert "# touched" in (folders[0] / "points.csv").read_text()
    assert run_batch(replace(request, overwrite=True)).done == 1


# ── job key ───────────────────────────────────────────────────────────────────────────────────────────────────────────


def test_every_shipped_file_is_part_of_the_key(tmp_path: Path) -> None:
    """One file of each type is changed; cache files of Python and numba have no influence."""
    package = tmp_path / "machopt"
    shutil.copytree(Path(machopt.__file__).parent, package, ignore=shutil.ignore_patterns("__pycache__"))
    kinds = {f.suffix: f for f in sorted(package.rglob("*")) if f.is_file()}
    assert {".py", ".toml", ".js", ".css"} <= set(kinds)
    observed = {compute_package_hash(package)}
    for file in kinds.values():
        file.write_bytes(file.read_bytes() + b"\n")
        observed.add(compute_package_hash(package))
    assert len(observed) == len(kinds) + 1
    (package / "__pycache__").mkdir()
    (package / "__pycache__" / "run.cpython-311.pyc").write_bytes(b"made")
    (package / "__pycache__" / "solve.nbi").write_bytes(b"made")
    stored = package / "report" / "templates" / "__pycache__"  # created by the first report of an installation
    stored.mkdir(parents=True, exist_ok=True)
    (stored / "report.html.cpython-311-abc").write_bytes(b"made")
    assert compute_package_hash(package) in observed


def test_data_file_of_a_robot_program_is_part_of_the_key(tmp_path: Path) -> None:
    place = tmp_path / "jobs"
    place.mkdir()
    for name in ("golden.src", "golden.dat"):
        shutil.copy(Path(__file__).parent / "golden" / "krl" / name, place / name)
    request = request_for(place / "golden.src", tmp_path / "out", cell=CELL)

    def ready() -> ReadyJob:
        from machopt.batch.job_discovery import find_jobs

        (job,) = find_jobs(request).jobs
        found = JobKeyBuilder(request, "test").build_key(job)
        assert isinstance(found, ReadyJob)
        return found

    before = ready()
    assert str((place / "golden.dat").resolve()) in before.inputs
    (place / "golden.dat").write_text((place / "golden.dat").read_text().replace("0.25", "0.5") + "\n")
    assert ready().key != before.key
