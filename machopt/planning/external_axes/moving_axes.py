"""External joints that may move along the path: which of them move, and their range at each planning point."""

from __future__ import annotations

import itertools
from collections.abc import Sequence
from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from machopt.data_types.plan_options import ExternalJointOptions
from machopt.numerics.array_types import Array, Bools
from machopt.planning.external_axes.axis_curve_smoothing import GroupAxisRange
from machopt.planning.external_axes.moving_axis_search import FINER, AxisCurveSearch, compute_axis_curve
from machopt.planning.external_axes.operation_groups import OperationGroup
from machopt.planning.external_axes.position_constraints import (
    AxisBound,
    AxisPositionWish,
    Interval,
    find_nearest_allowed,
)
from machopt.planning.stations.path_subset import list_run_points
from machopt.planning.stations.planning_path import PlanningPath

ROOM = 0.01  # share of a range that a moving joint keeps from its ends: a curve may overshoot between points


def list_moving_subsets(
    groups: Sequence[OperationGroup], fixed_values: Sequence[Array], home: Array
) -> list[list[OperationGroup]]:
    """Return the groups with all their joints moving, and with fewer, the others at home or at the best fixed values.

    More joints have a coarser grid, so that more freedom alone could end in a worse plan.

    Args:
        groups: operation groups.
        fixed_values: (E,) m or rad, best fixed values of each group.
        home: (E,) m or rad.
    """
    free = np.flatnonzero(np.any([g.moves for g in groups], axis=0))
    must = np.any([g.must for g in groups], axis=0)
    out = [list(groups)]
    for n in range(len(free) - 1, 0, -1):
        for subset in itertools.combinations(free, n):
            is_fixed = np.isin(np.arange(len(home)), free) & ~np.isin(np.arange(len(home)), subset)
            if (is_fixed & must).any():
                continue
            at_home, as_best = [g.snapped(home) for g in groups], list(fixed_values)
            same = all(np.array_equal(a[is_fixed], b[is_fixed]) for a, b in zip(at_home, as_best, strict=True))
            for values in [at_home] if same else [at_home, as_best]:
                out.append(
                    [_lock_resting_joints(g, is_fixed & g.moving, v) for g, v in zip(groups, values, strict=True)]
                )
    return out


def list_partly_fixed_groups(groups: Sequence[OperationGroup]) -> list[list[OperationGroup]]:
    """Return the groups with some of their joints moving, and one value, still to be found, for each of the others.

    Args:
        groups: operation groups.
    """
    free = np.flatnonzero(np.any([g.moves for g in groups], axis=0))
    must = np.any([g.must for g in groups], axis=0)
    out = []
    for n in range(len(free) - 1, 0, -1):
        for subset in itertools.combinations(free, n):
            is_fixed = np.isin(np.arange(len(must)), free) & ~np.isin(np.arange(len(must)), subset)
            if not (is_fixed & must).any():
                out.append([replace(g, moving=g.moving & ~is_fixed) for g in groups])
    return out


def _lock_resting_joints(group: OperationGroup, rests: Bools, value: Array) -> OperationGroup:
    """The group with some joints locked at a value."""
    low, high = (np.where(rests, value, bound) for bound in (group.low, group.high))
    least, most = (np.where(rests, value, bound) for bound in (group.least, group.most))
    allowed = tuple(
        ((float(v), float(v)),) if rest else own for rest, v, own in zip(rests, value, group.allowed, strict=True)
    )
    return replace(group, moving=group.moving & ~rests, low=low, high=high, least=least, most=most, allowed=allowed)


def compute_moving_axis_path(
    search: AxisCurveSearch,
    path: PlanningPath,
    groups: Sequence[OperationGroup],
    axes: Sequence[ExternalJointOptions],
    fixed_values: Sequence[Array],
    is_coarse: bool = False,
) -> Array:
    """Return the (P, E) external joints in m or rad: curves where they may move, else the values of their group.

    Args:
        search: setup and settings of the search.
        path: planning points.
        groups: operation groups.
        axes: options of each external joint.
        fixed_values: (E,) m or rad, fixed values of each group.
        is_coarse: search on the first grid of values only.
    """
    fixed_values = [g.snapped(value) for g, value in zip(groups, fixed_values, strict=True)]
    out = np.empty((len(path.index), len(axes)))
    for g, value in zip(groups, fixed_values, strict=True):
        out[list_run_points(path, g.runs)] = value
    weight = np.array([axis.weight for axis in axes])
    for g, value in zip(groups, fixed_values, strict=True):
        if g.moves.any():
            rows = list_run_points(path, g.runs)
            sides = [_narrow_to_wish(g, wish, float(value[wish.joint])) for wish in g.position_wishes]
            low, high = _narrow_ranges(g, sides)
            home = g.snapped(search.setup.cell.external_home)
            bounds = tuple(
                _bound(rows, wish, side)
                for wish, side in zip(g.position_wishes, sides, strict=True)
                if g.moving[wish.joint]
            )
            group = GroupAxisRange(
                runs=g.runs,
                moving=g.moving,
                fixed=value,
                home=home,
                low=low,
                high=high,
                share=g.share,
                bounds=bounds,
                allowed=g.allowed,
            )
            out[rows] = compute_axis_curve(search, path, group, weight, 0 if is_coarse else FINER)
    return out


def _narrow_to_wish(group: OperationGroup, wish: AxisPositionWish, at: float) -> Interval:
    """Return the interval a wish leaves to a moving joint; of a zone the side that contains the best fixed value."""
    whole = (float(group.least[wish.joint]), float(group.most[wish.joint]))
    return min(wish.allowed((whole,)), key=lambda side: abs(find_nearest_allowed((side,), at) - at))


def _narrow_ranges(group: OperationGroup, sides: Sequence[Interval]) -> tuple[Array, Array]:
    """Return (E,) each: the range of the moving joints, reduced by ROOM at its ends where no wish needs values
    there.
    """
    low, high = group.low.copy(), group.high.copy()
    room = ROOM * (group.most - group.least)
    for k in np.flatnonzero(group.moving):
        own = [side for wish, side in zip(group.position_wishes, sides, strict=True) if wish.joint == k]
        low[k] = min([group.least[k] + room[k], *(b for _, b in own)])
        high[k] = max([group.most[k] - room[k], *(a for a, _ in own)])
    return low, high


def _bound(rows: NDArray[np.intp], wish: AxisPositionWish, side: Interval) -> AxisBound:
    own = np.flatnonzero((rows >= wish.rows[0]) & (rows <= wish.rows[1]))
    return AxisBound(wish.joint, (int(own[0]), int(own[-1])), *side)
