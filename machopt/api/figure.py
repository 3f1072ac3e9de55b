"""A picture that a result draws of itself."""

from __future__ import annotations

import os
from dataclasses import dataclass
from pathlib import Path

from machopt.errors import InputError


@dataclass(frozen=True)
class Figure:
    """A still picture; notebooks show it by themselves."""

    svg: str  # one SVG document without anything outside it

    def save(self, path: str | os.PathLike[str]) -> Path:
        """Write the picture as an SVG file.

        Raises:
            InputError: the name does not end in .svg, or the file cannot be written.
        """
        file = Path(path)
        if file.suffix.lower() != ".svg":
            raise InputError(f"pictures are SVG; {file.stem}.svg would work", file=file)
        try:
            file.write_text(self.svg + "\n", encoding="utf-8", newline="\n")
        except OSError as problem:
            raise InputError(f"cannot be written: {problem.strerror}", file=file) from None
        return file

    def _repr_svg_(self) -> str:
        return self.svg
