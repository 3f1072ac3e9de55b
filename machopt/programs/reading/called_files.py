"""Further files a program calls: looked for in its own folder only, by name, whatever the case."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from pathlib import Path

from machopt.errors import InputError
from machopt.file_formats.source_file import SourceFile, decode_source, read_bytes

LARGEST = 64_000_000  # bytes of a file that is only looked into
MOST_FILES = 500


def find_sibling_files(path: Path, endings: Sequence[str]) -> Iterator[Path]:
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


def find_called_file(path: Path, name: str, endings: Sequence[str]) -> SourceFile | None:
    """The file of that name and one of these endings beside ``path``, or None."""
    wanted = {(name + e).lower() for e in endings}
    for file in find_sibling_files(path, endings):
        if file.name.lower() in wanted:
            return try_read_source(file)
    return None


def try_read_source(path: Path) -> SourceFile | None:
    """A file as text, or None where it is none."""
    try:
        return decode_source(path, read_bytes(path))
    except InputError:
        return None
