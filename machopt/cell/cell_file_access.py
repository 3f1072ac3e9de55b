"""Cell folder: the files that may be read, and a record of those that were read."""

from __future__ import annotations

from dataclasses import dataclass, field
from functools import partial
from os.path import exists
from pathlib import Path

from machopt.cell.mesh import ErrorFactory
from machopt.errors import InputError
from machopt.file_formats.file_reading import check_file
from machopt.file_formats.strict_yaml import KeyPath, YamlDocument

ANY_SIZE = 1 << 62  # bytes; each reader has its own limit


@dataclass
class CellFolder:
    """Where the files that a cell names may lie, and those that were read."""

    document: YamlDocument  # cell.yaml
    path: Path
    allow_external: bool
    read: list[Path] = field(default_factory=list)  # for the hash of inputs

    def resolve_file(self, loc: KeyPath, name: str) -> Path:
        """Resolve a file that the cell names, and record it for the hash of inputs.

        Args:
            loc: Key path of the value in the document.
            name: File name as the user wrote it, for messages.

        Returns:
            Resolved path.
        """
        fail = partial(self.document.build_error, loc)
        path = self.resolve_inside(self.path / name, name, fail)
        self.read.append(self.check_existing_file(path, name, fail))
        return path

    def resolve_inside(self, path: Path, name: str, fail: ErrorFactory) -> Path:
        """Resolve links of a path; a target outside the cell folder is refused unless that is allowed.

        Args:
            path: Path of the file.
            name: File name as the user wrote it, for messages.
            fail: Function that builds an error from a message.

        Returns:
            Resolved path.

        Raises:
            InputError: built by ``fail``: the file lies outside the cell folder.
        """
        try:
            path = path.resolve()
        except (OSError, RuntimeError, ValueError):  # links in a circle, or a null byte
            raise fail(f"found {name!r}; expected a path (no NUL character in it, no links in a circle)") from None
        if not self.allow_external and not path.is_relative_to(self.path):
            raise fail(f"{name} lies outside the cell folder ({path}); copy it in, or allow it with --allow-external")
        return path

    def check_existing_file(self, path: Path, name: str, fail: ErrorFactory) -> Path:
        """Check that a path is a regular file.

        Args:
            path: Path of the file.
            name: File name as the user wrote it, for messages.
            fail: Function that builds an error from a message.

        Returns:
            The path.

        Raises:
            InputError: built by ``fail``: the path is no regular file.
        """
        if not exists(path):
            raise fail(f"no such file: {name} (searched for {path})")
        try:
            check_file(path, expected="a file", most=ANY_SIZE)
        except InputError as problem:
            raise fail(f"{name} {problem.reason}") from None
        return path
