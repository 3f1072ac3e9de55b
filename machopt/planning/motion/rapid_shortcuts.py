"""Shortcuts of rapid moves around obstacles: way points left out or cut off where that is free and faster.

Only the way points of detours are touched, which no file asks for. The points of the file, and the straight retracts
and approaches along the tool axis before and after, stay. Each way point in turn is left out, or replaced by two on its
legs; the first change that is free and faster is kept. The order and the number of trials are fixed.
"""

from __future__ import annotations

from collections.abc import Callable

import numpy as np

from machopt.numerics.array_types import Array
from machopt.planning.motion.corner_timing import measure_fastest_time

SHARES = (1.0, 0.7, 0.4)  # of the legs, from the way point, that are cut off; 1: it is left out
ROUNDS = 3  # over all way points
LEAST_GAIN = 0.01  # of the time
STILL = 1e-9  # rad or m


def shorten_detour(waypoints: Array, limits: Array, rounded: bool, is_free: Callable[[Array], bool]) -> Array:
    """Return way points (V, n) of a faster way between the same ends, or the given ones (W, n).

    Args:
        waypoints: (W, n) rad or m, ends included.
        limits: (3, n) speed, acceleration and jerk.
        rounded: whether corners may be rounded; else the machine stops at each.
        is_free: whether the straight legs between way points (V, n) are free.
    """
    best = waypoints
    time = measure_fastest_time(np.diff(best, axis=0), limits, rounded)
    for _ in range(ROUNDS):
        changed = False
        n = 1
        while n < len(best) - 1:
            for share in SHARES:
                if share < 1.0 and not rounded:
                    continue  # one more stop
                trial = _cut_corner(best, n, share)
                if (np.abs(np.diff(trial, axis=0)).max(axis=1) < STILL).any():
                    continue
                taken = measure_fastest_time(np.diff(trial, axis=0), limits, rounded)
                if taken < (1.0 - LEAST_GAIN) * time and is_free(trial):
                    best, time, changed = trial, taken, True
                    break
            n += 1
        if not changed:
            break
    return best


def _cut_corner(waypoints: Array, n: int, share: float) -> Array:
    before, corner, after = waypoints[n - 1 : n + 2]
    new = [] if share == 1.0 else [corner + 0.5 * share * (end - corner) for end in (before, after)]
    return np.vstack([waypoints[:n], *new, waypoints[n + 1 :]])
