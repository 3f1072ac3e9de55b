"""The torque that a drive tells is its current times a constant, and the constant is another one.

Friction and the motor's own inertia are refitted of each joint in any case and grow with it; what shows the gain is the
weight and the inertia of the arm, which all joints share.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np

from machopt.effects.protocol import LawParameter, MotorLoading, Quantity, Shape
from machopt.numerics.array_types import Array


@dataclass(frozen=True)
class DriveGainError:
    """One joint's torque reads a share too much."""

    word = ""
    has_memory = False
    name = "gain of one drive"
    equation = "τ recorded = (1 + g) τ; the constants of drives are off by some percent, and fall as motors warm"
    note = "in proportion to what the joint carries, at this joint alone"
    penalty = 0.0
    absorbed_by_gain = True
    coefficients = (LawParameter(key="too_much", unit="1"),)
    shape: tuple[LawParameter, ...] = ()

    def columns(self, shape: Array, seen: MotorLoading) -> Array:
        return seen.required_torque[:, :, None]

    def sizes(self, values: Array, shape: Array, seen: MotorLoading) -> Mapping[str, Quantity]:
        return {
            "gain": Quantity(100.0 * float(np.abs(values[0])), "%"),
            "too_much": Quantity(100.0 * float(values[0]), "%"),
        }

    def grid(self) -> tuple[Shape, ...]:
        return ((),)
