"""Work spread over the cores this process may use. Which core does what never shows in a result."""

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
)  # what users and schedulers set where a process is not alone


def count_threads() -> int:
    """How many threads may run: the cores this process is bound to, or fewer where LIMITS in the environment say so."""
    here = len(os.sched_getaffinity(0)) if hasattr(os, "sched_getaffinity") else (os.cpu_count() or 1)
    asked = [int(value) for value in map(os.environ.get, THREAD_LIMIT_VARIABLES) if value and value.isdecimal()]
    return max(min([here, *asked]), 1)


def map_in_threads(task: Callable[[A], B], parts: Iterable[A]) -> list[B]:
    """``task`` of every part, in the order of the parts, on :func:`count_threads` threads.

    It pays where the task leaves the interpreter's lock to others: compiled kernels, and NumPy on large arrays. The
    parts must not depend on the number of threads wherever a result depends on the parts.
    """
    every = list(parts)
    threads = min(count_threads(), len(every))
    if threads < 2:
        return [task(part) for part in every]
    with ThreadPoolExecutor(max_workers=threads) as pool:
        return list(pool.map(task, every))


def run_two_in_threads(first: Callable[[], A], second: Callable[[], B]) -> tuple[A, B]:
    """What two tasks give, the second in a thread of its own where there is a core for it.

    It pays as :func:`map_in_threads` does. An error of the first goes before one of the second.
    """
    if count_threads() < 2:
        return first(), second()
    with ThreadPoolExecutor(max_workers=1) as pool:
        later = pool.submit(copy_context().run, second)
        return first(), later.result()
