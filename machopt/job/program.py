"""The motion as a robot program: PTP for rapid moves, LIN along the toolpath."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from machopt.domain.toolpath import Move, Toolpath
from machopt.formats.krl import LIN, PTP, RobotProgram
from machopt.plan.pipeline import Plan
from machopt.plan.timeline import Timeline

Array = NDArray[np.float64]


def robot_program(plan: Plan, toolpath: Toolpath, timeline: Timeline) -> RobotProgram:
    """Home first, then every leg of the timeline as moves to its way points."""
    legs = timeline.legs
    Q = np.vstack([plan.setup.cell.home[None], *(leg.waypoints for leg in legs)])
    at = np.concatenate([[np.nan], *(leg.waypoint_index for leg in legs)])
    feed = np.concatenate([[np.nan], *(leg.waypoint_feed for leg in legs)])
    T = plan.setup.robot.fk(Q, plan.setup.cell.tool.T_flange_tcp)
    inverse_base = np.linalg.inv(plan.setup.arm.T_base_workpiece)
    finite = np.where(np.isfinite(at), np.ceil(at - 1e-9), 0).astype(int)
    operation = np.where(np.isfinite(at), toolpath.operation[finite], -1).astype(np.int32)
    kinds = np.where(np.isfinite(feed), LIN, PTP).astype(np.int8)
    cutting = (kinds == LIN) & np.isfinite(at) & (toolpath.move[finite] == Move.CUT)
    return RobotProgram(
        kind=kinds, q=Q, T_workpiece_tcp=inverse_base @ T, feed=feed, cutting=cutting, operation=operation,
        operations=tuple(o.label for o in toolpath.operations), T_flange_tcp=plan.setup.cell.tool.T_flange_tcp,
        T_base_workpiece=plan.setup.arm.T_base_workpiece, ptp_speed=plan.options.rapid_scale,
        blend=plan.options.path_tolerance,
        events=_events(toolpath, at), source=f"{plan.setup.cell.name}; {toolpath.source}",
    )  # fmt: skip


def _events(toolpath: Toolpath, index: Array) -> tuple[tuple[int, str], ...]:
    """Each event before the first move that goes to or beyond its point."""
    out = []
    for event in toolpath.events:
        later = np.flatnonzero(np.isfinite(index) & (index >= event.index - 1e-9))
        out.append((int(later[0]) if len(later) else len(index) - 1, event.text))
    return tuple(out)
