"""A lock that dies with its process: the system drops it however the process ends."""

from __future__ import annotations

import contextlib
import os
from collections.abc import Iterator
from pathlib import Path
from typing import Any

from machopt.errors import OutputFolderError


@contextlib.contextmanager
def hold_file_lock(file: Path, busy: str, named: Path | str, *, keep: bool = False) -> Iterator[None]:
    """Hold an exclusive lock on ``file``, which is made for it and taken away again.

    Args:
        file: the lock file; one that a killed process left is taken over.
        busy: what to say where another process holds it.
        named: the file or folder to name in that message.
        keep: leave the file there in the end.

    Raises:
        InputError: another process holds the lock.
        OSError: the file cannot be made.
    """
    try:
        import fcntl
    except ImportError:  # Windows: two runs into one folder are the user's to avoid
        yield
        return
    handle = _acquire_lock(file, busy, named, fcntl)
    try:
        yield
    finally:
        if not keep and _is_lock_current(handle, file):
            with contextlib.suppress(OSError):
                file.unlink()
        os.close(handle)


def _acquire_lock(file: Path, busy: str, named: Path | str, fcntl: Any) -> int:
    while True:
        handle = os.open(file, os.O_RDWR | os.O_CREAT | os.O_CLOEXEC | os.O_NOFOLLOW, 0o644)
        try:
            fcntl.flock(handle, fcntl.LOCK_EX | fcntl.LOCK_NB)
        except BlockingIOError:
            os.close(handle)
            raise OutputFolderError(busy, file=named) from None
        except OSError:
            os.close(handle)
            raise
        if _is_lock_current(handle, file):
            return handle
        os.close(handle)  # its holder took the file away between our two calls


def _is_lock_current(handle: int, file: Path) -> bool:
    """The lock held is that of the file that has this name now."""
    try:
        return os.path.samestat(os.fstat(handle), os.stat(file, follow_symlinks=False))
    except OSError:
        return False
