"""Play operator and elastic drag of a load history, the memory of the hysteresis laws."""

from __future__ import annotations

import numpy as np

from machopt.effects.protocol import Ints
from machopt.numerics.array_types import Array
from machopt.numerics.compiled_functions import jit_compile


@jit_compile
def _integrate_play(x: Array, first: Ints, half: float) -> Array:
    out = np.empty_like(x)
    y = 0.0
    for n in range(len(x)):
        if first[n]:
            y = x[n] - half if x[n] > half else (x[n] + half if x[n] < -half else 0.0)
        y = min(max(y, x[n] - half), x[n] + half)
        out[n] = y
    return out


def compute_play(x: Array, first: Ints, half: float) -> Array:
    """Apply the play operator P_r: y follows x as soon as |x − y| reaches r. It starts at zero where ``first`` is
    set.

    Args:
        x: (K,) input, for example torques in N·m.
        first: (K,) 1 where a load history begins.
        half: Half-width r, in the unit of x.

    Returns:
        (K,) output y, in the unit of x.

    Source:
        Krasnosel'skii & Pokrovskii, Systems with Hysteresis (1989), ch. 1.
    """
    return np.asarray(
        _integrate_play(np.ascontiguousarray(x, float), np.ascontiguousarray(first, np.int64), float(half))
    )


@jit_compile
def _integrate_drag(x: Array, first: Ints, reach: float, beta: float) -> Array:
    out = np.empty_like(x)
    z, last, bend = 0.0, 0.0, 2.0 * beta - 1.0
    for n in range(len(x)):
        if first[n]:
            z, last = 0.0, 0.0
        way = (x[n] - last) / reach
        up = 1.0 if way > 0.0 else -1.0
        z, way = z * up, abs(way)
        if z < 0.0:  # remaining opposite drag decays first: z' = 1 − (2β − 1) z
            gone = -z if bend == 0.0 else np.log1p(-bend * z) / bend
            if way < gone:
                z += way if bend == 0.0 else (1.0 / bend - z) * -np.expm1(-bend * way)
            else:
                z = 0.0
            way = max(way - gone, 0.0)
        if z >= 0.0:  # z' = 1 − z
            z += (1.0 - z) * -np.expm1(-way)
        z, last = z * up, x[n]
        out[n] = z
    return out


def compute_drag(x: Array, first: Ints, reach: float, beta: float) -> Array:
    """Integrate the Bouc–Wen state z: dz = [1 − |z| (β sgn(z dx) + 1 − β)] dx/r, in closed form between path points.

    For β > ½ small loops do not close: under one-sided loads z ratchets from cycle to cycle.

    Args:
        x: (K,) input, for example torques in N·m.
        first: (K,) 1 where a load history begins, at x = 0 and z = 0.
        reach: Characteristic load r, in the unit of x.
        beta: Loop shape parameter β > 0.

    Returns:
        (K,) z, from −1 to 1.

    Source:
        Wen, J. Eng. Mech. Div. ASCE 102 (1976) 249, exponent 1.
    """
    return np.asarray(
        _integrate_drag(
            np.ascontiguousarray(x, float), np.ascontiguousarray(first, np.int64), float(reach), float(beta)
        )
    )
