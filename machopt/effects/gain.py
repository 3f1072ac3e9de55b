"""The torque that a drive tells is its current times a constant, and the constant is another one.

Friction and the motor's own inertia are refitted of each joint in any case and grow with it; what shows the gain is the
weight and the inertia of the arm, which all joints share.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np

from machopt.arrays import Array
from machopt.effects.protocol import Geared, Parameter, Quantity, Shape


@dataclass(frozen=True)
class TooMuch:
    """One joint's torque reads a share too much."""

    word = ""
    remembers = False
    name = "gain of one drive"
    equation = "τ recorded = (1 + g) τ; the constants of drives are off by some percent, and fall as motors warm"
    note = "in proportion to what the joint carries, at this joint alone"
    penalty = 0.0
    of_gain = True
    coefficients = (Parameter(key="too_much", unit="1"),)
    shape: tuple[Parameter, ...] = ()

    def columns(self, shape: Array, seen: Geared) -> Array:
        return seen.needed[:, :, None]

    def sizes(self, values: Array, shape: Array, seen: Geared) -> Mapping[str, Quantity]:
        return {
            "gain": Quantity(100.0 * float(np.abs(values[0])), "%"),
            "too_much": Quantity(100.0 * float(values[0]), "%"),
        }

    def grid(self) -> tuple[Shape, ...]:
        return ((),)
