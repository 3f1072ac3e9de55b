"""Limit of the change of the tilt between neighbouring planning points.

Between two planning points the tip moves straight and the axis turns evenly. The centre of the ball then leaves its
path by up to r θ²/8, θ the change of the axis. Tangents are moved into the intersection of two convex sets, the ranges
and the steps, by alternating projections (von Neumann); what they leave is removed by scaling the tilts of the run.
"""

from __future__ import annotations

import numpy as np

from machopt.numerics.array_types import Array, Bools
from machopt.numerics.compiled_functions import jit_compile
from machopt.planning.stations.planning_path import PlanningPath
from machopt.planning.tilt.tilt_limits import TiltLimits

BULGE = 1.5e-6  # m, by which the ball's centre may leave its path between two planning points because of the tilt
ROUNDS = 60
SWEEPS = 4  # over all steps in each round
SLACK = 1.001


def limit_steps(path: PlanningPath, limits: TiltLimits, tangent: Array, radius: float) -> Array:
    """Return tangent vectors (P, 3) inside their ranges, whose steps inside cuts are small enough.

    Args:
        path: path of the CAM file.
        limits: permitted tilts.
        tangent: (P, 3) along the cuts.
        radius: m, of the ball.
    """
    most = float(np.sqrt(8.0 * BULGE / radius))
    joined = np.append(False, limits.cuts[0, :-1])  # the move to each point cuts
    out = np.ascontiguousarray(limits.project(tangent))
    for _ in range(ROUNDS):
        if _find_longest(out, joined) <= SLACK * most:
            return out
        _shorten(out, joined, most, SWEEPS)
        out = np.ascontiguousarray(limits.project(out))
    return _scale_runs(path, limits, out, joined, most)


def _find_longest(w: Array, joined: Bools) -> float:
    step = np.linalg.norm(np.diff(w, axis=0), axis=1)
    return float(step[joined[1:]].max(initial=0.0))


def _scale_runs(path: PlanningPath, limits: TiltLimits, w: Array, joined: Bools, most: float) -> Array:
    """Scale the tilts of runs with longer steps towards the least tilt that the ranges permit."""
    flat, out = limits.project(np.zeros_like(w)), w.copy()
    step = np.append(0.0, np.linalg.norm(np.diff(w, axis=0), axis=1)) * joined
    for first, last in path.runs:
        longest = float(step[first : last + 1].max(initial=0.0))
        if longest > SLACK * most:
            rows = slice(first, last + 1)
            out[rows] = flat[rows] + most / longest * (w[rows] - flat[rows])
    return out


@jit_compile
def _shorten(w: Array, joined: Bools, most: float, sweeps: int) -> None:
    """Move both ends of each step that is too long towards each other, forwards and backwards, in place."""
    n = len(w)
    for sweep in range(sweeps):
        for i in range(1, n):
            k = i if sweep % 2 == 0 else n - i
            if not joined[k]:
                continue
            size = 0.0
            for c in range(3):
                size += (w[k, c] - w[k - 1, c]) ** 2
            size = np.sqrt(size)
            if size > most:
                share = 0.5 * (1.0 - most / size)
                for c in range(3):
                    d = share * (w[k, c] - w[k - 1, c])
                    w[k, c] -= d
                    w[k - 1, c] += d
