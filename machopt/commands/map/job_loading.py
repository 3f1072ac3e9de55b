"""Job of ``machopt map --toolpath``: its first tool and the toolpath of that tool."""

from __future__ import annotations

from pathlib import Path

from machopt.cell.tool_selection import select_job_tools, split_into_tool_segments
from machopt.cell.work_offsets import place_toolpath
from machopt.commands.toolpath_reading_options import get_reading_options
from machopt.data_types.cell import Cell
from machopt.data_types.toolpath import Toolpath
from machopt.process.binding.operation_matching import attach_process
from machopt.toolpath.toolpath_reader import read_toolpath
from machopt.toolpath.unknown_words import refuse_unknown_words


def read_job(file: Path, cell: Cell) -> tuple[Cell, Toolpath]:
    """Return the cell with the job's first tool on, and the toolpath of that tool with its operations.

    Args:
        file: CAM file or point table.
        cell: The cell with the process.

    Raises:
        InputError: the file is wrong, or does not fit the process.
    """
    toolpath = read_toolpath(file, **get_reading_options(cell))
    refuse_unknown_words(toolpath, file)
    toolpath = attach_process(cell.process, place_toolpath(toolpath, cell))
    first = split_into_tool_segments(select_job_tools(cell, toolpath), toolpath)[0]
    return first.cell, first.toolpath
