"""Operators with memory on sampled signals: presliding, and a mass on a spring; compiled, one pass each."""

from __future__ import annotations

import numpy as np

from machopt.compiled import compiled
from machopt.diagnose.problem import Array, Ints

PARTS = 4  # of a sampling interval
SHARP = 1e-9  # rad


@compiled
def _presliding(v: Array, dt: float, first: Ints, distance: float, parts: int) -> Array:
    out = np.empty_like(v)
    z = 0.0
    for n in range(len(v)):
        if first[n]:
            z = np.sign(v[n])
        elif distance <= SHARP:
            # at once; parts of the interval would make it late by half a part. At rest it stays as it was
            z = np.sign(v[n]) if v[n] != 0.0 else z
        else:
            # a reversal lies between samples; one step a sample would put it half an interval off
            for k in range(parts):
                now = v[n - 1] + (v[n] - v[n - 1]) * (k + 0.5) / parts
                s = np.sign(now)
                z = s + (z - s) * np.exp(-abs(now) * dt / parts / distance)
        out[n] = z
    return out


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


def presliding(v: Array, dt: float, first: Ints, distance: float) -> Array:
    """Direction of motion with a breakaway path: dz = (sgn q̇ − z) |dq| / d.

    Args:
        v: (M,) rad/s.
        dt: s between samples.
        first: (M,) 1 where a segment begins.
        distance: d, rad (m); below SHARP it is the sign itself.

    Returns:
        (M,) −1 … 1.

    Source:
        Dahl, A solid friction model, TOR-158, Aerospace Corp. (1968).
    """
    return np.asarray(_presliding(np.ascontiguousarray(v), dt, first, max(distance, SHARP), PARTS))


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
