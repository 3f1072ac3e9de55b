"""Interfaces of laws of moving joints: motor friction, vibration of a joint on its spring, recorded drive torques."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass
from typing import Protocol

from machopt.effects.law_interfaces.law_parameters import DescribedLaw, Ints, Quantity, Shape
from machopt.numerics.array_types import Array


@dataclass(frozen=True, kw_only=True)
class FrictionState:
    """Motion of one joint in K samples, as input to friction laws. For a prismatic joint read m for rad and N for
    N·m.
    """

    speed: Array  # (K,) rad/s
    friction_direction: Array  # (K,) −1 … 1, which way friction points
    load: Array  # (K,) N·m, magnitude of the transmitted torque
    segment_start: Ints  # (K,) 1 where a segment begins
    time_step: float  # s between samples
    warmth: Callable[[float], Array]  # time constant in s → (K,) warm-up state 0 … 1; zero: by the recorded temperature
    is_prismatic: bool = False


@dataclass(frozen=True)
class JointSpeedRange:
    """Speeds of one joint in a recording. Shapes of friction laws are derived from it."""

    max_speed: float  # rad/s, about its largest speed
    has_varying_load: bool  # the transmitted torque varies
    warming_times: tuple[float, ...] = ()  # s, time constants that the recording can show


class FrictionLaw(DescribedLaw, Protocol):
    """Law of a motor torque beyond Coulomb and viscous friction, linear in its coefficients. Stateless; SI."""

    @property
    def note(self) -> str:
        """Where the effect is visible."""
        ...

    @property
    def plots_over_angle(self) -> bool:
        """Whether its figure is plotted over the joint's angle; else over its speed."""
        ...

    def columns(self, shape: Array, friction_state: FrictionState) -> Array:
        """Return the friction torque per unit of each coefficient.

        Args:
            shape: (S,) shape parameters of the law (nonlinear), SI, in the order of ``self.shape``.
            friction_state: Input of the law for K samples.

        Returns:
            (K, P) N·m per unit of each coefficient.
        """
        ...

    def sizes(self, values: Array, shape: Array, friction_state: FrictionState) -> Mapping[str, Quantity]:
        """Return the coefficients as reported quantities.

        Args:
            values: (P,) coefficients of the law (linear), SI, in the order of ``self.coefficients``.
            shape: (S,) shape parameters of the law (nonlinear), SI, in the order of ``self.shape``.
            friction_state: Input of the law for K samples.

        Returns:
            Quantities by name. The first one is the size of the effect and is proportional to the coefficients.
        """
        ...

    def grid(self, pace: JointSpeedRange) -> tuple[Shape, ...]:
        """Return the shapes that a search tries.

        Args:
            pace: Speeds, load variation and warm-up times that the recording covers.

        Returns:
            Shapes in SI; empty if the recording cannot show the effect.
        """
        ...


@dataclass(frozen=True)
class VibrationLoading:
    """Load and inertia of a joint's spring in K samples."""

    load: Array  # (K,) N·m, positive in the joint's positive direction
    inertia: Array  # (K,) kg·m² behind the spring
    time_step: Array  # (K,) s since the sample before
    segment_start: Ints  # (K,) 1 where a segment begins, at rest under its load


class VibrationLaw(DescribedLaw, Protocol):
    """Law of a joint's spring with the inertia behind it, linear in a compliance. Stateless; SI."""

    def stiffness(self, shape: Array, vibration_loading: VibrationLoading) -> float:
        """Return the stiffness that a shape implies for this inertia.

        Args:
            shape: (S,) shape parameters of the law (nonlinear), SI, in the order of ``self.shape``.
            vibration_loading: Input of the law for K samples.

        Returns:
            N·m/rad.
        """
        ...

    def deflection(self, shape: Array, vibration_loading: VibrationLoading) -> Array:
        """Return the deflection of a spring of that stiffness. Times stiffness and compliance it is the joint twist.

        Args:
            shape: (S,) shape parameters of the law (nonlinear), SI, in the order of ``self.shape``.
            vibration_loading: Input of the law for K samples.

        Returns:
            (K,) rad.
        """
        ...

    def sizes(self, compliance: float, shape: Array, vibration_loading: VibrationLoading) -> Mapping[str, Quantity]:
        """Return the compliance and the shape as reported quantities.

        Args:
            compliance: Fitted joint compliance, rad/(N·m).
            shape: (S,) shape parameters of the law (nonlinear), SI, in the order of ``self.shape``.
            vibration_loading: Input of the law for K samples.

        Returns:
            Quantities by name. The first one is the size of the effect and is proportional to the compliance.
        """
        ...

    def grid(self, rate: float, gain: Callable[[Shape], float] | None = None) -> tuple[Shape, ...]:
        """Return the shapes that a search tries.

        Args:
            rate: Sampling rate, Hz.
            gain: Function that returns the power explained by a shape's column. The grid then ends with the refined
                best shape. None returns a coarse grid.

        Returns:
            Shapes in SI.
        """
        ...


@dataclass(frozen=True, kw_only=True)
class MotorLoading:
    """Required torque and motion of the J joints of a place in K samples, as input to motor laws."""

    required_torque: Array  # (K, J) N·m, required by the rigid-body model
    speed: Array  # (K, J) rad/s
    acceleration: Array  # (K, J) rad/s²
    compute_friction_direction: Callable[
        [Array], Array
    ]  # speed (K,) of the last joint's motor → (K,) −1 … 1, which way its friction points


class MotorLaw(DescribedLaw, Protocol):
    """Law of the recorded drive torques beyond the joint's own motor model, linear in its coefficients. Stateless;
    SI.
    """

    @property
    def note(self) -> str:
        """Where the effect is visible."""
        ...

    @property
    def penalty(self) -> float:
        """Additional gain that the law must reach beyond that of its coefficients."""
        ...

    @property
    def absorbed_by_gain(self) -> bool:
        """Whether a fitted gain per joint already contains the effect, if currents are recorded instead of torques."""
        ...

    def columns(self, shape: Array, motor_loading: MotorLoading) -> Array:
        """Return the torque deviation per unit of each coefficient.

        Args:
            shape: (S,) shape parameters of the law (nonlinear), SI, in the order of ``self.shape``.
            motor_loading: Input of the law for K samples.

        Returns:
            (K, J, P) N·m per unit of each coefficient.
        """
        ...

    def sizes(self, values: Array, shape: Array, motor_loading: MotorLoading) -> Mapping[str, Quantity]:
        """Return the coefficients as reported quantities.

        Args:
            values: (P,) coefficients of the law (linear), SI, in the order of ``self.coefficients``.
            shape: (S,) shape parameters of the law (nonlinear), SI, in the order of ``self.shape``.
            motor_loading: Input of the law for K samples.

        Returns:
            Quantities by name. The first one is the size of the effect and is proportional to the coefficients.
        """
        ...

    def grid(self) -> tuple[Shape, ...]:
        """Return the shapes that a search tries."""
        ...
