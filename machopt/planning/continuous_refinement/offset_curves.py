"""Curves of the offsets of rotation and external joints along a path, in a few coefficients.

A cubic spline along a run where the quantity may move, one value where it may not: the rotation of a hole, external
joints over holes and short runs, and over all of a group for a joint that keeps one value for an operation.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy import sparse

from machopt.numerics.array_types import Array, Bools
from machopt.planning.external_axes.axis_curve_smoothing import SHORTEST
from machopt.planning.external_axes.operation_groups import OperationGroup
from machopt.planning.smoothing.corridor import compute_turning_length
from machopt.planning.smoothing.cubic_curves import build_design_matrix
from machopt.planning.stations.planning_path import PlanningPath

KNOTS = 40  # most spline intervals in a run


@dataclass(frozen=True)
class OffsetCurves:
    """Permitted offsets at the stations and at all points, linear in m coefficients."""

    at_stations: sparse.csr_matrix  # (n·d, m), d = 1 + E: rotation, then external joints as they count
    at_points: sparse.csr_matrix  # (P·d, m) likewise
    shared: Bools  # (m,) several runs have the coefficient

    @classmethod
    def build(cls, path: PlanningPath, groups: Sequence[OperationGroup], is_fixed: Bools | None = None) -> OffsetCurves:
        """Build the curves along a path that contains all runs of the groups.

        Args:
            path: planning points.
            groups: operation groups with the ranges of their external joints.
            is_fixed: (P, 1 + E) where rotation or a moving external joint is fixed: no curve changes these points.
        """
        P, E = len(path.index), path.external.shape[1]
        is_fixed = np.zeros((P, 1 + E), bool) if is_fixed is None else is_fixed
        blocks: list[tuple[NDArray[np.intp], int, Array]] = []  # points, variable, values (points, k)
        for group in groups:
            free = np.flatnonzero(group.high > group.low)
            rows = [np.arange(path.runs[r][0], path.runs[r][1] + 1) for r in group.runs]
            blocks += [
                (np.concatenate(rows), 1 + int(k), np.ones((sum(map(len, rows)), 1)))
                for k in free
                if not group.moving[k]
            ]
            for points in rows:
                turning = compute_turning_length(path, points[0], points[-1])
                turns = _build_spline_basis(turning, _count_intervals(path, points, points[-1] - points[0], 0.0))
                blocks.append((points, 0, _build_zero_basis(turns, is_fixed[points, 0])))
                length = path.s[points] - path.s[points[0]]
                for k in free[group.moving[free]]:
                    ways = _build_spline_basis(length, _count_intervals(path, points, 0, 0.5))
                    blocks.append((points, 1 + int(k), _build_zero_basis(ways, is_fixed[points, 1 + int(k)])))
        values, i, j, shared, column = [], [], [], [], 0
        for points, variable, basis in blocks:
            row, own = np.nonzero(basis)
            values.append(basis[row, own])
            i.append(points[row] * (1 + E) + variable)
            j.append(column + own)
            column += basis.shape[1]
            shared += [len(np.unique(path.run[points])) > 1] * basis.shape[1]
        entries = np.concatenate(values), (np.concatenate(i), np.concatenate(j))
        every = sparse.csr_matrix(entries, shape=(P * (1 + E), column))
        rows = (path.stations[:, None] * (1 + E) + np.arange(1 + E)).ravel()
        return cls(every[rows], every, np.array(shared, bool))


def _count_intervals(path: PlanningPath, points: NDArray[np.intp], most: int, shortest: float) -> int:
    """Return the number of spline intervals of a run, 0 where it keeps one value.

    Args:
        path: planning points.
        points: planning points of the run.
        most: unused upper bound, in points.
        shortest: shortest interval, as a share of the shortest wave of external joints; 0 for rotation.
    """
    stations = int(np.isin(path.stations, points).sum())
    length = float(path.s[points[-1]] - path.s[points[0]])
    if path.is_drilling[points].any() or length <= 0.0 or stations < 3:
        return 0
    count = min(KNOTS, stations // 2)
    if shortest:
        seconds = float(path.time[points[-1]] - path.time[points[0]])
        wave = max(SHORTEST[0], SHORTEST[1] * length / max(seconds, 1e-9))
        if length < wave:
            return 0
        count = min(count, int(length / (shortest * wave)))
    return max(count, 1)


def _build_zero_basis(basis: Array, is_fixed: Bools) -> Array:
    """Return the curves (n, k) that are zero at all of some places (n,)."""
    return np.asarray(basis[:, ~(basis[is_fixed] != 0.0).any(axis=0)])


def _build_spline_basis(along: Array, intervals: int) -> Array:
    """Return (n, k) cubic B-splines at places along a run; one constant where there are no intervals."""
    length = float(along[-1])
    if intervals == 0 or length <= 0.0:
        return np.ones((len(along), 1))
    knots = np.r_[[0.0] * 3, np.linspace(0.0, length, intervals + 1), [length] * 3]
    return np.asarray(build_design_matrix(knots, np.clip(along, 0.0, length)).toarray())
