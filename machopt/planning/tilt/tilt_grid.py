"""Configurations and costs over a grid of tilts, at some stations of a path.

The grid has the ends and the middle of both ranges: the index changes almost linearly over some degrees of tilt.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from math import pi, radians

import numpy as np
from numpy.typing import NDArray

from machopt.data_types.plan_options import PlanOptions
from machopt.numerics.array_types import Array
from machopt.numerics.rigid_transforms import normalise_vectors
from machopt.planning.cost.stiffness_index import compute_configuration_cost
from machopt.planning.pipeline.plan_data_types import Plan
from machopt.planning.sampling.candidate_enumeration import enumerate_candidates
from machopt.planning.stations.planning_path import PlanningPath
from machopt.planning.stations.tilt_curve import tilt_path
from machopt.planning.tilt.tilt_limits import TiltLimits

STATIONS = 320  # of the coarse search, besides both ends of every run
STEP = radians(7.5)  # of the rotation in the coarse search
NARROW = 4.0 * STEP  # a rotation range narrower than this is searched with the step of the options


@dataclass(frozen=True, kw_only=True)
class TiltNodes:
    """K tilts at every planning point: three levels of lead by three of side, or one where a range is one value."""

    tangent: Array  # (K, P, 3) a'/(a'·a) − a
    number: NDArray[np.int64]  # (3, 3) which of the K tilts has each pair of levels
    frame: Array  # (P, 2, 3) directions t and a × t
    levels: Array  # (P, 3, 2) tangents of lead and side


@dataclass(frozen=True, kw_only=True)
class TiltGrid:
    """Vertices of S stations, K tilts, R rotations and B branches."""

    stations: NDArray[np.int32]  # (S,) planning points
    nodes: TiltNodes
    phi: Array  # (S, R) rad
    q: Array  # (S, K, R, B, 6) rad
    cost: Array  # (S, K, R, B) in units of c₀; inf where there is no configuration
    stable: bool  # a branch has one number at every pose
    step: float  # rad, of the rotation


def select_coarse_stations(path: PlanningPath) -> NDArray[np.int32]:
    """Return stations of a coarse search: both ends of every run and others at even distances.

    Args:
        path: planning points.
    """
    st = path.stations
    if len(st) <= STATIONS:
        return st
    keep = np.zeros(len(st), bool)
    ends = np.unique(np.array(path.runs).ravel())
    keep[np.searchsorted(st, ends)] = True
    unit = float(path.s[-1]) / STATIONS
    cell = np.floor(path.s[st] / max(unit, 1e-12))
    keep[1:] |= cell[1:] > cell[:-1]
    return st[keep]


def build_tilt_nodes(path: PlanningPath, limits: TiltLimits) -> TiltNodes:
    """Return the tilts of the grid: the ends and the middle of both ranges, of the move that leaves each point.

    Args:
        path: path of the CAM file.
        limits: permitted tilts.
    """
    side = np.where(limits.cuts[0] | ~limits.cuts[1], 0, 1)
    rows = np.arange(len(path.index))
    low, high, frame = (of[side, rows] for of in (limits.low, limits.high, limits.frame))
    middle = np.where((low < 0) & (high > 0), 0.0, 0.5 * (low + high))
    levels = np.stack([low, middle, high], axis=1)
    used = [(0, 1, 2) if (low[:, c] != high[:, c]).any() else (1,) for c in (0, 1)]
    nodes = [
        levels[:, i, 0, None] * frame[:, 0] + levels[:, j, 1, None] * frame[:, 1] for i in used[0] for j in used[1]
    ]
    number = np.arange(len(nodes)).reshape(len(used[0]), len(used[1]))
    return TiltNodes(
        tangent=np.stack(nodes),
        number=np.broadcast_to(number, (3, 3)) if 1 in number.shape else number,
        frame=frame,
        levels=levels,
    )


def build_tilt_grid(plan: Plan, limits: TiltLimits, options: PlanOptions) -> TiltGrid:
    """Return configurations and costs of every coarse station, tilt, rotation and branch.

    Args:
        plan: plan with the axes of the CAM file.
        limits: permitted tilts.
        options: plan options of the path.
    """
    path, setup = plan.path.programmed, plan.setup
    stations = select_coarse_stations(path)
    path = replace(path, stations=stations)
    low, high = options.rotation_range
    coarse = min(high - low, 2 * pi) >= NARROW and options.rotation_step < STEP
    sparse = replace(options, rotation_step=STEP if coarse else options.rotation_step)
    nodes = build_tilt_nodes(path, limits)
    solved = []
    for tangent in nodes.tangent:
        tilted = tilt_path(path, normalise_vectors(path.axis + tangent), setup.ball_radius)
        solved.append(enumerate_candidates(tilted, setup.arm, sparse))
    branches = np.unique(np.concatenate([found.branch for found in solved]))
    solved = [found.expand_branches(branches) for found in solved]
    cost = []
    for found in solved:
        usable = found.usable
        value = np.full(usable.shape, np.inf)
        points = stations[np.nonzero(usable)[0]]
        value[usable] = compute_configuration_cost(
            setup.elasticity, plan.directions, points, found.q[usable], plan.scores.index
        )
        cost.append(value / plan.scores.scale)
    return TiltGrid(
        stations=stations,
        nodes=nodes,
        phi=solved[0].phi_at(),
        q=np.stack([found.q for found in solved], axis=1),
        cost=np.stack(cost, axis=1),
        stable=solved[0].stable,
        step=sparse.rotation_step,
    )
