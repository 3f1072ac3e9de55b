"""Share of a normal distribution within limits, averaged over many means: mean of Φ((t − m)/σ) − Φ((−t − m)/σ).

Φ is interpolated between its values at steps of 1/128 by cubics with the exact slope φ. The error of a cubic is at most
h⁴/384 · max|Φ⁗| = 5·10⁻¹² there. Beyond ±9, Φ is 0 or 1.
"""

from __future__ import annotations

import math

import numpy as np

from machopt.numerics.array_types import Array
from machopt.numerics.compiled_functions import jit_compile

REACH, STEPS = 9.0, 128  # of the table, and its steps per unit
SMALLEST_STD = 1e-12  # m; a smaller one counts as this


def compute_interval_shares(means: Array, limit: Array, std: Array) -> Array:
    """Return (n,) the mean over D means of the share within ±limit.

    Args:
        means: (n, D).
        limit: (n,) > 0, in the unit of the means.
        std: (n,) ≥ 0, of each distribution.
    """
    out = np.empty(len(means))
    _fill_shares(np.ascontiguousarray(means), np.array(limit, float), np.maximum(std, SMALLEST_STD), _TABLE, out)
    return out


def _build_table() -> Array:
    """Return (N, 2) Φ and its change over a step by its slope."""
    x = np.arange(int(2 * REACH * STEPS) + 2) / STEPS - REACH
    value = np.array([0.5 * math.erfc(-v / math.sqrt(2.0)) for v in x])
    return np.ascontiguousarray(np.stack([value, np.exp(-0.5 * x**2) / math.sqrt(2.0 * math.pi) / STEPS], axis=1))


@jit_compile
def _fill_shares(means: Array, limit: Array, std: Array, table: Array, out: Array) -> None:
    for n in range(len(means)):
        scale, t = 1.0 / std[n], limit[n]
        total = 0.0
        for d in range(means.shape[1]):
            m = means[n, d]
            total += _interpolate((t - m) * scale, table) - _interpolate((-t - m) * scale, table)
        out[n] = total / means.shape[1]


@jit_compile
def _interpolate(x: float, table: Array) -> float:
    """Φ(x)."""
    if not x < REACH:
        return 1.0 if x >= REACH else x  # NaN stays
    if x <= -REACH:
        return 0.0
    place = (x + REACH) * STEPS
    k = int(place)
    f = place - k
    g = 1.0 - f
    blend = f * f * (3.0 - 2.0 * f)
    low, high = table[k, 0], table[k + 1, 0]
    out: float = low + blend * (high - low) + f * g * (g * table[k, 1] - f * table[k + 1, 1])
    return out


_TABLE = _build_table()
