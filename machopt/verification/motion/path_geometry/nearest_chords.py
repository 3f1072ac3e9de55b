"""Chord between two samples of a motion that passes each corner of the commanded path best (compiled)."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from machopt.numerics.array_types import Array
from machopt.numerics.compiled_functions import jit_compile

MAX_ROWS = 1000  # samples on either side that are searched: the motion may stand there


@jit_compile
def find_nearest_chords(
    tcp: Array, T: Array, before: NDArray[np.intp], lever: float, reach: float, gain: float
) -> NDArray[np.intp]:
    """Return (C,) the sample before the chord that passes each corner best, its own where no other is nearer.

    A corner that its own chord misses by more than ``reach`` was not rounded but lies between two samples: it stays.

    Args:
        tcp: (S, 3, 4) poses at the samples.
        T: (C, 4, 4) poses at the corners.
        before: (C,) sample before the chord whose samples state the corner.
        lever: m/rad, by which an angle of the tool axis counts as a distance.
        reach: m along the motion between its own chord and another one that is tried.
        gain: m by which another chord must be nearer than its own.
    """
    out = before.copy()
    for c in range(len(before)):
        own = best = _compute_chord_distance(tcp, T[c], before[c], lever)
        if own > reach:
            continue
        for step in (1, -1):
            way = 0.0
            for n in range(1, MAX_ROWS):
                k = before[c] + step * n
                if k < 0 or k > len(tcp) - 2:
                    break
                passed = k if step > 0 else k + 1
                length = 0.0
                for i in range(3):
                    length += (tcp[passed, i, 3] - tcp[passed - step, i, 3]) ** 2
                way += np.sqrt(length) if n > 1 else 0.0
                if way > reach:
                    break
                away = _compute_chord_distance(tcp, T[c], k, lever)
                if away < best and away < own - gain:
                    best, out[c] = away, k
    return out


@jit_compile
def _compute_chord_distance(tcp: Array, corner: Array, k: int, lever: float) -> float:
    """Return the distance in m of a pose (4, 4) from the chord between samples k and k + 1, the tool axis counted."""
    length, along = 0.0, 0.0
    for i in range(3):
        for j, weight in ((3, 1.0), (2, lever * lever)):
            step = tcp[k + 1, i, j] - tcp[k, i, j]
            length += weight * step * step
            along += weight * step * (corner[i, j] - tcp[k, i, j])
    share = min(max(along / length, 0.0), 1.0) if length > 1e-24 else 0.0
    away = 0.0
    for i in range(3):
        for j, weight in ((3, 1.0), (2, lever * lever)):
            foot = tcp[k, i, j] + share * (tcp[k + 1, i, j] - tcp[k, i, j])
            away += weight * (foot - corner[i, j]) ** 2
    return float(np.sqrt(away))
