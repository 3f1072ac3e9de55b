"""Motions of a turning positioner that keep the tool's azimuth about its axis: the part turns as the tool goes round.

Search grids of values are coarse, and a local search does not find its way from a standing table to one that follows
the tool over several turns. Such motions are therefore starts of their own. The joint turns the part about a line z
through c. With the azimuth α of the tool axis about z while the joint is at e₀ (of the tool tip where the axis is
nearly parallel to z),

    e(s) = e₀ + C − α(s),

unwrapped along the path, for some constants C. Where the range does not hold all of it, each run is shifted by whole
turns next to the one before.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from machopt.numerics.array_types import Array
from machopt.planning.external_axes.operation_groups import OperationGroup
from machopt.planning.pipeline.planning_setup import PlanningSetup, fix_external_axes
from machopt.planning.stations.path_subset import list_run_points
from machopt.planning.stations.planning_path import PlanningPath

AZIMUTHS = 12  # constants C
UPRIGHT = 0.3  # sine of the median angle between tool axis and z, below which the tip counts
STEP = 0.1  # rad, by which the line of a joint is found
ROOM = 0.01  # share of the range that stays free at its ends
TWO_PI = 2.0 * np.pi


def list_following_paths(
    setup: PlanningSetup, path: PlanningPath, groups: Sequence[OperationGroup], fixed_values: Sequence[Array]
) -> list[Array]:
    """Return (P, E) m or rad each, the motions of every turning positioner joint that may move along the whole path.

    Args:
        setup: planning setup of the cell.
        path: planning points.
        groups: operation groups.
        fixed_values: (E,) m or rad, values of the other joints for each group.
    """
    machine = setup.arm.machine
    base = np.empty((len(path.index), machine.external_count))
    for group, value in zip(groups, fixed_values, strict=True):
        base[list_run_points(path, group.runs)] = value
    out: list[Array] = []
    for line in range(machine.positioner):
        k = int(machine.column[line]) - 6
        if machine.slides[line] or not all(group.moves[k] for group in groups):
            continue
        azimuth = _compute_azimuths(setup, path, base, k)
        low = max(float(group.least[k]) for group in groups)
        high = min(float(group.most[k]) for group in groups)
        room = ROOM * (high - low)
        for c in np.arange(AZIMUTHS) * TWO_PI / AZIMUTHS:
            own = _fit_into_range(path, base[:, k] + c - azimuth, low + room, high - room)
            if own is not None:
                out.append(np.where(np.arange(base.shape[1]) == k, own[:, None], base))
    return out


def _compute_azimuths(setup: PlanningSetup, path: PlanningPath, base: Array, k: int) -> Array:
    """Return the (P,) azimuth in rad of the tool about the line of joint k, unwrapped along the path."""
    arm = setup.arm
    turned = base[:1].copy()
    turned[0, k] += STEP
    before, after = (arm.machine.compute_T_base_workpiece(e)[0] for e in (base[:1], turned))
    T = after @ np.linalg.inv(before)
    R = T[:3, :3]
    z = np.array([R[2, 1] - R[1, 2], R[0, 2] - R[2, 0], R[1, 0] - R[0, 1]])
    z /= np.linalg.norm(z)
    c = np.linalg.lstsq(np.eye(3) - R, T[:3, 3], rcond=1e-9)[0]
    there = fix_external_axes(path, base)
    across = arm.directions(there.external, path.axis)
    if np.median(np.linalg.norm(np.cross(across, z), axis=1)) < UPRIGHT:
        across = arm.places(there.external, path.position) - c
    x = np.cross(z, np.eye(3)[int(np.abs(z).argmin())])
    x /= np.linalg.norm(x)
    return np.asarray(np.unwrap(np.arctan2(across @ np.cross(z, x), across @ x)))


def _fit_into_range(path: PlanningPath, value: Array, low: float, high: float) -> Array | None:
    """Return the (P,) values shifted into a range: as a whole, else run by run; None where a run does not fit."""
    if np.ptp(value) <= high - low:
        middle = 0.5 * (value.min() + value.max() - low - high)
        shift = TWO_PI * np.round(middle / TWO_PI)
        if value.min() - shift >= low and value.max() - shift <= high:
            return np.asarray(value - shift)
    out, last = value.copy(), 0.0
    for first, end in path.runs:
        rows = slice(first, end + 1)
        if path.is_drilling[rows].any():
            out[rows] = value[end]
        turns = _list_turns(out[rows], low, high)
        if not len(turns):
            return None
        out[rows] += TWO_PI * turns[np.abs(out[first] + TWO_PI * turns - last).argmin()]
        last = float(out[end])
    return out


def _list_turns(value: Array, low: float, high: float) -> NDArray[np.int_]:
    """Return the whole turns by which values may be shifted within a range."""
    least, most = np.ceil((low - value.min()) / TWO_PI), np.floor((high - value.max()) / TWO_PI)
    return np.arange(int(least), int(most) + 1)
