"""Reading of user files: regular files of limited size, otherwise one clear error.

A named pipe would block, a device never ends, and a file of gigabytes would fill the memory before the first check.
All three are detected from the inode before a byte is read.
"""

from __future__ import annotations

import os
import stat
from pathlib import Path
from typing import BinaryIO

from machopt.errors import FileAccessError, InputError

MIB = 1 << 20
BLOCK = 1 << 16  # bytes read at once beyond the stated size
TOOLPATH = 512 * MIB  # some twenty million blocks; the readers hold every line
TABLE = 1024 * MIB  # an hour of a motion at 1 kHz with thirty columns
YAML = 8 * MIB  # the parser takes half a million values, which is less
MARKUP = 32 * MIB  # a URDF of a whole factory is under 1 MiB
MESH = 128 * MIB  # two and a half million triangles in binary STL
TEMPLATE = 4 * MIB

_KINDS = (
    (stat.S_ISDIR, "a directory"),
    (stat.S_ISFIFO, "a named pipe"),
    (stat.S_ISCHR, "a device"),
    (stat.S_ISBLK, "a device"),
    (stat.S_ISSOCK, "a socket"),
)


def read_file(path: Path, *, expected: str, most: int) -> bytes:
    """The bytes of a regular file.

    Args:
        path: as the user named it.
        expected: what the file should be, for messages, e.g. ``a URDF``.
        most: bytes above which it is refused unread.

    Raises:
        InputError: absent, no regular file, not readable, too large, or a name that no file can have.
    """
    handle = _open_regular_file(path, expected)
    try:
        status = os.fstat(handle)
        _check_file_status(path, status, expected, most)
        with os.fdopen(handle, "rb", closefd=False) as file:
            data = _read_at_most(file, status.st_size, most + 1)
    except OSError as problem:
        raise _build_unreadable_error(path, problem, expected) from None
    finally:
        os.close(handle)
    if len(data) > most:
        raise _build_too_large_error(path, f"more than {_format_size(most)}", expected, most)
    return data


def _read_at_most(file: BinaryIO, size: int, most: int) -> bytes:
    """Return up to ``most`` bytes; memory follows the content, which may exceed ``size`` (a file that grows, /proc)."""
    parts, count = [], 0
    while count < most and (block := file.read(min(max(size + 1 - count, BLOCK), most - count))):
        parts.append(block)
        count += len(block)
    return b"".join(parts)


def read_text(path: Path, *, expected: str, most: int) -> str:
    """Read UTF-8 text of a regular file without a byte-order mark; line ends stay.

    Args:
        path: Path of the file.
        expected: Description of the expected file, for messages.
        most: Largest size in bytes.

    Returns:
        The text.

    Raises:
        FileAccessError: as :func:`read_file`, or not UTF-8.
    """
    data = read_file(path, expected=expected, most=most)
    try:
        return data.decode("utf-8-sig")
    except UnicodeDecodeError as problem:
        line = data.count(b"\n", 0, problem.start) + 1
        raise FileAccessError(
            f"is not UTF-8 text (byte {problem.start}); expected {expected} in UTF-8", file=path, where=f"line {line}"
        ) from None


def check_file(path: Path, *, expected: str, most: int) -> int:
    """Check a file as :func:`read_file` does, without reading it.

    Args:
        path: Path of the file.
        expected: Description of the expected file, for messages.
        most: Largest size in bytes.

    Returns:
        Size in bytes.

    Raises:
        FileAccessError: as :func:`read_file`.
    """
    handle = _open_regular_file(path, expected)
    try:
        found = os.fstat(handle)
    finally:
        os.close(handle)
    _check_file_status(path, found, expected, most)
    return found.st_size


def _open_regular_file(path: Path, expected: str) -> int:
    name = str(path)
    if "\0" not in name and not name.isprintable():  # it would go on into reports and program comments, line by line
        raise FileAccessError(
            f"the name {name!r} holds control characters or is no UTF-8; expected {expected} of a plain name"
        )
    try:
        return os.open(path, os.O_RDONLY | os.O_CLOEXEC | os.O_NONBLOCK)  # a pipe without a writer must not wait
    except (OSError, ValueError) as problem:
        raise _build_unreadable_error(path, problem, expected) from None


def _check_file_status(path: Path, found: os.stat_result, expected: str, most: int) -> None:
    if not stat.S_ISREG(found.st_mode):
        kind = next((name for test, name in _KINDS if test(found.st_mode)), "no regular file")
        raise FileAccessError(f"is {kind}; expected {expected}", file=path)
    if found.st_size > most:
        raise _build_too_large_error(path, _format_size(found.st_size), expected, most)


def _build_too_large_error(path: Path, size: str, expected: str, most: int) -> InputError:
    return FileAccessError(f"holds {size}; expected {expected} of at most {_format_size(most)}", file=path)


def _build_unreadable_error(path: Path, problem: OSError | ValueError, expected: str) -> InputError:
    if isinstance(problem, ValueError):
        return FileAccessError(f"holds a NUL character, which no file name can; expected {expected}", file=path)
    if isinstance(problem, FileNotFoundError):
        return FileAccessError(f"no such file; expected {expected}", file=path)
    return FileAccessError(f"cannot be read: {problem.strerror or problem}; expected {expected}", file=path)


def _format_size(count: int) -> str:
    return f"{count / MIB:.4g} MiB" if count < 1024 * MIB else f"{count / MIB / 1024:.3g} GiB"
