"""Waves over a joint's angle, as springs that change with it and gears that run ahead and behind both have them."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from machopt.arrays import Array

ARCSEC = np.pi / 648000.0  # rad


def waves(angle: Array, orders: Sequence[float] | Array, derivative: int = 0) -> Array:
    """(..., 2n) cos and sin of each order per turn, at angles (...,) rad; or a derivative by the angle."""
    later = derivative * 0.5 * np.pi  # d/dx of cos is cos a quarter turn later
    return np.stack([n**derivative * f(n * angle + later) for n in orders for f in (np.cos, np.sin)], axis=-1)
