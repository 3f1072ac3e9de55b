"""Gain error of a drive: the recorded torque is the motor current times a constant, and the constant is wrong.

Friction and motor inertia are fitted for each joint anyway and scale with the gain. Gravity and inertia of the arm,
which all joints share, make the gain observable.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

from machopt.effects.protocol import LawParameter, MotorLoading, Quantity, Shape
from machopt.numerics.array_types import Array


@dataclass(frozen=True)
class DriveGainError:
    """Relative gain error of one joint's recorded torque."""

    word = ""
    has_memory = False
    name = "gain of one drive"
    equation = "τ recorded = (1 + g) τ; the constants of drives are off by some percent, and fall as motors warm"
    note = "in proportion to what the joint carries, at this joint alone"
    penalty = 0.0
    absorbed_by_gain = True
    coefficients = (LawParameter(key="too_much", unit="1"),)
    shape: tuple[LawParameter, ...] = ()

    def columns(self, shape: Array, motor_loading: MotorLoading) -> Array:
        """Return the torque error per unit of the gain error.

        Args:
            shape: (S,) shape parameters of the law (nonlinear), SI, in the order of ``self.shape``.
            motor_loading: Torque, speed and acceleration of the joint in K samples.

        Returns:
            (K, J, 1) N·m.
        """
        return motor_loading.required_torque[:, :, None]

    def sizes(self, values: Array, shape: Array, motor_loading: MotorLoading) -> Mapping[str, Quantity]:
        """Return the gain error.

        Args:
            values: (P,) coefficients of the law (linear), SI, in the order of ``self.coefficients``.
            shape: (S,) shape parameters of the law (nonlinear), SI, in the order of ``self.shape``.
            motor_loading: Torque, speed and acceleration of the joint in K samples.

        Returns:
            ``gain`` in %, positive where the drive reads too much.
        """
        return {"gain": Quantity(100.0 * float(values[0]), "%")}

    def grid(self) -> tuple[Shape, ...]:
        return ((),)
