"""Rotations that change where the path is too short for it, spread over more of the path.

A sequence of the grid changes its rotation by a whole step between two stations. The objective counts the time lost at
the velocity limits only, so that a step between stations a few micrometres apart costs little. The axes have to start
and stop for it, and the tool turns on the spot. The moving average over a time w at the programmed feed

    φ̄(t) = 1/w ∫ φ(τ) dτ,   τ = t − w/2 … t + w/2,

with φ constant beyond both ends of the run and while plunging, spreads each step over w. It replaces the rotation of
such runs where the objective does not get worse and where there are no contacts.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace

import numpy as np

from machopt.data_types.cell import JointLimits
from machopt.data_types.infeasibility_reasons import InfeasibilityReason
from machopt.numerics.array_types import Array
from machopt.planning.cost.rapid_time import compute_rest_time
from machopt.planning.pipeline.collision_free_search import CollisionFreeSearch, CollisionFreeSequence
from machopt.planning.sampling.joint_path import JointAssignment, solve_joint_path
from machopt.planning.stations.planning_path import PlanningPath

WIDTHS = 1.0, 0.3  # s at the programmed feed, tried in turn
SHARE = 0.5  # of a grid step: a smaller change of the rotation between two points is no step
MOST_RUNS = 8  # runs that are tried one by one, where all together are worse

Run = tuple[int, int]


def spread_rotation_steps(
    search: CollisionFreeSearch,
    sequence: CollisionFreeSequence,
    limits: JointLimits,
    total: Callable[[JointAssignment], float],
) -> CollisionFreeSequence:
    """Return the sequence with abrupt changes of the rotation spread, where J does not get worse.

    Args:
        search: search on the grid.
        sequence: its result.
        limits: of the joints.
        total: J of an assignment.
    """
    options = search.options
    if options.fixed or options.steer or not sequence.check.free or not np.isfinite(sequence.assignment.q).all():
        return sequence
    step = SHARE * 2 * np.pi / len(search.candidates.phi)
    runs = find_abrupt_runs(search.path, sequence.assignment, limits, options.limit_scale, step)
    if not runs:
        return sequence
    best = total(sequence.assignment)
    groups = [runs, *([run] for run in runs[:MOST_RUNS])] if len(runs) > 1 else [runs]
    done: set[Run] = set()
    for group in groups:
        if done.issuperset(group):
            continue
        for width in WIDTHS:
            spread = _spread_runs(search, sequence, group, width)
            value = np.inf if spread is None else total(spread.assignment)
            if spread is not None and value <= best:
                best, sequence = value, spread
                done.update(group)
                break
    return sequence


def find_abrupt_runs(
    path: PlanningPath, assignment: JointAssignment, limits: JointLimits, limit_scale: float, step: float
) -> list[Run]:
    """Return the runs whose rotation changes between two points faster than the axes can start and stop.

    Args:
        path: planning points.
        assignment: joints and rotations.
        limits: of the joints.
        limit_scale: share of the limits in use.
        step: rad, a smaller change of the rotation is not counted.
    """
    turn, need = np.abs(np.diff(assignment.phi)), np.abs(np.diff(assignment.q, axis=0))
    seconds = np.diff(path.time)
    found: list[Run] = []
    for first, last in path.runs:
        for n in first + np.flatnonzero(turn[first:last] >= step):
            bounds = (need[n] / (limit_scale * x[:6]) for x in (limits.velocity, limits.acceleration, limits.jerk))
            if compute_rest_time(*(float(x.max()) for x in bounds)) > seconds[n]:
                found.append((first, last))
                break
    return found


def compute_moving_average(time: Array, values: Array, width: float) -> Array:
    """Return the (n,) moving average of a piecewise linear function at its nodes; it is constant beyond both ends.

    Args:
        time: (n,) s, nodes, not decreasing.
        values: (n,) of the function there; different ones at the same time are a jump.
        width: s, of the average.
    """
    t = np.r_[time[0] - width, time, time[-1] + width]
    v = np.r_[values[0], values, values[-1]]
    length = np.diff(t)
    slope = np.divide(np.diff(v), length, out=np.zeros(len(length)), where=length > 0)
    area = np.r_[0.0, np.cumsum(0.5 * (v[1:] + v[:-1]) * length)]

    def integrate(x: Array) -> Array:
        k = np.clip(np.searchsorted(t, x, side="right") - 1, 0, len(length) - 1)
        d = x - t[k]
        return np.asarray(area[k] + d * v[k] + 0.5 * slope[k] * d * d)

    return (integrate(time + 0.5 * width) - integrate(time - 0.5 * width)) / width


def _spread_runs(
    search: CollisionFreeSearch, sequence: CollisionFreeSequence, runs: list[Run], width: float
) -> CollisionFreeSequence | None:
    """Return the sequence with the rotation of some runs averaged; None where it is not free of contacts."""
    path, checker = search.path, search.checker
    phi = sequence.assignment.phi.copy()
    for first, last in runs:
        seconds = np.diff(path.time[first : last + 1])
        seconds[path.plunge[first + 1 : last + 1]] = 0.0
        time = np.r_[0.0, np.cumsum(seconds)]
        phi[first : last + 1] = compute_moving_average(time, phi[first : last + 1], width)
    assignment = solve_joint_path(path, checker.arm, checker.robot, phi, sequence.assignment.q)
    if (assignment.reason != InfeasibilityReason.OK).any():
        return None
    check = checker.whole(assignment.phi, assignment.q)
    source = "smooth and grid" if sequence.source == "grid" else sequence.source
    return replace(sequence, assignment=assignment, check=check, source=source) if check.free else None
