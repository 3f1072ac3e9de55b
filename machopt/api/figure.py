"""A picture that a result draws of itself."""

from __future__ import annotations

import os
from dataclasses import dataclass
from pathlib import Path

from machopt.api.error_message_translation import use_argument_names
from machopt.errors import InputError
from machopt.output.single_file import write_text_file


@dataclass(frozen=True)
class Figure:
    """Static picture; notebooks show it directly."""

    svg: str  # one SVG document without anything outside it

    @use_argument_names()
    def save(self, path: str | os.PathLike[str], *, force: bool = False) -> Path:
        """Write the picture as an SVG file.

        Args:
            path: ends in .svg; a picture that machopt wrote there, and nobody edited, is replaced.
            force: replace any file.

        Raises:
            InputError: the name does not end in .svg, or the file cannot be written.
        """
        file = Path(path)
        if file.suffix.lower() != ".svg":
            raise InputError(f"pictures are SVG; {file.stem}.svg would work", file=file)
        write_text_file(file, self.svg + "\n", force=force)
        return file

    def _repr_svg_(self) -> str:
        return self.svg
