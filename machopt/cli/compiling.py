"""The first run after installing compiles: say so, share the work with a second process, and end that process."""

from __future__ import annotations

import contextlib
from collections.abc import Iterator
from typing import TYPE_CHECKING

from machopt.cli.display import Display

if TYPE_CHECKING:
    import subprocess

STORED = "compiling kernels, once per installation: the first run takes up to a minute longer"
NOT_STORED = (
    "compiling kernels in every run: neither the installation nor ~/.cache can be written; "
    "NUMBA_CACHE_DIR=FOLDER would name a place to store them"
)


@contextlib.contextmanager
def compiling(display: Display) -> Iterator[None]:
    """While a plan is made: what is printed and begun when a kernel is missing. Nothing where all are stored."""
    from machopt.compiled import when_compiling
    from machopt.plan.kernels import compile_beside

    beside: list[subprocess.Popen[bytes]] = []

    def told(stored: bool) -> None:
        display.say(STORED if stored else NOT_STORED)
        second = compile_beside() if stored else None
        if second is not None:
            beside.append(second)

    try:
        with when_compiling(told):
            yield
    finally:
        for process in beside:
            process.terminate()
            process.wait()
