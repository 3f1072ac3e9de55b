"""Joint angle errors without load: encoder zero offsets and transmission errors of the gears.

The true angle of joint j is q_j + Δ_j(q), where q are the encoder angles. The exported joint values compensate it.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, replace

import numpy as np

from machopt.effects import prior_scales
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

LOW_ORDERS = 12  # per joint turn: parts that rotate with the output (rings, pins, bearings) cause low orders
HIGH_ORDER = 200.0  # per joint turn: about the largest gear ratio of a robot; parts that rotate with the motor
MAX_PHASE_ERROR = (
    0.7  # rad, half the phase difference of neighbouring orders at the ends of the range: 8 % of the amplitude
)
MOST_HIGH = 48  # orders above the low ones
SUM_NAME = "waves"
ORDINAL_WORDS = (
    "second",
    "third",
    "fourth",
    "fifth",
    "sixth",
)  # harmonics listed in a report; the file has all of them


@dataclass(frozen=True)
class ZeroOffset(JointAngleLawDefaults):
    """Δ_j = δ."""

    name = "constant angle"
    equation = "Δ_j = δ, at the TCP J_j δ (Mooring, Roth & Driels 1991, Fundamentals of Manipulator Calibration)"
    note = "without load, smooth over the poses"
    static_only = True  # channels of a motion fit encoder or tracker offsets themselves
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
        """Return 1 for the offset, or 0 for its derivatives.

        Args:
            shape: Empty; the law has no shape parameters.
            angle: (...,) encoder angles, rad.
            derivative: Order of the derivative with respect to the angle; 0 is the function itself.

        Returns:
            (..., 1) rad/rad.
        """
        return np.full((*np.shape(angle), 1), 0.0 if derivative else 1.0)

    def compute_max_slope(self, values: Array, shape: Array) -> float:
        """Return zero: the offset does not depend on the angle.

        Args:
            values: (P,) coefficients of the law (linear), SI, in the order of ``self.coefficients``.
            shape: Empty; the law has no shape parameters.

        Returns:
            Largest |dΔ/dq|, rad/rad.
        """
        return 0.0

    def compute_max_error(self, values: Array, shape: Array) -> float:
        """Return the magnitude of the offset.

        Args:
            values: (P,) coefficients of the law (linear), SI, in the order of ``self.coefficients``.
            shape: Empty; the law has no shape parameters.

        Returns:
            Largest |Δ|, rad.
        """
        return abs(float(values[0]))

    def sizes(self, values: Array, shape: Array) -> Mapping[str, Quantity]:
        """Return the offset in degrees.

        Args:
            values: (P,) coefficients of the law (linear), SI, in the order of ``self.coefficients``.
            shape: Empty; the law has no shape parameters.

        Returns:
            ``offset`` in deg.
        """
        return {"offset": Quantity(float(values[0] / DEGREE), "deg")}


@dataclass(frozen=True)
class TransmissionError(JointAngleLawDefaults):
    """Δ_j = Σ a_n cos n q_j + b_n sin n q_j; the values are a and b of each order in turn."""

    harmonics: int = 1  # number of harmonics that a search tries together

    note = "without load, periodic over the joint's angle"
    prior = prior_scales.WAVE_AMPLITUDE.scale
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
        """Return cosine and sine of each order at joint angles, or a derivative of them.

        Args:
            shape: (n,) orders per turn of the joint.
            angle: (...,) encoder angles, rad.
            derivative: Order of the derivative with respect to the angle; 0 is the function itself.

        Returns:
            (..., 2n) rad/rad^(derivative + 1).
        """
        return compute_harmonics(angle, shape, derivative)

    def compute_max_slope(self, values: Array, shape: Array) -> float:
        """Return an upper bound of the slope: Σ n √(a_n² + b_n²).

        Args:
            values: (P,) coefficients of the law (linear), SI, in the order of ``self.coefficients``.
            shape: (n,) orders per turn of the joint.

        Returns:
            Largest |dΔ/dq|, rad/rad.
        """
        return float(shape @ np.hypot(values[0::2], values[1::2]))

    def compute_max_error(self, values: Array, shape: Array) -> float:
        """Return an upper bound of the error: the sum of all amplitudes.

        Args:
            values: (P,) coefficients of the law (linear), SI, in the order of ``self.coefficients``.
            shape: (n,) orders per turn of the joint.

        Returns:
            Largest |Δ|, rad.
        """
        return float(np.sum(np.hypot(values[0::2], values[1::2])))

    def sizes(self, values: Array, shape: Array) -> Mapping[str, Quantity]:
        """Return amplitudes and orders, the largest amplitude first.

        Args:
            values: (P,) coefficients of the law (linear), SI, in the order of ``self.coefficients``.
            shape: (n,) orders per turn of the joint.

        Returns:
            Amplitudes in arcsec and orders in 1/rev.
        """
        each = np.hypot(values[0::2], values[1::2]) / ARCSEC
        return describe_wave_amplitudes(each, tuple(shape.tolist()), "arcsec", doubled=self.harmonics > 1)

    def grid(self, swept: JointAngleRange) -> tuple[Shape, ...]:
        """Return the orders that a search tries.

        Args:
            swept: Angle range of the joint that the readings cover.

        Returns:
            Shapes of ``harmonics`` orders, multiples of the first.
        """
        orders = list_testable_orders(swept)
        together = tuple(tuple(k * n for k in range(1, self.harmonics + 1)) for n in orders)
        return tuple(shape for shape in together if shape[-1] <= orders[-1])


def describe_wave_amplitudes(amplitudes: Array, orders: Shape, unit: str, *, doubled: bool) -> dict[str, Quantity]:
    """Return amplitudes and orders of harmonics as reported quantities, the largest first.

    The first quantity must be zero only if all coefficients are zero. It is therefore the largest amplitude.

    Args:
        amplitudes: (n,) amplitudes in ``unit``.
        orders: n orders per turn of the joint.
        unit: Unit of the amplitudes, for example "arcsec".
        doubled: Whether the harmonics are one order and its double, reported in this sequence.

    Returns:
        Quantities by name.
    """
    order_of_report = range(len(amplitudes)) if doubled else np.argsort(-amplitudes, kind="stable").tolist()
    out = {
        "amplitude": Quantity(float(amplitudes.max()), unit),
        "order": Quantity(float(orders[order_of_report[0]]), "1/rev"),
    }
    for word, n in zip(ORDINAL_WORDS, order_of_report[1:], strict=False):
        out[f"{word}_amplitude"] = Quantity(float(amplitudes[n]), unit)
        if not doubled:
            out[f"{word}_order"] = Quantity(float(orders[n]), "1/rev")
    return out


def list_testable_orders(swept: JointAngleRange) -> tuple[float, ...]:
    """List the orders per turn that the measured angles can resolve.

    Integer orders up to LOW_ORDERS are for parts that rotate with the output. Above, the grid is as fine as the angle
    range requires, limited by the number of distinct angles. With fewer angles some order among many fits any noise.
    A motion passes all angles in between: integer orders up to the highest.

    Args:
        swept: Angle range of the joint that the readings cover.

    Returns:
        Orders in 1/rev; empty if the angles cannot distinguish an order from noise.
    """
    span = swept.max_angle - swept.min_angle
    if not swept.max_shapes:
        return ()
    if swept.is_motion:
        return tuple(float(n) for n in range(int(np.ceil(swept.lowest_order)), int(HIGH_ORDER) + 1))
    step = 2.0 * MAX_PHASE_ERROR / (0.5 * span)
    first = max(
        swept.lowest_order, np.ceil(0.5 * np.pi / span)
    )  # a quarter of a wave is not distinguishable from offset and slope
    low = np.arange(first, LOW_ORDERS + 0.5)
    budget = swept.max_shapes - len(low)
    if budget > MOST_HIGH:  # integer orders suffice for a large range; a finer grid only takes longer
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
    form_uncertainty=0.0,  # a constant has no uncertain functional form
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


@dataclass(frozen=True)
class UnnamedAngleError(TransmissionError):
    """Δ_j = Σ a_n cos n q_j + b_n sin n q_j as a correction without a name; a search does not try it."""

    shape = (replace(TransmissionError.shape[0], key="orders"),)

    def grid(self, swept: JointAngleRange) -> tuple[Shape, ...]:
        """Return no shape: the waves of a transmission error are searched.

        Args:
            swept: Angle range of the joint that the readings cover.

        Returns:
            Nothing.
        """
        return ()


CORRECTION = Effect(
    name="kinematic_correction",
    noun="kinematic correction",
    sentence="Smooth angle errors of the joint that the readings show, and whose cause they do not tell.",
    port="angle",
    places=JOINTS,
    angle_laws=(UnnamedAngleError(),),
    form_uncertainty=0.1,
    plausible_sizes={"arcsec": 3600.0},
)
