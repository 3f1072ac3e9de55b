"""The jobs on Dask: a local cluster or a running scheduler hands each to a worker, which supervises it."""

from __future__ import annotations

import contextlib
import logging
from collections.abc import Generator, Sequence
from pathlib import Path
from typing import Any

from machopt.batch.key import program_version
from machopt.batch.supervise import Ended, Spec, stop_servers, supervise
from machopt.errors import InputError, MachoptError

CONNECT = 15.0  # s to reach a scheduler
WORKERS = 60.0  # s to wait for its first worker
PROBE = "probe.txt"
ANY_PORT = {"dashboard": False, "dashboard_address": "127.0.0.1:0"}
"""Dask's scheduler listens for its status pages on port 8787 without any too, and warns where another one does."""


class Engine:
    """A connection to the workers; use it as a context."""

    def __init__(self, batch: str, *, scheduler: str | None, workers: int, version: str | None) -> None:
        self.batch, self._address, self._workers, self._version = batch, scheduler, workers, version
        self._cluster: Any = None
        self._client: Any = None

    def __enter__(self) -> Engine:
        distributed = _distributed()
        if self._address is None:
            self._cluster = distributed.LocalCluster(
                n_workers=self._workers, threads_per_worker=1, processes=True, scheduler_kwargs=ANY_PORT,
                memory_limit=0, silence_logs=logging.CRITICAL,  # the workers only supervise; limits are the jobs' own
            )  # fmt: skip
        try:
            self._client = distributed.Client(self._cluster or self._address, timeout=CONNECT, set_as_default=False)
        except (OSError, ValueError, TypeError) as problem:
            raise InputError(
                f"no Dask scheduler answers at {self._address} ({problem}); its address as `dask scheduler` prints it, "
                "e.g. tcp://127.0.0.1:8786, would work", where="--scheduler",
            ) from None  # fmt: skip
        return self

    def __exit__(self, *_: object) -> None:
        if self._client is not None:
            with contextlib.suppress(OSError, RuntimeError):  # a scheduler that is gone
                self._client.run(stop_servers, self.batch)
            self._client.close()
        if self._cluster is not None:
            self._cluster.close(timeout=5.0)

    def check_workers(self, work: Path) -> None:
        """Make sure that the workers run this program and see the output folder.

        Raises:
            InputError: there is no worker, it has another version, or does not share the file system.
        """
        distributed = _distributed()
        try:
            self._client.wait_for_workers(1, timeout=WORKERS)
        except (TimeoutError, distributed.TimeoutError):
            raise InputError(
                f"the scheduler has no workers after {WORKERS:.0f} s; start some with `dask worker`",
                where="--scheduler",
            ) from None
        token = f"{self.batch}\n"
        (work / PROBE).write_text(token, encoding="utf-8")
        try:
            told = self._client.run(_probe, str(work / PROBE), on_error="return")
        finally:
            (work / PROBE).unlink()
        for worker, answer in told.items():
            if isinstance(answer, BaseException):
                raise InputError(
                    f"worker {worker} cannot run machopt ({type(answer).__name__}: {answer}); install the same version "
                    "there", where="--scheduler",
                )  # fmt: skip
            version, seen = answer
            if seen != token:
                raise InputError(
                    f"worker {worker} does not see the output folder; a folder on a file system shared by all would "
                    "work", file=work.parent, where="--scheduler",
                )  # fmt: skip
            if self._version is None and version != program_version():
                same = "install the same there" if self._address else "it was changed this moment; start again"
                raise InputError(f"worker {worker} has machopt {version}, here is {program_version()}; {same}")

    def run(self, specs: Sequence[tuple[str, Spec]]) -> Generator[tuple[str, Ended], None, None]:
        """Hand out all jobs in order; yields each with its end as they finish.

        Raises:
            MachoptError: the scheduler is gone.
        """
        distributed = _distributed()
        names = {f"{self.batch}-{name}": name for name, _ in specs}
        futures = [
            self._client.submit(supervise, spec, key=key, pure=False)
            for key, (_, spec) in zip(names, specs, strict=True)
        ]
        for future in distributed.as_completed(futures, loop=self._client.loop, raise_errors=False):
            if future.status == "finished":
                ended = Ended(**future.result())
            elif future.status == "error":
                ended = Ended("server", "", text=_words(future.exception()))
            else:
                raise MachoptError(
                    "the Dask scheduler is gone; finished jobs are kept, the same command goes on with the rest"
                )
            future.release()
            yield names[future.key], ended


def _probe(file: str) -> tuple[str, str | None]:
    """What a worker runs, and what it sees."""
    try:
        seen = Path(file).read_text(encoding="utf-8")
    except OSError:
        seen = None
    return program_version(), seen


def _words(problem: BaseException) -> str:
    """Why Dask gave a task up."""
    if type(problem).__name__ == "KilledWorker":
        return "every worker that took it was killed"
    return f"{type(problem).__name__}: {problem}"


def machine_memory() -> int:
    """Bytes of memory that this machine, or the container around us, has."""
    _distributed()
    from distributed.system import MEMORY_LIMIT

    return int(MEMORY_LIMIT)


def _distributed() -> Any:
    try:
        import distributed
    except ImportError:
        raise InputError(
            "machopt batch runs on Dask distributed, which is not installed; pip install 'dask[distributed]'"
        ) from None
    return distributed
