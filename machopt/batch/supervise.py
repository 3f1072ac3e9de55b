"""A Dask task: give one job to a process server, keep it within its time and memory, and tell how it ended.

Nothing here raises for what a job does; a job that crashes, hangs or eats memory is an :class:`Ended` like any other.
"""

from __future__ import annotations

import contextlib
import json
import math
import os
import queue
import signal
import subprocess
import sys
import tempfile
import threading
import time
from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Literal, TypeVar

from machopt.batch.messages import Begun, Over, Ready
from machopt.batch.nursery import LOG, OUTCOME
from machopt.domain.results.base import Part
from machopt.domain.results.batch import BatchRow, JobFailure

T = TypeVar("T", bound=Part)

How = Literal["ended", "crashed", "time", "memory", "server", "stopped"]

ENDED = "ended.json"
FORKS = sys.platform == "linux"  # elsewhere system libraries do not promise to survive a fork
WARM_LIMIT = 900.0  # s a server may take to import and compile, or to wait for another that does
GRACE = 10.0  # s in which a server ends the job it was told to end; one that does not is ended with it
LOOK = 0.05  # s between two looks at a job's memory and time
LOOKS_A_FAMILY = 20  # finding what a job has started itself takes milliseconds: not at every look
ONE_THREAD = dict.fromkeys(
    ("OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS", "MKL_NUM_THREADS", "NUMBA_NUM_THREADS", "VECLIB_MAXIMUM_THREADS"), "1"
)  # as many processes as cores are at work already


@dataclass(frozen=True, kw_only=True)
class Spec:
    """One job as it goes to a worker; plain values only."""

    label: str
    key: str
    batch: str  # token of the run, to which servers belong
    work: str  # folder on a file system that driver and workers share
    entry: str
    job: dict[str, Any]
    time_limit: float  # s
    memory_limit: int | None  # bytes


@dataclass(frozen=True, kw_only=True)
class Ended:
    """How a job ended."""

    how: How
    folder: str  # what it wrote: out/, outcome.json, log.txt
    code: int | None = None  # exit code, negative: the signal that killed it
    outcome: BatchRow | JobFailure | None = None  # None: it left none
    text: str = ""  # where the server itself failed: its last words
    wall: float = 0.0  # s
    cpu: float = 0.0  # s
    peak: int = 0  # bytes
    worker: str = ""

    def plain(self) -> dict[str, Any]:
        """In JSON's own types; :meth:`of` reads it."""
        return {**vars(self), "outcome": None if self.outcome is None else self.outcome.plain()}

    @classmethod
    def of(cls, plain: Mapping[str, Any]) -> Ended:
        """From :meth:`plain`."""
        return cls(**{**plain, "outcome": _outcome_of(plain["outcome"])})


def supervise(spec: Spec) -> dict[str, Any]:
    """Run one job to its end; returns an :class:`Ended` in plain types.

    The end is written beside what the job wrote before anyone is told, so a job whose worker or driver is killed
    before the result was put away is still done.
    """
    for _, key, earlier in attempts(Path(spec.work), spec.label):
        if key == spec.key:
            return earlier.plain()
    ended = _one(spec)
    if ended.how == "server":  # the server was killed from outside, or there was no memory for it: once more
        ended = _one(spec)
    if ended.how not in ("server", "stopped"):
        _keep(spec, ended)
    return ended.plain()


def attempts(work: Path, label: str = "*") -> Iterator[tuple[str, str, Ended]]:
    """Label, key and end of the jobs of a work folder, or of one of them, that have ended and were not put away."""
    for file in sorted(work.glob(f"{label}~*/{ENDED}")):
        try:
            found = json.loads(file.read_text(encoding="utf-8"))
            ended = found["label"], found["key"], Ended.of({**found["ended"], "folder": str(file.parent)})
        except (OSError, ValueError, KeyError, TypeError):
            continue  # being put away right now, or damaged: the job is run again
        yield ended


def _keep(spec: Spec, ended: Ended) -> None:
    """Write the end of a job in one step."""
    folder = Path(ended.folder)
    text = json.dumps({"label": spec.label, "key": spec.key, "ended": ended.plain()})
    (folder / f"{ENDED}.new").write_text(text, encoding="utf-8")
    (folder / f"{ENDED}.new").rename(folder / ENDED)


def stop_servers(batch: str) -> None:
    """End all servers of a batch in this worker, with the jobs they run."""
    with _LOCK:
        _STOPPED.add(batch)
        servers = [s for s in _ALL if s.batch == batch]
    for server in servers:
        server.close()


_LOCK = threading.Lock()
_IDLE: list[Server] = []
_ALL: set[Server] = set()
_STOPPED: set[str] = set()


def _one(spec: Spec) -> Ended:
    folder = tempfile.mkdtemp(dir=spec.work, prefix=f"{spec.label}~")
    if spec.batch in _STOPPED:
        return Ended(how="stopped", folder=folder)
    server = _take(spec)
    try:
        ended = server.run(spec, folder)
    finally:
        if server.alive and FORKS:
            with _LOCK:
                _IDLE.append(server)
        else:
            server.close()
    return Ended(how="stopped", folder=folder) if spec.batch in _STOPPED else ended


def _take(spec: Spec) -> Server:
    with _LOCK:
        for server in list(_IDLE):
            if not server.alive:
                _IDLE.remove(server)
            elif (server.batch, server.entry) == (spec.batch, spec.entry):
                _IDLE.remove(server)
                return server
    return Server(spec.batch, spec.entry, forks=FORKS)


class Server:
    """The other end of :mod:`machopt.batch.nursery`."""

    def __init__(self, batch: str, entry: str, *, forks: bool) -> None:
        self.batch, self.entry, self._forks = batch, entry, forks
        self._words = tempfile.TemporaryFile()  # noqa: SIM115 — closed with the server
        self._process = subprocess.Popen(
            [sys.executable, "-P", "-m", "machopt.batch.nursery", entry, *([] if forks else ["--once"])],
            stdin=subprocess.PIPE,
            stdout=subprocess.PIPE,
            stderr=self._words,
            start_new_session=True,
            env={**os.environ, **ONE_THREAD, "PYTHONPATH": os.pathsep.join(p or os.getcwd() for p in sys.path)},
        )
        self._answers: queue.Queue[dict[str, Any] | None] = queue.Queue()
        self._silent = threading.Event()  # no answer will come any more
        threading.Thread(target=self._listen, daemon=True).start()
        self._ready = False
        with _LOCK:
            _ALL.add(self)

    @property
    def alive(self) -> bool:
        """It can take a job. A killed process closes its pipe a moment before the system says that it has ended."""
        return not self._silent.is_set() and self._process.poll() is None

    def run(self, spec: Spec, folder: str) -> Ended:
        """Do one job, within its limits."""
        if not self._ready and not self._wait_ready():
            return Ended(how="server", folder=folder, text=self._last_words())
        if not self._send(json.dumps({"job": spec.job, "folder": folder})):
            return Ended(how="server", folder=folder, text=self._last_words())
        started = self._answer(Begun, WARM_LIMIT)
        if started is None:
            return Ended(how="server", folder=folder, text=self._last_words())
        begin = time.monotonic()
        broken, status, peak = self._watch(spec, started.pid, begin)
        wall = time.monotonic() - begin
        if status is None:
            return Ended(
                how=broken or "server", folder=folder, text=self._last_words(), wall=wall, peak=peak, worker=_here()
            )
        code = os.waitstatus_to_exitcode(status.status) if self._forks else status.status
        outcome = _outcome(Path(folder))
        how: How = broken or ("ended" if code == 0 and outcome is not None else "crashed")
        peak = max(peak, 1024 * status.peak_KiB)
        return Ended(
            how=how,
            folder=folder,
            code=code,
            outcome=outcome,
            text="",
            wall=wall,
            cpu=float(status.cpu_s),
            peak=peak,
            worker=_here(),
        )

    def close(self) -> None:
        """End the server; the job it runs ends with it."""
        with contextlib.suppress(OSError):
            self._process.stdin.close()  # type: ignore[union-attr]
        try:
            self._process.wait(2.0)
        except subprocess.TimeoutExpired:
            self._process.kill()
            self._process.wait()
        with _LOCK:
            _ALL.discard(self)
        self._process.stdout.close()  # type: ignore[union-attr]
        self._words.close()

    def _watch(self, spec: Spec, pid: int, begin: float) -> tuple[How | None, Over | None, int]:
        """Wait for the end; returns the limit that was broken, the end as told, and the largest memory seen."""
        broken: How | None = None
        peak = looks = 0
        told_at = math.inf
        family = _family(pid)
        while True:
            with contextlib.suppress(queue.Empty):
                told = self._answers.get(timeout=LOOK)
                if told is not None:
                    return broken, Over.model_validate(told), peak
                # without forks it was the job itself
                return broken, None if self._forks else Over(status=self._process.wait()), peak
            if broken is not None:  # killed already, unless the server itself is stopped or lost
                if self._forks and time.monotonic() - told_at > GRACE:
                    self._process.kill()
                    _kill_all(family)
                    told_at = math.inf
                continue
            looks += 1
            family = family if looks % LOOKS_A_FAMILY else _family(pid)
            memory = _memory(family)
            peak = max(peak, memory)
            if time.monotonic() - begin > spec.time_limit:
                broken = "time"
            elif spec.memory_limit is not None and memory > spec.memory_limit:
                broken = "memory"
            if broken is not None:
                told_at = time.monotonic()
                family = _family(pid)
                self._kill(pid)

    def _kill(self, pid: int) -> None:
        if self._forks:
            self._send("kill")
            return
        _kill_all(_family(pid))

    def _wait_ready(self) -> bool:
        self._ready = self._answer(Ready, WARM_LIMIT) is not None
        if not self._ready:
            self._process.kill()
            self._process.wait()
        return self._ready

    def _answer(self, kind: type[T], timeout: float) -> T | None:
        """The next answer; None where none comes in time, or ever."""
        try:
            told = self._answers.get(timeout=timeout)
        except queue.Empty:
            return None
        if told is None:
            self._answers.put(None)  # whoever asks next must not wait either
            return None
        return kind.model_validate(told)

    def _send(self, line: str) -> bool:
        try:
            self._process.stdin.write(line.encode() + b"\n")  # type: ignore[union-attr]
            self._process.stdin.flush()  # type: ignore[union-attr]
        except (OSError, ValueError):  # ValueError: closed by stop_servers
            return False
        return True

    def _listen(self) -> None:
        with contextlib.suppress(ValueError):  # closed while reading
            for line in self._process.stdout or ():
                self._answers.put(json.loads(line))
        self._silent.set()
        self._answers.put(None)

    def _last_words(self) -> str:
        with contextlib.suppress(OSError, ValueError):
            self._words.seek(0)
            words = [w for w in self._words.read().decode(errors="replace").splitlines() if w.strip()]
            return words[-1] if words else ""
        return ""


def _outcome(folder: Path) -> BatchRow | JobFailure | None:
    try:
        return _outcome_of(json.loads((folder / OUTCOME).read_text(encoding="utf-8")))
    except (OSError, ValueError):  # the latter of what is no JSON, or not what a job leaves
        return None


def _outcome_of(plain: Any) -> BatchRow | JobFailure | None:
    if plain is None:
        return None
    if not isinstance(plain, dict):
        raise ValueError(f"{plain!r} is no outcome of a job")
    kind = JobFailure if "error" in plain else BatchRow
    return kind.model_validate(plain)


def log_tail(folder: Path, lines: int = 1) -> str:
    """The last words a job wrote."""
    try:
        text = (folder / LOG).read_text(encoding="utf-8", errors="replace")
    except OSError:
        return ""
    return "\n".join([line for line in text.splitlines() if line.strip()][-lines:])


def signal_name(number: int) -> str:
    """``SIGSEGV`` of 11."""
    try:
        return signal.Signals(number).name
    except ValueError:
        return f"signal {number}"


def _memory(family: list[Any]) -> int:
    """Bytes in memory of some processes."""
    import psutil

    total = 0
    for process in family:
        with contextlib.suppress(psutil.Error):
            total += process.memory_info().rss
    return total


def _family(pid: int) -> list[Any]:
    """A process and all it has started."""
    import psutil

    try:
        process = psutil.Process(pid)
        return [process, *process.children(recursive=True)]
    except psutil.Error:
        return []


def _kill_all(family: list[Any]) -> None:
    import psutil

    for process in family:
        with contextlib.suppress(psutil.Error):
            process.kill()


def _here() -> str:
    import socket

    return f"{socket.gethostname()}:{os.getpid()}"
