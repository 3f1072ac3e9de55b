"""Creep: the part of the twist that follows the load with a delay (first-order lag) and recovers with the same delay.

A plan uses the worst case, reached after a few time constants of steady load. A shorter cut deflects the arm less, by
the factor 1 − exp(−t/T).
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np

from machopt.effects.protocol import (
    ARCMIN,
    COMPLIANCE,
    JOINTS,
    Effect,
    Ints,
    JointLaw,
    JointLawDefaults,
    JointLoading,
    JointLoadRange,
    LawParameter,
    Quantity,
    Shape,
    compute_compliance_percent,
)
from machopt.numerics.array_types import Array
from machopt.numerics.compiled_functions import jit_compile

STEPS = (3.0, 8.0, 20.0, 50.0, 120.0, 300.0)  # s, tried in load tests
STEP_PAIRS = ((3.0, 20.0), (3.0, 60.0), (8.0, 60.0), (8.0, 200.0))
SAMPLES = (0.5, 1.5, 4.0, 12.0, 40.0)  # s, in motions


@jit_compile
def _filter_first_order(x: Array, gap: Array, first: Ints, constant: float) -> Array:
    out = np.empty_like(x)
    y = 0.0
    for n in range(len(x)):
        if first[n]:
            y = 0.0
        passed = gap[n]
        if np.isnan(passed):
            passed = constant
        elif passed < 0.0:
            passed = max(-passed - constant, 0.0)
        y = x[n] + (y - x[n]) * np.exp(-passed / constant)
        out[n] = y
    return out


def filter_first_order(x: Array, gap: Array, first: Ints, constant: float) -> Array:
    """Apply a first-order lag T ẏ + y = x, with x constant over the interval before each state.

    Args:
        x: (K,) input, for example torques in N·m.
        gap: (K,) s since the state before, or since y was zero. Infinite: y has settled. NaN: unknown, T is used.
            Negative: that long, minus T, which the next state takes.
        first: (K,) 1 where a load history begins, at y = 0.
        constant: Time constant T, s.

    Returns:
        (K,) output y at each state, in the unit of x.
    """
    return np.asarray(
        _filter_first_order(
            np.ascontiguousarray(x, float),
            np.ascontiguousarray(gap, float),
            np.ascontiguousarray(first, np.int64),
            float(constant),
        )
    )


@dataclass(frozen=True)
class ViscoelasticCreep(JointLawDefaults):
    """T_n ẋ_n + x_n = a_n τ; φ = Σ x_n."""

    count: int
    coefficients = (
        LawParameter(
            key="extra_rad_per_Nm", unit=COMPLIANCE, lower_limit=0.0, is_list=True, is_scalar_for_one_branch=True
        ),
    )
    shape = (LawParameter(key="time_constant_s", unit="s", positive=True, is_list=True, is_scalar_for_one_branch=True),)
    has_memory = True

    @property
    def name(self) -> str:
        return "one time constant" if self.count == 1 else "two time constants"

    @property
    def equation(self) -> str:
        if self.count == 1:
            return "T ẋ + x = κ c τ beside c τ (Kelvin–Voigt)"
        return "T ẋ + x = κ c τ, two of them, beside c τ"

    def columns(self, shape: Array, drive: JointLoading) -> Array:
        """Return the delayed twist per unit of each coefficient.

        Args:
            shape: (P,) time constants T_n, s.
            drive: Torque, angle and load history of the joint, one entry per state.

        Returns:
            (..., P) N·m, the filtered torque; the settled torque for states without history.
        """
        if drive.segment_start is None or drive.time_gap is None:
            return np.repeat(drive.torque[..., None], len(shape), axis=-1)
        return np.stack(
            [filter_first_order(drive.torque, drive.time_gap, drive.segment_start, t) for t in shape], axis=-1
        )

    def tangent(self, shape: Array, drive: JointLoading) -> Array:
        """Return the slope for a lasting load: 1 for each coefficient.

        Args:
            shape: (P,) time constants T_n, s.
            drive: Torque, angle and load history of the joint, one entry per state.

        Returns:
            (..., P) ones.
        """
        return np.ones((*drive.torque.shape, len(shape)))

    def limit_to_compliance(self, values: Array, room: float) -> JointLaw:
        """Return the law unchanged.

        Args:
            values: (P,) coefficients of the law (linear), SI, in the order of ``self.coefficients``.
            room: Compliance that the joint has left to lose before its slope becomes zero, rad/(N·m).

        Returns:
            The law.
        """
        return self

    def sizes(self, values: Array, shape: Array, scale: JointLoadRange) -> Mapping[str, Quantity]:
        """Return the creep relative to the joint's compliance and the time constants.

        Args:
            values: (P,) coefficients of the law (linear), SI, in the order of ``self.coefficients``.
            shape: (P,) time constants T_n, s.
            scale: Range of torque, angle and time that the recording or plan covers at this joint.

        Returns:
            ``share`` in % and time constants in s; ``size`` in arcmin if the joint's compliance is not known.
        """
        whole = float(np.sum(values))
        if scale.compliance is None:
            return {
                "size": Quantity(whole * scale.max_torque / ARCMIN, "arcmin"),
                "slowest": Quantity(float(shape[-1]), "s"),
            }
        slow = {"slow_constant": Quantity(float(shape[1]), "s")} if len(shape) > 1 else {}
        return {
            "share": compute_compliance_percent(whole, scale.compliance),
            "time_constant": Quantity(float(shape[0]), "s"),
            **slow,
        }

    def grid(self, scale: JointLoadRange) -> tuple[Shape, ...]:
        """Return the time constants that a search tries.

        Args:
            scale: Range of torque, angle and time that the recording or plan covers at this joint.

        Returns:
            Shapes of one or two time constants in s.
        """
        if self.count > 1:
            return () if scale.is_motion else STEP_PAIRS
        return (
            tuple((t,) for t in SAMPLES if t < scale.longest_history) if scale.is_motion else tuple((t,) for t in STEPS)
        )


EFFECT = Effect(
    name="joint_creep",
    noun="creep",
    sentence="The joint goes on yielding for seconds after the load has come to rest.",
    port="twist",
    places=JOINTS,
    joint_laws=(ViscoelasticCreep(2), ViscoelasticCreep(1)),
    is_elastic=True,
    form_uncertainty=0.25,
    plausible_sizes={"%": 100.0},
    note="while the load rests",
)
