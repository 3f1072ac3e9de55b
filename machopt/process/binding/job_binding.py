"""Process of a cell bound to a job: operations of the points, programmed loads, options that know of them."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from machopt.data_types.cell import Cell
from machopt.data_types.plan_options import PlanOptions
from machopt.data_types.process import CuttingProcess
from machopt.data_types.tool_segments import ToolSegment
from machopt.data_types.toolpath import Toolpath
from machopt.errors import ConfigurationKeyError, CuttingInputError
from machopt.numerics.array_types import Array
from machopt.process.binding.point_loads import PointLoads, compute_point_loads
from machopt.process.stock.job_removal import JobRemoval, find_wanted_points, remove_job


def attach_forces(segments: tuple[ToolSegment, ...]) -> tuple[ToolSegment, ...]:
    """Return the segments of a job with the forces of their process at the programmed feed.

    Args:
        segments: Segments whose toolpaths have their process operations, where the cell has a process.

    Raises:
        ConfigurationKeyError: an operation lacks a value, or has one that its force model does not accept.
    """
    return tuple(
        segment
        if segment.cell.process is None
        else replace(segment, toolpath=attach_programmed_force(segment.cell, segment.toolpath))
        for segment in attach_engagement(segments)
    )


def attach_engagement(segments: tuple[ToolSegment, ...]) -> tuple[ToolSegment, ...]:
    """Return the segments of a job with the contact of their cutters with the stock.

    Args:
        segments: Segments whose toolpaths have their process operations, where the cell has a process.

    Raises:
        ConfigurationKeyError: the contact cannot be computed from the stock.
    """
    process = segments[0].cell.process
    if process is None or process.stock is None:
        return segments
    if not any(find_wanted_points(process, segment.toolpath).any() for segment in segments):
        return segments
    removal = remove_stock(process, segments)
    return tuple(
        replace(segment, toolpath=replace(segment.toolpath, engagement=found))
        for segment, found in zip(segments, removal.engagements, strict=True)
    )


def remove_stock(process: CuttingProcess, segments: Sequence[ToolSegment]) -> JobRemoval:
    """Return what a job removes from its stock, with errors that name the file.

    Args:
        process: Content of process.yaml, with a stock.
        segments: Segments of the job with their process operations.

    Raises:
        ConfigurationKeyError: the contact cannot be computed from the stock.
    """
    try:
        return remove_job(process, segments)
    except CuttingInputError as error:
        where = f"stock.{error.key}" if error.key in ("mesh", "cell_mm") else f"operations.{error.key}"
        raise ConfigurationKeyError(error.reason, file=process.file, where=where, key=error.key) from None


def attach_programmed_force(cell: Cell, toolpath: Toolpath) -> Toolpath:
    """Return a toolpath of one tool with the force on the arm at the programmed feed.

    Args:
        cell: The cell, with the tool and the process.
        toolpath: Toolpath with its process operations.

    Raises:
        ConfigurationKeyError: an operation lacks a value, or has one that its force model does not accept.
    """
    loads = compute_loads(cell, toolpath, toolpath.feed)
    if loads is None:
        return toolpath
    _check_any_force(cell, toolpath, loads.arm_force)
    return replace(toolpath, force=loads.arm_force)


def _check_any_force(cell: Cell, toolpath: Toolpath, force: Array) -> None:
    """Refuse operations that apply no force anywhere: there is no deflection to minimise."""
    assert cell.process is not None
    assert toolpath.process_operation is not None
    cut = force[toolpath.cutting]
    if not len(cut) or np.isnan(cut).any() or cut.any():
        return
    used = sorted({cell.process.operations[k].label for k in toolpath.process_operation[toolpath.cutting].tolist()})
    raise ConfigurationKeyError(
        "no cut move has a cutting force: force_N is zero, or every move ends above the surface that depth_mm states",
        file=cell.process.file,
        where=f"operations.{used[0]}",
        key=used[0],
    )


def compute_loads(cell: Cell, toolpath: Toolpath, feed: Array) -> PointLoads | None:
    """Return the loads of a toolpath of one tool; None where the cell has no process.

    Args:
        cell: The cell, with the tool and the process.
        toolpath: Toolpath with its process operations.
        feed: (N,) m/s of the move that ends at each point.
    """
    if cell.process is None or toolpath.process_operation is None:
        return None
    return compute_point_loads(cell.process, toolpath, cell.tool.cutter, feed)


def mark_forces(options: PlanOptions, segments: tuple[ToolSegment, ...]) -> PlanOptions:
    """Return the planning options, which know whether points have forces of their own.

    Args:
        options: The planning options.
        segments: Segments of the job, with their forces.
    """
    own = [segment.toolpath.force for segment in segments]
    given = any(force is not None and bool(np.nan_to_num(force).any()) for force in own)
    return replace(options, force=replace(options.force, is_per_point=True)) if given else options
