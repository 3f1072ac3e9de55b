"""Friction of a joint beyond Coulomb and viscous, which are refitted in any case: rival laws on the motor's torque.

z is the direction of motion after a short breakaway path. Source of most: Armstrong-Hélouvry, Dupont & Canudas de Wit,
Automatica 30 (1994) 1083.
"""

from __future__ import annotations

from abc import ABC, abstractmethod
from dataclasses import dataclass

import numpy as np

from machopt.effects.protocol import JOINTS, Effect, FrictionState, Ints, JointSpeedRange, LawParameter, Quantity, Shape
from machopt.numerics.array_types import Array
from machopt.numerics.compiled_functions import jit_compile

PARTS = 4  # of a sampling interval
MIN_BREAKAWAY_PATH = 1e-9  # rad
SIZE_QUANTILE = 0.98  # quantile of what a law adds that counts as its size
DRAG = (0.01, 0.03, 0.08, 0.2)  # rad; slip on paths this long is no breakaway of a gear but something dragged along
STRIBECK = (0.03, 0.06, 0.12, 0.25, 0.5)  # of the joint's largest speed
MAX_PEAK_SPEED_SHARE = 0.15  # of it, below which friction that differs with the direction has its peak
SOURCE = "; Armstrong-Hélouvry, Dupont & Canudas de Wit, Automatica 30 (1994) 1083"
VISCOUS = "N·m·s/rad"  # of a slide N·s/m, as all units here


@jit_compile
def _integrate_presliding(v: Array, dt: float, first: Ints, distance: float, parts: int) -> Array:
    out = np.empty_like(v)
    z = 0.0
    for n in range(len(v)):
        if first[n]:
            z = np.sign(v[n])
        elif distance <= MIN_BREAKAWAY_PATH:
            # at once; parts of the interval would make it late by half a part. At rest it stays as it was
            z = np.sign(v[n]) if v[n] != 0.0 else z
        else:
            # a reversal lies between samples; one step a sample would put it half an interval off
            for k in range(parts):
                now = v[n - 1] + (v[n] - v[n - 1]) * (k + 0.5) / parts
                s = np.sign(now)
                if z != s:  # most of the way it has long turned over
                    z = s + (z - s) * np.exp(-abs(now) * dt / parts / distance)
        out[n] = z
    return out


def compute_presliding_direction(v: Array, dt: float, first: Ints, distance: float) -> Array:
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
    return np.asarray(
        _integrate_presliding(np.ascontiguousarray(v), dt, first, max(distance, MIN_BREAKAWAY_PATH), PARTS)
    )


class _FrictionDefaults(ABC):
    """What most of these laws answer."""

    word = ""
    has_memory = False
    note = ""
    size = "torque"
    plots_over_angle = False
    shape: tuple[LawParameter, ...] = ()

    @abstractmethod
    def columns(self, shape: Array, seen: FrictionState) -> Array:
        """(K, P) N·m per unit of each coefficient."""

    def sizes(self, values: Array, shape: Array, seen: FrictionState) -> dict[str, Quantity]:
        added = self.columns(shape, seen) @ values
        unit = "N" if seen.is_prismatic else "N·m"
        return {self.size: Quantity(float(np.quantile(np.abs(added - np.median(added)), SIZE_QUANTILE)), unit)}

    def grid(self, pace: JointSpeedRange) -> tuple[Shape, ...]:
        return ((),)


def _convert_speed(at: float, seen: FrictionState) -> Quantity:
    return Quantity(1e3 * at, "mm/s") if seen.is_prismatic else Quantity(float(np.degrees(at)), "deg/s")


@dataclass(frozen=True)
class StribeckFriction(_FrictionDefaults):
    name = "Stribeck"
    equation = "τ_f += z F_s exp(−|q̇|/v_s)" + SOURCE
    note = "at low speed"
    size = "stribeck"
    coefficients = (LawParameter(key="stribeck_Nm", unit="N·m", lower_limit=0.0),)
    shape = (LawParameter(key="speed_rad_s", unit="rad/s", positive=True),)

    def columns(self, shape: Array, seen: FrictionState) -> Array:
        return np.asarray(seen.friction_direction * np.exp(-np.abs(seen.speed) / shape[0]))[:, None]

    def sizes(self, values: Array, shape: Array, seen: FrictionState) -> dict[str, Quantity]:
        return super().sizes(values, shape, seen) | {"stribeck_speed": _convert_speed(float(shape[0]), seen)}

    def grid(self, pace: JointSpeedRange) -> tuple[Shape, ...]:
        return tuple((k * pace.max_speed,) for k in STRIBECK)


@dataclass(frozen=True)
class LoadDependentFriction(_FrictionDefaults):
    name = "load-dependent"
    equation = "τ_f += μ z |τ|"
    note = "grows with the load"
    coefficients = (LawParameter(key="share", unit="1", lower_limit=0.0),)

    def columns(self, shape: Array, seen: FrictionState) -> Array:
        return (seen.friction_direction * seen.load)[:, None]

    def grid(self, pace: JointSpeedRange) -> tuple[Shape, ...]:
        return ((),) if pace.has_varying_load else ()


@dataclass(frozen=True)
class DirectionDependentFriction(_FrictionDefaults):
    name = "other in the other direction"
    equation = "τ_f += d |q̇| + F exp(−|q̇|/v)"
    note = "differs with the direction"
    size = "lopsided"
    coefficients = (LawParameter(key="viscous", unit=VISCOUS), LawParameter(key="at_low_speed_Nm", unit="N·m"))
    shape = (LawParameter(key="speed_rad_s", unit="rad/s", positive=True),)

    def columns(self, shape: Array, seen: FrictionState) -> Array:
        v = np.abs(seen.speed)
        return np.stack([v, np.exp(-v / shape[0])], axis=1)

    def grid(self, pace: JointSpeedRange) -> tuple[Shape, ...]:
        return ((MAX_PEAK_SPEED_SHARE * pace.max_speed,),)


@dataclass(frozen=True)
class CurvedViscousFriction(_FrictionDefaults):
    name = "viscous bends"
    equation = "τ_f += d₂ q̇|q̇| + d₁ z √|q̇|: shear thinning of grease"
    note = "over speed"
    coefficients = (
        LawParameter(key="square", unit="N·m·s²/rad²"),
        LawParameter(key="root", unit="N·m·√(s/rad)"),
    )

    def columns(self, shape: Array, seen: FrictionState) -> Array:
        v = seen.speed
        return np.stack([v * np.abs(v), seen.friction_direction * np.sqrt(np.abs(v))], axis=1)


@dataclass(frozen=True)
class CombinedFriction(_FrictionDefaults):
    """Stribeck's peak, load and direction at once, and where a joint warms its warmth too."""

    warm: bool
    note = "over speed, load and warmth"
    size = "stribeck"

    @property
    def name(self) -> str:
        return "Stribeck, load, direction" + (", warmth" if self.warm else "")

    @property
    def equation(self) -> str:
        more = " + d_w w q̇; w from 0 to 1 as the joint warms" if self.warm else ""
        return f"τ_f += (z F_s + F_d) exp(−|q̇|/v_s) + μ z |τ|{more}{SOURCE}"

    @property
    def coefficients(self) -> tuple[LawParameter, ...]:
        three = (
            *StribeckFriction.coefficients,
            LawParameter(key="lopsided_Nm", unit="N·m"),
            *LoadDependentFriction.coefficients,
        )
        return (*three, LawParameter(key="viscous_warm", unit=VISCOUS)) if self.warm else three

    @property
    def shape(self) -> tuple[LawParameter, ...]:  # type: ignore[override]  # a property of the base is a constant
        return (*StribeckFriction.shape, *TemperatureDependentFriction.shape) if self.warm else StribeckFriction.shape

    def columns(self, shape: Array, seen: FrictionState) -> Array:
        low, z = np.exp(-np.abs(seen.speed) / shape[0]), seen.friction_direction
        parts = [z * low, np.abs(z) * low, z * seen.load]
        return np.stack([*parts, seen.warmth(float(shape[1])) * seen.speed] if self.warm else parts, axis=1)

    def sizes(self, values: Array, shape: Array, seen: FrictionState) -> dict[str, Quantity]:
        return super().sizes(values, shape, seen) | {"stribeck_speed": _convert_speed(float(shape[0]), seen)}

    def grid(self, pace: JointSpeedRange) -> tuple[Shape, ...]:
        if self.warm:
            return tuple((k * pace.max_speed, t) for k in STRIBECK for t in pace.warming_times)
        return () if pace.warming_times else tuple((k * pace.max_speed,) for k in STRIBECK)


@dataclass(frozen=True)
class CableDragFriction(_FrictionDefaults):
    name = "dragged along"
    equation = "τ_f += F z, dz = (sgn q̇ − z) |dq|/d with a long path d: cables, hoses, seals"
    note = "after reversals"
    plots_over_angle = True
    coefficients = (LawParameter(key="drag_Nm", unit="N·m", lower_limit=0.0),)
    shape = (LawParameter(key="path_rad", unit="rad", positive=True),)

    def columns(self, shape: Array, seen: FrictionState) -> Array:
        return compute_presliding_direction(seen.speed, seen.time_step, seen.segment_start, float(shape[0]))[:, None]

    def sizes(self, values: Array, shape: Array, seen: FrictionState) -> dict[str, Quantity]:
        d = float(shape[0])
        path = Quantity(1e3 * d, "mm") if seen.is_prismatic else Quantity(float(np.degrees(d)), "deg")
        return super().sizes(values, shape, seen) | {"path": path}

    def grid(self, pace: JointSpeedRange) -> tuple[Shape, ...]:
        return tuple((d,) for d in DRAG)


@dataclass(frozen=True)
class TemperatureDependentFriction(_FrictionDefaults):
    name = "warms up"
    equation = "τ_f += (F_w z + d_w q̇) w; w from 0 to 1 as the joint warms"
    note = "over time"
    coefficients = (LawParameter(key="coulomb_warm_Nm", unit="N·m"), LawParameter(key="viscous_warm", unit=VISCOUS))
    shape = (LawParameter(key="time_constant_s", unit="s"),)  # zero: the recorded temperature

    def columns(self, shape: Array, seen: FrictionState) -> Array:
        w = seen.warmth(float(shape[0]))
        return np.stack([w * seen.friction_direction, w * seen.speed], axis=1)

    def grid(self, pace: JointSpeedRange) -> tuple[Shape, ...]:
        return tuple((t,) for t in pace.warming_times)


EFFECT = Effect(
    name="joint_friction",
    noun="friction",
    sentence="The motor works against friction that the model does not hold.",
    port="torque",
    places=JOINTS,
    friction_laws=(
        StribeckFriction(),
        LoadDependentFriction(),
        DirectionDependentFriction(),
        CurvedViscousFriction(),
        CombinedFriction(warm=False),
        CombinedFriction(warm=True),
        CableDragFriction(),
        TemperatureDependentFriction(),
    ),
)
