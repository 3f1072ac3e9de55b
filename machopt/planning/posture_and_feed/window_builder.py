"""Division of the runs of a plan into windows, and the numbers of each window at an iterate."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from machopt.numerics.array_types import Array, Bools
from machopt.numerics.rigid_transforms import compute_tool_rotation, wrap_angle
from machopt.planning.pipeline.plan_data_types import Plan
from machopt.planning.posture_and_feed.advised_feeds import AdvisedFeeds
from machopt.planning.posture_and_feed.linearized_constraints import LimitSources, build_local_limits
from machopt.planning.posture_and_feed.node_loads import MilledTargets, build_node_loads
from machopt.planning.posture_and_feed.symbolic_machine import SymbolicMachine
from machopt.planning.posture_and_feed.window_data import WindowData
from machopt.planning.stations.fixed_rotations import find_fixed_rotations

NODES = 300  # most nodes of a window
OVERLAP = 60  # nodes that a window shares with the one before
KEPT = 3  # nodes that keep the plan where a window ends inside a run: q, its first and second difference continue
LEAST_NODES = 8  # a window with fewer has nothing to optimise
SPACING = 4e-3  # m of the metric, least distance of nodes that no fixed rotation needs
LEAST_WAY = 1e-6  # m, shortest segment between two nodes
LEAST_LENGTH = 1e-7  # m, a segment whose tip moves less has no feed limit
JOINT_RESERVE = 1e-5  # rad or m, a hundred times the change of a joint within the solver's tolerance of a pose (1e-8 m)
SPIN = 0.5  # m/s along the metric: limit where only the axis turns


@dataclass(frozen=True)
class RunState:
    """A plan with its feed advice and the duration of one of its runs at the advised feeds."""

    plan: Plan  # without the advised feeds
    advised: AdvisedFeeds
    seconds: float


@dataclass(frozen=True)
class Window:
    """Nodes of a run that are optimised together."""

    run: int  # number of the run in the path
    nodes: NDArray[np.intp]  # planning points of all nodes of the run
    first: int  # of the nodes
    last: int

    @property
    def points(self) -> NDArray[np.intp]:
        """Planning points of the window's nodes."""
        return self.nodes[self.first : self.last + 1]

    @property
    def name(self) -> str:
        """Description for messages."""
        return f"nodes {self.first} to {self.last} of run {self.run}"


def list_windows(plan: Plan) -> Iterator[Window]:
    """Yield the windows of every run that cuts along a path, in order.

    Args:
        plan: Plan of one tool.
    """
    path = plan.path
    for number, (first, last) in enumerate(path.runs):
        if path.is_drilling[first : last + 1].any() or not path.counted[first : last + 1].any():
            continue
        nodes = _list_nodes(plan, first, last)
        if len(nodes) < LEAST_NODES:
            continue
        count = max(int(np.ceil((len(nodes) - OVERLAP) / (NODES - OVERLAP))), 1)
        size = int(np.ceil((len(nodes) + (count - 1) * OVERLAP) / count))
        for n in range(count):
            begin = min(n * (size - OVERLAP), len(nodes) - size)
            yield Window(number, nodes, begin, begin + size - 1)


def _list_nodes(plan: Plan, first: int, last: int) -> NDArray[np.intp]:
    """Return the stations of a run without those that are too near; the first and last point are nodes."""
    path = plan.path
    stations = path.stations[(path.stations > first) & (path.stations < last)]
    points = np.r_[first, stations, last].astype(np.intp)
    fixed = find_fixed_rotations(path, plan.options)
    nodes = [int(points[0])]
    for point in points[1:-1].tolist():
        way = path.s[point] - path.s[nodes[-1]]
        if way > LEAST_WAY and (way >= SPACING or point in fixed):
            nodes.append(point)
    points = np.array([*nodes, int(points[-1])], np.intp)
    if len(points) > 2 and path.s[points[-1]] - path.s[points[-2]] <= LEAST_WAY:
        points = np.delete(points, -2)
    return np.asarray(points if path.s[points[-1]] > path.s[points[0]] else points[:1])


def build_window_data(
    state: RunState,
    window: Window,
    milled: MilledTargets | None,
    sources: LimitSources,
    machine: SymbolicMachine,
    is_free: Bools,
    trust: float,
) -> WindowData:
    """Return the numbers of a window at the present plan.

    Args:
        state: The iterate.
        window: Its nodes.
        milled: Points with a tolerance.
        sources: Sources of the local limits.
        machine: Symbolic kinematics.
        is_free: (E,) external joints that may move.
        trust: rad, largest change of the rotation; external joints change by as many rad or 0.5 m per rad.
    """
    plan, points = state.plan, window.points
    path, setup = plan.path, plan.setup
    a, limits, scale = plan.chosen.assignment, plan.setup.driven.limits, plan.options.limit_scale
    x, phi = path.whole(a.q)[points], a.phi[points]
    way = np.diff(path.s[points])
    length, cap = _compute_feed_caps(plan, points, way)
    loads = build_node_loads(plan, points, cap * length / way, milled, state.advised, machine)
    cap = _limit_to_chip(cap, length, way, loads.highest)
    count, ends = len(points), len(window.nodes) - 1
    fixed = np.zeros(count, bool)
    fixed[:KEPT] |= window.first > 0
    fixed[count - KEPT :] |= window.last < ends
    low, high = _bound_rotation(plan, points, phi, trust)
    lower = np.r_[setup.arm.lower, limits.lower[6:]]
    upper = np.r_[setup.arm.upper, limits.upper[6:]]
    return WindowData(
        points=points,
        x=x,
        phi=phi,
        position=path.position[points],
        frame=compute_tool_rotation(path.axis[points], path.reference[points], np.zeros(count)),
        way=way,
        length=length,
        cap=cap,
        velocity=scale * limits.velocity,
        acceleration=scale * limits.acceleration,
        jerk=scale * limits.jerk,
        lower=np.minimum(lower + JOINT_RESERVE, x.min(axis=0)),
        upper=np.maximum(upper - JOINT_RESERVE, x.max(axis=0)),
        phi_lower=low,
        phi_upper=high,
        is_fixed=fixed,
        is_plunge=np.add.reduceat(path.plunge.astype(int), points[:-1] + 1) > 0,
        is_free=is_free,
        external_trust=0.5 * trust,
        starts_at_rest=window.first == 0,
        ends_at_rest=window.last == ends,
        loads=loads,
        limits=build_local_limits(sources, points, phi, x, is_free),
    )


def _compute_feed_caps(plan: Plan, points: NDArray[np.intp], way: Array) -> tuple[Array, Array]:
    """Return length of the tip's path (N − 1,) m and the speed limit along the metric (N − 1,) m/s, by the file."""
    path = plan.path
    step = np.r_[0.0, np.linalg.norm(np.diff(path.programmed.position, axis=0), axis=1)]
    feed = np.where(path.feed > 0, path.feed, plan.options.approach_feed)
    length = np.add.reduceat(np.r_[step, 0.0], points + 1)[:-1]
    seconds = np.add.reduceat(np.r_[step / feed, 0.0], points + 1)[:-1]
    moving = length > LEAST_LENGTH
    cap = np.where(moving, way / np.where(moving, seconds, 1.0), SPIN)
    return np.where(moving, length, 0.0), np.minimum(cap, np.where(moving, np.inf, SPIN))


def _limit_to_chip(cap: Array, length: Array, way: Array, highest: Array) -> Array:
    """Return the speed limits within the feed at which the cutting coefficients hold at either end of a segment."""
    feed = np.minimum(highest[1:], highest[:-1])
    return np.where(length > 0.0, np.minimum(cap, feed * way / np.maximum(length, LEAST_LENGTH)), cap)


def _bound_rotation(plan: Plan, points: NDArray[np.intp], phi: Array, trust: float) -> tuple[Array, Array]:
    """Return (N,) rad each: the trust region within the user's range, and the fixed rotations."""
    low, high = phi - trust, phi + trust
    least, most = plan.options.rotation_range
    if most - least < 2.0 * np.pi - 1e-6:
        middle = 0.5 * (least + most)
        offset = np.asarray(wrap_angle(phi + plan.path.offset[points] - middle))
        room = 0.5 * (most - least)
        low = np.maximum(low, phi - offset - room)
        high = np.minimum(high, phi - offset + room)
    row_of = {int(point): n for n, point in enumerate(points)}
    for row, target in find_fixed_rotations(plan.path, plan.options).items():
        if row in row_of:
            n = row_of[row]
            low[n] = high[n] = phi[n] + float(wrap_angle(target - phi[n]))
    return np.minimum(low, phi), np.maximum(high, phi)
