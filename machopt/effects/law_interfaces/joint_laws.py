"""Ports of joints: what a law is asked of one joint, and what it is told of it.

Twist by the joint's torque, angle without load, torque beside the gear, friction of the motor.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass
from typing import Protocol

import numpy as np

from machopt.effects.law_interfaces.law_parameters import DescribedLaw, Ints, LawParameter, Quantity, Shape
from machopt.numerics.array_types import Array


@dataclass(frozen=True)
class JointLoading:
    """What acts at one joint in K states, in the order they happened.

    Different memories of a gear are different drives over the same law.
    """

    torque: Array  # (..., ) N·m that the law follows
    angle: Array | None = None  # (...,) rad of the joint
    time_gap: Array | None = None  # (K,) s since the state before; of a first one since the gear rested; see creep.lag
    segment_start: Ints | None = (
        None  # (K,) 1: nothing before this state counts. None: each state stands by itself, for long
    )


@dataclass(frozen=True, kw_only=True)
class JointLoadRange:
    """How much a recording or a plan asks of one joint: what shares and sizes are of."""

    max_torque: float  # N·m, about the largest torque
    compliance: float | None = None  # rad/(N·m) of the joint's own spring; None: not known yet
    min_angle: float = 0.0  # rad, range of its angle
    max_angle: float = 0.0
    longest_history: float = np.inf  # s, the longest history without a break
    is_motion: bool = False  # a motion in many samples; else settled readings, some a cycle


class JointLaw(DescribedLaw, Protocol):
    """One law of an effect. Stateless; SI."""

    @property
    def includes_weight(self) -> bool:
        """It follows the whole torque of a joint, weight included, along a curve."""
        ...

    def columns(self, shape: Array, drive: JointLoading) -> Array:
        """(..., P) what it makes per unit of each coefficient, at each state of the drive."""
        ...

    def tangent(self, shape: Array, drive: JointLoading) -> Array:
        """(..., P) its slope by the torque; of what remembers, the most that a lasting load can meet."""
        ...

    def compute_max_slope(self, values: Array, shape: Array, low: float, high: float) -> tuple[float, float]:
        """How much compliance it may take from its joint at most, ≤ 0 rad/(N·m), and at which angle in rad (or NaN)."""
        ...

    def limit_to_compliance(self, values: Array, room: float) -> JointLaw:
        """The law as it holds where the joint has ``room`` rad/(N·m) left for it to take."""
        ...

    def sizes(self, values: Array, shape: Array, scale: JointLoadRange) -> Mapping[str, Quantity]:
        """Numbers of the trade; the first is the effect's size and grows in proportion to the coefficients."""
        ...

    def grid(self, scale: JointLoadRange) -> tuple[Shape, ...]:
        """Shapes that a search tries; none where the law is not offered."""
        ...

    def explain_undetectable(self, loaded: Array, unloaded: Array, scale: JointLoadRange) -> str:
        """Why torques (N,) against those without load (N,) cannot show it; empty where they can."""
        ...


class JointLawDefaults:
    """What most laws answer: nothing is taken, nothing bounds them, every torque shows them."""

    word = ""
    includes_weight = False
    has_memory = False

    def compute_max_slope(self, values: Array, shape: Array, low: float, high: float) -> tuple[float, float]:
        return 0.0, np.nan

    def explain_undetectable(self, loaded: Array, unloaded: Array, scale: JointLoadRange) -> str:
        return ""


def is_time_dependent(law: JointLaw) -> bool:
    """It goes by time: one of its numbers is a time constant."""
    return any(p.unit == "s" for p in law.shape)


def compute_compliance_percent(value: float, compliance: float) -> Quantity:
    """A compliance as a share of the joint's own."""
    return Quantity(100.0 * value / compliance, "%")


@dataclass(frozen=True)
class JointAngleRange:
    """The angles of a joint that readings were taken at: what shapes of laws without load are of."""

    min_angle: float  # rad by encoder
    max_angle: float
    max_shapes: int  # shapes that as many distinct angles can tell from noise
    lowest_order: float = 1.0  # per turn of the joint: slower waves are another effect's (those of a balancer)
    is_motion: bool = False  # a motion in many samples; else settled poses


class JointAngleLaw(DescribedLaw, Protocol):
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
    def sum_name(self) -> str:
        """What several of its shapes at one place are called, one law again: "waves"; empty: they are none."""
        ...

    @property
    def has_angle_range(self) -> bool:
        """It holds at the angles it was measured over, and fades out beyond; else everywhere."""
        ...

    def columns(self, shape: Array, angle: Array, derivative: int = 0) -> Array:
        """(..., P) rad per unit of each coefficient at angles (...,) rad, or a derivative by the angle."""
        ...

    def compute_max_slope(self, values: Array, shape: Array) -> float:
        """The most that Δ changes, rad per rad of the angle."""
        ...

    def compute_max_error(self, values: Array, shape: Array) -> float:
        """The most that Δ is to either side, rad; infinite where angles bound it alone."""
        ...

    def sizes(self, values: Array, shape: Array) -> Mapping[str, Quantity]:
        """Numbers of the trade; the first is the effect's size and grows in proportion to the coefficients."""
        ...

    def grid(self, swept: JointAngleRange) -> tuple[Shape, ...]:
        """Shapes that a search tries; none where these angles cannot show it."""
        ...


class JointAngleLawDefaults:
    """What most laws without load answer: at once, everywhere, and nothing is known of their size."""

    word = ""
    has_memory = False
    prior: float | None = None
    has_angle_range = False
    static_only = False  # no motion is searched for it
    shape: tuple[LawParameter, ...] = ()

    @property
    def penalty(self) -> float:
        return 0.0

    @property
    def sum_name(self) -> str:
        return ""

    def grid(self, swept: JointAngleRange) -> tuple[Shape, ...]:
        return () if self.static_only and swept.is_motion else ((),)


class ParallelTorqueLaw(DescribedLaw, Protocol):
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
class FrictionState:
    """How a joint moves in K samples, as its friction feels it; of a slide m for rad and N for N·m."""

    speed: Array  # (K,) rad/s
    friction_direction: Array  # (K,) −1 … 1, which way friction points
    load: Array  # (K,) N·m, size of the torque that it carries
    segment_start: Ints  # (K,) 1 where a segment begins
    time_step: float  # s between samples
    warmth: Callable[[float], Array]  # (K,) 0 … 1 for a time constant in s; of zero by the recorded temperature
    is_prismatic: bool = False


@dataclass(frozen=True)
class JointSpeedRange:
    """How a joint moves in a recording: what shapes of friction are of."""

    max_speed: float  # rad/s, about its largest speed
    has_varying_load: bool  # what it carries changes
    warming_times: tuple[float, ...] = ()  # s, time constants that the recording can show


class FrictionLaw(DescribedLaw, Protocol):
    """A torque of the motor beyond Coulomb and viscous friction, linear in its coefficients. Stateless; SI."""

    @property
    def note(self) -> str:
        """Where it shows."""
        ...

    @property
    def plots_over_angle(self) -> bool:
        """Its picture is over the joint's angle; else over its speed."""
        ...

    def columns(self, shape: Array, seen: FrictionState) -> Array:
        """(K, P) N·m per unit of each coefficient."""
        ...

    def sizes(self, values: Array, shape: Array, seen: FrictionState) -> Mapping[str, Quantity]:
        """Numbers of the trade; the first is the effect's size and grows in proportion to the coefficients."""
        ...

    def grid(self, pace: JointSpeedRange) -> tuple[Shape, ...]:
        """Shapes that a search tries; none where the recording cannot show it."""
        ...


@dataclass(frozen=True)
class VibrationLoading:
    """How a joint's spring is loaded in K samples, and what swings on it."""

    load: Array  # (K,) N·m that twists the joint forward
    inertia: Array  # (K,) kg·m² behind the spring
    time_step: Array  # (K,) s since the sample before
    segment_start: Ints  # (K,) 1 where a segment begins, at rest under its load


class VibrationLaw(DescribedLaw, Protocol):
    """A joint's spring with what swings on it, linear in a compliance. Stateless; SI."""

    def stiffness(self, shape: Array, seen: VibrationLoading) -> float:
        """N·m/rad that a shape means here."""
        ...

    def deflection(self, shape: Array, seen: VibrationLoading) -> Array:
        """(K,) rad, how far a spring of that stiffness gives; times stiffness and compliance it is the twist."""
        ...

    def sizes(self, compliance: float, shape: Array, seen: VibrationLoading) -> Mapping[str, Quantity]:
        """Numbers of the trade; the first is the effect's size and grows in proportion to the compliance."""
        ...

    def grid(self, rate: float, gain: Callable[[Shape], float] | None = None) -> tuple[Shape, ...]:
        """Shapes that a search tries in samples at a rate in Hz.

        Args:
            gain: power that a shape's column takes, for a grid that ends with the best; None: it shall stay coarse.
        """
        ...


@dataclass(frozen=True, kw_only=True)
class MotorLoading:
    """What the gears of a place's joints (J of them, in order) do in K samples, as their motors feel it."""

    required_torque: Array  # (K, J) N·m that rigid bodies ask of each
    speed: Array  # (K, J) rad/s
    acceleration: Array  # (K, J) rad/s²
    compute_friction_direction: Callable[
        [Array], Array
    ]  # speed (K,) of the last joint's motor → (K,) −1 … 1, which way its friction points


class MotorLaw(DescribedLaw, Protocol):
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
    def absorbed_by_gain(self) -> bool:
        """What a gain of each joint takes up that is refitted in any case, where currents stand for torques."""
        ...

    def columns(self, shape: Array, seen: MotorLoading) -> Array:
        """(K, J, P) N·m per unit of each coefficient."""
        ...

    def sizes(self, values: Array, shape: Array, seen: MotorLoading) -> Mapping[str, Quantity]:
        """Numbers of the trade; the first is the effect's size and grows in proportion to the coefficients."""
        ...

    def grid(self) -> tuple[Shape, ...]:
        """Shapes that a search tries."""
        ...
