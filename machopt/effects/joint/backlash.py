"""Backlash: a step with the sign of the total torque; absent where weight keeps the teeth on one side."""

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

STEPS = (0.01, 0.025, 0.06)  # transitions tried in load tests, per largest torque: a step, softened
SAMPLES = (0.004, 0.01, 0.025, 0.06)  # in motions
MIN_SIGN_CHANGES = 3  # readings whose load turns the sign of the torque
MIN_SHARE_PER_SIDE = 0.01  # of the samples of a motion on either side


@dataclass(frozen=True)
class TorqueSignStep(JointLawDefaults):
    """φ = ½ w clip(τ/τ_t, ±1)."""

    name = "step with the sign of the total torque"
    equation = "φ = c τ + ½ w sgn(τ), τ with weight; sgn rounded below a few percent of the largest torque"
    coefficients = (LawParameter(key="width_arcmin", unit="rad", factor=ARCMIN, lower_limit=0.0, name="width"),)
    shape = (LawParameter(key="transition_Nm", unit="N·m", positive=True),)
    includes_weight = True

    def columns(self, shape: Array, drive: JointLoading) -> Array:
        return np.asarray(0.5 * np.clip(drive.torque[..., None] / shape, -1.0, 1.0))

    def tangent(self, shape: Array, drive: JointLoading) -> Array:
        return np.asarray((np.abs(drive.torque[..., None]) < shape) * (0.5 / shape))

    def compute_max_slope(self, values: Array, shape: Array, low: float, high: float) -> tuple[float, float]:
        return min(0.0, float((0.5 * values / shape).min())), np.nan

    def limit_to_compliance(self, values: Array, room: float) -> JointLaw:
        return self

    def sizes(self, values: Array, shape: Array, scale: JointLoadRange) -> Mapping[str, Quantity]:
        return {"width": Quantity(float(values[0]) / ARCMIN, "arcmin")}

    def grid(self, scale: JointLoadRange) -> tuple[Shape, ...]:
        return tuple((s * scale.max_torque,) for s in (SAMPLES if scale.is_motion else STEPS))

    def explain_undetectable(self, loaded: Array, unloaded: Array, scale: JointLoadRange) -> str:
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
