"""Whole turns of the arm's joints along a sequence that knows its poses only up to these."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from machopt.numerics.array_types import Array

BEYOND, AS_NEAR = 1e3, 1e-6  # price of a rad beyond a limit, and away from the plan, beside one between runs
TURNS = 2.0  # to either side of what is nearest


def compute_run_turns(q: Array, runs: Sequence[NDArray[np.intp]], lower: Array, upper: Array, near: Array) -> Array:
    """(S, 6) whole turns that each run of some joints (S, 6) rad is to be away, within the limits if that can be.

    Of what the limits leave, the least way between runs; of several such the nearest to ``near`` (S, 6) rad.
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
