"""Requests that no plan can answer, and from a plan to its motion."""

from __future__ import annotations

from pathlib import Path

import numpy as np

from machopt.domain.cell import Cell
from machopt.domain.options import PlanOptions
from machopt.domain.toolpath import Toolpath
from machopt.errors import InputError
from machopt.model.robot import load_robot
from machopt.plan.pipeline import Plan, Timings
from machopt.plan.timeline import Timeline, build_timeline
from machopt.plan.wrongunit import wrong_unit
from machopt.se3 import inverse


def refuse_wrong_unit(cell: Cell, toolpath: Toolpath, file: Path, *, stated: bool) -> None:
    """Refuse a path whose numbers count another unit: all out of reach is no answer to it.

    Args:
        cell: the robot cell.
        toolpath: as it was read.
        file: what it was read from.
        stated: the user gave the unit: a small path is meant.
    """
    if cell.workpiece.link != "world" or cell.external_joints:
        return  # refused by the plan
    T_base_workpiece = inverse(cell.T_world_base) @ cell.workpiece.T_link_workpiece
    why = wrong_unit(toolpath, load_robot(cell), T_base_workpiece, cell.tool.T_flange_tcp, stated=stated)
    if why:
        raise InputError(why, file=file)


def refuse_fixed_beyond(toolpath: Toolpath, options: PlanOptions) -> None:
    """Refuse fixed rotations that no plan would keep."""
    if options.fixed and options.method != "global":
        raise InputError(
            f"method {options.method} chooses every rotation by itself and would not keep fixed ones; method global "
            "would",
            file="options",
            where="fixed",
        )
    for fixed in options.fixed:
        if fixed.point >= len(toolpath):
            raise InputError(
                f"point {fixed.point} is fixed, but {toolpath.source} has points 0 to {len(toolpath) - 1}",
                file="options",
                where="fixed",
            )


def motion_of(the_plan: Plan, toolpath: Toolpath, options: PlanOptions, timings: Timings) -> Timeline | None:
    """The motion, unless points are missing that the user did not allow to miss."""
    cut = the_plan.path.counted
    missing = the_plan.missing
    needed = missing[the_plan.path.may_touch[missing]]  # rapid points that cannot be reached are passed by
    if (len(needed) or the_plan.breaks) and not options.allow_gaps:
        return None
    if cut.any() and not np.setdiff1d(np.flatnonzero(cut), missing).size:
        return None
    with timings.stage("retime"):
        return build_timeline(the_plan, toolpath)
