"""Fixed rotations of the user: at points, and interpolated between the points of one request."""

from __future__ import annotations

import numpy as np

from machopt.data_types.plan_options import PlanOptions
from machopt.data_types.steering_rules import select_steered_rows
from machopt.numerics.rigid_transforms import wrap_angle
from machopt.planning.stations.planning_path import PlanningPath

SAME_INDEX = 1e-9


def find_fixed_rotations(path: PlanningPath, options: PlanOptions) -> dict[int, float]:
    """Return the fixed phi in rad by planning point.

    γ is relative to the direction of travel, which changes abruptly at a point. Between two points of one request phi
    therefore changes linearly along the path from one value to the other.

    Args:
        path: planning points.
        options: plan options with resolved points.
    """
    out: dict[int, float] = {}
    points = np.array([f.point for f in options.fixed], float)
    first = np.searchsorted(path.index, points - SAME_INDEX)
    last = np.searchsorted(path.index, points + SAME_INDEX)  # a point of a re-entry occurs twice
    for fixed, a, b in zip(options.fixed, first.tolist(), last.tolist(), strict=True):  # none in some parts of a path
        for row in range(a, b):
            out[row] = _angle(fixed.gamma - path.offset[row])
    for wish in options.steer:
        if wish.gamma is None:
            continue
        rows = select_steered_rows(wish, path.index)
        at = rows[path.is_point[rows]]
        for point, b in zip(at[:-1].tolist(), at[1:].tolist(), strict=True):
            a = point + 1 if path.is_reentry[point + 1] else point  # phi of the run that leads to b
            if b - a > 1 and path.s[b] > path.s[a] and a in out and b in out:
                turn = _angle(out[b] - out[a])
                for row in range(a + 1, b):
                    share = float((path.s[row] - path.s[a]) / (path.s[b] - path.s[a]))
                    out[row] = _angle(out[a] + share * turn)
    return dict(sorted(out.items()))


def _angle(value: float) -> float:
    return float(wrap_angle(np.asarray(value, float)))
