"""The balancer of joint 2: a spring between two pivots s apart, s² = a² + L² + 2 a L cos(α + q₂), force F₀ + k s.

Its torque −(F₀ + k s) ds/dq changes with the joint's angle; its slope is a stiffness beside the gear. Lengths come as
the ratio a/L; F₀ L and k L² are torques (Klimchik et al. arXiv 1311.6810).
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from machopt.effects.protocol import DEGREE, Array, Effect, Parameter, Shape

RATIOS = (0.15, 0.35, 0.7)  # a/L that are tried
ANGLES = tuple(np.radians(np.arange(0.0, 360.0, 30.0)).tolist())  # rad, α that are tried
GRID: tuple[Shape, ...] = tuple((a, b) for a in RATIOS for b in ANGLES)


@dataclass(frozen=True)
class Balancer:
    """Coefficients F₀ L and k L², shape a/L and α."""

    word = ""
    remembers = False
    coefficients = (
        Parameter(key="force_times_length_Nm", unit="N·m"),
        Parameter(key="rate_times_length2_Nm", unit="N·m"),
    )
    shape = (
        Parameter(key="ratio", unit="1", positive=True),
        Parameter(key="angle_deg", unit="rad", factor=DEGREE),
    )


BALANCER = Balancer()


def torques(q: Array, ratio: float, alpha: float) -> tuple[Array, Array]:
    """(..., 2) torque on the joint per F₀ L and per k L², and its derivative by the angle q (...,) rad."""
    angle = alpha + q
    s = np.sqrt(ratio**2 + 1.0 + 2.0 * ratio * np.cos(angle))  # in units of L
    ds = -ratio * np.sin(angle) / s
    dds = (-ratio * np.cos(angle) - ds**2) / s
    return np.stack([-ds, -s * ds], axis=-1), np.stack([-dds, -(ds**2 + s * dds)], axis=-1)


EFFECT = Effect(
    name="gravity_compensator",
    noun="gravity compensator",
    sentence="The spring or gas cylinder at joint 2 carries a torque that depends on its angle.",
    port="torque",
    places=("joint:2",),
    elastic=True,
    form=0.2,
)
