"""A joint spring that changes with the joint's own angle: harmonics of a turn, or a soft sector."""

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
    2001  # angles of a joint's range that are looked at; between them a second harmonic is missed by 1e-5 of itself
)
CENTRES = 7
WIDTHS = (0.12, 0.25)  # of the range


class AngleDependentCompliance(JointLawDefaults, ABC):
    """φ = c(q) τ: linear in the torque, by a share s_p(q) for each coefficient."""

    @abstractmethod
    def shares(self, shape: Array, angle: Array) -> Array:
        """(..., P) by which a coefficient counts at joint angles (...,) rad; they are not wrapped."""

    def columns(self, shape: Array, drive: JointLoading) -> Array:
        return np.asarray(drive.torque[..., None] * self.tangent(shape, drive))

    def tangent(self, shape: Array, drive: JointLoading) -> Array:
        assert drive.angle is not None  # whoever drives a joint knows where it stands
        return self.shares(shape, drive.angle)

    def explain_undetectable(self, loaded: Array, unloaded: Array, scale: JointLoadRange) -> str:
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
        return compute_harmonics(angle, self.orders)

    def compute_max_slope(self, values: Array, shape: Array, low: float, high: float) -> tuple[float, float]:
        at = np.linspace(low, high, SAMPLED_ANGLES)
        if self.orders == (1,):  # a cos q + b sin q is least opposite to its largest
            least = np.arctan2(-values[1], -values[0]) + 2.0 * np.pi * np.arange(-4, 5)
            at = np.concatenate([at, least[(least >= low) & (least <= high)]])
        value = self.shares(shape, at) @ values
        return min(0.0, float(value.min())), float(at[value.argmin()])

    def limit_to_compliance(self, values: Array, room: float) -> JointLaw:
        return self

    def sizes(self, values: Array, shape: Array, scale: JointLoadRange) -> Mapping[str, Quantity]:
        half = 0.5 * float(np.ptp(self.shares(shape, np.linspace(scale.min_angle, scale.max_angle, 60)) @ values))
        return {"variation": compute_compliance_percent(half, scale.compliance or np.nan)}

    def grid(self, scale: JointLoadRange) -> tuple[Shape, ...]:
        return () if scale.is_motion or scale.max_angle - scale.min_angle < LEAST_RANGE else ((),)


@dataclass(frozen=True)
class SectorCompliance(AngleDependentCompliance):
    """c(q) = a exp(−½((q − q₀)/σ)²): teeth that give over a part of the turn."""

    word = "sector"
    name = "soft sector"
    equation = "c(q) = c + a exp(−½((q − q₀)/σ)²)"
    coefficients = (LawParameter(key="extra_rad_per_Nm", unit=COMPLIANCE),)
    shape = (
        LawParameter(key="centre_deg", unit="rad", factor=DEGREE, required=True),
        LawParameter(key="width_deg", unit="rad", factor=DEGREE, positive=True, required=True),
    )

    def shares(self, shape: Array, angle: Array) -> Array:
        return np.asarray(np.exp(-0.5 * ((angle[..., None] - shape[0]) / shape[1]) ** 2))

    def compute_max_slope(self, values: Array, shape: Array, low: float, high: float) -> tuple[float, float]:
        at = np.append(np.linspace(low, high, SAMPLED_ANGLES), np.clip(shape[0], low, high))
        value = self.shares(shape, at)[:, 0] * values[0]
        return min(0.0, float(value.min())), float(at[value.argmin()])

    def limit_to_compliance(self, values: Array, room: float) -> JointLaw:
        return self

    def sizes(self, values: Array, shape: Array, scale: JointLoadRange) -> Mapping[str, Quantity]:
        return {
            "variation": compute_compliance_percent(0.5 * abs(float(values[0])), scale.compliance or np.nan),
            "centre": Quantity(float(shape[0] / DEGREE), "deg"),
            "width": Quantity(float(shape[1] / DEGREE), "deg"),
        }

    def grid(self, scale: JointLoadRange) -> tuple[Shape, ...]:
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
