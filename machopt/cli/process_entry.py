"""Entry point of the command as a process, and its fast exit."""

from __future__ import annotations

import atexit
import contextlib
import os
import sys
import threading
from typing import NoReturn

from machopt.cli import main


def run_command_and_exit() -> NoReturn:
    """Run the command of the process arguments and exit with its exit code."""
    exit_process(main())


def exit_process(code: int) -> NoReturn:
    """End the process at once, after exit handlers and flushing of the output.

    Python would free every object first, one by one: 0.17 s after a plan of 1,000 points. Where another thread still
    runs, Python exits as usual and waits for it.

    Args:
        code: The exit code.
    """
    if threading.active_count() > 1:
        sys.exit(code)
    atexit._run_exitfuncs()
    for stream in (sys.stdout, sys.stderr):
        with contextlib.suppress(OSError, ValueError):  # whoever read it has gone, or it was closed
            stream.flush()
    os._exit(code)
