"""Hysteresis: the loop of a gear with friction in it, by play operators, used up or not, or with rounded ends.

All have a memory. A plan has none and takes the branch of a load that rises from a gear at rest,
P_r = sgn(τ) max(|τ| − r, 0): a gear left on the far side of its play by a load before gives up to a·r more, once. What
a *small* load meets is the slope once the play is taken up or the drag has grown, the softest the gear can be.
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
)
from machopt.numerics.array_types import Array
from machopt.numerics.compiled_functions import jit_compile

STEPS = ((0.03,), (0.08,), (0.15,), (0.3,), (0.5,))  # half-widths tried in load tests, per largest torque
STEP_PAIRS = ((0.03, 0.15), (0.03, 0.3), (0.08, 0.3), (0.15, 0.5))
SAMPLES = ((0.02,), (0.05,), (0.1,), (0.18,), (0.3,), (0.45,))  # in motions
SAMPLE_PAIRS = ((0.02, 0.1), (0.02, 0.3), (0.05, 0.18), (0.05, 0.3), (0.1, 0.3), (0.1, 0.45), (0.18, 0.45))
BOUC_WEN_SHAPES = tuple((r, b) for r in (0.1, 0.2, 0.4, 0.8, 1.6) for b in (0.5, 0.65, 0.8))  # in motions
SATURATED_PLAY_SHAPES = tuple(
    (r, k) for r in (0.08, 0.18, 0.35) for k in (0.12, 0.35)
)  # half-width and reach, in load tests
# a cycle of a load, from rest up and down and up again: where it comes through zero either way
CYCLE = np.concatenate([np.linspace(0.0, 1.0, 40), np.linspace(1.0, -1.0, 81)[1:], np.linspace(-1.0, 1.0, 81)[1:]])
DOWN, UP = 79, 159


@jit_compile
def _integrate_play(x: Array, first: Ints, half: float) -> Array:
    out = np.empty_like(x)
    y = 0.0
    for n in range(len(x)):
        if first[n]:
            y = x[n] - half if x[n] > half else (x[n] + half if x[n] < -half else 0.0)
        y = min(max(y, x[n] - half), x[n] + half)
        out[n] = y
    return out


def compute_play(x: Array, first: Ints, half: float) -> Array:
    """Play operator P_r, y follows x when |x − y| reaches r; from zero wherever ``first`` is set.

    Args:
        x: (K,).
        first: (K,) 1 where a history begins.
        half: r, in units of x.

    Source:
        Krasnosel'skii & Pokrovskii, Systems with Hysteresis (1989), ch. 1.
    """
    return np.asarray(
        _integrate_play(np.ascontiguousarray(x, float), np.ascontiguousarray(first, np.int64), float(half))
    )


@jit_compile
def _integrate_drag(x: Array, first: Ints, reach: float, beta: float) -> Array:
    out = np.empty_like(x)
    z, last, bend = 0.0, 0.0, 2.0 * beta - 1.0
    for n in range(len(x)):
        if first[n]:
            z, last = 0.0, 0.0
        way = (x[n] - last) / reach
        up = 1.0 if way > 0.0 else -1.0
        z, way = z * up, abs(way)
        if z < 0.0:  # what holds back from before: z' = 1 − (2β − 1) z until it is gone
            gone = -z if bend == 0.0 else np.log1p(-bend * z) / bend
            if way < gone:
                z += way if bend == 0.0 else (1.0 / bend - z) * -np.expm1(-bend * way)
            else:
                z = 0.0
            way = max(way - gone, 0.0)
        if z >= 0.0:  # z' = 1 − z
            z += (1.0 - z) * -np.expm1(-way)
        z, last = z * up, x[n]
        out[n] = z
    return out


def compute_drag(x: Array, first: Ints, reach: float, beta: float) -> Array:
    """Drag −1 < z < 1 of dz = [1 − |z| (β sgn(z dx) + 1 − β)] dx/r, in closed form between the points of the path.

    With β > ½ small loops do not close: under one-sided loads z creeps from cycle to cycle.

    Args:
        x: (K,).
        first: (K,) 1 where a history begins, at x = 0 and z = 0.
        reach: r, in units of x.
        beta: β > 0.

    Source:
        Wen, J. Eng. Mech. Div. ASCE 102 (1976) 249, exponent 1.
    """
    return np.asarray(
        _integrate_drag(
            np.ascontiguousarray(x, float), np.ascontiguousarray(first, np.int64), float(reach), float(beta)
        )
    )


@dataclass(frozen=True)
class PlayHysteresis(JointLawDefaults):
    """φ = Σ a_n P_n[τ], P_n the play operator of half-width r_n."""

    count: int
    word = "play"
    equation = "φ = c τ + Σ a P_r[τ], P_r the play operator of half-width r (Prandtl–Ishlinskii); rate-independent"
    coefficients = (LawParameter(key="weights_rad_per_Nm", unit=COMPLIANCE, lower_limit=0.0, is_list=True),)
    shape = (LawParameter(key="thresholds_Nm", unit="N·m", lower_limit=0.0, positive=True, is_list=True),)
    has_memory = True

    @property
    def name(self) -> str:
        return "play" if self.count == 1 else "two plays"

    def columns(self, shape: Array, drive: JointLoading) -> Array:
        if drive.segment_start is None:
            tau = drive.torque[..., None]
            return np.asarray(tau - np.clip(tau, -shape, shape))
        return np.stack([compute_play(drive.torque, drive.segment_start, r) for r in shape], axis=-1)

    def tangent(self, shape: Array, drive: JointLoading) -> Array:
        return np.ones((*drive.torque.shape, len(shape)))

    def compute_max_slope(self, values: Array, shape: Array, low: float, high: float) -> tuple[float, float]:
        return min(0.0, float(np.cumsum(values[np.argsort(shape)]).min())), np.nan

    def limit_to_compliance(self, values: Array, room: float) -> JointLaw:
        return self

    def sizes(self, values: Array, shape: Array, scale: JointLoadRange) -> Mapping[str, Quantity]:
        # opening of the loop in the middle of a cycle up to the largest torque and back
        opened = sum(
            2.0 * abs(float(a)) * min(float(r), 0.5 * scale.max_torque) for a, r in zip(values, shape, strict=True)
        )
        return {"width": Quantity(opened / ARCMIN, "arcmin"), "threshold": Quantity(float(shape[0]), "N·m")}

    def grid(self, scale: JointLoadRange) -> tuple[Shape, ...]:
        one, two = (SAMPLES, SAMPLE_PAIRS) if scale.is_motion else (STEPS, STEP_PAIRS)
        return tuple(tuple(s * scale.max_torque for s in shares) for shares in (one if self.count == 1 else two))


@dataclass(frozen=True)
class SaturatedPlay(JointLawDefaults):
    """φ = a tanh(P_r[τ] / k): flanks that friction holds on their way across a clearance, and that then lie on.

    Other than of plays alone, whose loop goes on growing with the load, branches part once and run side by side.
    """

    word = "used_up"
    name = "play that is used up"
    equation = "φ = c τ + a tanh(P_r[τ]/k), P_r the play operator of half-width r (generalised play); rate-independent"
    coefficients = (
        LawParameter(key="half_clearance_arcmin", unit="rad", factor=ARCMIN, lower_limit=0.0, name="half clearance"),
    )
    shape = (
        LawParameter(key="threshold_Nm", unit="N·m", lower_limit=0.0, positive=True),
        LawParameter(key="reach_Nm", unit="N·m", positive=True),
    )
    has_memory = True

    def columns(self, shape: Array, drive: JointLoading) -> Array:
        r, k = float(shape[0]), float(shape[1])
        tau = drive.torque
        taken = tau - np.clip(tau, -r, r) if drive.segment_start is None else compute_play(tau, drive.segment_start, r)
        return np.asarray(np.tanh(taken / k)[..., None])

    def tangent(self, shape: Array, drive: JointLoading) -> Array:
        r, k = float(shape[0]), float(shape[1])
        nearest = np.maximum(np.abs(drive.torque) - r, 0.0) / k  # to the middle of the way, wherever the gear stands
        return np.asarray(((1.0 - np.tanh(nearest) ** 2) / k)[..., None])

    def limit_to_compliance(self, values: Array, room: float) -> JointLaw:
        return self

    def sizes(self, values: Array, shape: Array, scale: JointLoadRange) -> Mapping[str, Quantity]:
        r, k = float(shape[0]), float(shape[1])
        # between the branches where a full cycle crosses zero torque
        width = 2.0 * float(values[0]) * float(np.tanh(max(min(r, scale.max_torque - r), 0.0) / k)) / ARCMIN
        return {"width": Quantity(width, "arcmin"), "threshold": Quantity(r, "N·m")}

    def grid(self, scale: JointLoadRange) -> tuple[Shape, ...]:
        return (
            ()
            if scale.is_motion
            else tuple((r * scale.max_torque, k * scale.max_torque) for r, k in SATURATED_PLAY_SHAPES)
        )


@dataclass(frozen=True)
class BoucWenHysteresis(JointLawDefaults):
    """φ = −a z: what friction holds back of c τ, a loop with rounded ends."""

    word = "bouc_wen"
    name = "Bouc–Wen"
    equation = "φ = c τ − a z, dz = [1 − |z| (β sgn(z dτ) + 1 − β)] dτ/r"
    coefficients = (LawParameter(key="drag_arcmin", unit="rad", factor=ARCMIN, lower_limit=0.0, name="drag"),)
    shape = (LawParameter(key="reach_Nm", unit="N·m", positive=True), LawParameter(key="beta", unit="1", positive=True))
    has_memory = True

    def columns(self, shape: Array, drive: JointLoading) -> Array:
        if drive.segment_start is None:
            return np.asarray(np.expm1(-np.abs(drive.torque) / shape[0]) * np.sign(drive.torque))[..., None]
        return -compute_drag(drive.torque, drive.segment_start, *shape)[..., None]

    def tangent(self, shape: Array, drive: JointLoading) -> Array:
        return np.zeros((*drive.torque.shape, 1))

    def compute_max_slope(self, values: Array, shape: Array, low: float, high: float) -> tuple[float, float]:
        return min(0.0, -float(values[0] / shape[0])), np.nan

    def limit_to_compliance(self, values: Array, room: float) -> JointLaw:
        return self

    def sizes(self, values: Array, shape: Array, scale: JointLoadRange) -> Mapping[str, Quantity]:
        # twist between the branches where a full cycle crosses zero torque
        z = compute_drag(CYCLE * scale.max_torque, np.zeros(len(CYCLE), np.int64), *shape)
        width = float(values[0]) * abs(float(z[UP] - z[DOWN])) / ARCMIN
        return {"width": Quantity(width, "arcmin"), "reach": Quantity(float(shape[0]), "N·m")}

    def grid(self, scale: JointLoadRange) -> tuple[Shape, ...]:
        return tuple((r * scale.max_torque, beta) for r, beta in BOUC_WEN_SHAPES) if scale.is_motion else ()


EFFECT = Effect(
    name="joint_hysteresis",
    noun="hysteresis",
    sentence="The joint comes back by another path than it went: friction in the drive train holds twist back.",
    port="twist",
    places=JOINTS,
    joint_laws=(PlayHysteresis(1), PlayHysteresis(2), SaturatedPlay(), BoucWenHysteresis()),
    default_law="play",
    is_elastic=True,
    form_uncertainty=0.2,
    plausible_sizes={"arcmin": 30.0},
    note="on load reversal",
)
