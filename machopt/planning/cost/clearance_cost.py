"""Clearance term of the objective (``weights.clearance``): how near the arm comes to other bodies.

A finished plan is measured at some planning points, evenly spread over the cut. The grid search would need the distance
of each configuration, which takes minutes. There it is measured at some stations and rotations, and interpolated
linearly between them within a branch. The search therefore minimises a value close to the reported objective, not equal
to it. Pairs of bodies with a constant distance do not count
(:meth:`machopt.collision.collision_model.CollisionModel.find_nearest_pair`).
"""

from __future__ import annotations

import numpy as np

from machopt.collision.collision_model import CollisionModel
from machopt.data_types.plan_options import PlanOptions
from machopt.numerics.array_types import Array
from machopt.planning.cost.objective import compute_crowding
from machopt.planning.sampling.candidate_grid import CandidateGrid
from machopt.planning.stations.planning_path import PlanningPath

BLOCK = 512  # stations at a time
MEASURED = 5  # number of stations at which configurations are measured
ROTATIONS = 18  # number of their rotations
POINTS = 12  # number of planning points of a plan that are measured


def is_clearance_weighted(model: CollisionModel | None, options: PlanOptions) -> bool:
    """Return whether the objective includes clearance.

    Args:
        model: collision model, or None.
        options: plan options with ``weights.clearance``.
    """
    return model is not None and options.weights.clearance > 0


def compute_path_crowding(
    path: PlanningPath, model: CollisionModel | None, q: Array, options: PlanOptions
) -> Array | None:
    """Return the (P,) crowding at the planning points, NaN where it is not measured; None where it does not count.

    Args:
        path: planning points.
        model: collision model, or None.
        q: (P, 6) rad, joints of the arm.
        options: plan options with the clearance weight and ``clearance_full``.
    """
    if model is None or not is_clearance_weighted(model, options):
        return None
    out = np.full(len(q), np.nan)
    known = np.flatnonzero(np.isfinite(q).all(axis=1) & path.counted)
    known = known[np.unique(np.linspace(0, len(known) - 1, min(len(known), POINTS)).round().astype(int))]
    full = options.clearance_full
    out[known] = compute_crowding(
        model.find_nearest_pair(path.whole(q[known], known), path.may_touch[known], full).distance, full
    )
    return out


def compute_grid_crowding(
    path: PlanningPath, model: CollisionModel | None, c: CandidateGrid, options: PlanOptions
) -> Array | None:
    """Return the (S, R, B) crowding of every configuration, 0 where none is measured near it; None where it does not
    count.

    Args:
        path: planning points.
        model: collision model, or None.
        c: candidate grid of the search.
        options: plan options with the clearance weight and ``clearance_full``.
    """
    if model is None or not is_clearance_weighted(model, options):
        return None
    st, usable = path.stations, c.usable
    S = len(st)
    at = np.unique(np.linspace(0, S - 1, min(S, MEASURED)).round().astype(int))
    found = np.full((len(at), *usable.shape[1:]), np.nan)
    stride = max(usable.shape[1] // ROTATIONS, 1)
    stride = stride if usable.shape[1] % stride == 0 else 1
    wanted = usable[at].transpose(1, 2, 0)
    wanted[np.arange(len(wanted)) % stride > 0] = False
    r, b, n = np.nonzero(wanted)
    distance = model.find_nearest_pair(
        path.whole(c.q[at[n], r, b], st[at[n]]), path.may_touch[st[at[n]]], options.clearance_full
    ).distance
    found[n, r, b] = compute_crowding(distance, options.clearance_full)
    near, far = found[:, ::stride], np.roll(found[:, ::stride], -1, axis=1)
    for k in range(1, stride):
        found[:, k::stride] = _interpolate(near, far, k / stride)
    after = np.minimum(np.searchsorted(at, np.arange(S)), len(at) - 1)
    before = np.maximum(after - 1, 0)
    f = (np.arange(S) - at[before]) / np.maximum(at[after] - at[before], 1)
    out = np.empty(usable.shape)
    for first in range(0, S, BLOCK):
        rows = slice(first, first + BLOCK)
        between = _interpolate(found[before[rows]], found[after[rows]], f[rows, None, None])
        out[rows] = np.nan_to_num(between, copy=False)
    return out


def _interpolate(low: Array, high: Array, f: Array | float) -> Array:
    """Interpolate linearly; where one value is unknown, the other holds."""
    low, high = np.where(np.isnan(low), high, low), np.where(np.isnan(high), low, high)
    return np.asarray(low + f * (high - low))
