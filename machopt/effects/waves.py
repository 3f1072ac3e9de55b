"""Waves over a joint's angle, as springs that change with it and gears that run ahead and behind both have them."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from machopt.effects.protocol import Array

ARCSEC = np.pi / 648000.0  # rad


def waves(angle: Array, orders: Sequence[float]) -> Array:
    """(..., 2n) cos and sin of each order per turn, at angles (...,) rad."""
    return np.stack([f(n * angle) for n in orders for f in (np.cos, np.sin)], axis=-1)


def transmission(orders: Sequence[float], x: Array) -> dict[str, float | list[float]]:
    """A transmission error as kinematics.yaml states it.

    Args:
        orders: n per turn of the joint.
        x: (2n,) rad, cos and sin of each.
    """
    parts = {"per_turn": np.asarray(orders, float), "cos_arcsec": x[0::2] / ARCSEC, "sin_arcsec": x[1::2] / ARCSEC}
    lists = {key: [float(v) for v in value] for key, value in parts.items()}
    return {key: v[0] if len(v) == 1 else v for key, v in lists.items()}
