"""Other processes that look at places for ``machopt place``: of this machine, or the workers of a Dask scheduler."""

from __future__ import annotations

import contextlib
import multiprocessing
import os
import pickle
import tempfile
import threading
from collections.abc import Callable, Generator, Iterator, Sequence
from concurrent.futures import ProcessPoolExecutor
from concurrent.futures.process import BrokenProcessPool
from dataclasses import dataclass
from pathlib import Path
from typing import Any, TypeVar

from machopt.batch.engine import Engine
from machopt.errors import InputError, MachoptError
from machopt.placement.search import Site
from machopt.services.place import PlaceRequest
from machopt.services.place_site import answer

A = TypeVar("A")
B = TypeVar("B")


@dataclass(frozen=True, eq=False)
class Crew:
    """Processes that were told the request, and load cell and toolpaths with the first question."""

    order: bytes  # the pickled request
    submit: Callable[..., Any]  # what to call and its arguments; a future
    width: int

    def each(self, ask: Callable[[Site, A], B], items: Sequence[A]) -> Iterator[B]:
        """Answers in the order of the questions.

        Raises:
            MachoptError: a process has ended.
            SchedulerLostError: the scheduler is gone.
        """
        futures = [self.submit(answer, self.order, ask, item) for item in items]
        try:
            for future in futures:
                yield _result(future)
        finally:
            for future in futures:
                future.cancel()


@contextlib.contextmanager
def crew(request: PlaceRequest, *, jobs: int, scheduler: str | None) -> Generator[Crew | None, None, None]:
    """Those who look at places; None: this process does it alone.

    Args:
        request: with paths that hold on the workers, where there is a scheduler.
        jobs: processes of this machine.
        scheduler: address of a running Dask scheduler, instead.

    Raises:
        InputError: no scheduler answers, or its workers run another version or do not see the files.
    """
    if scheduler is not None:
        with _cluster(request, scheduler) as some:
            yield some
    elif jobs == 1:
        yield None
    else:
        with _processes(jobs) as pool:
            yield Crew(pickle.dumps(request), pool.submit, jobs)


@contextlib.contextmanager
def _processes(jobs: int) -> Generator[ProcessPoolExecutor, None, None]:
    """Started with the first question; each with one thread, as there is one process a core."""
    with _environment(OPENBLAS_NUM_THREADS="1", MKL_NUM_THREADS="1", NUMBA_NUM_THREADS="1"):
        pool = ProcessPoolExecutor(
            jobs, mp_context=multiprocessing.get_context("spawn"), initializer=_end_with_the_one_who_asks
        )
        try:
            yield pool
        finally:
            pool.shutdown(wait=True, cancel_futures=True)


def _end_with_the_one_who_asks() -> None:
    """A process of a pool holds both ends of the pipe it waits on, so it would wait for ever for one who was killed."""
    asker = multiprocessing.parent_process()
    if asker is not None:
        threading.Thread(target=_ended_after, args=(asker.join,), name="machopt asker", daemon=True).start()


def _ended_after(wait: Callable[[], None]) -> None:
    wait()
    os._exit(1)


@contextlib.contextmanager
def _cluster(request: PlaceRequest, address: str) -> Generator[Crew, None, None]:
    with (
        tempfile.TemporaryDirectory(prefix=f".{request.out.name}-", dir=_parent(request.out)) as shared,
        Engine(Path(shared).name, scheduler=address, workers=0, version=None) as engine,
    ):
        engine.check_workers(Path(shared))
        yield Crew(pickle.dumps(request), engine.submit, engine.width)


def _parent(out: Path) -> Path:
    """The folder that OUT will stand in.

    Raises:
        InputError: it cannot be made.
    """
    try:
        out.parent.mkdir(parents=True, exist_ok=True)
    except OSError as problem:
        raise InputError(f"cannot be made: {problem.strerror}", file=out.parent) from None
    return out.parent


def _result(future: Any) -> Any:
    try:
        return future.result()
    except BrokenProcessPool:
        raise MachoptError(
            "a process that looked at places was ended from outside (out of memory?); what was found is kept, the same "
            "command goes on, with --jobs 1 in one process"
        ) from None


@contextlib.contextmanager
def _environment(**values: str) -> Generator[None, None, None]:
    """Variables that child processes inherit; whoever has set one is obeyed."""
    new = {k: v for k, v in values.items() if k not in os.environ}
    os.environ.update(new)
    try:
        yield
    finally:
        for name in new:
            os.environ.pop(name, None)
