"""Normal equations of the base and of every law at every shape, summed up once: what any set of them leaves is small
linear algebra from there on, however many the readings are.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from machopt.arrays import Array
from machopt.diagnose import calibrated
from machopt.diagnose.evidence.grams import NOTHING, Model, Tried, ridged_inverse

MOST_SHAPES = 8  # of a law that is no wave
FOLDS = 10


@dataclass(frozen=True)
class Group:
    """One law at one shape."""

    law: Tried
    shape: int
    columns: slice  # of all


@dataclass(frozen=True)
class Sums:
    """Normal equations of the base's columns, all groups' columns, and y, in this order."""

    total: Array  # (C + 1, C + 1)
    folds: tuple[Array, ...]
    groups: tuple[Group, ...]
    base: int  # columns of it
    rows: int


def summed(model: Model, laws: Sequence[Tried], first: Sequence[Tried] = ()) -> Sums:
    """Of a base and laws; of many shapes of a law that is no wave, some.

    Args:
        model: the base.
        laws: where some are sums of waves, other waves of the same effect and place are left out.
        first: laws of one shape each that are the first groups in any case, in this order.
    """
    groups, at = [], model.X.shape[1]
    waves = {t.hypothesis.name for t in laws if t.hypothesis.summed}
    for t in [*first, *laws]:
        kept = any(t is f for f in first)
        if not kept and t.hypothesis.name in waves and not t.hypothesis.summed:
            continue  # an order and its double: the pursuit takes them one by one
        p, count = t.X.shape[2], len(t.shapes)
        most = count if t.hypothesis.summed else min(count, MOST_SHAPES)
        for s in np.linspace(0, count - 1, most).astype(int).tolist():
            groups.append(Group(t, s, slice(at, at + p)))
            at += p
    total, parts = np.zeros((at + 1, at + 1)), []
    for some in np.array_split(np.arange(model.folds), min(FOLDS, model.folds)):
        rows = np.concatenate([model.rows[f] for f in some])
        A = np.concatenate([model.X[rows], *(g.law.at(g.shape)[rows] for g in groups), model.y[rows, None]], axis=1)
        parts.append(A.T @ A)
        total += parts[-1]
    k = np.arange(model.X.shape[1])
    total[k, k] += model.prior
    for g in groups:
        n = np.arange(g.columns.start, g.columns.stop)
        total[n, n] += g.law.precision(g.shape)
    return Sums(total, tuple(parts), tuple(groups), len(k), len(model.y))


def swept(sums: Array, columns: Array) -> Array:
    """What is left of normal equations once columns are fitted."""
    C = sums[columns]
    return np.asarray(sums - C.T @ ridged_inverse(C[:, columns]) @ C)


def gains(left: Array, sums: Sums) -> Array:
    """Sum of squares that each group takes beside what was fitted; directions that nothing is left of take none."""
    out = np.zeros(len(sums.groups))
    size = np.sqrt(np.maximum(np.diag(sums.total), NOTHING))
    width = np.array([g.columns.stop - g.columns.start for g in sums.groups])
    for p in np.unique(width).tolist():
        which = np.flatnonzero(width == p)
        at = np.array([np.arange(sums.groups[n].columns.start, sums.groups[n].columns.stop) for n in which])
        S = left[at[:, :, None], at[:, None, :]] / (size[at][:, :, None] * size[at][:, None, :])
        value, V = np.linalg.eigh(S)
        w = np.einsum("kij,ki->kj", V, left[at, -1] / size[at])
        seen = value > calibrated.RESTING.visible
        out[which] = np.sum(np.where(seen, w**2 / np.where(seen, value, 1.0), 0.0), axis=1)
    return out
