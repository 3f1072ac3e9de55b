"""Joint compliance that depends on the joint's own angle: harmonics of the angle, or a soft sector."""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np

from machopt.effects.joint.harmonic_functions import compute_harmonics
from machopt.effects.protocol import (
    COMPLIANCE,
    DEGREE,
    JOINTS,
    Effect,
    JointLaw,
    JointLawDefaults,
    JointLoading,
    JointLoadRange,
    LawParameter,
    Quantity,
    Shape,
    compute_compliance_percent,
)
from machopt.numerics.array_types import Array

LEAST_RANGE = 15.0 * DEGREE  # of the joint's angles
SAMPLED_ANGLES = (
    2001  # sampled angles of a joint's range; interpolation error of a second harmonic: 1e-5 of its amplitude
)
CENTRES = 7
WIDTHS = (0.12, 0.25)  # of the range


class AngleDependentCompliance(JointLawDefaults, ABC):
    """Twist φ = c(q) τ: linear in the torque, with a factor s_p(q) for each coefficient."""

    @abstractmethod
    def shares(self, shape: Array, angle: Array) -> Array:
        """Return the factor of each coefficient at joint angles.

        Args:
            shape: (S,) shape parameters of the law (nonlinear), SI, in the order of ``self.shape``.
            angle: (...,) joint angles, rad, not wrapped.

        Returns:
            (..., P) dimensionless factors s_p(q).
        """

    def columns(self, shape: Array, drive: JointLoading) -> Array:
        """Return the joint twist per unit of each coefficient.

        Args:
            shape: (S,) shape parameters of the law (nonlinear), SI, in the order of ``self.shape``.
            drive: Torque, angle and load history of the joint, one entry per state.

        Returns:
            (..., P) rad per unit of each coefficient.
        """
        return np.asarray(drive.torque[..., None] * self.tangent(shape, drive))

    def tangent(self, shape: Array, drive: JointLoading) -> Array:
        """Return the slope of the twist with respect to the torque, per unit of each coefficient.

        Args:
            shape: (S,) shape parameters of the law (nonlinear), SI, in the order of ``self.shape``.
            drive: Torque, angle and load history of the joint, one entry per state.

        Returns:
            (..., P) factors s_p(q).
        """
        assert drive.angle is not None  # callers of angle-dependent laws supply the angle
        return self.shares(shape, drive.angle)

    def explain_undetectable(self, loaded: Array, unloaded: Array, scale: JointLoadRange) -> str:
        """Explain why the data cannot show the effect.

        Args:
            loaded: (N,) joint torques under load, N·m.
            unloaded: (N,) joint torques of the same poses without load, N·m.
            scale: Range of torque, angle and time that the recording or plan covers at this joint.

        Returns:
            The reason; empty if the joint covers a sufficient angle range.
        """
        return "" if scale.max_angle - scale.min_angle >= LEAST_RANGE else "the joint turns by less than 15 degrees"


@dataclass(frozen=True)
class HarmonicCompliance(AngleDependentCompliance):
    """c(q) = Σ_n a_n cos n q + b_n sin n q."""

    orders: tuple[int, ...]
    word = "harmonics"
    equation = "c(q) = c + Σ (a_n cos nq + b_n sin nq)"
    shape: tuple[LawParameter, ...] = ()

    @property
    def name(self) -> str:
        return "one harmonic" if len(self.orders) == 1 else "two harmonics"

    @property
    def coefficients(self) -> tuple[LawParameter, ...]:
        order = [str(n) if n > 1 else "" for n in self.orders]
        return tuple(LawParameter(key=f"{f}{n}_rad_per_Nm", unit=COMPLIANCE) for n in order for f in ("cos", "sin"))

    def shares(self, shape: Array, angle: Array) -> Array:
        """Return cosine and sine of each order at joint angles.

        Args:
            shape: Empty; the orders are fixed.
            angle: (...,) joint angles, rad.

        Returns:
            (..., P) dimensionless factors.
        """
        return compute_harmonics(angle, self.orders)

    def compute_max_slope(self, values: Array, shape: Array, low: float, high: float) -> tuple[float, float]:
        """Return the largest reduction of the joint compliance over an angle range.

        Args:
            values: (P,) coefficients of the law (linear), SI, in the order of ``self.coefficients``.
            shape: (S,) shape parameters of the law (nonlinear), SI, in the order of ``self.shape``.
            low: Lower end of the joint's angle range, rad.
            high: Upper end of the joint's angle range, rad.

        Returns:
            Compliance change, ≤ 0 rad/(N·m), and the angle in rad at which it occurs.
        """
        sampled_angles = np.linspace(low, high, SAMPLED_ANGLES)
        if self.orders == (1,):  # the minimum of a cos q + b sin q lies half a turn from its maximum
            least = np.arctan2(-values[1], -values[0]) + 2.0 * np.pi * np.arange(-4, 5)
            sampled_angles = np.concatenate([sampled_angles, least[(least >= low) & (least <= high)]])
        value = self.shares(shape, sampled_angles) @ values
        return min(0.0, float(value.min())), float(sampled_angles[value.argmin()])

    def limit_to_compliance(self, values: Array, room: float) -> JointLaw:
        """Return the law unchanged.

        Args:
            values: (P,) coefficients of the law (linear), SI, in the order of ``self.coefficients``.
            room: Compliance that the joint has left to lose before its slope becomes zero, rad/(N·m).

        Returns:
            The law.
        """
        return self

    def sizes(self, values: Array, shape: Array, scale: JointLoadRange) -> Mapping[str, Quantity]:
        """Return half the peak-to-peak variation relative to the joint's compliance.

        Args:
            values: (P,) coefficients of the law (linear), SI, in the order of ``self.coefficients``.
            shape: (S,) shape parameters of the law (nonlinear), SI, in the order of ``self.shape``.
            scale: Range of torque, angle and time that the recording or plan covers at this joint.

        Returns:
            ``variation`` in %.
        """
        half = 0.5 * float(np.ptp(self.shares(shape, np.linspace(scale.min_angle, scale.max_angle, 60)) @ values))
        return {"variation": compute_compliance_percent(half, scale.compliance or np.nan)}

    def grid(self, scale: JointLoadRange) -> tuple[Shape, ...]:
        """Return one empty shape; none for motions and for small angle ranges.

        Args:
            scale: Range of torque, angle and time that the recording or plan covers at this joint.

        Returns:
            The shapes that a search tries.
        """
        return () if scale.is_motion or scale.max_angle - scale.min_angle < LEAST_RANGE else ((),)


@dataclass(frozen=True)
class SectorCompliance(AngleDependentCompliance):
    """c(q) = a exp(−½((q − q₀)/σ)²): teeth with additional compliance over a part of the turn."""

    word = "sector"
    name = "soft sector"
    equation = "c(q) = c + a exp(−½((q − q₀)/σ)²)"
    coefficients = (LawParameter(key="extra_rad_per_Nm", unit=COMPLIANCE),)
    shape = (
        LawParameter(key="centre_deg", unit="rad", factor=DEGREE, required=True),
        LawParameter(key="width_deg", unit="rad", factor=DEGREE, positive=True, required=True),
    )

    def shares(self, shape: Array, angle: Array) -> Array:
        """Return the Gaussian factor of the soft sector at joint angles.

        Args:
            shape: (2,) centre q₀ and width σ of the sector, rad.
            angle: (...,) joint angles, rad.

        Returns:
            (..., 1) dimensionless factor, 1 at the centre.
        """
        return np.asarray(np.exp(-0.5 * ((angle[..., None] - shape[0]) / shape[1]) ** 2))

    def compute_max_slope(self, values: Array, shape: Array, low: float, high: float) -> tuple[float, float]:
        """Return the largest reduction of the joint compliance over an angle range.

        Args:
            values: (P,) coefficients of the law (linear), SI, in the order of ``self.coefficients``.
            shape: (2,) centre q₀ and width σ of the sector, rad.
            low: Lower end of the joint's angle range, rad.
            high: Upper end of the joint's angle range, rad.

        Returns:
            Compliance change, ≤ 0 rad/(N·m), and the angle in rad at which it occurs.
        """
        sampled_angles = np.append(np.linspace(low, high, SAMPLED_ANGLES), np.clip(shape[0], low, high))
        value = self.shares(shape, sampled_angles)[:, 0] * values[0]
        return min(0.0, float(value.min())), float(sampled_angles[value.argmin()])

    def limit_to_compliance(self, values: Array, room: float) -> JointLaw:
        """Return the law unchanged.

        Args:
            values: (P,) coefficients of the law (linear), SI, in the order of ``self.coefficients``.
            room: Compliance that the joint has left to lose before its slope becomes zero, rad/(N·m).

        Returns:
            The law.
        """
        return self

    def sizes(self, values: Array, shape: Array, scale: JointLoadRange) -> Mapping[str, Quantity]:
        """Return half the compliance change relative to the joint's compliance, and the sector's centre and width.

        Args:
            values: (P,) coefficients of the law (linear), SI, in the order of ``self.coefficients``.
            shape: (2,) centre q₀ and width σ of the sector, rad.
            scale: Range of torque, angle and time that the recording or plan covers at this joint.

        Returns:
            ``variation`` in %, ``centre`` and ``width`` in deg.
        """
        return {
            "variation": compute_compliance_percent(0.5 * abs(float(values[0])), scale.compliance or np.nan),
            "centre": Quantity(float(shape[0] / DEGREE), "deg"),
            "width": Quantity(float(shape[1] / DEGREE), "deg"),
        }

    def grid(self, scale: JointLoadRange) -> tuple[Shape, ...]:
        """Return centres and widths that a search tries; none for motions and for small angle ranges.

        Args:
            scale: Range of torque, angle and time that the recording or plan covers at this joint.

        Returns:
            Shapes (centre, width) in rad.
        """
        if scale.is_motion or scale.max_angle - scale.min_angle < LEAST_RANGE:
            return ()
        centres = np.linspace(scale.min_angle, scale.max_angle, CENTRES)
        return tuple((float(q), w * (scale.max_angle - scale.min_angle)) for q in centres for w in WIDTHS)


EFFECT = Effect(
    name="joint_pose_dependent_stiffness",
    noun="angle-dependent stiffness",
    sentence="One spring constant does not hold over the joint's range.",
    port="twist",
    places=JOINTS,
    joint_laws=(HarmonicCompliance((1,)), SectorCompliance(), HarmonicCompliance((1, 2))),
    default_law="harmonics",
    is_elastic=True,
    form_uncertainty=0.2,
    note="changes with the joint's angle",
)
