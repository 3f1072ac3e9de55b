"""Processes that a job has started: their memory, their end, and names for messages."""

from __future__ import annotations

import contextlib
import os
import signal
from typing import Any


def format_signal_name(number: int) -> str:
    """Return the name of a signal: ``SIGSEGV`` of 11.

    Args:
        number: Number of the signal.
    """
    try:
        return signal.Signals(number).name
    except ValueError:
        return f"signal {number}"


def measure_memory(family: list[Any]) -> int:
    """Return the resident memory of some processes in bytes.

    Args:
        family: Processes of psutil.
    """
    import psutil

    total = 0
    for process in family:
        with contextlib.suppress(psutil.Error):
            total += process.memory_info().rss
    return total


def list_processes(pid: int) -> list[Any]:
    """Return a process and all processes that it has started.

    Args:
        pid: Number of the process.

    Returns:
        Processes of psutil; none where it has ended.
    """
    import psutil

    try:
        process = psutil.Process(pid)
        return [process, *process.children(recursive=True)]
    except psutil.Error:
        return []


def kill_processes(family: list[Any]) -> None:
    """Kill some processes; those that have ended are passed over.

    Args:
        family: Processes of psutil.
    """
    import psutil

    for process in family:
        with contextlib.suppress(psutil.Error):
            process.kill()


def get_worker_name() -> str:
    """Return host name and process number of this worker."""
    import socket

    return f"{socket.gethostname()}:{os.getpid()}"
