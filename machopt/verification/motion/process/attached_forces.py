"""Segments of a job with the recomputed force of each point, for checks of deflection and compensation."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from machopt.data_types.plan_options import PlanOptions
from machopt.data_types.tool_segments import ToolSegment
from machopt.data_types.toolpath import Toolpath
from machopt.verification.motion.process.point_loads import find_operations, recompute_loads


def attach_recomputed_forces(
    segments: Sequence[ToolSegment], toolpath: Toolpath, options: PlanOptions
) -> tuple[tuple[ToolSegment, ...], PlanOptions]:
    """Return the segments with the force of each point at the programmed feed, and options that know of it.

    Args:
        segments: Segments of the job.
        toolpath: The whole toolpath.
        options: The planning options in force.
    """
    process = segments[0].cell.process
    if process is None:
        return tuple(segments), options
    operation = find_operations(process, toolpath)
    out, given = [], False
    for segment in segments:
        mine = operation[segment.first : segment.stop].astype(np.int32)
        loads = recompute_loads(segment.cell, segment.toolpath, segment.toolpath.feed, mine)
        given |= bool(np.nan_to_num(loads.arm_force).any())
        bound = replace(segment.toolpath, force=loads.arm_force, process_operation=mine)
        out.append(replace(segment, toolpath=bound))
    force = replace(options.force, is_per_point=True) if given else options.force
    return tuple(out), replace(options, force=force)
