"""SHA-256 of files."""

from __future__ import annotations

import hashlib
import stat
from pathlib import Path

from machopt.data_types.manifest import ManifestFile
from machopt.errors import OutputFolderError

SMALL_BYTES = 1 << 18  # a file up to this size is read at once: the buffer for parts costs more than to hash it


def compute_sha256(file: Path) -> str:
    """Return SHA-256 of a file's bytes as lower-case hexadecimal.

    Args:
        file: Path of the file.

    Raises:
        InputError: the file cannot be read.
    """
    try:
        found = file.stat()
        if not stat.S_ISREG(found.st_mode):  # opening a named pipe waits for whoever writes into it
            raise OutputFolderError("is not a plain file", file=file)
        if found.st_size <= SMALL_BYTES:
            return compute_digest(file.read_bytes())
        with file.open("rb") as data:
            return hashlib.file_digest(data, "sha256").hexdigest()
    except OSError as problem:
        raise OutputFolderError(f"cannot be read: {problem.strerror}", file=file) from None


def build_manifest_file(file: Path, name: str, role: str) -> ManifestFile:
    """Return a file's entry in a manifest.

    Args:
        file: Path of the file.
        name: Name of the file in the manifest.
        role: Role of the file in the manifest.

    Raises:
        InputError: the file cannot be read.
    """
    sha256 = compute_sha256(file)
    return ManifestFile(name, role, sha256, file.stat().st_size)


def compute_digest(data: bytes) -> str:
    """Return SHA-256 of bytes as lower-case hexadecimal.

    Args:
        data: The bytes.
    """
    return hashlib.sha256(data).hexdigest()
