"""Load on the arm where a pressure foot clamps the work, and when the foot skids."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from machopt.errors import CuttingInputError
from machopt.numerics.array_types import Array, Bools


@dataclass(frozen=True)
class FootLoad:
    """Axial load of the arm while the foot presses."""

    arm: Array  # (P,) N, max(thrust, clamp)
    lifted: Bools  # (P,) the thrust exceeds the clamp force: the foot leaves the work


def compute_foot_load(thrust: Array | float, clamp: float) -> FootLoad:
    """Return the axial load of the arm: the clamp force while the thrust only relieves the foot, else the thrust.

    Args:
        thrust: (P,) or one value, N.
        clamp: N, clamp force; 0: no foot.

    Raises:
        CuttingInputError: a negative clamp force.
    """
    if not (np.isfinite(clamp) and clamp >= 0.0):
        raise CuttingInputError(f"clamp force {clamp:g} N; 0 or more is expected", key="clamp_N")
    force = np.atleast_1d(np.asarray(thrust, float))
    return FootLoad(np.maximum(force, clamp), (force > clamp) & (clamp > 0.0))


def compute_skid_margin(lateral: Array | float, thrust: Array | float, clamp: float, friction: float) -> Array:
    """Return how much lateral force the foot still carries before it skids, (P,) N; negative: it skids.

    The foot presses with the clamp force less the thrust, so that its friction is µ (N_c − T). Before the drill cuts,
    the thrust is 0.

    Args:
        lateral: (P,) or one value, N, lateral force between foot and work.
        thrust: (P,) or one value, N.
        clamp: N, clamp force.
        friction: coefficient of friction of the foot.

    Raises:
        CuttingInputError: a negative clamp force or friction.
    """
    if not (np.isfinite(clamp) and clamp >= 0.0):
        raise CuttingInputError(f"clamp force {clamp:g} N; 0 or more is expected", key="clamp_N")
    if not (np.isfinite(friction) and friction >= 0.0):
        raise CuttingInputError(f"friction {friction:g}; 0 or more is expected", key="foot_friction")
    press = np.maximum(clamp - np.asarray(thrust, float), 0.0)
    return np.atleast_1d(friction * press - np.abs(np.asarray(lateral, float)))
