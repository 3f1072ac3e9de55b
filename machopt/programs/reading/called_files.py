"""Files that a program calls, searched by name in its own folder only, in any case."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from pathlib import Path

from machopt.errors import InputError
from machopt.file_formats.source_file import SourceFile, decode_source, read_bytes

LARGEST = 64_000_000  # bytes of a file that is only inspected
MOST_FILES = 500


def find_sibling_files(path: Path, endings: Sequence[str]) -> Iterator[Path]:
    """Find other files of the folder with one of these extensions, sorted by name.

    Args:
        path: Path of the program.
        endings: File name extensions.

    Returns:
        The paths.
    """
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
    """Find the file with a name and one of these extensions in the folder of the program.

    Args:
        path: Path of the program.
        name: Name without extension, any case.
        endings: File name extensions.

    Returns:
        The file, None where there is none.
    """
    wanted = {(name + e).lower() for e in endings}
    for file in find_sibling_files(path, endings):
        if file.name.lower() in wanted:
            return try_read_source(file)
    return None


def try_read_source(path: Path) -> SourceFile | None:
    """Read a file as text if it is text.

    Args:
        path: Path of the file.

    Returns:
        The file, None where it is no text.
    """
    try:
        return decode_source(path, read_bytes(path))
    except InputError:
        return None
