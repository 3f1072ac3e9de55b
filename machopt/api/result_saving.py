"""Saving of API results to output folders."""

from __future__ import annotations

import os
from collections.abc import Callable
from contextlib import AbstractContextManager
from pathlib import Path
from typing import TypeVar

from machopt.api.cell import Cell
from machopt.effects.user_effects import activate_user_effects
from machopt.output import write_output_folder

W = TypeVar("W")
Progress = Callable[[str], None]
Named = str | os.PathLike[str]


def ignore_progress(_: str) -> None:
    """Ignore progress messages.

    Args:
        _: Name of the stage.
    """


def save_result(cell: Cell, out: Named, write: Callable[[Path], W], *, force: bool = False) -> W:
    """Write a result of a cell into an output folder, completely or not at all.

    Args:
        cell: The robot cell.
        out: The output folder.
        write: Function that writes the files into a folder.
        force: Replace the file or folder whatever it holds.

    Raises:
        InputError: the folder holds something else, or a file of the cell has changed since it was loaded.
    """
    with (
        use_cell_effects(cell.unchanged()),
        write_output_folder(Path(out), force=force, inputs=cell.description.files) as folder,
    ):
        return write(folder)


def use_cell_effects(cell: Cell) -> AbstractContextManager[None]:
    """Return a context in which the cell's user-defined effects are registered.

    Args:
        cell: The robot cell.
    """
    return activate_user_effects(cell.effects)
