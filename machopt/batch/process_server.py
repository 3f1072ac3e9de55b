"""Process server of one worker: imports and compiles once, then forks a process for every job.

Run as ``python -m machopt.batch.process_server ENTRY [--once]``. It exchanges JSON lines. On its standard output it
writes ``{"ready": true}`` first. For each job line on its standard input it writes ``{"pid": …}`` and, when that
process has ended, ``{"status": …, "peak_KiB": …}``. The line ``kill`` ends the running job. When its standard input
closes, it kills the job and ends; so no job outlives the process that waits for it.

With ``--once`` (where forking is not safe) the process runs one job itself and ends with it.
"""

from __future__ import annotations

import contextlib
import faulthandler
import importlib
import json
import os
import select
import signal
import sys
import tempfile
import threading
import traceback
from pathlib import Path
from types import ModuleType
from typing import Any

from machopt.batch.process_messages import JobEndedMessage, JobStartedMessage, ServerReadyMessage
from machopt.data_types.documents.batch_document import JobFailureDocument
from machopt.data_types.documents.document_base import DocumentModel

IDLE_TIMEOUT_S = 300.0  # s without a job, then the server ends by itself
OUTCOME_FILE = "outcome.json"
LOG_FILE = "log.txt"


def main(argv: list[str]) -> int:
    """Serve jobs until standard input closes.

    Args:
        argv: Arguments: entry point, then options.

    Returns:
        The exit code.
    """
    signal.signal(signal.SIGINT, signal.SIG_IGN)  # Ctrl-C is for the driver, which closes our input
    channel = os.dup(1)
    os.dup2(2, 1)  # what libraries print must not get between the answers
    importlib.import_module("machopt.output")  # every job writes with it
    entry = importlib.import_module(argv[0])
    with tempfile.TemporaryDirectory(prefix="machopt-warm-") as folder:
        if hasattr(entry, "warm"):
            entry.warm(Path(folder))
    _send_message(channel, ServerReadyMessage(ready=True))
    lines = _LineReader()
    while (line := lines.read_line(IDLE_TIMEOUT_S)) is not None:
        if line == b"kill":
            continue  # the job it was for ended by itself
        job = json.loads(line)
        if "--once" in argv:
            _run_single_job(entry, job, channel)
        elif not _run_job_in_child(entry, job, channel, lines):
            return 0
    return 0


class _LineReader:
    """Lines of standard input, read without holding back what comes after them."""

    def __init__(self) -> None:
        self._rest = b""

    def read_line(self, timeout: float) -> bytes | None:
        """Return the next line; None at the end of the input, or if none came in time.

        Args:
            timeout: Longest wait, s.
        """
        while b"\n" not in self._rest:
            if sys.platform != "win32" and not select.select([0], [], [], timeout)[0]:
                return None
            data = os.read(0, 65536)
            if not data:
                return None
            self._rest += data
        line, _, self._rest = self._rest.partition(b"\n")
        return line


def _send_message(channel: int, message: DocumentModel) -> None:
    os.write(channel, json.dumps(message.to_json_types()).encode() + b"\n")


def _run_job_in_child(entry: ModuleType, job: dict[str, Any], channel: int, lines: _LineReader) -> bool:
    """Run one job in a child process; return False when the client is gone."""
    parent = os.getpid()
    pid = os.fork()
    if pid == 0:
        os.close(channel)
        os.setsid()  # a group of its own: whatever it starts can be ended with it
        _exit_with_parent(parent)
        os.dup2(os.open(os.devnull, os.O_RDONLY), 0)
        _run_job_and_exit(entry, job)
    _send_message(channel, JobStartedMessage(pid=pid))
    ended = os.pidfd_open(pid)
    is_client_connected = True
    while is_client_connected:
        ready = select.select([0, ended], [], [])[0]
        if ended in ready:
            break
        is_client_connected = lines.read_line(0.0) is not None
        _kill_group(pid)
    os.close(ended)
    _kill_group(pid)  # what it may have left behind
    _, status, usage = os.wait4(pid, 0)
    if is_client_connected:
        _send_message(
            channel, JobEndedMessage(status=status, peak_KiB=usage.ru_maxrss, cpu_s=usage.ru_utime + usage.ru_stime)
        )
    return is_client_connected


def _run_single_job(entry: ModuleType, job: dict[str, Any], channel: int) -> None:
    _send_message(channel, JobStartedMessage(pid=os.getpid()))

    def watch() -> None:
        while os.read(0, 65536):
            pass
        os._exit(1)

    threading.Thread(target=watch, daemon=True).start()
    _run_job_and_exit(entry, job)


def _run_job_and_exit(entry: ModuleType, job: dict[str, Any]) -> None:
    """Run the job and exit the process in any case; result or error is written to outcome.json."""
    folder = Path(job["folder"])
    code = 1
    try:
        log = os.open(folder / LOG_FILE, os.O_WRONLY | os.O_CREAT | os.O_APPEND, 0o644)
        os.dup2(log, 1)
        os.dup2(log, 2)
        faulthandler.enable()
        found = entry.run(job["job"], folder / "out")
        _write_outcome(folder, found)
        code = 0
    finally:
        error = sys.exception()
        if error is not None:
            with contextlib.suppress(OSError, MemoryError):
                traceback.print_exception(error)
                _write_outcome(folder, JobFailureDocument(error=type(error).__name__, text=str(error)).to_json_types())
        with contextlib.suppress(OSError):
            sys.stdout.flush()
            sys.stderr.flush()
        os._exit(code)


def _write_outcome(folder: Path, value: dict[str, object]) -> None:
    from machopt.output import write_json

    write_json(folder / OUTCOME_FILE, value)


def _kill_group(pid: int) -> None:
    with contextlib.suppress(ProcessLookupError, PermissionError):
        os.killpg(pid, signal.SIGKILL)


def _exit_with_parent(parent: int) -> None:
    """Ask Linux to kill this process when its parent ends; the parent may be gone already."""
    if sys.platform != "linux":
        return
    import ctypes

    set_death_signal = 1  # PR_SET_PDEATHSIG
    ctypes.CDLL(None).prctl(set_death_signal, signal.SIGKILL)
    if os.getppid() != parent:
        os._exit(1)


if __name__ == "__main__":
    sys.exit(main(sys.argv[1:]))
