"""Cache of compiled templates: they are compiled once for each installation."""

from __future__ import annotations

import contextlib
import hashlib
import os
import sys
from pathlib import Path

import jinja2
from jinja2.bccache import Bucket, BytecodeCache


class TemplateCache(BytecodeCache):
    """Folder of compiled templates, one file each, used where it and Python's own cache can be written.

    Jinja2 compares the source of a template and the version of Python before it uses what is stored.

    Args:
        folder: The folder.
        options: Options of the environment that change the compiled code, as text.
    """

    def __init__(self, folder: Path, options: str) -> None:
        self.folder = folder
        self.of = hashlib.sha256(f"{jinja2.__version__} {options}".encode()).hexdigest()[:12]

    def get_cache_key(self, name: str, filename: str | None = None) -> str:
        """Return the key of a template; it depends on the name alone, not on the package's folder.

        Args:
            name: Name of the template.
            filename: Path of the template, not used.
        """
        return f"{name.replace('/', '.')}.{sys.implementation.cache_tag}-{self.of}"

    def load_bytecode(self, bucket: Bucket) -> None:
        """Load a compiled template into a bucket, if it is stored.

        Args:
            bucket: Bucket of Jinja2.
        """
        with contextlib.suppress(OSError), (self.folder / bucket.key).open("rb") as file:
            bucket.load_bytecode(file)

    def dump_bytecode(self, bucket: Bucket) -> None:
        """Store a compiled template, if the folder can be written.

        Args:
            bucket: Bucket of Jinja2.
        """
        if sys.dont_write_bytecode:
            return
        with contextlib.suppress(OSError):
            self.folder.mkdir(exist_ok=True)
            own = self.folder / f"{bucket.key}.{os.getpid()}"  # two processes may write the same
            with own.open("wb") as file:
                bucket.write_bytecode(file)
            own.replace(self.folder / bucket.key)
