"""Gravity compensator of joint 2: a spring between two pivots at distance s, s² = a² + L² + 2 a L cos(α + q₂), force
F₀ + k s.

Its torque −(F₀ + k s) ds/dq depends on the joint angle. The slope of the torque is a stiffness in parallel to the
gear. Lengths enter as the ratio a/L; F₀ L and k L² are torques (Klimchik et al. arXiv 1311.6810).
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np

from machopt.effects.joint.harmonic_functions import compute_harmonics
from machopt.effects.protocol import DEGREE, Effect, LawParameter, ParallelTorqueLaw, Quantity, Shape
from machopt.numerics.array_types import Array

RATIOS = (0.15, 0.35, 0.7)  # ratios a/L that a search tries
FAR_PIVOT_RATIO = 1e-3  # a/L of a spring whose second pivot is too far away to be identified
ANGLES = tuple(np.radians(np.arange(0.0, 360.0, 30.0)).tolist())  # rad, angles α that a search tries


@dataclass(frozen=True)
class CompensatorLinkage:
    """Spring between two pivots: coefficients F₀ L and k L², shape a/L and α."""

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
        """Return the compensator torque per unit of each coefficient.

        Args:
            shape: (2,) ratio a/L, and angle α in rad.
            angle: (...,) angle of joint 2, rad.

        Returns:
            (..., 2) N·m per N·m.
        """
        s, ds, _ = _compute_pivot_distance(shape, angle)
        return np.stack([-ds, -s * ds], axis=-1)

    def slope(self, shape: Array, angle: Array) -> Array:
        """Return the derivative of the torque with respect to the joint angle, per unit of each coefficient.

        Args:
            shape: (2,) ratio a/L, and angle α in rad.
            angle: (...,) angle of joint 2, rad.

        Returns:
            (..., 2) N·m/rad per N·m.
        """
        s, ds, dds = _compute_pivot_distance(shape, angle)
        return np.stack([-dds, -(ds**2 + s * dds)], axis=-1)

    def sizes(self, values: Array) -> Mapping[str, Quantity]:
        """Return both coefficients as reported quantities.

        Args:
            values: (2,) F₀ L and k L², N·m.

        Returns:
            Quantities by name in N·m.
        """
        force, rate = (float(v) for v in values)
        return {"force_times_length": Quantity(force, "N·m"), "rate_times_length_squared": Quantity(rate, "N·m")}

    def grid(self) -> tuple[Shape, ...]:
        return tuple((a, b) for a in RATIOS for b in ANGLES)


@dataclass(frozen=True)
class HarmonicTorque:
    """A cos q + B sin q: a spring with zero natural length, or an unmodelled weight."""

    name = "first harmonics"
    equation = "τ = A cos q₂ + B sin q₂ (Klimchik et al. arXiv 1311.6810)"
    penalty = 0.0
    word = "harmonic"
    has_memory = False
    coefficients = (LawParameter(key="cos_Nm", unit="N·m"), LawParameter(key="sin_Nm", unit="N·m"))
    shape: tuple[LawParameter, ...] = ()

    def torque(self, shape: Array, angle: Array) -> Array:
        """Return cosine and sine of the joint angle.

        Args:
            shape: Empty; the law has no shape parameters.
            angle: (...,) angle of joint 2, rad.

        Returns:
            (..., 2) N·m per N·m.
        """
        return compute_harmonics(angle, (1,))

    def slope(self, shape: Array, angle: Array) -> Array:
        """Return the derivative of the torque with respect to the joint angle.

        Args:
            shape: Empty; the law has no shape parameters.
            angle: (...,) angle of joint 2, rad.

        Returns:
            (..., 2) N·m/rad per N·m.
        """
        return compute_harmonics(angle, (1,), 1)

    def sizes(self, values: Array) -> Mapping[str, Quantity]:
        """Return both coefficients as reported quantities.

        Args:
            values: (2,) A and B, N·m.

        Returns:
            Quantities by name in N·m.
        """
        return {"cos": Quantity(float(values[0]), "N·m"), "sin": Quantity(float(values[1]), "N·m")}

    def grid(self) -> tuple[Shape, ...]:
        return ((),)


LINKAGE, HARMONIC = CompensatorLinkage(), HarmonicTorque()


def convert_to_file_law(law: ParallelTorqueLaw, values: Array, shape: Array) -> tuple[Array, Array]:
    """Convert coefficients and shape to the law that files state, the first law of the effect.

    A cos q + B sin q = C sin(α + q) equals a spring whose second pivot is very far away: −F₀ L s' = F₀ L (a/L) sin(α
    + q) with a relative error of a/L.

    Args:
        law: Law that the values belong to.
        values: (P,) coefficients of the law (linear), SI, in the order of ``self.coefficients``.
        shape: (S,) shape parameters of the law (nonlinear), SI, in the order of ``self.shape``.

    Returns:
        Coefficients and shape of :class:`CompensatorLinkage`; unchanged if the law already is that one.
    """
    if law is not HARMONIC:
        return values, shape
    cos, sin = (float(v) for v in values)
    return np.array([np.hypot(cos, sin) / FAR_PIVOT_RATIO, 0.0]), np.array([FAR_PIVOT_RATIO, np.arctan2(cos, sin)])


def _compute_pivot_distance(shape: Array, angle: Array) -> tuple[Array, Array, Array]:
    """Return the distance of the pivots in units of L, and its first two derivatives with respect to the angle."""
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
