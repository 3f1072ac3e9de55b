"""Job of ``machopt map --toolpath``: its first tool and the toolpath of that tool."""

from __future__ import annotations

from dataclasses import dataclass, replace
from pathlib import Path

from machopt.cell.tool_selection import select_job_tools, split_into_tool_segments
from machopt.cell.work_offsets import place_toolpath
from machopt.commands.toolpath_reading_options import get_reading_options
from machopt.data_types.cell import Cell
from machopt.data_types.toolpath import Toolpath
from machopt.job_map.job_quantities import build_job_quantities
from machopt.process.binding.operation_matching import attach_process
from machopt.toolpath.toolpath_reader import read_toolpath
from machopt.toolpath.unknown_words import refuse_unknown_words
from machopt.workspace_map.quantities import MapSettings


@dataclass(frozen=True)
class MappedJob:
    """Job of a map, with the tool that the postures of the map hold."""

    cell: Cell  # with that tool
    toolpath: Toolpath  # of that tool
    notes: tuple[str, ...]  # tools that are not mapped


def read_job(file: Path, cell: Cell) -> MappedJob:
    """Return the cell with the job's first tool on, and the toolpath of that tool with its operations.

    A note names the tools that are not mapped: a posture of the map is that of one tool.

    Args:
        file: CAM file or point table.
        cell: The cell with the process.

    Raises:
        InputError: the file is wrong, or does not fit the process.
    """
    toolpath = read_toolpath(file, **get_reading_options(cell))
    refuse_unknown_words(toolpath, file)
    toolpath = attach_process(cell.process, place_toolpath(toolpath, cell))
    first, *others = split_into_tool_segments(select_job_tools(cell, toolpath), toolpath)
    names = dict.fromkeys(one.tool for one in others if one.tool != first.tool)
    notes = (f"the map holds for tool {first.tool}; not mapped: {', '.join(names)}",) if names else ()
    return MappedJob(first.cell, first.toolpath, notes)


def add_job_quantities(setting: MapSettings, cell: Cell, job: MappedJob | None) -> MapSettings:
    """Return the settings of a map with the quantities of the job.

    Args:
        setting: Settings of the map.
        cell: The cell with the tool of the job.
        job: The job; None where none is given.
    """
    if job is None:
        return setting
    quantities, notes = build_job_quantities(cell, job.toolpath, setting)
    return replace(setting, of_job=quantities, job_notes=(*job.notes, *notes))
