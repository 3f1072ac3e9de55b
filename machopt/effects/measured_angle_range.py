"""Angle range over which a transmission error was measured. The correction is not applied outside of it.

A sum of harmonics is valid only where it was measured. A quarter of a turn further its error may equal its own
amplitude. Beyond either end it fades out over :data:`FADE`, smoothly enough for a continuous jerk of the path: w(t) =
t⁴ (35 − 84 t + 70 t² − 20 t³), w' = 140 t³ (1 − t)³.
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
MAX_ANGLE_GAP = 20.0 * DEGREE  # an outermost angle farther than this from the next one does not extend the range
MIN_ANGLES = 3  # fewest angles that define a range


@dataclass(frozen=True)
class AngleRange:
    """Encoder angles in rad, both ends included."""

    low: float
    high: float

    def weight(self, angle: Array, derivative: int = 0) -> Array:
        """Return the fade weight of the correction, or a derivative of it.

        Args:
            angle: (...,) encoder angles, rad.
            derivative: Order of the derivative with respect to the angle, 0 to 3.

        Returns:
            (...,) 1 inside the range and 0 farther than :data:`FADE` outside; derivatives in 1/rad^n.
        """
        up, down = ((angle - self.low) / FADE + 1.0, (self.high - angle) / FADE + 1.0)
        if not derivative:
            return np.asarray(_compute_fade(up, 0) * _compute_fade(down, 0))
        sign = -1.0 if derivative % 2 else 1.0  # one of the two is constant everywhere
        return np.asarray((_compute_fade(up, derivative) + sign * _compute_fade(down, derivative)) / FADE**derivative)


def differentiate_weighted_product(weight: AngleRange, angle: Array, other: list[Array], derivative: int) -> Array:
    """Return a derivative of weight(q) · f(q) with respect to the angle (Leibniz rule).

    Args:
        weight: Range that defines the fade weight.
        angle: (...,) encoder angles, rad.
        other: f and its derivatives up to ``derivative``, each of the shape of ``angle``.
        derivative: Order of the derivative with respect to the angle; 0 is the function itself.

    Returns:
        (...,) the derivative of the product.
    """
    return np.asarray(
        sum(comb(derivative, k) * weight.weight(angle, derivative - k) * other[k] for k in range(derivative + 1))
    )


def read_angle_range(parameters: Mapping[str, Any]) -> AngleRange | None:
    """Read the angle range of an entry of kinematics.yaml.

    Args:
        parameters: Parameters of the entry; ``range_deg`` holds both ends in degrees.

    Returns:
        The range in rad, or None if the entry states none and therefore holds for the whole turn.
    """
    if RANGE_KEY not in parameters:
        return None
    low, high = parameters[RANGE_KEY]
    return AngleRange(low * DEGREE, high * DEGREE)


def compute_measured_range(angle: Array) -> list[float]:
    """Compute the angle range that an entry states from the angles of its measurements.

    Outermost angles with a gap of more than :data:`MAX_ANGLE_GAP` to the next one are left out.

    Args:
        angle: (N,) measured joint angles, rad.

    Returns:
        [lower, upper] in degrees, rounded outward to 0.001 degree.
    """
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
