"""Batch jobs on Dask: each worker, of this process or of a running scheduler, supervises one job at a time.

A local batch opens no port: scheduler and workers are threads of this process and communicate in memory; Dask's
status pages are off. So no other user of the machine can connect. Jobs run in the process servers of
:mod:`machopt.batch.job_supervisor`, which are restarted when they end.
"""

from __future__ import annotations

import contextlib
import errno
import functools
import logging
import queue
import tempfile
import time
from collections.abc import Generator, Sequence
from concurrent.futures import CancelledError
from pathlib import Path
from typing import Any

from machopt.batch.job_key import compute_program_version
from machopt.batch.job_supervisor import JobEnd, JobSpec, stop_servers, supervise_job
from machopt.errors import InputError, OptionError

CONNECT_TIMEOUT_S = 15.0  # s to reach a scheduler
WORKER_TIMEOUT_S = 60.0  # s to wait for its first worker, and for another where all are gone
CLOSE_TIMEOUT_S = 5.0  # s to part from a scheduler
POLL_INTERVAL_S = 5.0  # s between two looks whether the scheduler and a worker are there
PROBE_FILE = "probe.txt"


class SchedulerLostError(InputError):
    """The scheduler that the user named, or the last of its workers, has gone while jobs were open.

    Args:
        what: that happened.
        address: of the scheduler.
    """

    def __init__(self, what: str, address: str) -> None:
        self.address = address
        super().__init__(
            f"{what}; finished jobs are kept: start a scheduler with workers, and the same command resumes the rest",
            where=f"--scheduler {address}",
        )


class DaskExecutor:
    """Connection to the workers; use it as a context manager."""

    def __init__(self, batch: str, *, scheduler: str | None, workers: int, version: str | None) -> None:
        self.batch, self._address, self._workers, self._version = batch, scheduler, workers, version
        self._client: Any = None
        self._held = contextlib.ExitStack()
        self._seen = 0.0  # when a worker was seen last, monotonic

    def __enter__(self) -> DaskExecutor:
        distributed = _import_distributed()
        try:
            where = self._address or self._held.enter_context(_start_local_cluster(self._workers))
            self._client = distributed.Client(where, timeout=CONNECT_TIMEOUT_S, set_as_default=False)
        except (OSError, ValueError, TypeError) as problem:
            self._held.close()
            raise OptionError(
                f"no Dask scheduler answers at {self._address} ({problem}); its address as `dask scheduler` prints it, "
                "e.g. tcp://127.0.0.1:8786, would work",
                where="--scheduler",
            ) from None
        self._seen = time.monotonic()
        return self

    def __exit__(self, kind: type[BaseException] | None, problem: BaseException | None, _: object) -> None:
        """Part from the workers.

        Raises:
            SchedulerLostError: the connection to the scheduler of another process broke; Dask has its own exceptions
                for that, which nobody outside of this file knows.
        """
        self._close()
        if self._address is not None and _is_lost_connection(problem):
            raise self._raise_connection_lost(f"the Dask scheduler is gone ({type(problem).__name__})") from problem

    def _close(self) -> None:
        with self._held:
            if self._address is None:
                stop_servers(self.batch)  # the workers are this process
            elif self._client is not None:
                with contextlib.suppress(OSError, RuntimeError, TimeoutError):  # a scheduler that is gone
                    self._client.run(stop_servers, self.batch)
            if self._client is not None:
                with contextlib.suppress(TimeoutError):
                    self._client.close(timeout=CLOSE_TIMEOUT_S)

    def check_workers(self, work: Path) -> None:
        """Check that the workers run this version and can access the output folder.

        Args:
            work: Work folder of the batch.

        Raises:
            InputError: there is no worker, it has another version, or does not share the file system.
        """
        distributed = _import_distributed()
        try:
            self._client.wait_for_workers(1, timeout=WORKER_TIMEOUT_S)
        except (TimeoutError, distributed.TimeoutError):
            raise OptionError(
                f"the scheduler has no workers after {WORKER_TIMEOUT_S:.0f} s; start some with `dask worker`",
                where="--scheduler",
            ) from None
        token = f"{self.batch}\n"
        (work / PROBE_FILE).write_text(token, encoding="utf-8")
        try:
            answers = self._client.run(_probe_worker, str(work / PROBE_FILE), on_error="return")
        finally:
            (work / PROBE_FILE).unlink()
        for worker, answer in answers.items():
            if isinstance(answer, BaseException):
                raise OptionError(
                    f"worker {worker} cannot run machopt ({type(answer).__name__}: {answer}); install the same version "
                    "there",
                    where="--scheduler",
                )
            version, seen = answer
            if seen != token:
                raise OptionError(
                    f"worker {worker} does not see the output folder; a folder on a file system shared by all would "
                    "work",
                    file=work.parent,
                    where="--scheduler",
                )
            if self._version is None and version != compute_program_version():
                same = "install the same there" if self._address else "it was changed this moment; start again"
                raise InputError(f"worker {worker} has machopt {version}, here is {compute_program_version()}; {same}")

    @property
    def worker_count(self) -> int:
        """Number of connected workers, at least one."""
        return max(len(self._client.ncores()), 1)

    def submit_call(self, what: Any, *arguments: Any) -> Any:
        """Submit one call to a worker; equal calls are not merged.

        Args:
            what: The function.
            arguments: Its positional arguments.

        Returns:
            The future of the call.
        """
        return self._client.submit(what, *arguments, pure=False)

    def run_jobs(self, specs: Sequence[tuple[str, JobSpec]]) -> Generator[tuple[str, JobEnd], None, None]:
        """Submit all jobs in order; yield each with its end as they finish.

        Args:
            specs: (label, job) pairs.

        Raises:
            SchedulerLostError: the scheduler is gone.
        """
        names = {f"{self.batch}-{name}": name for name, _ in specs}
        ends: queue.SimpleQueue[Any] = queue.SimpleQueue()
        futures = [
            self._client.submit(supervise_job, spec, key=key, pure=False)
            for key, (_, spec) in zip(names, specs, strict=True)
        ]
        for future in futures:
            future.add_done_callback(ends.put)
        for _ in specs:
            future = self._wait_for_next(ends)
            if future.status == "finished":
                ended = JobEnd.from_json_types(future.result())
            elif future.status == "error":
                ended = JobEnd(how="server", folder="", text=_format_error(future.exception()))
            else:
                raise self._raise_connection_lost("the Dask scheduler is gone")
            future.release()
            yield names[future.key], ended

    def _raise_connection_lost(self, what: str) -> SchedulerLostError:
        return SchedulerLostError(what, self._address or "this process")

    def _wait_for_next(self, ends: queue.SimpleQueue[Any]) -> Any:
        """The next future that is over; never waits for a scheduler or workers that are no more."""
        while True:
            with contextlib.suppress(queue.Empty):
                return ends.get(timeout=POLL_INTERVAL_S)
            self._check_connection()

    def _check_connection(self) -> None:
        if self._client.status in ("closed", "closing"):
            raise self._raise_connection_lost("the Dask scheduler is gone")
        try:
            workers = self._client.sync(self._client.scheduler.ncores, callback_timeout=CONNECT_TIMEOUT_S)
        except (OSError, TimeoutError, _import_distributed().TimeoutError):
            workers = {}
        now = time.monotonic()
        if workers:
            self._seen = now
        elif now - self._seen > WORKER_TIMEOUT_S:
            raise self._raise_connection_lost(f"no Dask worker has been there for {WORKER_TIMEOUT_S:.0f} s")


@contextlib.contextmanager
def _start_local_cluster(workers: int) -> Generator[Any, None, None]:
    """A scheduler and workers as threads of this process, without a port."""
    with tempfile.TemporaryDirectory(prefix="machopt-dask-") as scratch:
        scheduler, worker = _define_portless_classes()
        options = {"nthreads": 1, "memory_limit": 0, "dashboard": False, "local_directory": scratch}
        cluster = _import_distributed().SpecCluster(
            scheduler={"cls": scheduler, "options": {"protocol": "inproc", "dashboard": False}},
            workers={n: {"cls": worker, "options": options} for n in range(workers)},
            silence_logs=logging.CRITICAL,
        )
        try:
            yield cluster
        finally:
            cluster.close(timeout=CLOSE_TIMEOUT_S)


@functools.cache
def _define_portless_classes() -> tuple[type, type]:
    """Dask's scheduler and worker without the status pages, which no option of Dask switches off."""
    distributed = _import_distributed()

    class Portless:
        def start_http_server(self, *_: object, **__: object) -> None:
            """Serve nothing."""

    scheduler = type("PortlessScheduler", (Portless, distributed.Scheduler), {})
    return scheduler, type("PortlessWorker", (Portless, distributed.Worker), {})


def _probe_worker(file: str) -> tuple[str, str | None]:
    """What a worker runs, and what it sees."""
    try:
        seen = Path(file).read_text(encoding="utf-8")
    except OSError:
        seen = None
    return compute_program_version(), seen


def _format_error(problem: BaseException) -> str:
    """Why Dask gave a task up."""
    if type(problem).__name__ == "KilledWorker":
        return "every worker that took it was killed"
    return f"{type(problem).__name__}: {problem}"


def _is_lost_connection(problem: BaseException | None) -> bool:
    """Whether an exception is one that Dask raises where the other side of a connection has gone."""
    if isinstance(problem, OSError) and not isinstance(problem, TimeoutError):
        return problem.errno in (None, errno.ECONNREFUSED, errno.ECONNRESET, errno.EPIPE, errno.ETIMEDOUT)
    return isinstance(problem, (CancelledError, TimeoutError, _import_distributed().TimeoutError))


def check_installed() -> None:
    """Check that the packages of batch runs are installed.

    Raises:
        InputError: a package is missing; the message names the extra.
    """
    _import_distributed()


def get_machine_memory() -> int:
    """Return the memory of this machine, or of its container, bytes."""
    _import_distributed()
    from distributed.system import MEMORY_LIMIT

    return int(MEMORY_LIMIT)


def _import_distributed() -> Any:
    try:
        import distributed
        import psutil  # noqa: F401  the jobs' processes need it; checked here before any is started
    except ImportError:
        raise InputError(
            "machopt batch runs on Dask distributed and psutil, of which one is not installed; "
            "pip install '.[batch]' in machopt's source folder would work",
            where="batch",
        ) from None
    return distributed
