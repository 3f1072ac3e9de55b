"""Robot program of a motion: PTP for rapid moves, LIN along the toolpath; or every control sample with its time."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from machopt.data_types.robot_program import LEAST_FEED, LIN, PTP, RobotProgram
from machopt.data_types.toolpath import MoveKind, Toolpath, ToolpathEvent
from machopt.data_types.trajectory import Trajectory
from machopt.kinematics.controller_posture import compute_controller_posture
from machopt.kinematics.machine import load_machine
from machopt.numerics.array_types import Array
from machopt.planning.motion.motion_segment import MotionSegment
from machopt.planning.motion.trajectory_builder import MotionTimeline
from machopt.planning.pipeline.plan_data_types import Plan
from machopt.programs.writing.rapid_zones import compute_rapid_zone_limits
from machopt.programs.writing.target_insertion import ProgramTolerance, insert_targets
from machopt.programs.writing.target_thinning import find_needed_targets
from machopt.verification.folder.programs.post_lookup import (
    compute_workpiece_in_base,
    get_workpiece_on_positioner,
    list_external_axes,
)

SAMPLES_AT_ONCE = 50_000  # samples of the motion whose poses are held at a time


@dataclass(frozen=True)
class MotionProgram:
    """Robot program with the motion it represents."""

    program: RobotProgram
    at: Array  # (M,) row of the trajectory each move ends at, fractional, not falling
    added_targets: int  # moves put in so that the controller's lines keep to the motion


def build_robot_program(
    plan: Plan, toolpath: Toolpath, timeline: MotionTimeline, tolerance: ProgramTolerance | None = None
) -> MotionProgram:
    """Return home (or the tool-change pose) first, then every leg of the timeline as moves to its way points.

    Where a straight line between two way points would leave the motion by more than the tolerance, samples of the
    motion become way points too.

    Args:
        plan: The plan.
        toolpath: The toolpath, points in the workpiece frame, SI.
        timeline: The motion over time.
        tolerance: The tolerance; None takes the default.

    Raises:
        ValueError: the timeline has no trajectory.
    """
    trajectory, legs = _get_trajectory(timeline), timeline.legs
    cell = plan.setup.cell
    begin = cell.joints_at_home if plan.begin is None else plan.begin
    arm = np.vstack([begin[None, :6], *(leg.waypoints for leg in legs)])
    X = np.hstack([arm, np.vstack([begin[None, 6:], *(leg.waypoint_external for leg in legs)])])
    index = np.concatenate([[np.nan], *(leg.waypoint_index for leg in legs)])
    feed = np.concatenate([[np.nan], *(leg.waypoint_feed for leg in legs)])
    move = np.concatenate([[np.int8(MoveKind.RAPID)], *(_list_move_kinds(leg, toolpath) for leg in legs)]).astype(
        np.int8
    )
    drawn = np.concatenate([[False], *(np.full(len(leg.waypoints), _is_tool_retracted(leg)) for leg in legs)])
    share, zone = _compute_rapid_zones(plan, X, legs)
    at = _list_move_end_rows(legs)
    needed = find_needed_targets(
        _compute_tcp_poses(plan, X),
        X[:, 6:],
        feed,
        _find_required_targets(toolpath, index, feed, move, legs),
        tolerance or ProgramTolerance(),
    )
    X, index, feed, at = X[needed], index[needed], feed[needed], at[needed]
    move, drawn, share, zone = move[needed], drawn[needed], share[needed], zone[needed]
    driven = np.hstack([trajectory.q, trajectory.external])
    added = _find_inserted_targets(plan, driven, X, at, np.isfinite(feed), tolerance or ProgramTolerance())
    if len(added):
        place = np.searchsorted(at, added, side="left")  # each goes before the target of its line
        X = np.insert(X, place, driven[added], axis=0)
        index, feed = np.insert(index, place, trajectory.point[added]), np.insert(feed, place, feed[place])
        move, at = np.insert(move, place, move[place]), np.insert(at, place, added)
        drawn = np.insert(drawn, place, drawn[place])
        share, zone = np.insert(share, place, 0.0), np.insert(zone, place, 0.0)
    kind = np.where(np.isfinite(feed), LIN, PTP).astype(np.int8)
    operation = np.where(np.isfinite(index), toolpath.operation[_find_toolpath_points(index)], -1).astype(np.int32)
    made = _build_base_program(plan, X, kind, feed, move, operation, toolpath, _place_events(toolpath, index, drawn))
    made = replace(made, blend=(tolerance or ProgramTolerance()).position, rapid_share=share, rapid_zone=zone)
    return MotionProgram(made, at, len(added))


def _compute_rapid_zones(plan: Plan, x: Array, legs: tuple[MotionSegment, ...]) -> tuple[Array, Array]:
    """Return the share (M,) of the joint moves over which each target may be rounded, and the same as m (M,)."""
    shares = np.vstack(
        [np.zeros((1, 2)), *(np.zeros((len(leg.waypoints), 2)) if leg.rounded is None else leg.rounded for leg in legs)]
    )
    at = np.flatnonzero(shares.min(axis=1) > 0.0)
    zone = np.zeros(len(x))
    zone[at] = compute_rapid_zone_limits(
        x[at], (x[at - 1], x[at + 1]), shares[at], lambda q: _compute_tcp_poses(plan, q)[:, :3, 3]
    )
    return shares.min(axis=1), zone


def _find_inserted_targets(
    plan: Plan, driven: Array, x: Array, at: Array, linear: NDArray[np.bool_], tolerance: ProgramTolerance
) -> NDArray[np.intp]:
    """Return the samples that become targets, ascending; of some moves at a time, as the poses need much memory.

    Args:
        plan: The plan.
        driven: (S, 6 + E) rad or m, the samples of the motion.
        x: (M, 6 + E) rad or m, the targets.
        at: (M,) place of each target among the samples, fractional, not falling.
        linear: (M,) True where the move to the target is a straight line.
        tolerance: The tolerance of the program.
    """
    found, first = [np.empty(0, np.intp)], 0
    while first < len(at) - 1:
        last = int(np.searchsorted(at, at[first] + SAMPLES_AT_ONCE, side="right")) - 1
        last = min(max(last, first + 1), len(at) - 1)
        start, some = int(at[first]), slice(first, last + 1)
        samples, targets = driven[start : int(np.ceil(at[last])) + 1], x[some]
        external = (samples[:, 6:], targets[:, 6:]) if plan.setup.cell.external_joints else None
        poses = _compute_tcp_poses(plan, samples), _compute_tcp_poses(plan, targets)
        found.append(start + insert_targets(*poses, at[some] - start, linear[some], tolerance, external))
        first = last
    return np.concatenate(found)


def build_sampled_program(plan: Plan, toolpath: Toolpath, timeline: MotionTimeline) -> MotionProgram:
    """Return every control sample of the trajectory with its time, for posts that stream joint positions.

    Args:
        plan: The plan.
        toolpath: The toolpath, points in the workpiece frame, SI.
        timeline: The motion over time.

    Raises:
        ValueError: the timeline has no trajectory.
    """
    trajectory = _get_trajectory(timeline)
    kind = np.where(trajectory.move == MoveKind.RAPID, PTP, LIN).astype(np.int8)
    kind[0] = PTP
    feed = np.where(kind == LIN, np.maximum(trajectory.feed, LEAST_FEED), np.nan)
    driven = np.hstack([trajectory.q, trajectory.external])
    drawn = np.concatenate([[False], *(np.full(len(leg.q) - 1, _is_tool_retracted(leg)) for leg in timeline.legs)])
    events = _place_events(toolpath, trajectory.point, drawn)
    made = _build_base_program(plan, driven, kind, feed, trajectory.move, trajectory.operation, toolpath, events)
    return MotionProgram(replace(made, time=trajectory.time), np.arange(len(trajectory.time), dtype=float), 0)


def _find_required_targets(
    toolpath: Toolpath, index: Array, feed: Array, move: NDArray[np.int8], legs: tuple[MotionSegment, ...]
) -> NDArray[np.bool_]:
    """(M,) True where a target may not be left out: a leg, a feed, a kind of move, an operation or an event changes."""
    stays = np.zeros(len(index), bool)
    ends = np.cumsum([1, *(len(leg.waypoints) for leg in legs)])
    stays[ends - 1] = True
    point = _find_toolpath_points(index)
    label = np.where(np.isfinite(index), toolpath.operation[point], -1)
    for words in (np.nan_to_num(feed, nan=-1.0), move, label):
        changes = words[1:] != words[:-1]
        stays[:-1] |= changes
    after = np.zeros(len(toolpath) + 1, bool)
    after[[event.index for event in toolpath.events]] = True  # an event comes before its point is moved to
    events = np.isfinite(index) & (
        after[np.minimum(point + 1, len(toolpath))] | ~np.isfinite(np.append(index[1:], 0.0))
    )
    return np.asarray(stays | events)


def _get_trajectory(timeline: MotionTimeline) -> Trajectory:
    if timeline.trajectory is None:
        raise ValueError("a blocked motion is no program")
    return timeline.trajectory


def _list_move_end_rows(legs: tuple[MotionSegment, ...]) -> Array:
    """(M,) trajectory rows at which the moves end; legs share their ends there."""
    out, start = [np.zeros(1)], 0
    for leg in legs:
        last = len(leg.q) - 1
        if leg.name == "run" and len(leg.q) > 1 and leg.index[-1] > leg.index[0]:
            rows = np.interp(leg.waypoint_index, leg.index, np.arange(last + 1))
        elif leg.waypoint_row is not None:
            rows = leg.waypoint_row.astype(float)
        elif len(leg.waypoints) > 1:  # a rapid move around something: each way point is a sample
            rows = np.array([np.abs(leg.q - w).max(axis=1).argmin() for w in leg.waypoints], float)
        else:
            rows = np.zeros(len(leg.waypoints))
        rows[-1:] = last
        out.append(start + np.maximum.accumulate(rows))
        start += last
    return np.concatenate(out)


def _build_base_program(
    plan: Plan,
    x: Array,
    kind: NDArray[np.int8],
    feed: Array,
    move: NDArray[np.int8],
    operation: NDArray[np.int32],
    toolpath: Toolpath,
    events: tuple[ToolpathEvent, ...],
) -> RobotProgram:
    cell, robot, q = plan.setup.cell, plan.setup.robot, x[:, :6]
    standing = compute_controller_posture(robot, q, cell.controller)
    return RobotProgram(
        kind=kind,
        q=q,
        T_workpiece_tcp=_compute_tcp_poses(plan, x)
        if cell.external_joints
        else _convert_to_workpiece(plan, _compute_tcp_poses(plan, x)),
        feed=feed,
        cutting=(kind == LIN) & (move == MoveKind.CUT),
        operation=operation,
        move=move,
        operations=tuple(o.label for o in toolpath.operations),
        T_flange_tcp=cell.tool.T_flange_tcp,
        T_base_workpiece=compute_workpiece_in_base(cell, cell.external_home),
        external=x[:, 6:],
        external_axes=list_external_axes(cell),
        T_carrier_workpiece=get_workpiece_on_positioner(cell),
        ptp_speed=plan.options.rapid_scale,
        events=events,
        source=f"{cell.name}; {toolpath.source}",
        joint_names=cell.arm_joints,
        wrist_behind=None if standing is None else standing[0],
        elbow_up=None if standing is None else standing[1],
        axis_velocity=cell.limits.velocity[:6],
        axis_acceleration=cell.limits.acceleration[:6],
        tool_com=cell.tool.com,
        tool_mass=cell.tool.mass if cell.tool.mass > 0.0 else float("nan"),
    )


def _compute_tcp_poses(plan: Plan, x: Array) -> Array:
    """(M, 4, 4) the tool as the controller reckons: in the workpiece where external joints move it, else in base_link.

    Args:
        plan: whose cell it is.
        x: (M, 6 + E) rad or m.
    """
    setup = plan.setup
    T_flange_tcp = setup.cell.tool.T_flange_tcp
    if setup.cell.external_joints:
        machine, drawn = setup.arm.machine, setup.robot.nominal_robot
        return (machine if drawn is setup.robot else load_machine(setup.cell, drawn)).compute_fk(x, T_flange_tcp)
    return setup.robot.nominal_robot.compute_fk(x, T_flange_tcp)


def _convert_to_workpiece(plan: Plan, T: Array) -> Array:
    return np.asarray(np.linalg.inv(plan.setup.arm.machine.T_base_workpiece_zero) @ T)


def _list_move_kinds(leg: MotionSegment, toolpath: Toolpath) -> NDArray[np.int8]:
    """(W,) Move codes at the leg's way points."""
    if leg.name == "run":
        return np.asarray(toolpath.move[_find_toolpath_points(leg.waypoint_index)], np.int8)
    return np.full(len(leg.waypoints), leg.move[0], np.int8)


def _find_toolpath_points(at: Array) -> NDArray[np.intp]:
    """The toolpath point a move towards index ``at`` belongs to; 0 where there is none."""
    return np.where(np.isfinite(at), np.ceil(at - 1e-9), 0).astype(np.intp)


def _is_tool_retracted(leg: MotionSegment) -> bool:
    """The tool is drawn out of a point along its axis: a lift that the file has no move for."""
    return leg.name == "lift" and leg.move[0] == MoveKind.RETRACT


def _place_events(toolpath: Toolpath, index: Array, drawn: NDArray[np.bool_]) -> tuple[ToolpathEvent, ...]:
    """Each event before the first move from the point before its own; what comes after the last point at the end.

    Where the tool is drawn out of that point, it is drawn out first (with the spindle still on), but the file's dwell
    is at the point itself, and so is what the file says before it.

    Args:
        toolpath: with its events.
        index: (M,) fractional toolpath index where each move ends, NaN from and to home.
        drawn: (M,) the move draws the tool out of a point.
    """
    out = []
    last = {event.index: k for k, event in enumerate(toolpath.events) if event.kind == "dwell"}
    for k, event in enumerate(toolpath.events):
        later = index > event.index - 1 + 1e-9
        if k <= last.get(event.index, -1):
            later |= drawn & (np.abs(index - (event.index - 1)) <= 1e-9)
        rows = np.flatnonzero(later)
        out.append(replace(event, index=int(rows[0]) if len(rows) else len(index) - 1))
    return tuple(out)
