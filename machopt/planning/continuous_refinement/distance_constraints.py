"""How far stations may move before something touches: distances to first order, as bounds of a step.

Where a step of the refinement (:mod:`machopt.planning.continuous_refinement.refinement`) has led into something, a
smaller one along the
same line only creeps up to it. With the distance as one more value that is linear in z, the next one goes beside it.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from machopt.collision.collision_model import CollisionModel
from machopt.numerics.array_types import Array, Bools
from machopt.planning.continuous_refinement.quadratic_model import OffsetBounds

STENCIL = np.radians(0.25)  # of each offset, to either side
FAR = 0.1  # m, beyond which nothing is measured
KEPT = 1e-4  # m, of the room at a station, which the line of the model may be wrong by


def add_distance_constraints(
    bounds: OffsetBounds, model: CollisionModel, x: Array, lean: Array, cutting: Bools, rows: Bools
) -> OffsetBounds:
    """The bounds, and that no station of ``rows`` (n,) comes nearer to anything than it may.

    Args:
        model: whose clearance is kept.
        x: (n, 6 + E) rad or m, where they are.
        lean: (n, 6 + E, d) of these on the offsets.
        cutting: (n,) the cutter may touch the workpiece.
    """
    n, d = bounds.low.shape
    slope, under = np.zeros((n, 1, d)), np.full((n, 1), -np.inf)
    at = np.flatnonzero(rows)
    if not len(at):
        return bounds
    sides = np.concatenate([np.zeros((1, d)), STENCIL * np.eye(d), -STENCIL * np.eye(d)])
    there = x[at, None] + np.einsum("nkd,sd->nsk", lean[at], sides)
    room = _room(model, there.reshape(-1, there.shape[2]), np.repeat(cutting[at], len(sides))).reshape(len(at), -1)
    slope[at, 0] = (room[:, 1 : 1 + d] - room[:, 1 + d :]) / (2.0 * STENCIL)
    under[at, 0] = np.minimum(KEPT - room[:, 0], 0.0)
    return replace(
        bounds,
        lean=np.concatenate([bounds.lean, slope], axis=1),
        under=np.hstack([bounds.under, under]),
        over=np.hstack([bounds.over, np.full((n, 1), np.inf)]),
    )


def _room(model: CollisionModel, x: Array, cutting: Bools) -> Array:
    """(S,) m from the nearest body beyond the clearance."""
    found = model.find_nearest_pair(x, cutting, FAR + model.clearance)
    clearance = np.array([pair.clearance for pair in model.pairs] or [0.0])
    return np.asarray(found.distance - np.where(found.pair >= 0, clearance[found.pair], 0.0))
