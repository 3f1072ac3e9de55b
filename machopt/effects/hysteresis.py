"""Hysteresis: play operators side by side (Prandtl–Ishlinskii), the loop of a gear with friction in it.

Play has a memory. A plan has none and takes the branch of a load that rises from a gear at rest,
P_r = sgn(τ) max(|τ| − r, 0): a gear left on the far side of its play by a load before gives up to a·r more, once. What
a *small* load meets is the slope once the play is taken up, the softest the gear can be.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np

from machopt.compiled import compiled
from machopt.effects.protocol import (
    ARCMIN,
    COMPLIANCE,
    JOINTS,
    Array,
    Drive,
    Effect,
    Ints,
    Law,
    Parameter,
    Quantity,
    Scale,
    Settled,
    Shape,
)

STEPS = ((0.03,), (0.08,), (0.15,), (0.3,), (0.5,))  # half-widths tried in load tests, per largest torque
STEP_PAIRS = ((0.03, 0.15), (0.03, 0.3), (0.08, 0.3), (0.15, 0.5))
SAMPLES = ((0.02,), (0.05,), (0.1,), (0.18,), (0.3,), (0.45,))  # in motions
SAMPLE_PAIRS = ((0.02, 0.1), (0.02, 0.3), (0.05, 0.18), (0.05, 0.3), (0.1, 0.3), (0.1, 0.45), (0.18, 0.45))


@compiled
def _play(x: Array, first: Ints, half: float) -> Array:
    out = np.empty_like(x)
    y = 0.0
    for n in range(len(x)):
        if first[n]:
            y = x[n] - half if x[n] > half else (x[n] + half if x[n] < -half else 0.0)
        y = min(max(y, x[n] - half), x[n] + half)
        out[n] = y
    return out


def play(x: Array, first: Ints, half: float) -> Array:
    """Play operator P_r, y follows x when |x − y| reaches r; from zero wherever ``first`` is set.

    Args:
        x: (K,).
        first: (K,) 1 where a history begins.
        half: r, in units of x.

    Source:
        Krasnosel'skii & Pokrovskii, Systems with Hysteresis (1989), ch. 1.
    """
    return np.asarray(_play(np.ascontiguousarray(x, float), np.ascontiguousarray(first, np.int64), float(half)))


@dataclass(frozen=True)
class Plays(Settled):
    """φ = Σ a_n P_n[τ], P_n the play operator of half-width r_n."""

    count: int
    word = "play"
    equation = "φ = c τ + Σ a P_r[τ], P_r the play operator of half-width r (Prandtl–Ishlinskii); rate-independent"
    coefficients = (Parameter(key="weights_rad_per_Nm", unit=COMPLIANCE, least=0.0, many=True),)
    shape = (Parameter(key="thresholds_Nm", unit="N·m", least=0.0, positive=True, many=True),)
    remembers = True

    @property
    def name(self) -> str:
        return "play" if self.count == 1 else "two plays"

    def columns(self, shape: Array, drive: Drive) -> Array:
        if drive.first is None:
            tau = drive.torque[..., None]
            return np.asarray(tau - np.clip(tau, -shape, shape))
        return np.stack([play(drive.torque, drive.first, r) for r in shape], axis=-1)

    def tangent(self, shape: Array, drive: Drive) -> Array:
        return np.ones((*drive.torque.shape, len(shape)))

    def steepest(self, values: Array, shape: Array, low: float, high: float) -> tuple[float, float]:
        return min(0.0, float(np.cumsum(values[np.argsort(shape)]).min())), np.nan

    def within(self, values: Array, room: float) -> Law:
        return self

    def sizes(self, values: Array, shape: Array, scale: Scale) -> Mapping[str, Quantity]:
        # opening of the loop in the middle of a cycle up to the largest torque and back
        opened = sum(2.0 * abs(float(a)) * min(float(r), 0.5 * scale.reach) for a, r in zip(values, shape, strict=True))
        return {"width": Quantity(opened / ARCMIN, "arcmin"), "threshold": Quantity(float(shape[0]), "N·m")}

    def grid(self, scale: Scale) -> tuple[Shape, ...]:
        one, two = (SAMPLES, SAMPLE_PAIRS) if scale.sampled else (STEPS, STEP_PAIRS)
        return tuple(tuple(s * scale.reach for s in shares) for shares in (one if self.count == 1 else two))


EFFECT = Effect(
    name="joint_hysteresis",
    noun="hysteresis",
    sentence="The joint comes back by another path than it went: friction in the drive train holds twist back.",
    port="twist",
    places=JOINTS,
    laws=(Plays(1), Plays(2)),
    default="play",
    elastic=True,
    form=0.2,
    plausible={"arcmin": 30.0},
    note="on load reversal",
)
