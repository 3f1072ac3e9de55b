"""Where the arm stands without any load: zeros of the encoders, waves of the gears.

The true angle of joint j is q_j + Δ_j(q), q what the encoders say; compensated in the exported joints.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np

from machopt.effects.joint.harmonic_functions import ARCSEC, compute_harmonics
from machopt.effects.protocol import (
    DEGREE,
    JOINTS,
    Effect,
    JointAngleLawDefaults,
    JointAngleRange,
    LawParameter,
    Quantity,
    Shape,
)
from machopt.numerics.array_types import Array

LOW_ORDERS = 12  # per turn of the joint: what turns with the output (rings, pins, bearings) comes round a few times
HIGH_ORDER = 200.0  # per turn: about the largest ratio of a robot's reducer, what turns with the motor
MAX_PHASE_ERROR = (
    0.7  # rad, half the phase that neighbouring orders may part by at the ends of the range: 8 % of amplitude
)
MOST_HIGH = 48  # orders above the low ones
SUM_NAME = "waves"
ORDINAL_WORDS = ("second", "third", "fourth", "fifth", "sixth")  # waves of a sum that are told; the file has all


@dataclass(frozen=True)
class ZeroOffset(JointAngleLawDefaults):
    """Δ_j = δ."""

    name = "constant angle"
    equation = "Δ_j = δ, at the TCP J_j δ (Mooring, Roth & Driels 1991, Fundamentals of Manipulator Calibration)"
    note = "without load, smooth over the poses"
    static_only = True  # a motion's channels refit offsets of encoders, or of what is tracked
    coefficients = (
        LawParameter(
            key="offset_deg",
            unit="rad",
            factor=DEGREE,
            positive=False,
            required=True,
            magnitude_limit=10.0,
            unit_in_words="degrees",
        ),
    )

    def columns(self, shape: Array, angle: Array, derivative: int = 0) -> Array:
        return np.full((*np.shape(angle), 1), 0.0 if derivative else 1.0)

    def compute_max_slope(self, values: Array, shape: Array) -> float:
        return 0.0

    def compute_max_error(self, values: Array, shape: Array) -> float:
        return abs(float(values[0]))

    def sizes(self, values: Array, shape: Array) -> Mapping[str, Quantity]:
        return {"offset": Quantity(float(values[0] / DEGREE), "deg")}


@dataclass(frozen=True)
class TransmissionError(JointAngleLawDefaults):
    """Δ_j = Σ a_n cos n q_j + b_n sin n q_j; values a and b of each order in turn."""

    harmonics: int = 1  # that a search tries together

    note = "without load, periodic over the joint's angle"
    prior = 3e-4  # rad: a robot's gears run a minute of arc ahead and behind, strain wave gears more
    has_angle_range = True
    coefficients = tuple(
        LawParameter(
            key=f"{f}_arcsec",
            unit="rad",
            factor=ARCSEC,
            is_list=True,
            is_scalar_for_one_branch=True,
            required=True,
            magnitude_limit=7200.0,
            unit_in_words="arcsec",
        )
        for f in ("cos", "sin")
    )
    shape = (
        LawParameter(
            key="per_turn",
            unit="1/rev",
            positive=True,
            is_list=True,
            is_scalar_for_one_branch=True,
            required=True,
            magnitude_limit=1e4,
            unit_in_words="waves a turn of the joint",
        ),
    )

    @property
    def name(self) -> str:
        return "one wave" if self.harmonics == 1 else "a wave and its double"

    @property
    def sum_name(self) -> str:
        return SUM_NAME if self.harmonics == 1 else ""

    @property
    def equation(self) -> str:
        law = "a cos Nq_j + b sin Nq_j" if self.harmonics == 1 else "Σ_{n = N, 2N} a_n cos nq_j + b_n sin nq_j"
        return f"Δ_j = {law}, at the TCP J_j Δ_j (Whitney, Lozinski & Rourke 1986)"

    @property
    def penalty(self) -> float:
        return 2.0 * (self.harmonics - 1)

    def columns(self, shape: Array, angle: Array, derivative: int = 0) -> Array:
        return compute_harmonics(angle, shape, derivative)

    def compute_max_slope(self, values: Array, shape: Array) -> float:
        return float(shape @ np.hypot(values[0::2], values[1::2]))

    def compute_max_error(self, values: Array, shape: Array) -> float:
        return float(np.sum(np.hypot(values[0::2], values[1::2])))

    def sizes(self, values: Array, shape: Array) -> Mapping[str, Quantity]:
        each = np.hypot(values[0::2], values[1::2]) / ARCSEC
        return describe_wave_amplitudes(each, tuple(shape.tolist()), "arcsec", doubled=self.harmonics > 1)

    def grid(self, swept: JointAngleRange) -> tuple[Shape, ...]:
        orders = list_testable_orders(swept)
        together = tuple(tuple(k * n for k in range(1, self.harmonics + 1)) for n in orders)
        return tuple(shape for shape in together if shape[-1] <= orders[-1])


def describe_wave_amplitudes(amplitudes: Array, orders: Shape, unit: str, *, doubled: bool) -> dict[str, Quantity]:
    """What is told of waves, the largest first; ``doubled``: of one and its double, in this order.

    The first number must vanish with the coefficients only: it is the largest amplitude.
    """
    at = range(len(amplitudes)) if doubled else np.argsort(-amplitudes, kind="stable").tolist()
    out = {"amplitude": Quantity(float(amplitudes.max()), unit), "order": Quantity(float(orders[at[0]]), "1/rev")}
    for word, n in zip(ORDINAL_WORDS, at[1:], strict=False):
        out[f"{word}_amplitude"] = Quantity(float(amplitudes[n]), unit)
        if not doubled:
            out[f"{word}_order"] = Quantity(float(orders[n]), "1/rev")
    return out


def list_testable_orders(swept: JointAngleRange) -> tuple[float, ...]:
    """Orders per turn that angles of a joint can show and tell apart; none where they tell nothing from noise.

    Whole orders up to LOW_ORDERS (parts that turn with the output). Above, a grid as fine as the range asks for, up
    to as many as there are angles for: with fewer, some order among many fits any noise. A motion passes all angles
    between: whole orders, up to the highest.
    """
    span = swept.max_angle - swept.min_angle
    if not swept.max_shapes:
        return ()
    if swept.is_motion:
        return tuple(float(n) for n in range(int(np.ceil(swept.lowest_order)), int(HIGH_ORDER) + 1))
    step = 2.0 * MAX_PHASE_ERROR / (0.5 * span)
    first = max(swept.lowest_order, np.ceil(0.5 * np.pi / span))  # a quarter of a wave is an offset and a slope
    low = np.arange(first, LOW_ORDERS + 0.5)
    budget = swept.max_shapes - len(low)
    if budget > MOST_HIGH:  # whole orders of a joint that turns far: a finer grid only takes longer
        budget, step = MOST_HIGH, max(step, 1.0)
    high = LOW_ORDERS + step * np.arange(1, max(budget, 0) + 1)
    return tuple(float(n) for n in np.concatenate([low, high[high <= HIGH_ORDER]]))


ZERO = Effect(
    name="joint_zero_offset",
    noun="zero offset",
    sentence="The mastering of the joint is off by a constant angle.",
    port="angle",
    places=JOINTS,
    angle_laws=(ZeroOffset(),),
    form_uncertainty=0.0,  # a constant is its own form
    plausible_sizes={"deg": 10.0},
)

WAVES = Effect(
    name="transmission_error",
    noun="transmission error",
    sentence="The gear runs ahead and behind periodically, with no load at all.",
    port="angle",
    places=JOINTS,
    angle_laws=(TransmissionError(), TransmissionError(2)),
    form_uncertainty=0.1,
    plausible_sizes={"arcsec": 3600.0},
)
