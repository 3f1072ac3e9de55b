"""Smooth curves of external axes through the step functions of a search.

Waves shorter than a share of the run are damped (Whittaker 1923). Runs that are too short keep one value.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from machopt.numerics.array_types import Array, Bools
from machopt.planning.external_axes.position_constraints import AxisBound, Interval
from machopt.planning.stations.planning_path import PlanningPath

WAVE = 1.0 / 6.0  # share of a run: shorter waves of the step function are removed by smoothing
SHORTEST = 0.2, 2.0  # m and s: minimum wave length
SAMPLE = 0.01  # m, of the grid a run is smoothed on
SAMPLES = 400  # at most


@dataclass(frozen=True, kw_only=True)
class GroupAxisRange:
    """Permitted motion of the external joints of one group of operations."""

    runs: tuple[int, ...]
    moving: Bools  # (E,)
    fixed: Array  # (E,) m or rad, values of the best fixed plan
    home: Array  # (E,)
    low: Array  # (E,) range; equal to ``high`` where a joint is locked
    high: Array  # (E,)
    share: float  # of the length cut
    bounds: tuple[AxisBound, ...] = ()  # user requests about the moving joints
    allowed: tuple[tuple[Interval, ...], ...] = ()  # (E,) of those that keep one value; empty: the full range


def smooth_step_curve(part: PlanningPath, stairs: Array, group: GroupAxisRange, wave: float) -> Array:
    """Return a smooth curve for each run through a step function at its stations.

    Args:
        part: Path with its stations and runs.
        stairs: (S, E) values at the stations, rad or m.
        group: Ranges of the axes.
        wave: Shortest wave as a share of a run's length.

    Returns:
        (n, E) values at the points of the path, within the ranges.
    """
    from scipy.interpolate import CubicSpline

    out = np.empty((len(part.index), stairs.shape[1]))
    for first, last in part.runs:
        own = np.flatnonzero((part.stations >= first) & (part.stations <= last))
        s, steps = part.s[part.stations[own]] - part.s[first], stairs[own]
        rows = slice(first, last + 1)
        length, shortest = float(part.s[last] - part.s[first]), _compute_min_wave_length(part, (first, last))
        if _has_constant_value(part, (first, last)):
            out[rows] = np.median(steps, axis=0)
            continue
        n = int(np.clip(length / SAMPLE, 16, SAMPLES))
        at = np.linspace(0.0, length, n)
        keep = np.r_[True, np.diff(s) > 1e-9]
        raw = np.column_stack([np.interp(at, s[keep], column[keep]) for column in steps.T])
        curve = _smooth_whittaker(raw, max(wave * length, shortest) / (at[1] - at[0]))
        middle, room = curve.mean(axis=0), np.ones(len(curve.T))
        for k in range(len(room)):  # not beyond the range, and as smooth as before
            middle[k] = np.clip(middle[k], group.low[k], group.high[k])
            over, under = curve[:, k].max() - middle[k], middle[k] - curve[:, k].min()
            room[k] = min(
                1.0,
                (group.high[k] - middle[k]) / over if over > 0 else 1.0,
                (middle[k] - group.low[k]) / under if under > 0 else 1.0,
            )
        curve = middle + room * (curve - middle)
        out[rows] = np.clip(CubicSpline(at, curve)(part.s[rows] - part.s[first]), group.low, group.high)
    return out


def _compute_min_wave_length(part: PlanningPath, run: tuple[int, int]) -> float:
    """Return the shortest path length in m over which an external joint may move, in a run."""
    first, last = run
    length, seconds = float(part.s[last] - part.s[first]), float(part.time[last] - part.time[first])
    return max(SHORTEST[0], SHORTEST[1] * length / max(seconds, 1e-9))


def _has_constant_value(part: PlanningPath, run: tuple[int, int]) -> bool:
    """Return whether external joints keep one value in a run: point operations, or too short for a curve."""
    first, last = run
    stations = int(((part.stations >= first) & (part.stations <= last)).sum())
    length = float(part.s[last] - part.s[first])
    return (
        bool(part.is_drilling[first : last + 1].any()) or length < _compute_min_wave_length(part, run) or stations < 3
    )


def compute_narrowing_length(part: PlanningPath, run: tuple[int, int]) -> float:
    """Compute the path length over which the range narrows towards a wish.

    Args:
        part: Path with its stations and runs.
        run: First and last point of the run.

    Returns:
        Length in m; infinite in a run that keeps one value.
    """
    if _has_constant_value(part, run):
        return np.inf
    return max(WAVE * float(part.s[run[1]] - part.s[run[0]]), _compute_min_wave_length(part, run))


def _smooth_whittaker(values: Array, wave: float) -> Array:
    """Return the columns (n, E) smoothed; a wave of the given number of samples is damped to half."""
    from scipy.linalg import solveh_banded

    n = len(values)
    stiff = (2.0 * np.sin(np.pi / max(wave, 2.0))) ** -6.0
    third = np.array([-1.0, 3.0, -3.0, 1.0])
    upper = np.zeros((4, n))  # of 1 + stiff · DᵀD, D the third differences: row 3 − k is the k-th diagonal above
    upper[3] = 1.0
    for a in range(4):
        for b in range(a, 4):
            upper[3 - (b - a), b : n - 3 + b] += stiff * third[a] * third[b]
    return np.asarray(solveh_banded(upper, values))
