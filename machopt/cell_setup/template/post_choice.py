"""Choice of the post of a new cell: one that needs no values beyond those of a new cell."""

from __future__ import annotations

from dataclasses import replace

from machopt.cell_setup.template.cell_text import NewCellContent
from machopt.data_types.cell import Cell
from machopt.errors import InputError
from machopt.program_export.selected_posts import select_posts
from machopt.programs.writing.post_file import list_post_names


def add_post(new: NewCellContent, cell: Cell) -> tuple[NewCellContent, tuple[str, ...]]:
    """The cell with the requested post, or with its axis-by-axis kin where the controller says too little for it.

    Args:
        new: the cell; its post as the user gave it.
        cell: the same, read back.

    Returns:
        The cell, and what is missing for the requested post.

    Raises:
        InputError: no such post, or neither it nor a kin of it can be written.
    """
    try:
        select_posts(cell, ())
    except InputError as problem:
        kin = f"{new.post}_joint"
        if kin not in list_post_names():
            raise
        select_posts(replace(cell, controller=replace(cell.controller, post=kin)), ())
        note = f"{new.post} once {problem.where} is known"
        message = f"the robot program is {kin}, positions as joints; {problem.where} in cell.yaml allows {new.post}"
        return replace(new, post=kin, post_note=note), (message,)
    return new, ()
