"""Batched kinematics of an arm with prismatic joints; not used for planning."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from machopt.kinematics import product_of_exponentials
from machopt.numerics.array_types import Array
from machopt.numerics.rigid_transforms import build_transform

Slides = NDArray[np.bool_]


def compute_link_motions_with_slides(slides: Slides, axis: Array, point: Array, rows: Array) -> tuple[Array, Array]:
    """Return R (M, n + 1, 3, 3) and p (M, n + 1, 3) m of the links, as
    :func:`machopt.kinematics.product_of_exponentials.compute_link_motions` defines them.

    Args:
        slides: (n,) prismatic joints.
        axis: (n, 3) unit, the lines in base_link at q = 0.
        point: (n, 3) m, a point of each.
        rows: (M, n) rad, or m for prismatic joints.
    """
    links = len(axis) + 1
    R, p = np.empty((len(rows), links, 3, 3)), np.empty((len(rows), links, 3))
    product_of_exponentials.compute_chain_motions(axis, point, np.array(slides), rows, R, p)
    return R, p


def compute_jacobians_with_slides(
    slides: Slides, axis: Array, point: Array, zero: Array, rows: Array
) -> tuple[Array, Array]:
    """Return the poses T (M, 4, 4) of a frame and the Jacobians J (M, 6, n), with no angular part for prismatic joints.

    Args:
        slides: (n,) prismatic joints.
        axis: (n, 3) unit, the lines in base_link at q = 0.
        point: (n, 3) m, a point of each.
        zero: (4, 4) the frame at q = 0.
        rows: (M, n) rad, or m for prismatic joints.
    """
    R, p = compute_link_motions_with_slides(slides, axis, point, rows)
    T = build_transform(R[:, -1], p[:, -1]) @ zero
    z = np.einsum("mkij,kj->mki", R[:, :-1], axis)
    lever = T[:, None, :3, 3] - np.einsum("mkij,kj->mki", R[:, :-1], point) - p[:, :-1]
    along = np.asarray(slides)[:, None]
    J = np.concatenate([np.where(along, z, np.cross(z, lever)), np.where(along, 0.0, z)], axis=2)
    return T, np.swapaxes(J, 1, 2)
