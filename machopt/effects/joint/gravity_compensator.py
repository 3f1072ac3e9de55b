"""The balancer of joint 2: a spring between two pivots s apart, s² = a² + L² + 2 a L cos(α + q₂), force F₀ + k s.

Its torque −(F₀ + k s) ds/dq changes with the joint's angle; its slope is a stiffness beside the gear. Lengths come as
the ratio a/L; F₀ L and k L² are torques (Klimchik et al. arXiv 1311.6810).
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np

from machopt.effects.joint.harmonic_functions import compute_harmonics
from machopt.effects.protocol import DEGREE, Effect, LawParameter, ParallelTorqueLaw, Quantity, Shape
from machopt.numerics.array_types import Array

RATIOS = (0.15, 0.35, 0.7)  # a/L that are tried
FAR_PIVOT_RATIO = 1e-3  # a/L of a spring whose far pivot does not show
ANGLES = tuple(np.radians(np.arange(0.0, 360.0, 30.0)).tolist())  # rad, α that are tried


@dataclass(frozen=True)
class CompensatorLinkage:
    """Coefficients F₀ L and k L², shape a/L and α."""

    name = "spring between two pivots"
    equation = "τ = −(F₀ + k s) ds/dq, s² = a² + L² + 2aL cos(α + q₂) (Klimchik et al. arXiv 1311.6810)"
    penalty = 4.0
    word = ""
    has_memory = False
    coefficients = (
        LawParameter(key="force_times_length_Nm", unit="N·m"),
        LawParameter(key="rate_times_length2_Nm", unit="N·m"),
    )
    shape = (
        LawParameter(key="ratio", unit="1", positive=True),
        LawParameter(key="angle_deg", unit="rad", factor=DEGREE),
    )

    def torque(self, shape: Array, angle: Array) -> Array:
        s, ds, _ = _compute_pivot_distance(shape, angle)
        return np.stack([-ds, -s * ds], axis=-1)

    def slope(self, shape: Array, angle: Array) -> Array:
        s, ds, dds = _compute_pivot_distance(shape, angle)
        return np.stack([-dds, -(ds**2 + s * dds)], axis=-1)

    def sizes(self, values: Array) -> Mapping[str, Quantity]:
        force, rate = (float(v) for v in values)
        return {"force_times_length": Quantity(force, "N·m"), "rate_times_length_squared": Quantity(rate, "N·m")}

    def grid(self) -> tuple[Shape, ...]:
        return tuple((a, b) for a in RATIOS for b in ANGLES)


@dataclass(frozen=True)
class HarmonicTorque:
    """A cos q + B sin q: a spring with no length of its own, or a weight."""

    name = "first harmonics"
    equation = "τ = A cos q₂ + B sin q₂ (Klimchik et al. arXiv 1311.6810)"
    penalty = 0.0
    word = "harmonic"
    has_memory = False
    coefficients = (LawParameter(key="cos_Nm", unit="N·m"), LawParameter(key="sin_Nm", unit="N·m"))
    shape: tuple[LawParameter, ...] = ()

    def torque(self, shape: Array, angle: Array) -> Array:
        return compute_harmonics(angle, (1,))

    def slope(self, shape: Array, angle: Array) -> Array:
        return compute_harmonics(angle, (1,), 1)

    def sizes(self, values: Array) -> Mapping[str, Quantity]:
        return {"cos": Quantity(float(values[0]), "N·m"), "sin": Quantity(float(values[1]), "N·m")}

    def grid(self) -> tuple[Shape, ...]:
        return ((),)


LINKAGE, HARMONIC = CompensatorLinkage(), HarmonicTorque()


def convert_to_file_law(law: ParallelTorqueLaw, values: Array, shape: Array) -> tuple[Array, Array]:
    """Values and shape by the law that files state, the first of an effect; of any other law they stay as they are.

    A cos q + B sin q = C sin(α + q) is a spring whose far pivot is very far: −F₀ L s' = F₀ L (a/L) sin(α + q) to a
    share a/L.
    """
    if law is not HARMONIC:
        return values, shape
    cos, sin = (float(v) for v in values)
    return np.array([np.hypot(cos, sin) / FAR_PIVOT_RATIO, 0.0]), np.array([FAR_PIVOT_RATIO, np.arctan2(cos, sin)])


def _compute_pivot_distance(shape: Array, angle: Array) -> tuple[Array, Array, Array]:
    """Of the pivots in units of L, and its first two derivatives by the angle."""
    ratio, alpha = float(shape[0]), float(shape[1])
    q = alpha + angle
    s = np.sqrt(ratio**2 + 1.0 + 2.0 * ratio * np.cos(q))
    ds = -ratio * np.sin(q) / s
    return s, ds, (-ratio * np.cos(q) - ds**2) / s


EFFECT = Effect(
    name="gravity_compensator",
    noun="gravity compensator",
    sentence="The spring or gas cylinder at joint 2 carries a torque that depends on its angle.",
    port="torque",
    places=("joint:2",),
    parallel_torque_laws=(LINKAGE, HARMONIC),
    is_elastic=True,
    form_uncertainty=0.2,
)
