"""Further files a program calls: looked for in its own folder only, by name, whatever the case."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from pathlib import Path

from machopt.errors import InputError
from machopt.formats.source import Source, decode, read_bytes

LARGEST = 64_000_000  # bytes of a file that is only looked into
MOST_FILES = 500


def siblings(path: Path, endings: Sequence[str]) -> Iterator[Path]:
    """Other files of the folder with one of these endings, by name."""
    try:
        found = sorted(path.parent.iterdir())
    except OSError:
        return
    wanted = tuple(e.lower() for e in endings)
    for n, file in enumerate(f for f in found if f.name.lower().endswith(wanted) and f != path):
        if n >= MOST_FILES:
            return
        if file.is_file() and file.stat().st_size <= LARGEST:
            yield file


def called(path: Path, name: str, endings: Sequence[str]) -> Source | None:
    """The file of that name and one of these endings beside ``path``, or None."""
    wanted = {(name + e).lower() for e in endings}
    for file in siblings(path, endings):
        if file.name.lower() in wanted:
            return opened(file)
    return None


def opened(path: Path) -> Source | None:
    """A file as text, or None where it is none."""
    try:
        return decode(path, read_bytes(path))
    except InputError:
        return None
