"""Conversion of controller axis angles to URDF joint positions: the inverse of the writer, in plain numbers."""

from __future__ import annotations

import numpy as np

from machopt.numerics.array_types import Array


def compute_urdf_joints(axes_deg: Array, sign: Array, offset_deg: Array, coupling: Array) -> Array:
    """q = radians(sign · (C⁻¹ a − offset)), C = 1 + coupling; exact because coupling is strictly triangular.

    Args:
        axes_deg: (..., 6) as the controller counts them.
        sign: (6,) ±1.
        offset_deg: (6,) of the controller at q = 0.
        coupling: (6, 6), row: the axis that gains.

    Returns:
        (..., 6) rad.
    """
    own = np.linalg.solve(np.eye(6) + coupling, np.asarray(axes_deg, float)[..., None])[..., 0]
    return np.asarray(np.radians((own - offset_deg) * sign))
