"""Files of a robot program, written below the output folder."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path

from machopt.errors import PostError


def write_program_files(folder: Path, files: Mapping[str, str], encoding: str, line_end: str) -> list[Path]:
    """Write the files of a program.

    Args:
        folder: Output folder.
        files: File name → text.
        encoding: Text encoding.
        line_end: Line end.

    Returns:
        Paths of the files.

    Raises:
        PostError: a name would leave the folder.
    """
    out = []
    for name, text in files.items():
        parts = Path(name).parts
        if not parts or ".." in parts or Path(name).is_absolute() or "\\" in name:
            raise PostError(f"{name!r} is no file inside the output folder", where="file.name")
        path = folder / name
        path.parent.mkdir(parents=True, exist_ok=True)
        path.write_text(text, encoding=encoding, newline="\r\n" if line_end == "crlf" else "\n")
        out.append(path)
    return out
