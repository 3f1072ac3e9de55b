"""Cache of the tables of a folder: each is read once as long as its bytes are the same.

The checks of tables, programs and result.json need the same tables. The key is the hash of the bytes, so a changed
table is read again.
"""

from __future__ import annotations

import hashlib
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from contextvars import ContextVar
from dataclasses import dataclass, field
from pathlib import Path
from threading import Lock
from typing import TypeVar

T = TypeVar("T")
MAX_CACHED_BYTES = 256 * 2**20  # bytes: of a longer table reading again costs less than the memory to hold it


@dataclass(frozen=True)
class _TableCache:
    tables: dict[Path, tuple[bytes, object]] = field(default_factory=dict)
    lock: Lock = field(default_factory=Lock)  # two verdicts may be formed side by side: the second waits for the table


_CURRENT_CACHE: ContextVar[_TableCache | None] = ContextVar("tables", default=None)


@contextmanager
def cache_tables() -> Iterator[None]:
    """Cache tables within this context; they are released at the end of the outermost one."""
    if _CURRENT_CACHE.get() is not None:
        yield
        return
    token = _CURRENT_CACHE.set(_TableCache())
    try:
        yield
    finally:
        _CURRENT_CACHE.reset(token)


def read_cached(file: Path, read: Callable[[Path], T]) -> T:
    """Return what ``read`` returns for a file, from the cache if its bytes were read before; do not modify it.

    Args:
        file: Path of the file.
        read: Reader of the file; its errors are passed on.
    """
    shelf = _CURRENT_CACHE.get()
    if shelf is None:
        return read(file)
    with shelf.lock:
        digest = _compute_digest(file)
        if digest is None:
            return read(file)
        if shelf.tables.get(file, (b"", None))[0] != digest:
            shelf.tables[file] = (digest, read(file))
        result: T = shelf.tables[file][1]  # type: ignore[assignment]  # one reader a file
        return result


def _compute_digest(file: Path) -> bytes | None:
    """None where the table is too long to hold, or cannot be read."""
    try:
        if file.stat().st_size > MAX_CACHED_BYTES:
            return None
        with file.open("rb") as data:
            return hashlib.file_digest(data, "sha256").digest()
    except OSError:
        return None
