"""The motion as a robot program: PTP for rapid moves, LIN along the toolpath; or every control sample with its time."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from machopt.domain.program import LEAST_FEED, LIN, PTP, RobotProgram
from machopt.domain.toolpath import Event, Move, Toolpath
from machopt.model.posture import posture
from machopt.plan.pipeline import Plan
from machopt.plan.timeline import Leg, Timeline

Array = NDArray[np.float64]


def robot_program(plan: Plan, toolpath: Toolpath, timeline: Timeline) -> RobotProgram:
    """Home first, then every leg of the timeline as moves to its way points."""
    legs = timeline.legs
    Q = np.vstack([plan.setup.cell.home[None], *(leg.waypoints for leg in legs)])
    at = np.concatenate([[np.nan], *(leg.waypoint_index for leg in legs)])
    feed = np.concatenate([[np.nan], *(leg.waypoint_feed for leg in legs)])
    move = np.concatenate([[np.int8(Move.RAPID)], *(_moves(leg, toolpath) for leg in legs)]).astype(np.int8)
    kind = np.where(np.isfinite(feed), LIN, PTP).astype(np.int8)
    operation = np.where(np.isfinite(at), toolpath.operation[_point(at)], -1).astype(np.int32)
    return replace(_base(plan, toolpath, Q, kind, feed, move, operation, at), blend=plan.options.path_tolerance)


def sampled_program(plan: Plan, toolpath: Toolpath, timeline: Timeline) -> RobotProgram:
    """Every control sample of the trajectory with its time, for posts that stream joints.

    Raises:
        ValueError: the timeline has no trajectory.
    """
    trajectory = timeline.trajectory
    if trajectory is None:
        raise ValueError("a blocked motion has no samples")
    kind = np.where(trajectory.move == Move.RAPID, PTP, LIN).astype(np.int8)
    kind[0] = PTP
    feed = np.where(kind == LIN, np.maximum(trajectory.feed, LEAST_FEED), np.nan)
    made = _base(plan, toolpath, trajectory.q, kind, feed, trajectory.move, trajectory.operation, trajectory.point)
    return replace(made, time=trajectory.time)


def _base(
    plan: Plan, toolpath: Toolpath, q: Array, kind: NDArray[np.int8], feed: Array, move: NDArray[np.int8],
    operation: NDArray[np.int32], at: Array,
) -> RobotProgram:  # fmt: skip
    cell, robot = plan.setup.cell, plan.setup.robot
    T = robot.fk(q, cell.tool.T_flange_tcp)
    standing = _posture(plan, q)
    return RobotProgram(
        kind=kind, q=q, T_workpiece_tcp=np.linalg.inv(plan.setup.arm.T_base_workpiece) @ T, feed=feed,
        cutting=(kind == LIN) & (move == Move.CUT), operation=operation, move=move,
        operations=tuple(o.label for o in toolpath.operations), T_flange_tcp=cell.tool.T_flange_tcp,
        T_base_workpiece=plan.setup.arm.T_base_workpiece, ptp_speed=plan.options.rapid_scale,
        events=_events(toolpath, at), source=f"{cell.name}; {toolpath.source}", joint_names=cell.arm_joints,
        behind=None if standing is None else standing[0], elbow_up=None if standing is None else standing[1],
        axis_velocity=cell.limits.velocity[:6], tool_com=cell.tool.com,
        tool_mass=cell.tool.mass if cell.tool.mass > 0.0 else float("nan"),
    )  # fmt: skip


def _posture(plan: Plan, q: Array) -> tuple[NDArray[np.bool_], NDArray[np.bool_]] | None:
    """Front is the x axis of the controller's own robot system, at its axis 1 at zero."""
    controller = plan.setup.cell.controller
    front = np.array([1.0, 0.0, 0.0]) if controller.T_base_root is None else controller.T_base_root[:3, 0]
    joints = controller.joint_map
    zero = 0.0 if joints is None else float(np.radians(-joints.offset_deg[0] * joints.sign[0]))
    return posture(plan.setup.robot, q, front, zero)


def _moves(leg: Leg, toolpath: Toolpath) -> NDArray[np.int8]:
    """(W,) Move codes at the leg's way points."""
    if leg.name == "run":
        return np.asarray(toolpath.move[_point(leg.waypoint_index)], np.int8)
    return np.full(len(leg.waypoints), leg.move[0], np.int8)


def _point(at: Array) -> NDArray[np.intp]:
    """The toolpath point a move towards index ``at`` belongs to; 0 where there is none."""
    return np.where(np.isfinite(at), np.ceil(at - 1e-9), 0).astype(np.intp)


def _events(toolpath: Toolpath, index: Array) -> tuple[Event, ...]:
    """Each event before the first move that goes to or beyond its point; what comes after the last point at the end."""
    out = []
    for event in toolpath.events:
        later = np.flatnonzero(np.isfinite(index) & (index >= event.index - 1e-9))
        out.append(replace(event, index=int(later[0]) if len(later) else len(index) - 1))
    return tuple(out)
