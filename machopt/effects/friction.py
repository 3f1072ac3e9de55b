"""Friction of a joint beyond Coulomb and viscous, which are refitted in any case: rival laws on the motor's torque.

z is the direction of motion after a short breakaway path. Source of most: Armstrong-Hélouvry, Dupont & Canudas de Wit,
Automatica 30 (1994) 1083.
"""

from __future__ import annotations

from abc import ABC, abstractmethod
from dataclasses import dataclass

import numpy as np

from machopt.arrays import Array
from machopt.compiled import compiled
from machopt.effects.protocol import JOINTS, Effect, Ints, Pace, Parameter, Quantity, Rubbing, Shape

PARTS = 4  # of a sampling interval
SHARP = 1e-9  # rad
LARGE = 0.98  # quantile of what a law adds that counts as its size
DRAG = (0.01, 0.03, 0.08, 0.2)  # rad; slip on paths this long is no breakaway of a gear but something dragged along
STRIBECK = (0.03, 0.06, 0.12, 0.25, 0.5)  # of the joint's largest speed
LOPSIDED = 0.15  # of it, below which friction that differs with the direction has its peak
SOURCE = "; Armstrong-Hélouvry, Dupont & Canudas de Wit, Automatica 30 (1994) 1083"
VISCOUS = "N·m·s/rad"  # of a slide N·s/m, as all units here


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
                if z != s:  # most of the way it has long turned over
                    z = s + (z - s) * np.exp(-abs(now) * dt / parts / distance)
        out[n] = z
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


class _Law(ABC):
    """What most of these laws answer."""

    word = ""
    remembers = False
    note = ""
    size = "torque"
    by_angle = False
    shape: tuple[Parameter, ...] = ()

    @abstractmethod
    def columns(self, shape: Array, seen: Rubbing) -> Array:
        """(K, P) N·m per unit of each coefficient."""

    def sizes(self, values: Array, shape: Array, seen: Rubbing) -> dict[str, Quantity]:
        added = self.columns(shape, seen) @ values
        unit = "N" if seen.slides else "N·m"
        return {self.size: Quantity(float(np.quantile(np.abs(added - np.median(added)), LARGE)), unit)}

    def grid(self, pace: Pace) -> tuple[Shape, ...]:
        return ((),)


def _speed(at: float, seen: Rubbing) -> Quantity:
    return Quantity(1e3 * at, "mm/s") if seen.slides else Quantity(float(np.degrees(at)), "deg/s")


@dataclass(frozen=True)
class Stribeck(_Law):
    name = "Stribeck"
    equation = "τ_f += z F_s exp(−|q̇|/v_s)" + SOURCE
    note = "at low speed"
    size = "stribeck"
    coefficients = (Parameter(key="stribeck_Nm", unit="N·m", least=0.0),)
    shape = (Parameter(key="speed_rad_s", unit="rad/s", positive=True),)

    def columns(self, shape: Array, seen: Rubbing) -> Array:
        return np.asarray(seen.way * np.exp(-np.abs(seen.speed) / shape[0]))[:, None]

    def sizes(self, values: Array, shape: Array, seen: Rubbing) -> dict[str, Quantity]:
        return super().sizes(values, shape, seen) | {"stribeck_speed": _speed(float(shape[0]), seen)}

    def grid(self, pace: Pace) -> tuple[Shape, ...]:
        return tuple((k * pace.fast,) for k in STRIBECK)


@dataclass(frozen=True)
class Loaded(_Law):
    name = "load-dependent"
    equation = "τ_f += μ z |τ|"
    note = "grows with the load"
    coefficients = (Parameter(key="share", unit="1", least=0.0),)

    def columns(self, shape: Array, seen: Rubbing) -> Array:
        return (seen.way * seen.load)[:, None]

    def grid(self, pace: Pace) -> tuple[Shape, ...]:
        return ((),) if pace.loaded else ()


@dataclass(frozen=True)
class Lopsided(_Law):
    name = "other in the other direction"
    equation = "τ_f += d |q̇| + F exp(−|q̇|/v)"
    note = "differs with the direction"
    size = "lopsided"
    coefficients = (Parameter(key="viscous", unit=VISCOUS), Parameter(key="at_low_speed_Nm", unit="N·m"))
    shape = (Parameter(key="speed_rad_s", unit="rad/s", positive=True),)

    def columns(self, shape: Array, seen: Rubbing) -> Array:
        v = np.abs(seen.speed)
        return np.stack([v, np.exp(-v / shape[0])], axis=1)

    def grid(self, pace: Pace) -> tuple[Shape, ...]:
        return ((LOPSIDED * pace.fast,),)


@dataclass(frozen=True)
class Bends(_Law):
    name = "viscous bends"
    equation = "τ_f += d₂ q̇|q̇| + d₁ z √|q̇|: shear thinning of grease"
    note = "over speed"
    coefficients = (
        Parameter(key="square", unit="N·m·s²/rad²"),
        Parameter(key="root", unit="N·m·√(s/rad)"),
    )

    def columns(self, shape: Array, seen: Rubbing) -> Array:
        v = seen.speed
        return np.stack([v * np.abs(v), seen.way * np.sqrt(np.abs(v))], axis=1)


@dataclass(frozen=True)
class Together(_Law):
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
    def coefficients(self) -> tuple[Parameter, ...]:
        three = (*Stribeck.coefficients, Parameter(key="lopsided_Nm", unit="N·m"), *Loaded.coefficients)
        return (*three, Parameter(key="viscous_warm", unit=VISCOUS)) if self.warm else three

    @property
    def shape(self) -> tuple[Parameter, ...]:  # type: ignore[override]  # a property of the base is a constant
        return (*Stribeck.shape, *Warms.shape) if self.warm else Stribeck.shape

    def columns(self, shape: Array, seen: Rubbing) -> Array:
        low, z = np.exp(-np.abs(seen.speed) / shape[0]), seen.way
        parts = [z * low, np.abs(z) * low, z * seen.load]
        return np.stack([*parts, seen.warmth(float(shape[1])) * seen.speed] if self.warm else parts, axis=1)

    def sizes(self, values: Array, shape: Array, seen: Rubbing) -> dict[str, Quantity]:
        return super().sizes(values, shape, seen) | {"stribeck_speed": _speed(float(shape[0]), seen)}

    def grid(self, pace: Pace) -> tuple[Shape, ...]:
        if self.warm:
            return tuple((k * pace.fast, t) for k in STRIBECK for t in pace.warming)
        return () if pace.warming else tuple((k * pace.fast,) for k in STRIBECK)


@dataclass(frozen=True)
class Dragged(_Law):
    name = "dragged along"
    equation = "τ_f += F z, dz = (sgn q̇ − z) |dq|/d with a long path d: cables, hoses, seals"
    note = "after reversals"
    by_angle = True
    coefficients = (Parameter(key="drag_Nm", unit="N·m", least=0.0),)
    shape = (Parameter(key="path_rad", unit="rad", positive=True),)

    def columns(self, shape: Array, seen: Rubbing) -> Array:
        return presliding(seen.speed, seen.step, seen.first, float(shape[0]))[:, None]

    def sizes(self, values: Array, shape: Array, seen: Rubbing) -> dict[str, Quantity]:
        d = float(shape[0])
        path = Quantity(1e3 * d, "mm") if seen.slides else Quantity(float(np.degrees(d)), "deg")
        return super().sizes(values, shape, seen) | {"path": path}

    def grid(self, pace: Pace) -> tuple[Shape, ...]:
        return tuple((d,) for d in DRAG)


@dataclass(frozen=True)
class Warms(_Law):
    name = "warms up"
    equation = "τ_f += (F_w z + d_w q̇) w; w from 0 to 1 as the joint warms"
    note = "over time"
    coefficients = (Parameter(key="coulomb_warm_Nm", unit="N·m"), Parameter(key="viscous_warm", unit=VISCOUS))
    shape = (Parameter(key="time_constant_s", unit="s"),)  # zero: the recorded temperature

    def columns(self, shape: Array, seen: Rubbing) -> Array:
        w = seen.warmth(float(shape[0]))
        return np.stack([w * seen.way, w * seen.speed], axis=1)

    def grid(self, pace: Pace) -> tuple[Shape, ...]:
        return tuple((t,) for t in pace.warming)


EFFECT = Effect(
    name="joint_friction",
    noun="friction",
    sentence="The motor works against friction that the model does not hold.",
    port="torque",
    places=JOINTS,
    rubs=(Stribeck(), Loaded(), Lopsided(), Bends(), Together(warm=False), Together(warm=True), Dragged(), Warms()),
)
