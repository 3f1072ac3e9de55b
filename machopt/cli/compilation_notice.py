"""Notice of the first run after installation, which compiles; a second process shares the work and is ended
afterwards.
"""

from __future__ import annotations

import contextlib
from collections.abc import Iterator
from typing import TYPE_CHECKING

from machopt.cli.progress_display import ProgressDisplay

if TYPE_CHECKING:
    import subprocess

STORED = "compiling kernels, once per installation: the first run takes up to a minute longer"
NOT_STORED = (
    "compiling kernels in every run: neither the installation nor ~/.cache can be written; "
    "NUMBA_CACHE_DIR=FOLDER would name a place to store them"
)


@contextlib.contextmanager
def announce_compilation(display: ProgressDisplay) -> Iterator[None]:
    """Show a notice and start a second process while a kernel has to be compiled; nothing where all are stored.

    Args:
        display: The progress display.
    """
    from machopt.numerics.compiled_functions import call_on_compilation
    from machopt.planning.kernel_precompilation import start_compile_process

    processes: list[subprocess.Popen[bytes]] = []

    def notify(stored: bool) -> None:
        display.print_line(STORED if stored else NOT_STORED)
        second = start_compile_process() if stored else None
        if second is not None:
            processes.append(second)

    try:
        with call_on_compilation(notify):
            yield
    finally:
        for process in processes:
            process.terminate()
            process.wait()
