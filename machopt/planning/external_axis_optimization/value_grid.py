"""Values of external joints for the bound search: a grid over their ranges, and some near the plan.

A row is a position of the joints of one group of operations: absolute values, or offsets from the plan at that
station. The grid has all combinations, and so have the steps to either side of the plan.
"""

from __future__ import annotations

import itertools
from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from machopt.numerics.array_types import Array, Bools
from machopt.planning.external_axes.operation_groups import OperationGroup
from machopt.planning.stations.planning_path import PlanningPath

VALUES = {1: 13, 2: 5, 3: 3}  # of each joint in the grid, by how many are free
NEAR = tuple(np.radians((8.0, 2.0)).tolist())  # equivalent rad from the plan's own values


@dataclass(frozen=True)
class GroupValueGrid:
    """Possible positions of the external joints of one group of operations; all groups of a grid have as many rows."""

    value: Array  # (G, E) m or rad, NaN where the value of the path is used
    offset: Array  # (G, E) m or rad, added to that
    held: NDArray[np.int64]  # (G,) number of the position of the joints that keep one value
    exists: Bools  # (G,) False: padding

    def padded(self, count: int) -> GroupValueGrid:
        """Return the grid with additional rows that do not exist.

        Args:
            count: number of rows of the result.
        """
        more = count - len(self.value)
        value = np.vstack([self.value, np.full((more, self.value.shape[1]), np.nan)])
        offset = np.vstack([self.offset, np.zeros((more, self.value.shape[1]))])
        return GroupValueGrid(
            value, offset, np.r_[self.held, np.zeros(more, np.int64)], np.r_[self.exists, np.zeros(more, bool)]
        )


def find_largest_steps(grids: Sequence[GroupValueGrid]) -> Array:
    """Return (E,) m or rad, the largest distance of neighbouring values of each joint; 0 where it has one value.

    Args:
        grids: grids of all groups.
    """
    out = np.zeros(grids[0].value.shape[1])
    for grid in grids:
        for k in range(len(out)):
            column = grid.value[grid.exists, k]
            values = np.unique(column[np.isfinite(column)])
            out[k] = max(out[k], float(np.diff(values).max(initial=0.0)))
    return out


def build_group_value_grid(
    group: OperationGroup,
    path: PlanningPath,
    per: Array | None = None,
    counts: Mapping[int, int] = VALUES,
) -> GroupValueGrid:
    """Return a grid over the ranges of the group's joints, values near the plan's, and the plan's own last.

    Args:
        group: group of operations.
        path: planning points with the external joints of the plan.
        per: (E,) equivalent rad of a rad or m of each; None: no values near the plan.
        counts: of each joint in the grid, by how many are free.
    """
    own = path.external[path.runs[group.runs[0]][0]]
    free = np.flatnonzero(group.high > group.low)
    count = counts.get(len(free), 2)
    of_each = []
    for a, b, moves, at in zip(group.low, group.high, group.moving, own, strict=True):
        grid = np.linspace(a, b, count if b > a else 1)
        of_each.append(grid if moves else np.unique(np.r_[grid, at]))
    rows = [np.array(list(itertools.product(*of_each)))]
    offsets = [np.zeros_like(rows[0])]
    if per is not None:
        for step in NEAR:
            signs = np.array([sign for sign in itertools.product((-1.0, 0.0, 1.0), repeat=len(free)) if any(sign)])
            away = np.zeros((len(signs), len(own)))
            away[:, free] = signs * step / per[free]
            rows.append(np.where(group.moving, np.nan, np.clip(own + away, group.low, group.high)))
            offsets.append(np.where(group.moving, away, 0.0))
    value = np.vstack([*rows, own])
    keeps = np.zeros(len(own), bool)
    keeps[free] = ~group.moving[free]
    _, position_number = np.unique(value[:, keeps], axis=0, return_inverse=True)
    value[-1] = np.nan
    return GroupValueGrid(
        value,
        np.vstack([*offsets, np.zeros(len(own))]),
        np.asarray(position_number, np.int64).reshape(-1),
        np.ones(len(value), bool),
    )
