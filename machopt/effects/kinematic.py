"""Where the arm stands without any load: zeros of the encoders, waves of the gears.

The true angle of joint j is q_j + Δ_j(q), q what the encoders say; compensated in the exported joints.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np

from machopt.arrays import Array
from machopt.effects.protocol import DEGREE, JOINTS, Effect, Parameter, Quantity
from machopt.effects.waves import ARCSEC, waves


@dataclass(frozen=True)
class Constant:
    """Δ_j = δ."""

    word = ""
    remembers = False
    equation = "Δ_j = δ"
    coefficients = (
        Parameter(
            key="offset_deg", unit="rad", factor=DEGREE, positive=False, required=True, most=10.0, said="degrees"
        ),
    )
    shape: tuple[Parameter, ...] = ()

    def columns(self, shape: Array, angle: Array, derivative: int = 0) -> Array:
        return np.full((*np.shape(angle), 1), 0.0 if derivative else 1.0)

    def steepest(self, values: Array, shape: Array) -> float:
        return 0.0

    def sizes(self, values: Array, shape: Array) -> Mapping[str, Quantity]:
        return {"offset": Quantity(float(values[0] / DEGREE), "deg")}


@dataclass(frozen=True)
class Waves:
    """Δ_j = Σ a_n cos n q_j + b_n sin n q_j; values a and b of each order in turn."""

    word = ""
    remembers = False
    equation = "Δ_j = Σ a_n cos nq_j + b_n sin nq_j"
    coefficients = tuple(
        Parameter(
            key=f"{f}_arcsec",
            unit="rad",
            factor=ARCSEC,
            many=True,
            bare=True,
            required=True,
            most=7200.0,
            said="arcsec",
        )
        for f in ("cos", "sin")
    )
    shape = (
        Parameter(
            key="per_turn",
            unit="1/rev",
            positive=True,
            many=True,
            bare=True,
            required=True,
            most=1e4,
            said="waves a turn of the joint",
        ),
    )

    def columns(self, shape: Array, angle: Array, derivative: int = 0) -> Array:
        return waves(angle, shape, derivative)

    def steepest(self, values: Array, shape: Array) -> float:
        return float(shape @ np.hypot(values[0::2], values[1::2]))

    def sizes(self, values: Array, shape: Array) -> Mapping[str, Quantity]:
        each = [Quantity(float(v), "arcsec") for v in np.hypot(values[0::2], values[1::2]) / ARCSEC]
        # the first number must vanish with the coefficients only: the largest of the waves
        out = {"amplitude": max(each, key=lambda v: v.value), "order": Quantity(float(shape[0]), "1/rev")}
        return out | ({"second_amplitude": each[1]} if len(each) > 1 else {})


ZERO = Effect(
    name="joint_zero_offset",
    noun="zero offset",
    sentence="The mastering of the joint is off by a constant angle.",
    port="angle",
    places=JOINTS,
    unloaded=Constant(),
    plausible={"deg": 10.0},
)

WAVES = Effect(
    name="transmission_error",
    noun="transmission error",
    sentence="The gear runs ahead and behind periodically, with no load at all.",
    port="angle",
    places=JOINTS,
    unloaded=Waves(),
    form=0.1,
    plausible={"arcsec": 3600.0},
)
