"""Supervision of one job by a Dask task: a process server runs it within its limits of time and memory.

A job that crashes, exceeds its time or its memory raises nothing: its outcome is a :class:`JobEnd` like any other.
"""

from __future__ import annotations

import contextlib
import json
import math
import os
import queue
import subprocess
import sys
import tempfile
import threading
import time
from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Literal, TypeVar

from machopt.batch.process_messages import JobEndedMessage, JobStartedMessage, ServerReadyMessage
from machopt.batch.process_server import LOG_FILE, OUTCOME_FILE
from machopt.batch.process_tree import get_worker_name, kill_processes, list_processes, measure_memory
from machopt.data_types.documents.batch_document import BatchRowSection, JobFailureDocument
from machopt.data_types.documents.document_base import DocumentModel

T = TypeVar("T", bound=DocumentModel)

EndReason = Literal["ended", "crashed", "time", "memory", "server", "stopped"]

END_FILE = "ended.json"
CAN_FORK = sys.platform == "linux"  # elsewhere system libraries do not promise to survive a fork
WARM_UP_LIMIT_S = 900.0  # s a server may take to import and compile, or to wait for another that does
GRACE_PERIOD_S = 10.0  # s for a server to end a job on request; after that the server is ended too
POLL_INTERVAL_S = 0.05  # s between two looks at a job's memory and time
POLLS_PER_PROCESS_SCAN = 20  # finding what a job has started itself takes milliseconds: not at every look
SINGLE_THREAD_VARIABLES = dict.fromkeys(
    ("OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS", "MKL_NUM_THREADS", "NUMBA_NUM_THREADS", "VECLIB_MAXIMUM_THREADS"), "1"
)  # as many processes as cores are at work already


@dataclass(frozen=True, kw_only=True)
class JobSpec:
    """One job for a worker; plain values only."""

    label: str
    key: str
    batch: str  # token of the run, to which servers belong
    work: str  # folder on a file system that driver and workers share
    entry: str
    job: dict[str, Any]
    time_limit: float  # s
    memory_limit: int | None  # bytes


@dataclass(frozen=True, kw_only=True)
class JobEnd:
    """Outcome of a job."""

    how: EndReason
    folder: str  # what it wrote: out/, outcome.json, log.txt
    code: int | None = None  # exit code, negative: the signal that killed it
    outcome: BatchRowSection | JobFailureDocument | None = None  # None: it left none
    text: str = ""  # where the server itself failed: its last words
    wall: float = 0.0  # s
    cpu: float = 0.0  # s
    peak: int = 0  # bytes
    worker: str = ""

    def to_json_types(self) -> dict[str, Any]:
        """Return the fields in JSON's own types; :meth:`from_json_types` reads them."""
        return {**vars(self), "outcome": None if self.outcome is None else self.outcome.to_json_types()}

    @classmethod
    def from_json_types(cls, plain: Mapping[str, Any]) -> JobEnd:
        """Build the end from the plain types of a JSON file.

        Args:
            plain: The fields as plain types.
        """
        return cls(**{**plain, "outcome": _parse_outcome(plain["outcome"])})


def supervise_job(spec: JobSpec) -> dict[str, Any]:
    """Run one job to its end; return a :class:`JobEnd` in plain types.

    The end is written next to the job's files first. So a job is not lost if its worker or the main process is killed
    before the result is stored.

    Args:
        spec: The job with its limits.
    """
    for _, key, earlier in list_ended_jobs(Path(spec.work), spec.label):
        if key == spec.key:
            return earlier.to_json_types()
    ended = _run_one_job(spec)
    if ended.how == "server":  # the server was killed from outside, or there was no memory for it: once more
        ended = _run_one_job(spec)
    if ended.how not in ("server", "stopped"):
        _write_end(spec, ended)
    return ended.to_json_types()


def list_ended_jobs(work: Path, label: str = "*") -> Iterator[tuple[str, str, JobEnd]]:
    """Yield label, key and end of jobs in a work folder that have ended and are not stored yet.

    Args:
        work: Work folder of the batch.
        label: Label of the job; ``*`` for all.
    """
    for file in sorted(work.glob(f"{label}~*/{END_FILE}")):
        try:
            found = json.loads(file.read_text(encoding="utf-8"))
            ended = found["label"], found["key"], JobEnd.from_json_types({**found["ended"], "folder": str(file.parent)})
        except (OSError, ValueError, KeyError, TypeError):
            continue  # being put away right now, or damaged: the job is run again
        yield ended


def _write_end(spec: JobSpec, ended: JobEnd) -> None:
    """Write the end of a job in one step."""
    folder = Path(ended.folder)
    text = json.dumps({"label": spec.label, "key": spec.key, "ended": ended.to_json_types()})
    (folder / f"{END_FILE}.new").write_text(text, encoding="utf-8")
    (folder / f"{END_FILE}.new").rename(folder / END_FILE)


def stop_servers(batch: str) -> None:
    """End all servers of a batch in this worker, with their jobs.

    Args:
        batch: Id of the batch.
    """
    with _LOCK:
        _STOPPED_BATCHES.add(batch)
        servers = [s for s in _ALL_SERVERS if s.batch == batch]
    for server in servers:
        server.close()


_LOCK = threading.Lock()
_IDLE_SERVERS: list[ProcessServer] = []
_ALL_SERVERS: set[ProcessServer] = set()
_STOPPED_BATCHES: set[str] = set()


def _run_one_job(spec: JobSpec) -> JobEnd:
    folder = tempfile.mkdtemp(dir=spec.work, prefix=f"{spec.label}~")
    if spec.batch in _STOPPED_BATCHES:
        return JobEnd(how="stopped", folder=folder)
    server = _take_server(spec)
    try:
        ended = server.run_job(spec, folder)
    finally:
        if server.is_alive and CAN_FORK:
            with _LOCK:
                _IDLE_SERVERS.append(server)
        else:
            server.close()
    return JobEnd(how="stopped", folder=folder) if spec.batch in _STOPPED_BATCHES else ended


def _take_server(spec: JobSpec) -> ProcessServer:
    with _LOCK:
        for server in list(_IDLE_SERVERS):
            if not server.is_alive:
                _IDLE_SERVERS.remove(server)
            elif (server.batch, server.entry) == (spec.batch, spec.entry):
                _IDLE_SERVERS.remove(server)
                return server
    return ProcessServer(spec.batch, spec.entry, forks=CAN_FORK)


class ProcessServer:
    """Client of :mod:`machopt.batch.process_server`."""

    def __init__(self, batch: str, entry: str, *, forks: bool) -> None:
        self.batch, self.entry, self._forks = batch, entry, forks
        self._words = tempfile.TemporaryFile()  # noqa: SIM115 — closed with the server
        self._process = subprocess.Popen(
            [sys.executable, "-P", "-m", "machopt.batch.process_server", entry, *([] if forks else ["--once"])],
            stdin=subprocess.PIPE,
            stdout=subprocess.PIPE,
            stderr=self._words,
            start_new_session=True,
            env={
                **os.environ,
                **SINGLE_THREAD_VARIABLES,
                "PYTHONPATH": os.pathsep.join(p or os.getcwd() for p in sys.path),
            },
        )
        self._answers: queue.Queue[dict[str, Any] | None] = queue.Queue()
        self._silent = threading.Event()  # no answer will come any more
        threading.Thread(target=self._read_answers, daemon=True).start()
        self._ready = False
        with _LOCK:
            _ALL_SERVERS.add(self)

    @property
    def is_alive(self) -> bool:
        """Return whether it can take a job. A killed process closes its pipe before it counts as ended."""
        return not self._silent.is_set() and self._process.poll() is None

    def run_job(self, spec: JobSpec, folder: str) -> JobEnd:
        """Run one job within its limits.

        Args:
            spec: The job with its limits.
            folder: Output folder of the job.
        """
        if not self._ready and not self._wait_ready():
            return JobEnd(how="server", folder=folder, text=self._read_error_text())
        if not self._send_line(json.dumps({"job": spec.job, "folder": folder})):
            return JobEnd(how="server", folder=folder, text=self._read_error_text())
        started = self._wait_for_answer(JobStartedMessage, WARM_UP_LIMIT_S)
        if started is None:
            return JobEnd(how="server", folder=folder, text=self._read_error_text())
        begin = time.monotonic()
        broken, status, peak = self._watch_job(spec, started.pid, begin)
        wall = time.monotonic() - begin
        if status is None:
            return JobEnd(
                how=broken or "server",
                folder=folder,
                text=self._read_error_text(),
                wall=wall,
                peak=peak,
                worker=get_worker_name(),
            )
        code = os.waitstatus_to_exitcode(status.status) if self._forks else status.status
        outcome = _read_outcome(Path(folder))
        how: EndReason = broken or ("ended" if code == 0 and outcome is not None else "crashed")
        peak = max(peak, 1024 * status.peak_KiB)
        return JobEnd(
            how=how,
            folder=folder,
            code=code,
            outcome=outcome,
            text="",
            wall=wall,
            cpu=float(status.cpu_s),
            peak=peak,
            worker=get_worker_name(),
        )

    def close(self) -> None:
        """End the server and the job it runs."""
        with contextlib.suppress(OSError):
            self._process.stdin.close()  # type: ignore[union-attr]
        try:
            self._process.wait(2.0)
        except subprocess.TimeoutExpired:
            self._process.kill()
            self._process.wait()
        with _LOCK:
            _ALL_SERVERS.discard(self)
        self._process.stdout.close()  # type: ignore[union-attr]
        self._words.close()

    def _watch_job(self, spec: JobSpec, pid: int, begin: float) -> tuple[EndReason | None, JobEndedMessage | None, int]:
        """Wait for the end; return the exceeded limit, the reported end, and the peak memory."""
        broken: EndReason | None = None
        peak = looks = 0
        told_at = math.inf
        family = list_processes(pid)
        while True:
            with contextlib.suppress(queue.Empty):
                answer = self._answers.get(timeout=POLL_INTERVAL_S)
                if answer is not None:
                    return broken, JobEndedMessage.model_validate(answer), peak
                # without forks it was the job itself
                return broken, None if self._forks else JobEndedMessage(status=self._process.wait()), peak
            if broken is not None:  # killed already, unless the server itself is stopped or lost
                if self._forks and time.monotonic() - told_at > GRACE_PERIOD_S:
                    self._process.kill()
                    kill_processes(family)
                    told_at = math.inf
                continue
            looks += 1
            family = family if looks % POLLS_PER_PROCESS_SCAN else list_processes(pid)
            memory = measure_memory(family)
            peak = max(peak, memory)
            if time.monotonic() - begin > spec.time_limit:
                broken = "time"
            elif spec.memory_limit is not None and memory > spec.memory_limit:
                broken = "memory"
            if broken is not None:
                told_at = time.monotonic()
                family = list_processes(pid)
                self._kill_job(pid)

    def _kill_job(self, pid: int) -> None:
        if self._forks:
            self._send_line("kill")
            return
        kill_processes(list_processes(pid))

    def _wait_ready(self) -> bool:
        self._ready = self._wait_for_answer(ServerReadyMessage, WARM_UP_LIMIT_S) is not None
        if not self._ready:
            self._process.kill()
            self._process.wait()
        return self._ready

    def _wait_for_answer(self, kind: type[T], timeout: float) -> T | None:
        """The next answer; None where none comes in time, or ever."""
        try:
            answer = self._answers.get(timeout=timeout)
        except queue.Empty:
            return None
        if answer is None:
            self._answers.put(None)  # whoever asks next must not wait either
            return None
        return kind.model_validate(answer)

    def _send_line(self, line: str) -> bool:
        try:
            self._process.stdin.write(line.encode() + b"\n")  # type: ignore[union-attr]
            self._process.stdin.flush()  # type: ignore[union-attr]
        except (OSError, ValueError):  # ValueError: closed by stop_servers
            return False
        return True

    def _read_answers(self) -> None:
        with contextlib.suppress(ValueError):  # closed while reading
            for line in self._process.stdout or ():
                self._answers.put(json.loads(line))
        self._silent.set()
        self._answers.put(None)

    def _read_error_text(self) -> str:
        with contextlib.suppress(OSError, ValueError):
            self._words.seek(0)
            words = [w for w in self._words.read().decode(errors="replace").splitlines() if w.strip()]
            return words[-1] if words else ""
        return ""


def _read_outcome(folder: Path) -> BatchRowSection | JobFailureDocument | None:
    try:
        return _parse_outcome(json.loads((folder / OUTCOME_FILE).read_text(encoding="utf-8")))
    except (OSError, ValueError):  # the latter of what is no JSON, or not what a job leaves
        return None


def _parse_outcome(plain: Any) -> BatchRowSection | JobFailureDocument | None:
    if plain is None:
        return None
    if not isinstance(plain, dict):
        raise ValueError(f"{plain!r} is no outcome of a job")
    kind = JobFailureDocument if "error" in plain else BatchRowSection
    return kind.model_validate(plain)


def read_log_tail(folder: Path, lines: int = 1) -> str:
    """Return the last lines of a job's log that are not empty.

    Args:
        folder: Work folder of the job.
        lines: Number of lines.
    """
    try:
        text = (folder / LOG_FILE).read_text(encoding="utf-8", errors="replace")
    except OSError:
        return ""
    return "\n".join([line for line in text.splitlines() if line.strip()][-lines:])
