"""Shift of the part that would bring the points out of reach into reach: all of them, not only one."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from machopt.numerics.array_types import Array
from machopt.planning.pipeline.plan_data_types import Plan

MOST = 64  # maximum number of points, evenly selected
ROUNDS = 200  # maximum number of projections; each corrects the most violated point
NEAR = 2e-3  # m, permitted residual


@dataclass(frozen=True)
class ReachShift:
    """Proposed shift of the part."""

    by: Array  # (3,) m in base_link
    points: int  # toolpath points out of reach
    all: bool  # it brings all of them into reach, and moves no reached point beyond the smallest radius of these


def compute_reach_shift(plan: Plan, point: int) -> ReachShift:
    """Return the smallest shift that brings every point into reach; otherwise that of one point.

    A point p with shortfall s is reached within |p − c| − s of the shoulder c. These are balls for the shift, and so
    are
    those of the reached points, with the smallest of these radii where they lie within it. Repeated projection onto the
    most violated ball converges to the intersection, where one exists.

    Args:
        plan: plan of one tool.
        point: planning point that the fallback refers to.
    """
    path, shortfall = plan.path, plan.candidates.shortfall
    centre = plan.setup.robot.point[1]  # axis 2, the shoulder
    at = plan.setup.arm.places(path.external, path.position) - centre
    distance = np.linalg.norm(at, axis=1)
    station = np.minimum(np.searchsorted(path.stations, np.arange(len(distance))), len(path.stations) - 1)
    unreached = plan.candidates.is_out_of_reach()[station]
    radius = distance - shortfall[station]
    own = _shift(at[[point]], radius[[point]])
    out = unreached & path.is_point
    count = int(out.sum())
    if count <= 1:
        return ReachShift(own, max(count, 1), True)
    least = float(radius[out].min())
    others = np.flatnonzero(path.is_point & ~unreached & (distance <= least))
    some = np.concatenate([_select_few(np.flatnonzero(out), distance - radius), _select_few(others, distance)])
    limit = np.where(unreached, radius, least)
    by = _shift(at[some], limit[some])
    good = bool((np.linalg.norm(at[some] + by, axis=1) <= limit[some] + NEAR).all())
    return ReachShift(by if good else own, count, good)


def _select_few(rows: NDArray[np.intp], worst: Array) -> NDArray[np.intp]:
    """Return at most MOST of the rows, evenly, and the worst one."""
    if len(rows) <= MOST:
        return rows
    return np.append(rows[np.linspace(0, len(rows) - 1, MOST).astype(int)], rows[int(np.argmax(worst[rows]))])


def _shift(at: Array, radius: Array) -> Array:
    """(3,) that brings points (N, 3) into balls of radii (N,) about the origin, where the balls meet."""
    by = np.zeros(3)
    for _ in range(ROUNDS):
        place = at + by
        size = np.linalg.norm(place, axis=1)
        n = int(np.argmax(size - radius))
        if size[n] - radius[n] <= 0.1 * NEAR or size[n] == 0.0:
            break
        by = by - place[n] / size[n] * (size[n] - radius[n])
    return by
