"""How near the arm comes to anything, as the objective counts it (``weights.clearance``).

A finished plan is measured at every planning point. The search over the grid would need that of each configuration,
which takes minutes: there it is measured at some stations, and taken on the line between them along a rotation and
branch. What the choice trades is therefore close to the told objective, not equal to it.
"""

from __future__ import annotations

import numpy as np

from machopt.arrays import Array
from machopt.domain.options import PlanOptions
from machopt.model.collision import CollisionModel
from machopt.plan.configurations.candidates import Candidates
from machopt.plan.cost.objective import crowding
from machopt.plan.stations.path import Path

MEASURED = 32  # stations at which every configuration is measured


def wanted(model: CollisionModel | None, options: PlanOptions) -> bool:
    """The objective counts clearance."""
    return model is not None and options.weights.clearance > 0


def along(path: Path, model: CollisionModel | None, q: Array, options: PlanOptions) -> Array | None:
    """(P,) crowding of q (P, 6) rad at the planning points, NaN where there is none; None: it does not count."""
    if model is None or not wanted(model, options):
        return None
    out = np.full(len(q), np.nan)
    known = np.flatnonzero(np.isfinite(q).all(axis=1))
    full = options.clearance_full
    out[known] = crowding(model.nearest(path.whole(q[known], known), path.may_touch[known], full).distance, full)
    return out


def over_grid(path: Path, model: CollisionModel | None, c: Candidates, options: PlanOptions) -> Array | None:
    """(S, R, B) crowding of every configuration, 0 where nothing near it along the path is known; None: not counted."""
    if model is None or not wanted(model, options):
        return None
    st, usable = path.stations, c.usable
    S = len(st)
    at = np.unique(np.linspace(0, S - 1, min(S, MEASURED)).round().astype(int))
    found = np.full((len(at), *usable.shape[1:]), np.nan)
    r, b, n = np.nonzero(usable[at].transpose(1, 2, 0))
    distance = model.nearest(
        path.whole(c.q[at[n], r, b], st[at[n]]), path.may_touch[st[at[n]]], options.clearance_full
    ).distance
    found[n, r, b] = crowding(distance, options.clearance_full)
    after = np.minimum(np.searchsorted(at, np.arange(S)), len(at) - 1)
    before = np.maximum(after - 1, 0)
    f = (np.arange(S) - at[before]) / np.maximum(at[after] - at[before], 1)
    low, high = found[before], found[after]
    low, high = np.where(np.isnan(low), high, low), np.where(np.isnan(high), low, high)
    out = low + f[:, None, None] * (high - low)
    return np.asarray(np.nan_to_num(out))
