"""Whole turns of the arm's joints along a sequence whose poses are known only up to whole turns."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from machopt.numerics.array_types import Array

BEYOND, AS_NEAR = 1e3, 1e-6  # price per rad beyond a limit, and away from the plan; 1 per rad between runs
TURNS = 2.0  # turns to either side of the nearest one


def compute_run_turns(q: Array, runs: Sequence[NDArray[np.intp]], lower: Array, upper: Array, near: Array) -> Array:
    """Return the (S, 6) whole turns by which each run is to be shifted, within the limits where possible.

    Among the permitted turns, the travel between runs is minimal; among several such, the nearest to ``near``.

    Args:
        q: (S, 6) rad, joints of the sequence.
        runs: rows of each run.
        lower: (6,) rad, lower limits.
        upper: (6,) rad, upper limits.
        near: (S, 6) rad, joints of the plan.
    """
    whole, out = 2.0 * np.pi, np.zeros_like(q)
    first = np.stack([np.round((near - q)[rows].mean(axis=0) / whole) for rows in runs])  # (runs, 6)
    turns = first[..., None] + np.arange(-TURNS, TURNS + 1.0)  # (runs, 6, turns)
    cost, came = np.zeros(turns.shape), np.zeros(turns.shape, int)
    for n, rows in enumerate(runs):
        low, high = (np.expand_dims(end, 1) + whole * turns[n] for end in (q[rows].min(axis=0), q[rows].max(axis=0)))
        over = np.maximum(np.maximum(lower[:, None] - low, high - upper[:, None]), 0.0)
        away = np.abs((q - near)[rows].mean(axis=0)[:, None] + whole * turns[n])
        cost[n] = BEYOND * over + AS_NEAR * away
        if n:
            gap = (q[rows[0]] - q[runs[n - 1][-1]])[:, None, None] + whole * (
                turns[n][:, None] - turns[n - 1][..., None]
            )
            total = cost[n - 1][..., None] + np.abs(gap)  # (6, before, now)
            came[n] = total.argmin(axis=1)
            cost[n] += total.min(axis=1)
    at, joints = cost[-1].argmin(axis=1), np.arange(q.shape[1])
    for n in range(len(runs) - 1, -1, -1):
        out[runs[n]] = turns[n, joints, at]
        at = came[n, joints, at]
    return out
