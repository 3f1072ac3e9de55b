"""How results are written."""

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
    """Progress that nobody wants to hear of."""


def save_result(cell: Cell, out: Named, write: Callable[[Path], W], *, force: bool = False) -> W:
    """Write a result made from a cell into OUT: whole or not at all.

    Raises:
        InputError: OUT holds something else, or a file of the cell has changed since it was loaded.
    """
    with (
        use_cell_effects(cell.unchanged()),
        write_output_folder(Path(out), force=force, inputs=cell.description.files) as folder,
    ):
        return write(folder)


def use_cell_effects(cell: Cell) -> AbstractContextManager[None]:
    """Within it the effects of the user's own are known."""
    return activate_user_effects(cell.effects)
