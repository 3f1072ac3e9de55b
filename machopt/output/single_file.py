"""Single output files that a user names (a page, a picture, a table, a plan), protected against overwriting.

An existing file is replaced only if nothing can be lost. That is so if it holds the same bytes already, or if its
seal is valid: machopt wrote the file and nobody has edited it since. All other files, inputs first, are replaced only
with ``--force``. Links are resolved before the check, because the file behind the link would be lost. The new content
is written into a temporary file and renamed, so a hard link to the former file keeps its content.
"""

from __future__ import annotations

import os
import re
import secrets
import stat
from collections.abc import Iterable
from pathlib import Path

from machopt.errors import OutputFolderError
from machopt.output.file_hashes import compute_digest

_SEAL = re.compile(rb"(?:<!--|#) machopt sha256:([0-9a-f]{64})(?: -->)?\n\Z")
_COMMENT = {".yaml": "# {}\n", ".yml": "# {}\n"}
_SEALED = frozenset({".html", ".htm", ".svg", ".yaml", ".yml"})  # kinds of text that may end with a comment


def write_text_file(path: Path, text: str, *, force: bool = False, inputs: Iterable[Path] = ()) -> None:
    """Write a page, a picture or a plan, sealed where its kind has comments.

    Args:
        path: the file, as the user named it.
        text: its content.
        force: replace whatever plain file is there.
        inputs: files that this run reads.

    Raises:
        InputError: the file is an input, was not written by machopt, was edited or is no plain file; or it cannot be
            written.
    """
    suffix = path.suffix.lower()
    data = text.encode()
    if suffix in _SEALED or text.lstrip().startswith("<"):
        line = _COMMENT.get(suffix, "<!-- {} -->\n").format(f"machopt sha256:{compute_digest(data)}")
        data += line.encode()
    write_bytes_file(path, data, force=force, inputs=inputs)


def write_bytes_file(path: Path, data: bytes, *, force: bool = False, inputs: Iterable[Path] = ()) -> None:
    """Write a file of any kind; the same rule and errors as :func:`write_text_file`, without a seal.

    Args:
        path: The file to write.
        data: Content of the file.
        force: Replace the file or folder whatever it holds.
        inputs: Input files, which must never be overwritten.

    Raises:
        InputError: the file holds something else, or cannot be written.
    """
    try:
        target = path.expanduser().resolve()
        _refuse_overwriting(target, path, data, force=force, inputs=inputs)
        partial = target.with_name(f".{target.name[:40]}.{secrets.token_hex(8)}.partial")
        try:
            partial.write_bytes(data)
            partial.replace(target)
        finally:
            partial.unlink(missing_ok=True)
    except (OSError, RuntimeError) as problem:
        why = getattr(problem, "strerror", None) or str(problem)
        raise OutputFolderError(f"cannot be written: {why}", file=path) from None


def refuse_overwriting(path: Path, *, force: bool = False, inputs: Iterable[Path] = ()) -> None:
    """Refuse an output file before the work for it begins.

    Args:
        path: The file to write.
        force: Replace the file or folder whatever it holds.
        inputs: Input files, which must never be overwritten.

    Raises:
        InputError: as :func:`write_text_file`.
    """
    try:
        _refuse_overwriting(path.expanduser().resolve(), path, None, force=force, inputs=inputs)
    except (OSError, RuntimeError) as problem:
        why = getattr(problem, "strerror", None) or str(problem)
        raise OutputFolderError(f"cannot be written: {why}", file=path) from None


def _refuse_overwriting(target: Path, named: Path, data: bytes | None, *, force: bool, inputs: Iterable[Path]) -> None:
    try:
        found = target.lstat()
    except FileNotFoundError:
        return
    if stat.S_ISDIR(found.st_mode):
        raise OutputFolderError("is a folder; the name of a file would work", file=named)
    if not stat.S_ISREG(found.st_mode):
        raise OutputFolderError("is not a plain file; the name of a new file would work", file=named)
    if force:
        return
    if any(_is_same_file(place, found) for place in inputs):
        raise OutputFolderError("is an input of this command; name another file, or give --force", file=named)
    if not found.st_mode & 0o222:
        raise OutputFolderError("is read-only; name another file, or give --force", file=named)
    if data is not None and found.st_size == len(data) and target.read_bytes() == data:
        return
    if not _has_machopt_seal(target, found.st_size):
        raise OutputFolderError(
            "exists, and machopt did not write it or it was edited since; name another file, or give --force "
            "(force=True in Python)",
            file=named,
        )


def _is_same_file(place: Path, found: os.stat_result) -> bool:
    """The file is the input itself, under whatever name."""
    try:
        return os.path.samestat(place.stat(), found)
    except OSError:
        return False


def _has_machopt_seal(file: Path, size: int) -> bool:
    if size > 512 << 20:  # no page of ours comes near
        return False
    data = file.read_bytes()
    mark = _SEAL.search(data, max(0, size - 128))
    return mark is not None and compute_digest(data[: mark.start()]) == mark[1].decode()
