"""Segments of a job with the recomputed force of each point, for checks of deflection and compensation."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from machopt.data_types.plan_options import PlanOptions
from machopt.data_types.process import CuttingProcess
from machopt.data_types.stock import StockEngagement
from machopt.data_types.tool_segments import ToolSegment
from machopt.data_types.toolpath import MoveKind, Toolpath
from machopt.verification.motion.process.point_loads import find_operations, recompute_loads
from machopt.verification.tables.csv_columns import read_table
from machopt.verification.tables.exported_tables import read_engagement

FORCE_COLUMN = "f_travel_N"


def attach_recomputed_forces(
    segments: Sequence[ToolSegment], toolpath: Toolpath, options: PlanOptions, folder: Path
) -> tuple[tuple[ToolSegment, ...], PlanOptions]:
    """Return the segments with the force of each point at the programmed feed, and options that know of it.

    Args:
        segments: Segments of the job.
        toolpath: The whole toolpath.
        options: The planning options in force.
        folder: The output folder, whose engagement.csv states the contact with the stock.

    Raises:
        InputError: engagement.csv is needed and cannot be read.
    """
    process = segments[0].cell.process
    if process is None:
        return tuple(segments), options
    operation = find_operations(process, toolpath)
    contact = _read_contact(process, toolpath, operation, folder)
    out, given = [], False
    for segment in segments:
        mine = operation[segment.first : segment.stop].astype(np.int32)
        own = None if contact is None else contact.take_range(segment.first, segment.stop)
        path = replace(segment.toolpath, engagement=own)
        loads = recompute_loads(segment.cell, path, path.feed, mine)
        given |= bool(np.nan_to_num(loads.arm_force).any())
        bound = replace(path, force=loads.arm_force, process_operation=mine)
        out.append(replace(segment, toolpath=bound))
    force = replace(options.force, is_per_point=True) if given else options.force
    return tuple(out), replace(options, force=force)


def _read_contact(
    process: CuttingProcess, toolpath: Toolpath, operation: np.ndarray, folder: Path
) -> StockEngagement | None:
    """Return the stated contact with the stock; None where no operation takes it from there."""
    wants = np.array([*(one.takes_stock for one in process.operations), False])
    wanted = (toolpath.move == MoveKind.CUT) & wants[operation]
    if process.stock is None or not wanted.any():
        return None
    stated = read_engagement(folder / "engagement.csv", len(toolpath))
    return replace(
        stated,
        is_computed=wanted,
        is_end_cut=wanted & _find_points_without_force(folder, len(toolpath)),
        edge_sigma=process.stock.cell_size / math.sqrt(12.0),
    )


def _find_points_without_force(folder: Path, count: int) -> NDArray[np.bool_]:
    """Return (N,) where points.csv states no force; nowhere where it has other points or no such column."""
    table = read_table(folder / "points.csv")
    if FORCE_COLUMN not in table or len(table.read_numbers("point")) != count:
        return np.zeros(count, bool)
    return np.isnan(table.read_numbers(FORCE_COLUMN, empty=True))
