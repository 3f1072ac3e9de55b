"""Backlash: a step with the sign of the total torque; absent where weight keeps the teeth on one side."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np

from machopt.arrays import Array
from machopt.effects.protocol import (
    ARCMIN,
    JOINTS,
    Drive,
    Effect,
    Law,
    Parameter,
    Quantity,
    Scale,
    Settled,
    Shape,
)

STEPS = (0.01, 0.025, 0.06)  # transitions tried in load tests, per largest torque: a step, softened
SAMPLES = (0.004, 0.01, 0.025, 0.06)  # in motions
CROSSINGS = 3  # readings whose load turns the sign of the torque
BOTH_SIDES = 0.01  # of the samples of a motion on either side


@dataclass(frozen=True)
class Step(Settled):
    """φ = ½ w clip(τ/τ_t, ±1)."""

    name = "step with the sign of the total torque"
    equation = "φ = c τ + ½ w sgn(τ), τ with weight; sgn rounded below a few percent of the largest torque"
    coefficients = (Parameter(key="width_arcmin", unit="rad", factor=ARCMIN, least=0.0, name="width"),)
    shape = (Parameter(key="transition_Nm", unit="N·m", positive=True),)
    weighs = True

    def columns(self, shape: Array, drive: Drive) -> Array:
        return np.asarray(0.5 * np.clip(drive.torque[..., None] / shape, -1.0, 1.0))

    def tangent(self, shape: Array, drive: Drive) -> Array:
        return np.asarray((np.abs(drive.torque[..., None]) < shape) * (0.5 / shape))

    def steepest(self, values: Array, shape: Array, low: float, high: float) -> tuple[float, float]:
        return min(0.0, float((0.5 * values / shape).min())), np.nan

    def within(self, values: Array, room: float) -> Law:
        return self

    def sizes(self, values: Array, shape: Array, scale: Scale) -> Mapping[str, Quantity]:
        return {"width": Quantity(float(values[0]) / ARCMIN, "arcmin")}

    def grid(self, scale: Scale) -> tuple[Shape, ...]:
        return tuple((s * scale.reach,) for s in (SAMPLES if scale.sampled else STEPS))

    def silent(self, loaded: Array, unloaded: Array, scale: Scale) -> str:
        if scale.sampled:
            rounded = SAMPLES[0] * scale.reach
            some = min(np.mean(loaded > rounded), np.mean(loaded < -rounded)) > BOTH_SIDES
            return "" if some else "the torque of this joint keeps to one side"
        crossing = (np.sign(loaded) != np.sign(unloaded)) & (np.abs(loaded) > STEPS[0] * scale.reach)
        if crossing.sum() < CROSSINGS and np.abs(unloaded).min() > STEPS[-1] * scale.reach:
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
    laws=(Step(),),
    elastic=True,
    plausible={"arcmin": 30.0},
    note="where the torque changes its sign",
)
