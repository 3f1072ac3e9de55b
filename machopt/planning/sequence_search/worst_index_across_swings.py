"""Rotations crossed between two stations that have further planning points between them.

The search knows the index at stations only. A change of rotation from one to the next passes through all rotations in
between, each with at least the lesser index of the two stations, as far as they can tell. A swing across a rotation
that both stations exclude is therefore forbidden, and one that both rate soft counts in the worst index.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from machopt.numerics.array_types import Array, Bools
from machopt.planning.stations.planning_path import PlanningPath


def find_hidden_points(path: PlanningPath) -> Bools:
    """Return (S,) True where planning points lie between a station and the previous one, in one run.

    Args:
        path: planning points.
    """
    st = path.stations
    return np.asarray((np.diff(st, prepend=st[:1]) > 1) & (np.diff(path.run[st], prepend=-1) == 0))


def compute_worst_index(
    raw: Array, counted: Bools, hidden: Bools, rotation: NDArray[np.int32], branch: NDArray[np.int32]
) -> float:
    """Return the worst index of a sequence, at its stations and across its swings between them.

    Args:
        raw: (S, R, B) index, inf where there is none.
        counted: (S,) the worst index counts there.
        hidden: (S,) of :func:`find_hidden_points`.
        rotation: (S,) of the sequence, −1 where there is none.
        branch: (S,) likewise.
    """
    there = rotation >= 0
    at = np.flatnonzero(there & counted)
    worst = float(raw[at, rotation[at], branch[at]].max(initial=0.0))
    R = raw.shape[1]
    turn = (rotation[1:] - rotation[:-1] + R // 2) % R - R // 2
    both = there[1:] & there[:-1] & counted[1:] & counted[:-1] & (branch[1:] == branch[:-1])
    for s in np.flatnonzero(hidden[1:] & both & (np.abs(turn) > 1)).tolist():
        across = rotation[s] + np.sign(turn[s]) * np.arange(1, abs(turn[s]))
        b = branch[s]
        worst = max(worst, float(np.minimum(raw[s, across % R, b], raw[s + 1, across % R, b]).max()))
    return worst
