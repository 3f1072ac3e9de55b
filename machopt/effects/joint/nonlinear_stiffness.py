"""Nonlinear stiffness: a gear that is softer or stiffer at small torque than near its rated one."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, replace

import numpy as np

from machopt.effects.protocol import (
    ARCMIN,
    COMPLIANCE,
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

MAX_CUBIC_SHARE = (
    0.9  # of what a joint has that a cubic may take: a gear tenfold as stiff as unloaded is out of its reach
)
STEPS = (0.12, 0.2, 0.3, 0.45, 0.6)  # knees tried in load tests, per largest torque
SAMPLES = (0.1, 0.2, 0.3, 0.45, 0.6, 0.75)  # in motions
TWO_KNEE_STEPS = ((0.06, 0.25), (0.1, 0.35), (0.15, 0.5), (0.25, 0.6))


@dataclass(frozen=True)
class PiecewiseStiffness(JointLawDefaults):
    """φ = Σ a_n clip(τ, ±τ_n)."""

    count: int
    includes_weight = True

    @property
    def word(self) -> str:  # type: ignore[override]
        return "knee" if self.count == 1 else "knees"

    @property
    def name(self) -> str:
        return "two slopes" if self.count == 1 else "three slopes"

    @property
    def equation(self) -> str:
        if self.count > 1:
            return "φ = c τ + a clip(τ, ±τ₁) + b clip(τ, ±τ₂)"
        return (
            "φ = c τ + a clip(τ, ±τ₀): softer (a > 0) or harder below the knee τ₀; gear stiffness of RV and harmonic "
            "drives is catalogued so"
        )

    @property
    def coefficients(self) -> tuple[LawParameter, ...]:
        return (LawParameter(key="extra_rad_per_Nm", unit=COMPLIANCE, is_list=self.count > 1),)

    @property
    def shape(self) -> tuple[LawParameter, ...]:
        if self.count > 1:
            return (LawParameter(key="knees_Nm", unit="N·m", positive=True, is_list=True),)
        return (LawParameter(key="knee_Nm", unit="N·m", positive=True),)

    def columns(self, shape: Array, drive: JointLoading) -> Array:
        return np.asarray(np.clip(drive.torque[..., None], -shape, shape))

    def tangent(self, shape: Array, drive: JointLoading) -> Array:
        return np.asarray((np.abs(drive.torque[..., None]) < shape) * 1.0)

    def compute_max_slope(self, values: Array, shape: Array, low: float, high: float) -> tuple[float, float]:
        # from the far knee inwards more and more of them slope; beyond all of them none does
        return min(0.0, float(np.cumsum(values[np.argsort(-shape)]).min())), np.nan

    def limit_to_compliance(self, values: Array, room: float) -> JointLaw:
        return self

    def sizes(self, values: Array, shape: Array, scale: JointLoadRange) -> Mapping[str, Quantity]:
        knee = Quantity(float(shape[0]), "N·m")
        if scale.compliance is None:
            return {"twist": Quantity(abs(float(values[0])) * float(shape[0]) / ARCMIN, "arcmin"), "knee_torque": knee}
        return {
            "stiffness_change": compute_compliance_percent(abs(float(np.sum(values))), scale.compliance),
            "knee_torque": knee,
        }

    def grid(self, scale: JointLoadRange) -> tuple[Shape, ...]:
        if self.count > 1:
            return (
                () if scale.is_motion else tuple(tuple(s * scale.max_torque for s in pair) for pair in TWO_KNEE_STEPS)
            )
        return tuple((s * scale.max_torque,) for s in (SAMPLES if scale.is_motion else STEPS))


@dataclass(frozen=True)
class CubicStiffness(JointLawDefaults):
    """φ = b τ³; where b < 0 would turn it back, it goes on along its tangent from ``reach``."""

    max_torque: float = np.inf  # N·m
    word = "cubic"
    name = "cubic"
    equation = "φ = c τ + b τ³ (c(τ − βτ³), hardening for b < 0)"
    coefficients = (LawParameter(key="cubic_rad_per_Nm3", unit="rad/(N·m)³"),)
    shape: tuple[LawParameter, ...] = ()
    includes_weight = True

    def columns(self, shape: Array, drive: JointLoading) -> Array:
        tau = drive.torque[..., None]
        inside = np.clip(tau, -self.max_torque, self.max_torque)
        more = 0.0 if np.isinf(self.max_torque) else 3.0 * self.max_torque**2 * (tau - inside)
        return np.asarray(inside**3 + more)

    def tangent(self, shape: Array, drive: JointLoading) -> Array:
        return np.asarray(3.0 * np.minimum(np.abs(drive.torque[..., None]), self.max_torque) ** 2)

    def compute_max_slope(self, values: Array, shape: Array, low: float, high: float) -> tuple[float, float]:
        if not values[0] < 0.0:
            return 0.0, np.nan
        return (3.0 * float(values[0]) * self.max_torque**2 if np.isfinite(self.max_torque) else -np.inf), np.nan

    def limit_to_compliance(self, values: Array, room: float) -> JointLaw:
        """c τ + b τ³ with b < 0 turns back at τ² = c/(3|b|); held to where it has taken FLAT of c."""
        if not values[0] < 0.0:
            return self
        return replace(self, max_torque=float(np.sqrt(MAX_CUBIC_SHARE * max(room, 0.0) / (3.0 * -values[0]))))

    def sizes(self, values: Array, shape: Array, scale: JointLoadRange) -> Mapping[str, Quantity]:
        at_reach = abs(float(values[0])) * scale.max_torque**2
        if scale.compliance is None:
            return {"twist": Quantity(at_reach * scale.max_torque / ARCMIN, "arcmin")}
        return {"stiffness_change": compute_compliance_percent(3.0 * at_reach, scale.compliance)}

    def grid(self, scale: JointLoadRange) -> tuple[Shape, ...]:
        return ((),)


EFFECT = Effect(
    name="joint_nonlinear_stiffness",
    noun="nonlinear stiffness",
    sentence="The reducer is softer or stiffer at small torque than near its rated torque.",
    port="twist",
    places=JOINTS,
    joint_laws=(PiecewiseStiffness(1), PiecewiseStiffness(2), CubicStiffness()),
    is_elastic=True,
    note="the slope changes with the load",
)
