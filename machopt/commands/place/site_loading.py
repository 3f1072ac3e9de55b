"""Loading of cell and jobs of ``machopt place``, in this process or in a worker process that has only the request."""

from __future__ import annotations

import functools
import pickle
import threading
from collections.abc import Callable
from typing import Any, TypeVar

from machopt.cell.absolute_accuracy import apply_absolute_accuracy
from machopt.cell.cell_reader import load_cell
from machopt.cell.tool_selection import select_job_tools, split_into_tool_segments
from machopt.cell.work_offsets import place_toolpath
from machopt.commands.place.request import PlaceRequest, check_comparable_options
from machopt.commands.toolpath_reading_options import get_reading_options
from machopt.data_types.cell import Cell
from machopt.data_types.plan_options import PlanOptions
from machopt.data_types.toolpath import Toolpath
from machopt.effects.user_effects import activate_user_effects, load_effect_files
from machopt.options.plan_option_reader import load_options
from machopt.placement.moved_cell import check_robot_movable
from machopt.placement.placement_site import PlacementSite
from machopt.process.binding.job_binding import attach_forces, mark_forces
from machopt.process.binding.operation_matching import attach_process
from machopt.toolpath.toolpath_reader import read_toolpath
from machopt.toolpath.unknown_words import refuse_unknown_words

A = TypeVar("A")
B = TypeVar("B")
_SITE_LOCK = threading.Lock()  # a worker of a cluster may have threads; a plan uses the cores by itself


def read_request_files(request: PlaceRequest) -> tuple[Cell, tuple[Toolpath, ...]]:
    """Read the files that the request names.

    Args:
        request: The validated request.

    Raises:
        InputError: a file is wrong.
    """
    cell = load_cell(request.cell, process=request.process)
    pairs = zip(request.toolpaths, request.readings, strict=True)
    return cell, tuple(read_toolpath(file, **get_reading_options(cell), **reading) for file, reading in pairs)


def build_placement_site(
    request: PlaceRequest, cell: Cell, toolpaths: tuple[Toolpath, ...]
) -> tuple[PlacementSite, PlanOptions]:
    """Return the data that every placement is evaluated with, and the options.

    Args:
        request: The validated request.
        cell: The robot cell.
        toolpaths: The toolpaths of the jobs.

    Raises:
        InputError: the cell, an option or a range is wrong.
    """
    check_robot_movable(cell, base=request.search.base)
    for toolpath, file in zip(toolpaths, request.toolpaths, strict=True):
        refuse_unknown_words(toolpath, file)
    toolpaths = tuple(attach_process(cell.process, place_toolpath(toolpath, cell)) for toolpath in toolpaths)
    segments = [
        attach_forces(split_into_tool_segments(select_job_tools(cell, toolpath), toolpath)) for toolpath in toolpaths
    ]
    options = load_options(cell.plan, request.plan_file, list(request.overrides), **(request.direct or {}))
    options = mark_forces(options, tuple(one for parts in segments for one in parts))
    check_comparable_options(options)
    cell = apply_absolute_accuracy(cell, options)
    return PlacementSite.build(cell, toolpaths, options, request.search, segments), options


def run_site_task(pickled_request: bytes, evaluate: Callable[[Any, A], B], item: A) -> B:
    """Evaluate one item in a worker process, which loads the site on first use.

    Args:
        pickled_request: The pickled request.
        evaluate: Function of site and item.
        item: The item to evaluate.
    """
    with _SITE_LOCK:
        request, site = _load_cached_site(pickled_request)
        with activate_user_effects(load_effect_files(request.effects)):
            return evaluate(site, item)


@functools.lru_cache(maxsize=1)
def _load_cached_site(order: bytes) -> tuple[PlaceRequest, PlacementSite]:
    request: PlaceRequest = pickle.loads(order)
    with activate_user_effects(load_effect_files(request.effects)):
        return request, build_placement_site(request, *read_request_files(request))[0]
