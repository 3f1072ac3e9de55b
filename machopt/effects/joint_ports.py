"""Ports of joints: what a law is asked of one joint, and what it is told of it.

Twist by the joint's torque, angle without load, torque beside the gear, friction of the motor.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass
from typing import Protocol

import numpy as np

from machopt.arrays import Array
from machopt.effects.nouns import Ints, Named, Parameter, Quantity, Shape


@dataclass(frozen=True)
class Drive:
    """What acts at one joint in K states, in the order they happened.

    Different memories of a gear are different drives over the same law.
    """

    torque: Array  # (..., ) N·m that the law follows
    angle: Array | None = None  # (...,) rad of the joint
    gap: Array | None = None  # (K,) s since the state before; of a first one since the gear rested; see creep.lag
    first: Ints | None = None  # (K,) 1: nothing before this state counts. None: each state stands by itself, for long


@dataclass(frozen=True, kw_only=True)
class Scale:
    """How much a recording or a plan asks of one joint: what shares and sizes are of."""

    reach: float  # N·m, about the largest torque
    compliance: float | None = None  # rad/(N·m) of the joint's own spring; None: not known yet
    low: float = 0.0  # rad, range of its angle
    high: float = 0.0
    lasting: float = np.inf  # s, the longest history without a break
    sampled: bool = False  # a motion in many samples; else settled readings, some a cycle


class Law(Named, Protocol):
    """One law of an effect. Stateless; SI."""

    @property
    def weighs(self) -> bool:
        """It follows the whole torque of a joint, weight included, along a curve."""
        ...

    def columns(self, shape: Array, drive: Drive) -> Array:
        """(..., P) what it makes per unit of each coefficient, at each state of the drive."""
        ...

    def tangent(self, shape: Array, drive: Drive) -> Array:
        """(..., P) its slope by the torque; of what remembers, the most that a lasting load can meet."""
        ...

    def steepest(self, values: Array, shape: Array, low: float, high: float) -> tuple[float, float]:
        """How much compliance it may take from its joint at most, ≤ 0 rad/(N·m), and at which angle in rad (or NaN)."""
        ...

    def within(self, values: Array, room: float) -> Law:
        """The law as it holds where the joint has ``room`` rad/(N·m) left for it to take."""
        ...

    def sizes(self, values: Array, shape: Array, scale: Scale) -> Mapping[str, Quantity]:
        """Numbers of the trade; the first is the effect's size and grows in proportion to the coefficients."""
        ...

    def grid(self, scale: Scale) -> tuple[Shape, ...]:
        """Shapes that a search tries; none where the law is not offered."""
        ...

    def silent(self, loaded: Array, unloaded: Array, scale: Scale) -> str:
        """Why torques (N,) against those without load (N,) cannot show it; empty where they can."""
        ...


class Settled:
    """What most laws answer: nothing is taken, nothing bounds them, every torque shows them."""

    word = ""
    weighs = False
    remembers = False

    def steepest(self, values: Array, shape: Array, low: float, high: float) -> tuple[float, float]:
        return 0.0, np.nan

    def silent(self, loaded: Array, unloaded: Array, scale: Scale) -> str:
        return ""


def timed(law: Law) -> bool:
    """It goes by time: one of its numbers is a time constant."""
    return any(p.unit == "s" for p in law.shape)


def percent(value: float, compliance: float) -> Quantity:
    """A compliance as a share of the joint's own."""
    return Quantity(100.0 * value / compliance, "%")


@dataclass(frozen=True)
class Swept:
    """The angles of a joint that readings were taken at: what shapes of laws without load are of."""

    low: float  # rad by encoder
    high: float
    most: int  # shapes that as many distinct angles can tell from noise
    lowest: float = 1.0  # per turn of the joint: slower waves are another effect's (those of a balancer)
    sampled: bool = False  # a motion in many samples; else settled poses


class Unloaded(Named, Protocol):
    """An angle Δ(q) that a joint is off by without any load, by its own angle or another joint's. Stateless; SI."""

    @property
    def note(self) -> str:
        """Where it shows."""
        ...

    @property
    def penalty(self) -> float:
        """Gain beyond that of its coefficients that it must bring of settled poses: few, for what fits much."""
        ...

    @property
    def prior(self) -> float | None:
        """1 sigma of each coefficient about zero in settled poses, of what makers hold; None: nothing is known."""
        ...

    @property
    def summed(self) -> str:
        """What several of its shapes at one place are called, one law again: "waves"; empty: they are none."""
        ...

    @property
    def ranged(self) -> bool:
        """It holds at the angles it was measured over, and fades out beyond; else everywhere."""
        ...

    def columns(self, shape: Array, angle: Array, derivative: int = 0) -> Array:
        """(..., P) rad per unit of each coefficient at angles (...,) rad, or a derivative by the angle."""
        ...

    def steepest(self, values: Array, shape: Array) -> float:
        """The most that Δ changes, rad per rad of the angle."""
        ...

    def largest(self, values: Array, shape: Array) -> float:
        """The most that Δ is to either side, rad; infinite where angles bound it alone."""
        ...

    def sizes(self, values: Array, shape: Array) -> Mapping[str, Quantity]:
        """Numbers of the trade; the first is the effect's size and grows in proportion to the coefficients."""
        ...

    def grid(self, swept: Swept) -> tuple[Shape, ...]:
        """Shapes that a search tries; none where these angles cannot show it."""
        ...


class Free:
    """What most laws without load answer: at once, everywhere, and nothing is known of their size."""

    word = ""
    remembers = False
    prior: float | None = None
    ranged = False
    at_rest_only = False  # no motion is searched for it
    shape: tuple[Parameter, ...] = ()

    @property
    def penalty(self) -> float:
        return 0.0

    @property
    def summed(self) -> str:
        return ""

    def grid(self, swept: Swept) -> tuple[Shape, ...]:
        return () if self.at_rest_only and swept.sampled else ((),)


class Beside(Named, Protocol):
    """A torque that a spring puts on a joint beside its gear, by the joint's own angle. Stateless; SI."""

    @property
    def penalty(self) -> float:
        """Gain beyond that of its coefficients that it must bring at rest: flexible enough to fit much."""
        ...

    def torque(self, shape: Array, angle: Array) -> Array:
        """(..., P) N·m per unit of each coefficient at angles (...,) rad."""
        ...

    def slope(self, shape: Array, angle: Array) -> Array:
        """(..., P) its derivative by the angle; what it takes from the stiffness of the gear."""
        ...

    def sizes(self, values: Array) -> Mapping[str, Quantity]:
        """The coefficients in numbers of the trade."""
        ...

    def grid(self) -> tuple[Shape, ...]:
        """Shapes that a search tries."""
        ...


@dataclass(frozen=True, kw_only=True)
class Rubbing:
    """How a joint moves in K samples, as its friction feels it; of a slide m for rad and N for N·m."""

    speed: Array  # (K,) rad/s
    way: Array  # (K,) −1 … 1, which way friction points
    load: Array  # (K,) N·m, size of the torque that it carries
    first: Ints  # (K,) 1 where a segment begins
    step: float  # s between samples
    warmth: Callable[[float], Array]  # (K,) 0 … 1 for a time constant in s; of zero by the recorded temperature
    slides: bool = False


@dataclass(frozen=True)
class Pace:
    """How a joint moves in a recording: what shapes of friction are of."""

    fast: float  # rad/s, about its largest speed
    loaded: bool  # what it carries changes
    warming: tuple[float, ...] = ()  # s, time constants that the recording can show


class FrictionLaw(Named, Protocol):
    """A torque of the motor beyond Coulomb and viscous friction, linear in its coefficients. Stateless; SI."""

    @property
    def note(self) -> str:
        """Where it shows."""
        ...

    @property
    def by_angle(self) -> bool:
        """Its picture is over the joint's angle; else over its speed."""
        ...

    def columns(self, shape: Array, seen: Rubbing) -> Array:
        """(K, P) N·m per unit of each coefficient."""
        ...

    def sizes(self, values: Array, shape: Array, seen: Rubbing) -> Mapping[str, Quantity]:
        """Numbers of the trade; the first is the effect's size and grows in proportion to the coefficients."""
        ...

    def grid(self, pace: Pace) -> tuple[Shape, ...]:
        """Shapes that a search tries; none where the recording cannot show it."""
        ...


@dataclass(frozen=True)
class Swinging:
    """How a joint's spring is loaded in K samples, and what swings on it."""

    load: Array  # (K,) N·m that twists the joint forward
    inertia: Array  # (K,) kg·m² behind the spring
    step: Array  # (K,) s since the sample before
    first: Ints  # (K,) 1 where a segment begins, at rest under its load


class SwingLaw(Named, Protocol):
    """A joint's spring with what swings on it, linear in a compliance. Stateless; SI."""

    def stiffness(self, shape: Array, seen: Swinging) -> float:
        """N·m/rad that a shape means here."""
        ...

    def deflection(self, shape: Array, seen: Swinging) -> Array:
        """(K,) rad, how far a spring of that stiffness gives; times stiffness and compliance it is the twist."""
        ...

    def sizes(self, compliance: float, shape: Array, seen: Swinging) -> Mapping[str, Quantity]:
        """Numbers of the trade; the first is the effect's size and grows in proportion to the compliance."""
        ...

    def grid(self, rate: float, gain: Callable[[Shape], float] | None = None) -> tuple[Shape, ...]:
        """Shapes that a search tries in samples at a rate in Hz.

        Args:
            gain: power that a shape's column takes, for a grid that ends with the best; None: it shall stay coarse.
        """
        ...


@dataclass(frozen=True, kw_only=True)
class Geared:
    """What the gears of a place's joints (J of them, in order) do in K samples, as their motors feel it."""

    needed: Array  # (K, J) N·m that rigid bodies ask of each
    speed: Array  # (K, J) rad/s
    acceleration: Array  # (K, J) rad/s²
    way: Callable[[Array], Array]  # speed (K,) of the last joint's motor → (K,) −1 … 1, which way its friction points


class MotorLaw(Named, Protocol):
    """What drives tell beyond what each joint asks of its own motor, linear in its coefficients. Stateless; SI."""

    @property
    def note(self) -> str:
        """Where it shows."""
        ...

    @property
    def penalty(self) -> float:
        """Gain beyond that of its coefficients that it must bring."""
        ...

    @property
    def of_gain(self) -> bool:
        """What a gain of each joint takes up that is refitted in any case, where currents stand for torques."""
        ...

    def columns(self, shape: Array, seen: Geared) -> Array:
        """(K, J, P) N·m per unit of each coefficient."""
        ...

    def sizes(self, values: Array, shape: Array, seen: Geared) -> Mapping[str, Quantity]:
        """Numbers of the trade; the first is the effect's size and grows in proportion to the coefficients."""
        ...

    def grid(self) -> tuple[Shape, ...]:
        """Shapes that a search tries."""
        ...
