"""Distribution of work over the cores of this process; results never depend on the distribution."""

from __future__ import annotations

import os
from collections.abc import Callable, Iterable
from concurrent.futures import ThreadPoolExecutor
from contextvars import copy_context
from typing import TypeVar

A = TypeVar("A")
B = TypeVar("B")
THREAD_LIMIT_VARIABLES = (
    "NUMBA_NUM_THREADS",
    "OMP_NUM_THREADS",
)  # set by users and schedulers to limit the threads of a process


def count_threads() -> int:
    """Return how many threads may run: the available cores, or fewer by THREAD_LIMIT_VARIABLES in the environment."""
    cores = len(os.sched_getaffinity(0)) if hasattr(os, "sched_getaffinity") else (os.cpu_count() or 1)
    limits = [int(value) for value in map(os.environ.get, THREAD_LIMIT_VARIABLES) if value and value.isdecimal()]
    return max(min([cores, *limits]), 1)


def map_in_threads(task: Callable[[A], B], parts: Iterable[A]) -> list[B]:
    """Return ``task`` of every part, in the order of the parts, on :func:`count_threads` threads.

    It helps where the task releases the interpreter lock: compiled kernels, and NumPy on large arrays. The
    parts must not depend on the number of threads wherever a result depends on the parts.

    Args:
        task: function of one part.
        parts: parts of the work.
    """
    items = list(parts)
    threads = min(count_threads(), len(items))
    if threads < 2:
        return [task(part) for part in items]
    with ThreadPoolExecutor(max_workers=threads) as pool:
        return list(pool.map(task, items))


def run_two_in_threads(first: Callable[[], A], second: Callable[[], B]) -> tuple[A, B]:
    """Return the results of two tasks, the second run in a separate thread where there is a core for it.

    It helps as :func:`map_in_threads` does. An exception of the first has priority over one of the second.

    Args:
        first: task for this thread.
        second: task for the other thread.
    """
    if count_threads() < 2:
        return first(), second()
    with ThreadPoolExecutor(max_workers=1) as pool:
        later = pool.submit(copy_context().run, second)
        return first(), later.result()
