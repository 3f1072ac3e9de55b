"""Worker processes of ``machopt place``: of this machine, or the workers of a Dask scheduler."""

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

from machopt.batch.dask_executor import DaskExecutor
from machopt.commands.place.run import PlaceRequest
from machopt.commands.place.site_loading import run_site_task
from machopt.errors import InputError, MachoptError
from machopt.placement.placement_site import PlacementSite

A = TypeVar("A")
B = TypeVar("B")


@dataclass(frozen=True, eq=False)
class PlacementWorkers:
    """Worker processes that have the request and load cell and toolpaths on first use."""

    pickled_request: bytes  # the pickled request
    submit: Callable[..., Any]  # what to call and its arguments; a future
    worker_count: int

    def map_items(self, ask: Callable[[PlacementSite, A], B], items: Sequence[A]) -> Iterator[B]:
        """Yield the results of a function of the site in the order of its items.

        Args:
            ask: Function of site and item.
            items: The items.

        Raises:
            MachoptError: a process has ended.
            SchedulerLostError: the scheduler is gone.
        """
        futures = [self.submit(run_site_task, self.pickled_request, ask, item) for item in items]
        try:
            for future in futures:
                yield _get_result(future)
        finally:
            for future in futures:
                future.cancel()


@contextlib.contextmanager
def open_placement_workers(
    request: PlaceRequest, *, jobs: int, scheduler: str | None
) -> Generator[PlacementWorkers | None, None, None]:
    """Those who look at places; None: this process does it alone.

    Args:
        request: with paths that hold on the workers, where there is a scheduler.
        jobs: processes of this machine.
        scheduler: address of a running Dask scheduler, instead.

    Raises:
        InputError: no scheduler answers, or its workers run another version or do not see the files.
    """
    if scheduler is not None:
        with _connect_to_cluster(request, scheduler) as some:
            yield some
    elif jobs == 1:
        yield None
    else:
        with _open_process_pool(jobs) as pool:
            yield PlacementWorkers(pickle.dumps(request), pool.submit, jobs)


@contextlib.contextmanager
def _open_process_pool(jobs: int) -> Generator[ProcessPoolExecutor, None, None]:
    """Started with the first question; each with one thread, as there is one process a core."""
    with _set_thread_variables(OPENBLAS_NUM_THREADS="1", MKL_NUM_THREADS="1", NUMBA_NUM_THREADS="1"):
        pool = ProcessPoolExecutor(jobs, mp_context=multiprocessing.get_context("spawn"), initializer=_exit_with_parent)
        try:
            yield pool
        finally:
            pool.shutdown(wait=True, cancel_futures=True)


def _exit_with_parent() -> None:
    """A process of a pool holds both ends of the pipe it waits on, so it would wait for ever for one who was killed."""
    asker = multiprocessing.parent_process()
    if asker is not None:
        threading.Thread(target=_exit_after, args=(asker.join,), name="machopt asker", daemon=True).start()


def _exit_after(wait: Callable[[], None]) -> None:
    wait()
    os._exit(1)


@contextlib.contextmanager
def _connect_to_cluster(request: PlaceRequest, address: str) -> Generator[PlacementWorkers, None, None]:
    with (
        tempfile.TemporaryDirectory(prefix=f".{request.out.name}-", dir=_create_parent_folder(request.out)) as shared,
        DaskExecutor(Path(shared).name, scheduler=address, workers=0, version=None) as engine,
    ):
        engine.check_workers(Path(shared))
        yield PlacementWorkers(pickle.dumps(request), engine.submit_call, engine.worker_count)


def _create_parent_folder(out: Path) -> Path:
    """The folder that OUT will stand in.

    Raises:
        InputError: it cannot be made.
    """
    try:
        out.parent.mkdir(parents=True, exist_ok=True)
    except OSError as problem:
        raise InputError(f"cannot be made: {problem.strerror}", file=out.parent) from None
    return out.parent


def _get_result(future: Any) -> Any:
    try:
        return future.result()
    except BrokenProcessPool:
        raise MachoptError(
            "a process that evaluated places was ended from outside (out of memory?); results so far are saved, "
            "the same "
            "command goes on, with --jobs 1 in one process"
        ) from None


@contextlib.contextmanager
def _set_thread_variables(**values: str) -> Generator[None, None, None]:
    """Variables that child processes inherit; whoever has set one is obeyed."""
    new = {k: v for k, v in values.items() if k not in os.environ}
    os.environ.update(new)
    try:
        yield
    finally:
        for name in new:
            os.environ.pop(name, None)
