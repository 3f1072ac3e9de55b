"""A joint that swings on its own spring: the link as a mass behind it, integrated along sampled signals; compiled."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass

import numpy as np

from machopt.effects.protocol import COMPLIANCE, JOINTS, Effect, LawParameter, Quantity, Shape, VibrationLoading
from machopt.numerics.array_types import Array, Ints
from machopt.numerics.compiled_functions import jit_compile

BANDS = tuple(float(f) for f in np.geomspace(0.8, 20.0, 17).round(2))  # Hz, where a search begins that refines
COARSE = (3.0, 4.5, 6.5, 9.5, 14.0, 20.0)  # Hz, of torques, which show no more than that it swings
DAMPING = (0.01, 0.02, 0.03, 0.045, 0.07, 0.1)  # of critical
FREQUENCY_STEPS = (0.035, 0.012, 0.004)  # relative steps of the search for a frequency
DAMPED, TORQUE_DAMPING = 0.02, 0.04  # of critical: where a search begins; what torques are told
MAX_FREQUENCY_SHARE, MAX_TORQUE_FREQUENCY_SHARE = 0.3, 0.4  # of the sampling rate: faster than that is not seen


@jit_compile
def _integrate_mass_on_spring(load: Array, inertia: Array, step: Array, first: Ints, k: float, damping: float) -> Array:
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


def simulate_mass_on_spring(load: Array, inertia: Array, step: Array, first: Ints, k: float, damping: float) -> Array:
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
        _integrate_mass_on_spring(np.ascontiguousarray(load), np.ascontiguousarray(inertia), step, first, k, damping)
    )


@dataclass(frozen=True)
class JointVibration:
    """φ = c k x, M(q) ẍ + 2ζ√(kM) ẋ + k x = τ with the k that makes the frequency of the shape; c the coefficient."""

    name = "mass on a spring"
    equation = "M(q) φ̈ + 2ζ√(kM) φ̇ + k φ = τ"
    word = ""
    has_memory = False  # it forgets within its own decay
    coefficients = (LawParameter(key="compliance_rad_per_Nm", unit=COMPLIANCE, lower_limit=0.0),)
    shape = (
        LawParameter(key="frequency_Hz", unit="Hz", positive=True),
        LawParameter(key="damping", unit="1", positive=True),
    )

    def stiffness(self, shape: Array, seen: VibrationLoading) -> float:
        return float(np.mean(seen.inertia)) * float(2.0 * np.pi * shape[0]) ** 2

    def deflection(self, shape: Array, seen: VibrationLoading) -> Array:
        damping = float(shape[1]) if len(shape) > 1 else TORQUE_DAMPING
        return simulate_mass_on_spring(
            seen.load, seen.inertia, seen.time_step, seen.segment_start, self.stiffness(shape, seen), damping
        )

    def sizes(self, compliance: float, shape: Array, seen: VibrationLoading) -> Mapping[str, Quantity]:
        out = {"compliance": Quantity(compliance, COMPLIANCE), "frequency": Quantity(float(shape[0]), "Hz")}
        return out | ({"damping": Quantity(100.0 * float(shape[1]), "%")} if len(shape) > 1 else {})

    def grid(self, rate: float, gain: Callable[[Shape], float] | None = None) -> tuple[Shape, ...]:
        if gain is None:
            return tuple((f,) for f in COARSE if f < MAX_TORQUE_FREQUENCY_SHARE * rate)
        limit = MAX_FREQUENCY_SHARE * rate
        shapes = tuple((f, DAMPED) for f in BANDS if f < limit)
        if not shapes:
            return ()
        # weakly damped, a resonance is narrower than any grid that many joints can afford
        f, z = max(shapes, key=gain)
        for width in FREQUENCY_STEPS:
            near = [min(f * (1.0 + width * k), limit) for k in (-3, -2, -1, 0, 1, 2, 3)]
            f = max(near, key=lambda f: gain((f, z)))
            z = max(DAMPING, key=lambda d: gain((f, d)))
        return (*shapes, (float(f), float(z)))


VIBRATION = Effect(
    name="joint_elasticity",
    noun="vibration",
    short_noun="vibration of a flexible joint",
    sentence="The joint swings on its own spring.",
    port="twist",
    places=JOINTS,
    vibration_laws=(JointVibration(),),
    note="after the load changes",
)
