"""Nonlinear stiffness: a gear that is softer or stiffer at small torque than near its rated one."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, replace

import numpy as np

from machopt.arrays import Array
from machopt.effects.protocol import (
    ARCMIN,
    COMPLIANCE,
    JOINTS,
    Drive,
    Effect,
    Law,
    Parameter,
    Quantity,
    Scale,
    Settled,
    Shape,
    percent,
)

FLAT = 0.9  # of what a joint has that a cubic may take: a gear tenfold as stiff as unloaded is out of its reach
STEPS = (0.12, 0.2, 0.3, 0.45, 0.6)  # knees tried in load tests, per largest torque
SAMPLES = (0.1, 0.2, 0.3, 0.45, 0.6, 0.75)  # in motions
TWO = ((0.06, 0.25), (0.1, 0.35), (0.15, 0.5), (0.25, 0.6))


@dataclass(frozen=True)
class Knees(Settled):
    """φ = Σ a_n clip(τ, ±τ_n)."""

    count: int
    weighs = True

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
    def coefficients(self) -> tuple[Parameter, ...]:
        return (Parameter(key="extra_rad_per_Nm", unit=COMPLIANCE, many=self.count > 1),)

    @property
    def shape(self) -> tuple[Parameter, ...]:
        if self.count > 1:
            return (Parameter(key="knees_Nm", unit="N·m", positive=True, many=True),)
        return (Parameter(key="knee_Nm", unit="N·m", positive=True),)

    def columns(self, shape: Array, drive: Drive) -> Array:
        return np.asarray(np.clip(drive.torque[..., None], -shape, shape))

    def tangent(self, shape: Array, drive: Drive) -> Array:
        return np.asarray((np.abs(drive.torque[..., None]) < shape) * 1.0)

    def steepest(self, values: Array, shape: Array, low: float, high: float) -> tuple[float, float]:
        # from the far knee inwards more and more of them slope; beyond all of them none does
        return min(0.0, float(np.cumsum(values[np.argsort(-shape)]).min())), np.nan

    def within(self, values: Array, room: float) -> Law:
        return self

    def sizes(self, values: Array, shape: Array, scale: Scale) -> Mapping[str, Quantity]:
        knee = Quantity(float(shape[0]), "N·m")
        if scale.compliance is None:
            return {"twist": Quantity(abs(float(values[0])) * float(shape[0]) / ARCMIN, "arcmin"), "knee_torque": knee}
        return {"stiffness_change": percent(abs(float(np.sum(values))), scale.compliance), "knee_torque": knee}

    def grid(self, scale: Scale) -> tuple[Shape, ...]:
        if self.count > 1:
            return () if scale.sampled else tuple(tuple(s * scale.reach for s in pair) for pair in TWO)
        return tuple((s * scale.reach,) for s in (SAMPLES if scale.sampled else STEPS))


@dataclass(frozen=True)
class Cubic(Settled):
    """φ = b τ³; where b < 0 would turn it back, it goes on along its tangent from ``reach``."""

    reach: float = np.inf  # N·m
    word = "cubic"
    name = "cubic"
    equation = "φ = c τ + b τ³ (c(τ − βτ³), hardening for b < 0)"
    coefficients = (Parameter(key="cubic_rad_per_Nm3", unit="rad/(N·m)³"),)
    shape: tuple[Parameter, ...] = ()
    weighs = True

    def columns(self, shape: Array, drive: Drive) -> Array:
        tau = drive.torque[..., None]
        inside = np.clip(tau, -self.reach, self.reach)
        more = 0.0 if np.isinf(self.reach) else 3.0 * self.reach**2 * (tau - inside)
        return np.asarray(inside**3 + more)

    def tangent(self, shape: Array, drive: Drive) -> Array:
        return np.asarray(3.0 * np.minimum(np.abs(drive.torque[..., None]), self.reach) ** 2)

    def steepest(self, values: Array, shape: Array, low: float, high: float) -> tuple[float, float]:
        if not values[0] < 0.0:
            return 0.0, np.nan
        return (3.0 * float(values[0]) * self.reach**2 if np.isfinite(self.reach) else -np.inf), np.nan

    def within(self, values: Array, room: float) -> Law:
        """c τ + b τ³ with b < 0 turns back at τ² = c/(3|b|); held to where it has taken FLAT of c."""
        if not values[0] < 0.0:
            return self
        return replace(self, reach=float(np.sqrt(FLAT * max(room, 0.0) / (3.0 * -values[0]))))

    def sizes(self, values: Array, shape: Array, scale: Scale) -> Mapping[str, Quantity]:
        at_reach = abs(float(values[0])) * scale.reach**2
        if scale.compliance is None:
            return {"twist": Quantity(at_reach * scale.reach / ARCMIN, "arcmin")}
        return {"stiffness_change": percent(3.0 * at_reach, scale.compliance)}

    def grid(self, scale: Scale) -> tuple[Shape, ...]:
        return ((),)


EFFECT = Effect(
    name="joint_nonlinear_stiffness",
    noun="nonlinear stiffness",
    sentence="The reducer is softer or stiffer at small torque than near its rated torque.",
    port="twist",
    places=JOINTS,
    laws=(Knees(1), Knees(2), Cubic()),
    elastic=True,
    note="the slope changes with the load",
)
