"""Compiled count of the draws in which the error of a milled point is within its limit."""

from __future__ import annotations

from machopt.numerics.array_types import Array
from machopt.numerics.compiled_functions import jit_compile


@jit_compile
def count_within(
    compliance: Array, by_joint: Array, rest: float, factor: Array, noise: Array, shift: float, limit: float
) -> int:
    """Return in how many of D draws |(Σ compliance · by_joint + rest) · factor + noise + shift| ≤ limit.

    Args:
        compliance: (6, D) of each joint, relative to nominal.
        by_joint: (6,) m, error by each joint at nominal compliance and load.
        rest: m, error by everything else at nominal load.
        factor: (D,) of the load.
        noise: (D,) m.
        shift: m.
        limit: m.
    """
    a, b, c, d, e, f = compliance[0], compliance[1], compliance[2], compliance[3], compliance[4], compliance[5]
    s, t, u, v, w, x = by_joint[0], by_joint[1], by_joint[2], by_joint[3], by_joint[4], by_joint[5]
    count = 0
    for n in range(len(factor)):
        bent = a[n] * s + b[n] * t + c[n] * u + d[n] * v + e[n] * w + f[n] * x + rest
        count += abs(bent * factor[n] + noise[n] + shift) <= limit
    return count
