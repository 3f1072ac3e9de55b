"""The range of angles that a transmission error was measured over, outside of which it is not applied.

A sum of waves follows what was measured and nothing else: a quarter of a turn further it is as likely wrong by its own
size as right. Beyond either end it fades out over :data:`FADE`, so smoothly that the jerk of a path stays continuous:
w(t) = t⁴ (35 − 84 t + 70 t² − 20 t³), w' = 140 t³ (1 − t)³.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from math import comb
from typing import Any

import numpy as np

from machopt.effects.law_interfaces.law_parameters import DEGREE
from machopt.numerics.array_types import Array

RANGE_KEY = "range_deg"
FADE = 5.0 * DEGREE
STEEPEST = 35.0 / 16.0  # w' in the middle
MAX_ANGLE_GAP = 20.0 * DEGREE  # poses whose joint stands so far from all others show nothing of the way there
MIN_ANGLES = 3  # angles that a range is stated of


@dataclass(frozen=True)
class AngleRange:
    """Encoder angles in rad, both ends included."""

    low: float
    high: float

    def weight(self, angle: Array, derivative: int = 0) -> Array:
        """(...,) 1 inside, 0 farther than :data:`FADE` from it, or a derivative by the angle of up to three."""
        up, down = ((angle - self.low) / FADE + 1.0, (self.high - angle) / FADE + 1.0)
        if not derivative:
            return np.asarray(_compute_fade(up, 0) * _compute_fade(down, 0))
        sign = -1.0 if derivative % 2 else 1.0  # one of the two is constant everywhere
        return np.asarray((_compute_fade(up, derivative) + sign * _compute_fade(down, derivative)) / FADE**derivative)


def differentiate_weighted_product(weight: AngleRange, angle: Array, other: list[Array], derivative: int) -> Array:
    """A derivative of weight × other by the angle, from those of the other up to it."""
    return np.asarray(
        sum(comb(derivative, k) * weight.weight(angle, derivative - k) * other[k] for k in range(derivative + 1))
    )


def read_angle_range(parameters: Mapping[str, Any]) -> AngleRange | None:
    """The range of an entry of kinematics.yaml; None where it states none: the whole turn."""
    if RANGE_KEY not in parameters:
        return None
    low, high = parameters[RANGE_KEY]
    return AngleRange(low * DEGREE, high * DEGREE)


def compute_measured_range(angle: Array) -> list[float]:
    """What an entry states of the angles (N,) rad that it was found at, deg; ends that stand alone do not count."""
    q = np.sort(angle) / DEGREE
    first, last = 0, len(q) - 1
    while last - first >= MIN_ANGLES and q[first + 1] - q[first] > MAX_ANGLE_GAP / DEGREE:
        first += 1
    while last - first >= MIN_ANGLES and q[last] - q[last - 1] > MAX_ANGLE_GAP / DEGREE:
        last -= 1
    low, high = np.round(1e3 * q[[first, last]], 3)  # thousandths outward, rounding of degrees apart
    return [float(np.floor(low) / 1e3), float(np.ceil(high) / 1e3)]


def _compute_fade(t: Array, derivative: int) -> Array:
    t = np.clip(t, 0.0, 1.0)
    u = t * (1.0 - t)
    return np.asarray(
        (
            t**4 * (35.0 - 84.0 * t + 70.0 * t**2 - 20.0 * t**3),
            140.0 * u**3,
            420.0 * u**2 * (1.0 - 2.0 * t),
            840.0 * u * (1.0 - 5.0 * u),
        )[derivative]
    )
