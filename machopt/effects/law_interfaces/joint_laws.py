"""Interfaces of joint laws: the input that a law receives about one joint, and the outputs that it returns.

Twist by the joint torque, angle error without load, torque in parallel to the gear. Laws of moving joints are in
:mod:`machopt.effects.law_interfaces.motion_laws`.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Protocol

import numpy as np

from machopt.effects.law_interfaces.law_parameters import DescribedLaw, Ints, LawParameter, Quantity, Shape
from machopt.numerics.array_types import Array


@dataclass(frozen=True)
class JointLoading:
    """Loading of one joint in K states, in chronological order.

    Different load histories of a gear are different inputs to the same law.
    """

    torque: Array  # (..., ) N·m that the law follows
    angle: Array | None = None  # (...,) rad of the joint
    time_gap: Array | None = (
        None  # (K,) s since the state before, or since the gear was unloaded; see creep.filter_first_order
    )
    segment_start: Ints | None = None  # (K,) 1: a load history begins. None: states are independent and settled


@dataclass(frozen=True, kw_only=True)
class JointLoadRange:
    """Load and angle range of one joint in a recording or a plan. Reported shares and sizes refer to it."""

    max_torque: float  # N·m, about the largest torque
    compliance: float | None = None  # rad/(N·m) of the joint's own spring; None: not known yet
    min_angle: float = 0.0  # rad, range of its angle
    max_angle: float = 0.0
    longest_history: float = np.inf  # s, the longest uninterrupted load history
    is_motion: bool = False  # a sampled motion; else static readings


class JointLaw(DescribedLaw, Protocol):
    """Law of a joint twist that depends on the joint torque. Stateless; SI."""

    @property
    def includes_weight(self) -> bool:
        """It follows the whole torque of a joint, weight included, along a curve."""
        ...

    def columns(self, shape: Array, drive: JointLoading) -> Array:
        """Return the joint twist per unit of each coefficient, at each state.

        Args:
            shape: (S,) shape parameters of the law (nonlinear), SI, in the order of ``self.shape``.
            drive: Torque, angle and load history of the joint, one entry per state.

        Returns:
            (..., P) rad per unit of each coefficient.
        """
        ...

    def tangent(self, shape: Array, drive: JointLoading) -> Array:
        """Return the slope of the twist with respect to the torque, per unit of each coefficient.

        Args:
            shape: (S,) shape parameters of the law (nonlinear), SI, in the order of ``self.shape``.
            drive: Torque, angle and load history of the joint, one entry per state.

        Returns:
            (..., P); for a law with memory the largest slope that a lasting load can meet.
        """
        ...

    def compute_max_slope(self, values: Array, shape: Array, low: float, high: float) -> tuple[float, float]:
        """Return the largest reduction of the joint compliance over an angle range.

        Args:
            values: (P,) coefficients of the law (linear), SI, in the order of ``self.coefficients``.
            shape: (S,) shape parameters of the law (nonlinear), SI, in the order of ``self.shape``.
            low: Lower end of the joint's angle range, rad.
            high: Upper end of the joint's angle range, rad.

        Returns:
            Compliance change, ≤ 0 rad/(N·m), and the angle in rad at which it occurs (NaN if independent of it).
        """
        ...

    def limit_to_compliance(self, values: Array, room: float) -> JointLaw:
        """Return the law limited so that the joint compliance stays positive.

        Args:
            values: (P,) coefficients of the law (linear), SI, in the order of ``self.coefficients``.
            room: Compliance that the joint has left to lose before its slope becomes zero, rad/(N·m).

        Returns:
            The limited law; the law itself if it needs no limit.
        """
        ...

    def sizes(self, values: Array, shape: Array, scale: JointLoadRange) -> Mapping[str, Quantity]:
        """Return the coefficients as reported quantities.

        Args:
            values: (P,) coefficients of the law (linear), SI, in the order of ``self.coefficients``.
            shape: (S,) shape parameters of the law (nonlinear), SI, in the order of ``self.shape``.
            scale: Range of torque, angle and time that the recording or plan covers at this joint.

        Returns:
            Quantities by name. The first one is the size of the effect and is proportional to the coefficients.
        """
        ...

    def grid(self, scale: JointLoadRange) -> tuple[Shape, ...]:
        """Return the shapes that a search tries.

        Args:
            scale: Range of torque, angle and time that the recording or plan covers at this joint.

        Returns:
            Shapes in SI; empty if the law is not applicable to this range.
        """
        ...

    def explain_undetectable(self, loaded: Array, unloaded: Array, scale: JointLoadRange) -> str:
        """Explain why the torques cannot show the effect.

        Args:
            loaded: (N,) joint torques under load, N·m.
            unloaded: (N,) joint torques of the same poses without load, N·m.
            scale: Range of torque, angle and time that the recording or plan covers at this joint.

        Returns:
            The reason; empty if they can show it.
        """
        ...


class JointLawDefaults:
    """Default implementations shared by most joint laws: no compliance reduction, no bound, always detectable."""

    word = ""
    includes_weight = False
    has_memory = False

    def compute_max_slope(self, values: Array, shape: Array, low: float, high: float) -> tuple[float, float]:
        """Return zero: the law does not reduce the joint compliance.

        Args:
            values: (P,) coefficients of the law (linear), SI, in the order of ``self.coefficients``.
            shape: (S,) shape parameters of the law (nonlinear), SI, in the order of ``self.shape``.
            low: Lower end of the joint's angle range, rad.
            high: Upper end of the joint's angle range, rad.

        Returns:
            0 and NaN.
        """
        return 0.0, np.nan

    def explain_undetectable(self, loaded: Array, unloaded: Array, scale: JointLoadRange) -> str:
        """Return an empty reason: every torque shows the effect.

        Args:
            loaded: (N,) joint torques under load, N·m.
            unloaded: (N,) joint torques of the same poses without load, N·m.
            scale: Range of torque, angle and time that the recording or plan covers at this joint.

        Returns:
            An empty string.
        """
        return ""


def is_time_dependent(law: JointLaw) -> bool:
    """Return whether one of the law's shape parameters is a time constant.

    Args:
        law: Law to check.

    Returns:
        True if a shape parameter has the unit s.
    """
    return any(p.unit == "s" for p in law.shape)


def compute_compliance_percent(value: float, compliance: float) -> Quantity:
    """Return a compliance relative to the joint's own compliance.

    Args:
        value: Compliance, rad/(N·m).
        compliance: Compliance of the joint's spring, rad/(N·m).

    Returns:
        Quantity in %.
    """
    return Quantity(100.0 * value / compliance, "%")


@dataclass(frozen=True)
class JointAngleRange:
    """Angle range of one joint that the readings cover. Shapes of angle laws are derived from it."""

    min_angle: float  # rad by encoder
    max_angle: float
    max_shapes: int  # number of shapes that the distinct angles can distinguish from noise
    lowest_order: float = 1.0  # per joint turn: lower orders belong to other effects (gravity compensator)
    is_motion: bool = False  # a sampled motion; else static poses


class JointAngleLaw(DescribedLaw, Protocol):
    """Law of a joint angle error Δ(q) without load, by the joint's own angle or another joint's. Stateless; SI."""

    @property
    def note(self) -> str:
        """Where the effect is visible."""
        ...

    @property
    def penalty(self) -> float:
        """Additional gain that the law must reach in static poses beyond that of its coefficients, because it is
        flexible.
        """
        ...

    @property
    def prior(self) -> float | None:
        """Prior standard deviation (1σ) of each coefficient about zero in static poses; None if unknown."""
        ...

    @property
    def sum_name(self) -> str:
        """Name of a sum of several shapes at one place, for example "waves"; empty if shapes do not form a sum."""
        ...

    @property
    def has_angle_range(self) -> bool:
        """Whether the law is valid only over the measured angles and fades out beyond them."""
        ...

    def columns(self, shape: Array, angle: Array, derivative: int = 0) -> Array:
        """Return the angle error per unit of each coefficient, or a derivative of it.

        Args:
            shape: (S,) shape parameters of the law (nonlinear), SI, in the order of ``self.shape``.
            angle: (...,) encoder angles, rad.
            derivative: Order of the derivative with respect to the angle; 0 is the function itself.

        Returns:
            (..., P) rad per unit of each coefficient; derivatives per rad^n.
        """
        ...

    def compute_max_slope(self, values: Array, shape: Array) -> float:
        """Return the largest slope |dΔ/dq|.

        Args:
            values: (P,) coefficients of the law (linear), SI, in the order of ``self.coefficients``.
            shape: (S,) shape parameters of the law (nonlinear), SI, in the order of ``self.shape``.

        Returns:
            rad/rad.
        """
        ...

    def compute_max_error(self, values: Array, shape: Array) -> float:
        """Return the largest error |Δ|.

        Args:
            values: (P,) coefficients of the law (linear), SI, in the order of ``self.coefficients``.
            shape: (S,) shape parameters of the law (nonlinear), SI, in the order of ``self.shape``.

        Returns:
            rad; infinite if only the angle range bounds it.
        """
        ...

    def sizes(self, values: Array, shape: Array) -> Mapping[str, Quantity]:
        """Return the coefficients as reported quantities.

        Args:
            values: (P,) coefficients of the law (linear), SI, in the order of ``self.coefficients``.
            shape: (S,) shape parameters of the law (nonlinear), SI, in the order of ``self.shape``.

        Returns:
            Quantities by name. The first one is the size of the effect and is proportional to the coefficients.
        """
        ...

    def grid(self, swept: JointAngleRange) -> tuple[Shape, ...]:
        """Return the shapes that a search tries.

        Args:
            swept: Angle range of the joint that the readings cover.

        Returns:
            Shapes in SI; empty if these angles cannot show the effect.
        """
        ...


class JointAngleLawDefaults:
    """Default implementations shared by most angle laws: no memory, valid everywhere, no prior."""

    word = ""
    has_memory = False
    prior: float | None = None
    has_angle_range = False
    static_only = False  # not searched for in motions
    shape: tuple[LawParameter, ...] = ()

    @property
    def penalty(self) -> float:
        return 0.0

    @property
    def sum_name(self) -> str:
        return ""

    def grid(self, swept: JointAngleRange) -> tuple[Shape, ...]:
        """Return one empty shape; none for motions if the law is static only.

        Args:
            swept: Angle range of the joint that the readings cover.

        Returns:
            The shapes that a search tries.
        """
        return () if self.static_only and swept.is_motion else ((),)


class ParallelTorqueLaw(DescribedLaw, Protocol):
    """Law of a torque in parallel to the gear (a spring between two links), by the joint's own angle. Stateless; SI."""

    @property
    def penalty(self) -> float:
        """Additional gain that the law must reach in static poses beyond that of its coefficients, because it is
        flexible.
        """
        ...

    def torque(self, shape: Array, angle: Array) -> Array:
        """Return the torque per unit of each coefficient.

        Args:
            shape: (S,) shape parameters of the law (nonlinear), SI, in the order of ``self.shape``.
            angle: (...,) encoder angles, rad.

        Returns:
            (..., P) N·m per unit of each coefficient.
        """
        ...

    def slope(self, shape: Array, angle: Array) -> Array:
        """Return the derivative of the torque with respect to the angle; it reduces the stiffness of the joint.

        Args:
            shape: (S,) shape parameters of the law (nonlinear), SI, in the order of ``self.shape``.
            angle: (...,) encoder angles, rad.

        Returns:
            (..., P) N·m/rad per unit of each coefficient.
        """
        ...

    def sizes(self, values: Array) -> Mapping[str, Quantity]:
        """Return the coefficients as reported quantities.

        Args:
            values: (P,) coefficients of the law (linear), SI, in the order of ``self.coefficients``.

        Returns:
            Quantities by name.
        """
        ...

    def grid(self) -> tuple[Shape, ...]:
        """Return the shapes that a search tries."""
        ...
