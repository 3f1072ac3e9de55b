"""Direction of a joint motion with presliding displacement (Dahl 1968)."""

from __future__ import annotations

import numpy as np

from machopt.effects.protocol import Ints
from machopt.numerics.array_types import Array
from machopt.numerics.compiled_functions import jit_compile

PARTS = 4  # of a sampling interval
MIN_BREAKAWAY_PATH = 1e-9  # rad


@jit_compile
def _integrate_presliding(v: Array, dt: float, first: Ints, distance: float, parts: int) -> Array:
    out = np.empty_like(v)
    z = 0.0
    for n in range(len(v)):
        if first[n]:
            z = np.sign(v[n])
        elif distance <= MIN_BREAKAWAY_PATH:
            # immediate reversal: subdividing would delay it by half a part. At rest the state stays constant
            z = np.sign(v[n]) if v[n] != 0.0 else z
        else:
            # a reversal lies between samples; one step per sample would shift it by half an interval
            for k in range(parts):
                now = v[n - 1] + (v[n] - v[n - 1]) * (k + 0.5) / parts
                s = np.sign(now)
                if z != s:  # mostly z has already saturated
                    z = s + (z - s) * np.exp(-abs(now) * dt / parts / distance)
        out[n] = z
    return out


def compute_presliding_direction(v: Array, dt: float, first: Ints, distance: float) -> Array:
    """Compute the direction of motion with presliding displacement: dz = (sgn q̇ − z) |dq| / d (Dahl 1968).

    Args:
        v: (M,) joint speed, rad/s.
        dt: Sampling interval, s.
        first: (M,) 1 where a segment begins.
        distance: Presliding displacement d, rad (m for a prismatic joint). Below :data:`MIN_BREAKAWAY_PATH` z is
            sgn q̇.

    Returns:
        (M,) z, from −1 to 1.

    Source:
        Dahl, A solid friction model, TOR-158, Aerospace Corp. (1968).
    """
    return np.asarray(
        _integrate_presliding(np.ascontiguousarray(v), dt, first, max(distance, MIN_BREAKAWAY_PATH), PARTS)
    )
