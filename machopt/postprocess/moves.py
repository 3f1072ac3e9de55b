"""The motion as a robot program: PTP for rapid moves, LIN along the toolpath; or every control sample with its time."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from machopt.arrays import Array
from machopt.domain.program import LEAST_FEED, LIN, PTP, RobotProgram
from machopt.domain.toolpath import Event, Move, Toolpath
from machopt.domain.trajectory import Trajectory
from machopt.formats.posts.densify import Tolerance, densify
from machopt.formats.posts.thinning import find_needed_targets
from machopt.model.machine import load_machine
from machopt.model.posture import posture_of
from machopt.plan.motion.legs import Leg
from machopt.plan.motion.timeline import Timeline
from machopt.plan.pipeline.planned import Plan
from machopt.recheck.posts import carried_part, external_axes, standing_part


@dataclass(frozen=True)
class Programmed:
    """A program beside the motion it stands for."""

    program: RobotProgram
    at: Array  # (M,) row of the trajectory each move ends at, fractional, not falling
    added: int  # moves put in so that the controller's lines keep to the motion


def robot_program(plan: Plan, toolpath: Toolpath, timeline: Timeline, tolerance: Tolerance | None = None) -> Programmed:
    """Home (or where the tool was changed) first, then every leg of the timeline as moves to its way points.

    Where a straight line between two of them would leave the driven motion by more than the tolerance, samples of the
    motion become way points too.

    Raises:
        ValueError: the timeline has no trajectory.
    """
    trajectory, legs = _driven(timeline), timeline.legs
    cell = plan.setup.cell
    begin = cell.stands_at_home if plan.begin is None else plan.begin
    arm = np.vstack([begin[None, :6], *(leg.waypoints for leg in legs)])
    X = np.hstack([arm, np.vstack([begin[None, 6:], *(leg.waypoint_external for leg in legs)])])
    index = np.concatenate([[np.nan], *(leg.waypoint_index for leg in legs)])
    feed = np.concatenate([[np.nan], *(leg.waypoint_feed for leg in legs)])
    move = np.concatenate([[np.int8(Move.RAPID)], *(_moves(leg, toolpath) for leg in legs)]).astype(np.int8)
    drawn = np.concatenate([[False], *(np.full(len(leg.waypoints), _draws(leg)) for leg in legs)])
    at = _rows(legs)
    needed = find_needed_targets(
        _tcp(plan, X), X[:, 6:], feed, _must_stay(toolpath, index, feed, move, legs), tolerance or Tolerance()
    )
    X, index, feed, at = X[needed], index[needed], feed[needed], at[needed]
    move, drawn = move[needed], drawn[needed]
    driven = np.hstack([trajectory.q, trajectory.external])
    external = (trajectory.external, X[:, 6:]) if cell.external_joints else None
    added = densify(_tcp(plan, driven), _tcp(plan, X), at, np.isfinite(feed), tolerance or Tolerance(), external)
    if len(added):
        place = np.searchsorted(at, added, side="left")  # each goes before the target of its line
        X = np.insert(X, place, driven[added], axis=0)
        index, feed = np.insert(index, place, trajectory.point[added]), np.insert(feed, place, feed[place])
        move, at = np.insert(move, place, move[place]), np.insert(at, place, added)
        drawn = np.insert(drawn, place, drawn[place])
    kind = np.where(np.isfinite(feed), LIN, PTP).astype(np.int8)
    operation = np.where(np.isfinite(index), toolpath.operation[_point(index)], -1).astype(np.int32)
    made = _base(plan, X, kind, feed, move, operation, toolpath, _events(toolpath, index, drawn))
    return Programmed(replace(made, blend=(tolerance or Tolerance()).position), at, len(added))


def sampled_program(plan: Plan, toolpath: Toolpath, timeline: Timeline) -> Programmed:
    """Every control sample of the trajectory with its time, for posts that stream joints.

    Raises:
        ValueError: the timeline has no trajectory.
    """
    trajectory = _driven(timeline)
    kind = np.where(trajectory.move == Move.RAPID, PTP, LIN).astype(np.int8)
    kind[0] = PTP
    feed = np.where(kind == LIN, np.maximum(trajectory.feed, LEAST_FEED), np.nan)
    driven = np.hstack([trajectory.q, trajectory.external])
    drawn = np.concatenate([[False], *(np.full(len(leg.q) - 1, _draws(leg)) for leg in timeline.legs)])
    events = _events(toolpath, trajectory.point, drawn)
    made = _base(plan, driven, kind, feed, trajectory.move, trajectory.operation, toolpath, events)
    return Programmed(replace(made, time=trajectory.time), np.arange(len(trajectory.time), dtype=float), 0)


def _must_stay(
    toolpath: Toolpath, index: Array, feed: Array, move: NDArray[np.int8], legs: tuple[Leg, ...]
) -> NDArray[np.bool_]:
    """(M,) True where a target may not be left out: a leg, a feed, a kind of move, an operation or an event changes."""
    stays = np.zeros(len(index), bool)
    ends = np.cumsum([1, *(len(leg.waypoints) for leg in legs)])
    stays[ends - 1] = True
    point = _point(index)
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


def _driven(timeline: Timeline) -> Trajectory:
    if timeline.trajectory is None:
        raise ValueError("a blocked motion is no program")
    return timeline.trajectory


def _rows(legs: tuple[Leg, ...]) -> Array:
    """(M,) trajectory rows at which the moves end; legs share their ends there."""
    out, start = [np.zeros(1)], 0
    for leg in legs:
        last = len(leg.q) - 1
        if leg.name == "run" and len(leg.q) > 1 and leg.index[-1] > leg.index[0]:
            rows = np.interp(leg.waypoint_index, leg.index, np.arange(last + 1))
        elif len(leg.waypoints) > 1:  # a rapid move around something: each way point is a sample
            rows = np.array([np.abs(leg.q - w).max(axis=1).argmin() for w in leg.waypoints], float)
        else:
            rows = np.zeros(len(leg.waypoints))
        rows[-1:] = last
        out.append(start + np.maximum.accumulate(rows))
        start += last
    return np.concatenate(out)


def _base(
    plan: Plan,
    x: Array,
    kind: NDArray[np.int8],
    feed: Array,
    move: NDArray[np.int8],
    operation: NDArray[np.int32],
    toolpath: Toolpath,
    events: tuple[Event, ...],
) -> RobotProgram:
    cell, robot, q = plan.setup.cell, plan.setup.robot, x[:, :6]
    standing = posture_of(robot, q, cell.controller)
    return RobotProgram(
        kind=kind,
        q=q,
        T_workpiece_tcp=_tcp(plan, x) if cell.external_joints else _in_part(plan, _tcp(plan, x)),
        feed=feed,
        cutting=(kind == LIN) & (move == Move.CUT),
        operation=operation,
        move=move,
        operations=tuple(o.label for o in toolpath.operations),
        T_flange_tcp=cell.tool.T_flange_tcp,
        T_base_workpiece=standing_part(cell, cell.external_home),
        external=x[:, 6:],
        external_axes=external_axes(cell),
        T_carrier_workpiece=carried_part(cell),
        ptp_speed=plan.options.rapid_scale,
        events=events,
        source=f"{cell.name}; {toolpath.source}",
        joint_names=cell.arm_joints,
        behind=None if standing is None else standing[0],
        elbow_up=None if standing is None else standing[1],
        axis_velocity=cell.limits.velocity[:6],
        axis_acceleration=cell.limits.acceleration[:6],
        tool_com=cell.tool.com,
        tool_mass=cell.tool.mass if cell.tool.mass > 0.0 else float("nan"),
    )


def _tcp(plan: Plan, x: Array) -> Array:
    """(M, 4, 4) the tool as the controller reckons: in the workpiece where external joints move it, else in base_link.

    Args:
        plan: whose cell it is.
        x: (M, 6 + E) rad or m.
    """
    setup = plan.setup
    T_flange_tcp = setup.cell.tool.T_flange_tcp
    if setup.cell.external_joints:
        machine, drawn = setup.arm.machine, setup.robot.drawn
        return (machine if drawn is setup.robot else load_machine(setup.cell, drawn)).fk(x, T_flange_tcp)
    return setup.robot.drawn.fk(x, T_flange_tcp)


def _in_part(plan: Plan, T: Array) -> Array:
    return np.asarray(np.linalg.inv(plan.setup.arm.machine.T_base_workpiece_zero) @ T)


def _moves(leg: Leg, toolpath: Toolpath) -> NDArray[np.int8]:
    """(W,) Move codes at the leg's way points."""
    if leg.name == "run":
        return np.asarray(toolpath.move[_point(leg.waypoint_index)], np.int8)
    return np.full(len(leg.waypoints), leg.move[0], np.int8)


def _point(at: Array) -> NDArray[np.intp]:
    """The toolpath point a move towards index ``at`` belongs to; 0 where there is none."""
    return np.where(np.isfinite(at), np.ceil(at - 1e-9), 0).astype(np.intp)


def _draws(leg: Leg) -> bool:
    """The tool is drawn out of a point along its axis: a lift that the file has no move for."""
    return leg.name == "lift" and leg.move[0] == Move.RETRACT


def _events(toolpath: Toolpath, index: Array, drawn: NDArray[np.bool_]) -> tuple[Event, ...]:
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
