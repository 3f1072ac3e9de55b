"""Output folder of a command's run, with the effects and checks that its request asks for."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Protocol

from machopt.commands.input_hashes import list_request_paths
from machopt.effects.user_effects import activate_user_effects, load_effect_files
from machopt.file_formats.parquet_tables import refuse_without_pyarrow
from machopt.output import write_output_folder


class OutputRequest(Protocol):
    """Request of a command that writes an output folder."""

    @property
    def out(self) -> Path:
        """The output folder."""

    @property
    def overwrite(self) -> bool:
        """Whether an earlier output is replaced though files in it were edited or added."""

    @property
    def effects(self) -> tuple[Path, ...]:
        """Files of the user's own effects."""

    @property
    def tables(self) -> str:
        """Format of the tables."""


@contextmanager
def open_request_folder(request: OutputRequest) -> Iterator[Path]:
    """Activate the effects of a request and open its output folder, which takes its place at the end.

    Args:
        request: The validated request.

    Yields:
        The empty folder to write into.

    Raises:
        InputError: an effect file is wrong, the output folder cannot be written, or pyarrow is missing for the tables.
    """
    with (
        activate_user_effects(load_effect_files(request.effects)),
        write_output_folder(request.out, force=request.overwrite, inputs=list_request_paths(request)) as folder,
    ):
        refuse_without_pyarrow(request.tables)
        yield folder
