"""First-order distance constraints: how far stations may move before bodies touch, as bounds of a step.

If a step of the refinement (:mod:`machopt.planning.continuous_refinement.refinement`) has led to a contact, a
smaller one along the same line only approaches the contact. With the distance as one more value linear in z, the next
step passes it.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from machopt.collision.collision_model import CollisionModel
from machopt.numerics.array_types import Array, Bools
from machopt.planning.continuous_refinement.quadratic_model import OffsetBounds

STENCIL = np.radians(0.25)  # of each offset, to either side
FAR = 0.1  # m, greatest distance that is measured
KEPT = 1e-4  # m, reserve of the distance at a station for the error of the linear model


def add_distance_constraints(
    bounds: OffsetBounds, model: CollisionModel, x: Array, lean: Array, cutting: Bools, rows: Bools
) -> OffsetBounds:
    """Return the bounds with the constraint that no station of ``rows`` comes nearer to a body than its clearance.

    Args:
        bounds: bounds of the offsets at n stations.
        model: collision model whose clearance is kept.
        x: (n, 6 + E) rad or m, joints at the stations.
        lean: (n, 6 + E, d) derivative of the joints with respect to the offsets.
        cutting: (n,) the cutter may touch the workpiece.
        rows: (n,) stations that get the constraint.
    """
    n, d = bounds.low.shape
    slope, lower = np.zeros((n, 1, d)), np.full((n, 1), -np.inf)
    at = np.flatnonzero(rows)
    if not len(at):
        return bounds
    sides = np.concatenate([np.zeros((1, d)), STENCIL * np.eye(d), -STENCIL * np.eye(d)])
    neighbours = x[at, None] + np.einsum("nkd,sd->nsk", lean[at], sides)
    distance = _compute_distance_margin(
        model, neighbours.reshape(-1, neighbours.shape[2]), np.repeat(cutting[at], len(sides))
    ).reshape(len(at), -1)
    slope[at, 0] = (distance[:, 1 : 1 + d] - distance[:, 1 + d :]) / (2.0 * STENCIL)
    lower[at, 0] = np.minimum(KEPT - distance[:, 0], 0.0)
    return replace(
        bounds,
        lean=np.concatenate([bounds.lean, slope], axis=1),
        under=np.hstack([bounds.under, lower]),
        over=np.hstack([bounds.over, np.full((n, 1), np.inf)]),
    )


def _compute_distance_margin(model: CollisionModel, x: Array, cutting: Bools) -> Array:
    """Return the (S,) distance in m to the nearest body beyond the clearance."""
    found = model.find_nearest_pair(x, cutting, FAR + model.clearance)
    clearance = np.array([pair.clearance for pair in model.pairs] or [0.0])
    return np.asarray(found.distance - np.where(found.pair >= 0, clearance[found.pair], 0.0))
