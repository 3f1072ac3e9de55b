"""Velocity of the tip when the drill breaks through."""

from __future__ import annotations

import numpy as np

from machopt.numerics.array_types import Array

SURGE_SHARE = 0.3845  # share of the released energy, fitted to 20 holes of one large robot: public set, one arm


def compute_axial_compliance(compliance: Array, axis: Array) -> Array:
    """Return c = nᵀ C n, (P,) m/N.

    Args:
        compliance: (P, 3, 3) m/N, translation of the tip by force.
        axis: (P, 3) unit vector of the tool's axis, same frame.
    """
    return np.asarray(np.einsum("...i,...ij,...j->...", axis, compliance, axis))


def compute_axial_mass(mass_matrix: Array, jacobian: Array, axis: Array) -> Array:
    """Return the effective mass along the axis, 1 / (nᵀ J M⁻¹ Jᵀ n), (P,) kg.

    Args:
        mass_matrix: (P, n, n) kg·m², in joint space.
        jacobian: (P, 3, n) m/rad, translation of the tip.
        axis: (P, 3) unit vector of the tool's axis, same frame.
    """
    lever = np.einsum("...ij,...i->...j", jacobian, axis)
    return np.asarray(1.0 / np.sum(lever * np.linalg.solve(mass_matrix, lever[..., None])[..., 0], axis=-1))


def compute_breakthrough_velocity(
    thrust: Array | float,
    axial_compliance: Array,
    axial_mass: Array,
    feed: Array | float,
    share: float = SURGE_SHARE,
) -> Array:
    """Return the surge of the tip at breakthrough, η √(F² c / m + v²), (P,) m/s.

    It ranks places and directions of holes. Between postures at one hole its published ranking is not significant.

    Args:
        thrust: (P,) or one value, N, before breakthrough.
        axial_compliance: (P,) m/N.
        axial_mass: (P,) kg.
        feed: (P,) or one value, m/s.
        share: η.
    """
    force, v = np.asarray(thrust, float), np.asarray(feed, float)
    return np.asarray(share * np.sqrt(force**2 * axial_compliance / axial_mass + v**2))
