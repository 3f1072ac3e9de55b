"""Replacement of an old folder by a finished one; a kill at any moment leaves one of the two in place."""

from __future__ import annotations

import ctypes
import errno
import os
import sys
from pathlib import Path

_AT_FDCWD, _RENAME_EXCHANGE = -100, 2  # Linux, renameat2(2)
_RENAME_SWAP = 2  # macOS, renamex_np(2)


def sync_tree(folder: Path) -> None:
    """Flush every file and folder below to the disk, the folder itself last, so that a rename cannot precede its
    content.

    Args:
        folder: The folder.

    Raises:
        OSError: the disk refuses a write.
    """
    for place, _, files in os.walk(folder, topdown=False):
        for name in files:
            _sync_file(Path(place) / name)
        _sync_file(Path(place))


def sync_folder(folder: Path) -> None:
    """Flush a folder's own entries (names, renames) to the disk.

    Args:
        folder: The folder.

    Raises:
        OSError: the disk refuses a write.
    """
    _sync_file(folder)


def exchange_folders(a: Path, b: Path) -> bool:
    """Exchange two paths of one file system in one atomic step.

    Args:
        a: The first path.
        b: The second path.

    Returns:
        False where the system or the file system has no such step.

    Raises:
        OSError: the step exists and failed.
    """
    if sys.platform == "linux":
        call, arguments = "renameat2", (_AT_FDCWD, os.fsencode(a), _AT_FDCWD, os.fsencode(b), _RENAME_EXCHANGE)
    elif sys.platform == "darwin":
        call, arguments = "renamex_np", (os.fsencode(a), os.fsencode(b), _RENAME_SWAP)
    else:
        return False
    function = getattr(ctypes.CDLL(None, use_errno=True), call, None)
    if function is None:
        return False
    if function(*arguments) == 0:
        return True
    number = ctypes.get_errno()
    if number in (errno.ENOSYS, errno.EINVAL, errno.ENOTSUP):
        return False
    raise OSError(number, os.strerror(number), str(a), None, str(b))


def _sync_file(path: Path) -> None:
    if path.is_symlink():
        return
    try:
        handle = os.open(path, os.O_RDONLY)
    except PermissionError:
        if os.name == "nt":  # Windows opens no folders
            return
        raise
    try:
        os.fsync(handle)
    except OSError as problem:
        if problem.errno not in (errno.EINVAL, errno.ENOTSUP):  # a file system that syncs no folders
            raise
    finally:
        os.close(handle)
