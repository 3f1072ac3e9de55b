"""A finding none of whose numbers is beyond zero is none, however much it seems to gain."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray
from scipy.special import stdtrit

from machopt.diagnose.grams import Model, Tried, sandwich

Array = NDArray[np.float64]


def unproven(model: Model, laws: Sequence[tuple[Tried, int]]) -> list[int]:
    """Which laws have no coefficient, and no size, whose 95 % interval excludes zero.

    Args:
        model: with the columns of all laws, in their order, after those of the base.
        laws: each with the index of its shape.
    """
    if not laws:
        return []
    x, covariance, freedom = sandwich(model)
    t = float(stdtrit(freedom, 0.975))
    out, at = [], model.X.shape[1] - sum(law.X.shape[2] for law, _ in laws)
    for k, (law, shape) in enumerate(laws):
        p = law.X.shape[2]
        own, V = x[at : at + p], covariance[at : at + p, at : at + p]
        sure = bool((np.abs(own) > t * np.sqrt(np.maximum(np.diag(V), 0.0))).any())
        if not sure and not _size_proven(law, shape, own, V, t):
            out.append(k)
        at += p
    return out


def _size_proven(law: Tried, shape: int, x: Array, V: Array, t: float) -> bool:
    """Whether the effect's size is beyond zero, though its coefficients stand in for each other."""
    h, unit = law.hypothesis, law.unit[shape]

    def size(v: Array) -> float:
        return float(next(iter(h.quantities(v * unit, law.shapes[shape]).values())).value)

    slope = np.zeros(len(x))
    for i in range(len(x)):
        step = np.zeros(len(x))
        step[i] = 1e-3 * max(float(np.sqrt(max(V[i, i], 0.0))), abs(float(x[i])), 1e-12)
        slope[i] = (size(x + step) - size(x - step)) / (2.0 * step[i])
    slope = np.nan_to_num(slope, posinf=0.0, neginf=0.0)
    return abs(size(x)) > t * float(np.sqrt(max(slope @ V @ slope, 0.0))) > 0.0
