"""Tilt of the tool axis against the axis of the CAM file, by lead and side angle.

With a the CAM axis (tip to shank) and t the direction of travel normal to a, the tilted axis is

    a' = normalised(a + tan(lead) t + tan(side) (a × t)).

A ball cutter of radius r turns about its centre, so its tip is at p + r (a − a').
"""

from __future__ import annotations

import numpy as np

from machopt.numerics.array_types import Array
from machopt.numerics.rigid_transforms import normalise_vectors


def compute_tilted_axis(axis: Array, travel: Array, lead: Array, side: Array) -> Array:
    """Return the tilted tool axis a', (..., 3) unit.

    Args:
        axis: (..., 3) unit CAM axis, tip to shank.
        travel: (..., 3) unit direction of travel, normal to the axis.
        lead: (...) rad.
        side: (...) rad.
    """
    u, v = np.tan(lead)[..., None], np.tan(side)[..., None]
    return np.asarray(normalise_vectors(axis + u * travel + v * np.cross(axis, travel)))


def measure_lead_and_side(axis: Array, travel: Array, tilted: Array) -> tuple[Array, Array]:
    """Return lead and side angle (...) in rad of a tilted axis, the inverse of :func:`compute_tilted_axis`.

    Args:
        axis: (..., 3) unit CAM axis, tip to shank.
        travel: (..., 3) unit direction of travel, normal to the axis.
        tilted: (..., 3) unit, less than 90 degrees from the axis.
    """
    along = np.sum(tilted * axis, axis=-1)
    lead = np.arctan2(np.sum(tilted * travel, axis=-1), along)
    side = np.arctan2(np.sum(tilted * np.cross(axis, travel), axis=-1), along)
    return lead, side


def compute_tilted_tip(tip: Array, axis: Array, tilted: Array, radius: float) -> Array:
    """Return the tip of a tilted ball cutter, (..., 3) m.

    Args:
        tip: (..., 3) m, tip of the CAM file.
        axis: (..., 3) unit CAM axis, tip to shank.
        tilted: (..., 3) unit tilted axis.
        radius: m, of the ball.
    """
    return np.asarray(tip + radius * (axis - tilted))


def rotate_with_axis(v: Array, axis: Array, tilted: Array) -> Array:
    """Return vectors turned by the smallest rotation that takes one axis to another, (..., 3).

    Args:
        v: (..., 3).
        axis: (..., 3) unit, before.
        tilted: (..., 3) unit, after; not opposite.
    """
    w = np.cross(axis, tilted)
    c = np.sum(axis * tilted, axis=-1, keepdims=True)
    turned = np.cross(w, v)
    return np.asarray(v + turned + np.cross(w, turned) / (1.0 + c))
