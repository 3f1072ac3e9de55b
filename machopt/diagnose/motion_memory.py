"""A mass on a spring along sampled signals; compiled, one pass."""

from __future__ import annotations

import numpy as np

from machopt.arrays import Array
from machopt.compiled import compiled
from machopt.diagnose.problem import Ints


@compiled
def _mass_on_spring(load: Array, inertia: Array, step: Array, first: Ints, k: float, damping: float) -> Array:
    out = np.empty_like(load)
    x, v = 0.0, 0.0
    for n in range(len(load)):
        if first[n]:
            x, v = load[n] / k, 0.0
            out[n] = x
            continue
        w = np.sqrt(k / inertia[n])
        h, z = step[n], damping
        wd = w * np.sqrt(1.0 - z * z)
        # exact over a step with the load held at its mean
        rest = 0.5 * (load[n] + load[n - 1]) / k
        a = x - rest
        b = (v + z * w * a) / wd
        e, c, s = np.exp(-z * w * h), np.cos(wd * h), np.sin(wd * h)
        x = rest + e * (a * c + b * s)
        v = e * ((b * wd - z * w * a) * c - (a * wd + z * w * b) * s)
        out[n] = x
    return out


def mass_on_spring(load: Array, inertia: Array, step: Array, first: Ints, k: float, damping: float) -> Array:
    """Twist (M,) rad of m(t) ẍ + 2 ζ √(k m) ẋ + k x = load, from rest under the first load.

    Args:
        load: (M,) N·m.
        inertia: (M,) kg·m² behind the spring.
        step: (M,) s since the sample before.
        first: (M,) 1 where a segment begins.
        k: N·m/rad.
        damping: ζ.
    """
    return np.asarray(
        _mass_on_spring(np.ascontiguousarray(load), np.ascontiguousarray(inertia), step, first, k, damping)
    )
