"""Vibration of a joint on its own spring: the link as a mass on the joint spring, integrated along sampled signals."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass

import numpy as np

from machopt.effects.protocol import COMPLIANCE, JOINTS, Effect, LawParameter, Quantity, Shape, VibrationLoading
from machopt.numerics.array_types import Array, Ints
from machopt.numerics.compiled_functions import jit_compile

BANDS = tuple(float(f) for f in np.geomspace(0.8, 20.0, 17).round(2))  # Hz, start values of a refined search
COARSE = (
    3.0,
    4.5,
    6.5,
    9.5,
    14.0,
    20.0,
)  # Hz, for torque channels, which show the vibration but not its exact frequency
DAMPING = (0.01, 0.02, 0.03, 0.045, 0.07, 0.1)  # of critical
FREQUENCY_STEPS = (0.035, 0.012, 0.004)  # relative steps of the search for a frequency
DAMPED, TORQUE_DAMPING = (
    0.02,
    0.04,
)  # relative to critical damping: start value of the search; fixed value for torque channels
MAX_FREQUENCY_SHARE, MAX_TORQUE_FREQUENCY_SHARE = (
    0.3,
    0.4,
)  # relative to the sampling rate: higher frequencies are not resolved


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
        # exact over a step with the load constant at its mean
        rest = 0.5 * (load[n] + load[n - 1]) / k
        a = x - rest
        b = (v + z * w * a) / wd
        e, c, s = np.exp(-z * w * h), np.cos(wd * h), np.sin(wd * h)
        x = rest + e * (a * c + b * s)
        v = e * ((b * wd - z * w * a) * c - (a * wd + z * w * b) * s)
        out[n] = x
    return out


def simulate_mass_on_spring(load: Array, inertia: Array, step: Array, first: Ints, k: float, damping: float) -> Array:
    """Integrate m(t) ẍ + 2 ζ √(k m) ẋ + k x = load from rest under the first load.

    Args:
        load: (M,) joint torque, N·m.
        inertia: (M,) inertia behind the spring, kg·m².
        step: (M,) time since the sample before, s.
        first: (M,) 1 where a segment begins.
        k: Stiffness, N·m/rad.
        damping: Damping ratio ζ.

    Returns:
        (M,) twist x, rad.
    """
    return np.asarray(
        _integrate_mass_on_spring(np.ascontiguousarray(load), np.ascontiguousarray(inertia), step, first, k, damping)
    )


@dataclass(frozen=True)
class JointVibration:
    """φ = c k x with M(q) ẍ + 2ζ√(kM) ẋ + k x = τ. The shape's frequency determines k; c is the fitted compliance."""

    name = "mass on a spring"
    equation = "M(q) φ̈ + 2ζ√(kM) φ̇ + k φ = τ"
    word = ""
    has_memory = False  # its memory is limited to its decay time
    coefficients = (LawParameter(key="compliance_rad_per_Nm", unit=COMPLIANCE, lower_limit=0.0),)
    shape = (
        LawParameter(key="frequency_Hz", unit="Hz", positive=True),
        LawParameter(key="damping", unit="1", positive=True),
    )

    def stiffness(self, shape: Array, vibration_loading: VibrationLoading) -> float:
        """Return the stiffness that the shape's frequency implies for the mean inertia.

        Args:
            shape: (1,) frequency in Hz, or (2,) with the damping ratio.
            vibration_loading: Torque and inertia of the joint in K samples.

        Returns:
            N·m/rad.
        """
        return float(np.mean(vibration_loading.inertia)) * float(2.0 * np.pi * shape[0]) ** 2

    def deflection(self, shape: Array, vibration_loading: VibrationLoading) -> Array:
        """Return the deflection of a spring of that stiffness along the samples.

        Args:
            shape: (1,) frequency in Hz, or (2,) with the damping ratio.
            vibration_loading: Torque and inertia of the joint in K samples.

        Returns:
            (K,) rad.
        """
        damping = float(shape[1]) if len(shape) > 1 else TORQUE_DAMPING
        return simulate_mass_on_spring(
            vibration_loading.load,
            vibration_loading.inertia,
            vibration_loading.time_step,
            vibration_loading.segment_start,
            self.stiffness(shape, vibration_loading),
            damping,
        )

    def sizes(self, compliance: float, shape: Array, vibration_loading: VibrationLoading) -> Mapping[str, Quantity]:
        """Return compliance, frequency and damping.

        Args:
            compliance: Fitted joint compliance, rad/(N·m).
            shape: (1,) frequency in Hz, or (2,) with the damping ratio.
            vibration_loading: Torque and inertia of the joint in K samples.

        Returns:
            Quantities by name; the first one is the size of the effect.
        """
        out = {"compliance": Quantity(compliance, COMPLIANCE), "frequency": Quantity(float(shape[0]), "Hz")}
        return out | ({"damping": Quantity(100.0 * float(shape[1]), "%")} if len(shape) > 1 else {})

    def grid(self, rate: float, gain: Callable[[Shape], float] | None = None) -> tuple[Shape, ...]:
        """Return the frequencies and damping ratios that a search tries.

        Args:
            rate: Sampling rate, Hz.
            gain: Function that returns the power explained by a shape's column. The grid then ends with the refined
                best shape. None returns a coarse grid.

        Returns:
            Shapes (frequency,) or (frequency, damping ratio).
        """
        if gain is None:
            return tuple((f,) for f in COARSE if f < MAX_TORQUE_FREQUENCY_SHARE * rate)
        limit = MAX_FREQUENCY_SHARE * rate
        shapes = tuple((f, DAMPED) for f in BANDS if f < limit)
        if not shapes:
            return ()
        # a weakly damped resonance is narrower than a grid that is affordable for all joints
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
