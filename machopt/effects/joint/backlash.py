"""Backlash: a step of the joint angle with the sign of the total torque.

The effect does not appear where gravity keeps the tooth flanks in contact on one side.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np

from machopt.effects.protocol import (
    ARCMIN,
    JOINTS,
    Effect,
    JointLaw,
    JointLawDefaults,
    JointLoading,
    JointLoadRange,
    LawParameter,
    Quantity,
    Shape,
)
from machopt.numerics.array_types import Array

STEPS = (0.01, 0.025, 0.06)  # transition torques tried in load tests, relative to the largest torque: a softened step
SAMPLES = (0.004, 0.01, 0.025, 0.06)  # in motions
MIN_SIGN_CHANGES = 3  # least number of readings whose load reverses the sign of the torque
MIN_SHARE_PER_SIDE = 0.01  # least share of a motion's samples with either sign of the torque


@dataclass(frozen=True)
class TorqueSignStep(JointLawDefaults):
    """φ = ½ w clip(τ/τ_t, ±1)."""

    name = "step with the sign of the total torque"
    equation = "φ = c τ + ½ w sgn(τ), τ with weight; sgn rounded below a few percent of the largest torque"
    coefficients = (LawParameter(key="width_arcmin", unit="rad", factor=ARCMIN, lower_limit=0.0, name="width"),)
    shape = (LawParameter(key="transition_Nm", unit="N·m", positive=True),)
    includes_weight = True

    def columns(self, shape: Array, drive: JointLoading) -> Array:
        """Return the joint twist per unit of backlash width.

        Args:
            shape: (1,) transition torque τ_t, N·m.
            drive: Torque, angle and load history of the joint, one entry per state.

        Returns:
            (..., 1) −½ to ½.
        """
        return np.asarray(0.5 * np.clip(drive.torque[..., None] / shape, -1.0, 1.0))

    def tangent(self, shape: Array, drive: JointLoading) -> Array:
        """Return the slope of the twist with respect to the torque, per unit of backlash width.

        Args:
            shape: (1,) transition torque τ_t, N·m.
            drive: Torque, angle and load history of the joint, one entry per state.

        Returns:
            (..., 1) 1/(N·m).
        """
        return np.asarray((np.abs(drive.torque[..., None]) < shape) * (0.5 / shape))

    def compute_max_slope(self, values: Array, shape: Array, low: float, high: float) -> tuple[float, float]:
        """Return the largest reduction of the joint compliance by the law.

        Args:
            values: (P,) coefficients of the law (linear), SI, in the order of ``self.coefficients``.
            shape: (1,) transition torque τ_t, N·m.
            low: Lower end of the joint's angle range, rad.
            high: Upper end of the joint's angle range, rad.

        Returns:
            Compliance change, ≤ 0 rad/(N·m), and NaN: it does not depend on the angle.
        """
        return min(0.0, float((0.5 * values / shape).min())), np.nan

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
        """Return the width of the backlash.

        Args:
            values: (P,) coefficients of the law (linear), SI, in the order of ``self.coefficients``.
            shape: (1,) transition torque τ_t, N·m.
            scale: Range of torque, angle and time that the recording or plan covers at this joint.

        Returns:
            ``width`` in arcmin.
        """
        return {"width": Quantity(float(values[0]) / ARCMIN, "arcmin")}

    def grid(self, scale: JointLoadRange) -> tuple[Shape, ...]:
        """Return the transition torques that a search tries.

        Args:
            scale: Range of torque, angle and time that the recording or plan covers at this joint.

        Returns:
            Shapes (transition torque,) in N·m.
        """
        return tuple((s * scale.max_torque,) for s in (SAMPLES if scale.is_motion else STEPS))

    def explain_undetectable(self, loaded: Array, unloaded: Array, scale: JointLoadRange) -> str:
        """Explain why the torques cannot show backlash.

        Args:
            loaded: (N,) joint torques under load, N·m.
            unloaded: (N,) joint torques of the same poses without load, N·m.
            scale: Range of torque, angle and time that the recording or plan covers at this joint.

        Returns:
            The reason; empty if enough readings reverse the torque.
        """
        if scale.is_motion:
            rounded = SAMPLES[0] * scale.max_torque
            some = min(np.mean(loaded > rounded), np.mean(loaded < -rounded)) > MIN_SHARE_PER_SIDE
            return "" if some else "the torque of this joint keeps to one side"
        crossing = (np.sign(loaded) != np.sign(unloaded)) & (np.abs(loaded) > STEPS[0] * scale.max_torque)
        if crossing.sum() < MIN_SIGN_CHANGES and np.abs(unloaded).min() > STEPS[-1] * scale.max_torque:
            return (
                "weight keeps the torque of this joint on one side in every pose; loads that overcome it would show a "
                "step"
            )
        return ""


EFFECT = Effect(
    name="joint_backlash",
    noun="backlash",
    sentence="The joint is loose by a small angle wherever its total torque, weight included, changes sign.",
    port="twist",
    places=JOINTS,
    joint_laws=(TorqueSignStep(),),
    is_elastic=True,
    plausible_sizes={"arcmin": 30.0},
    note="where the torque changes its sign",
)
