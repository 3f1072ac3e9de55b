"""Creep: a part of the twist that comes late, and stays late when the load has gone.

A plan takes the worst case, reached after a few time constants of steady load; a shorter cut bends the arm less, by
exp(−t/T) of it.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np

from machopt.arrays import Array
from machopt.compiled import compiled
from machopt.effects.protocol import (
    ARCMIN,
    COMPLIANCE,
    JOINTS,
    Drive,
    Effect,
    Ints,
    Law,
    Parameter,
    Quantity,
    Scale,
    Settled,
    Shape,
    percent,
)

STEPS = (3.0, 8.0, 20.0, 50.0, 120.0, 300.0)  # s, tried in load tests
STEP_PAIRS = ((3.0, 20.0), (3.0, 60.0), (8.0, 60.0), (8.0, 200.0))
SAMPLES = (0.5, 1.5, 4.0, 12.0, 40.0)  # s, in motions


@compiled
def _lag(x: Array, gap: Array, first: Ints, constant: float) -> Array:
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


def lag(x: Array, gap: Array, first: Ints, constant: float) -> Array:
    """First-order lag T ẏ + y = x, x held over the gap before each state.

    Args:
        x: (K,).
        gap: (K,) s since the state before, or since y was zero; infinite: y has settled; NaN: not known, taken for T;
            negative: as long, less a T that the state after takes.
        first: (K,) 1 where a history begins, at y = 0.
        constant: T, s.
    """
    return np.asarray(
        _lag(
            np.ascontiguousarray(x, float),
            np.ascontiguousarray(gap, float),
            np.ascontiguousarray(first, np.int64),
            float(constant),
        )
    )


@dataclass(frozen=True)
class Late(Settled):
    """T_n ẋ_n + x_n = a_n τ; φ = Σ x_n."""

    count: int
    coefficients = (Parameter(key="extra_rad_per_Nm", unit=COMPLIANCE, least=0.0, many=True, bare=True),)
    shape = (Parameter(key="time_constant_s", unit="s", positive=True, many=True, bare=True),)
    remembers = True

    @property
    def name(self) -> str:
        return "one time constant" if self.count == 1 else "two time constants"

    @property
    def equation(self) -> str:
        if self.count == 1:
            return "T ẋ + x = κ c τ beside c τ (Kelvin–Voigt)"
        return "T ẋ + x = κ c τ, two of them, beside c τ"

    def columns(self, shape: Array, drive: Drive) -> Array:
        if drive.first is None or drive.gap is None:
            return np.repeat(drive.torque[..., None], len(shape), axis=-1)
        return np.stack([lag(drive.torque, drive.gap, drive.first, t) for t in shape], axis=-1)

    def tangent(self, shape: Array, drive: Drive) -> Array:
        return np.ones((*drive.torque.shape, len(shape)))

    def within(self, values: Array, room: float) -> Law:
        return self

    def sizes(self, values: Array, shape: Array, scale: Scale) -> Mapping[str, Quantity]:
        whole = float(np.sum(values))
        if scale.compliance is None:
            return {
                "size": Quantity(whole * scale.reach / ARCMIN, "arcmin"),
                "slowest": Quantity(float(shape[-1]), "s"),
            }
        slow = {"slow_constant": Quantity(float(shape[1]), "s")} if len(shape) > 1 else {}
        return {"share": percent(whole, scale.compliance), "time_constant": Quantity(float(shape[0]), "s"), **slow}

    def grid(self, scale: Scale) -> tuple[Shape, ...]:
        if self.count > 1:
            return () if scale.sampled else STEP_PAIRS
        return tuple((t,) for t in SAMPLES if t < scale.lasting) if scale.sampled else tuple((t,) for t in STEPS)


EFFECT = Effect(
    name="joint_creep",
    noun="creep",
    sentence="The joint goes on yielding for seconds after the load has come to rest.",
    port="twist",
    places=JOINTS,
    laws=(Late(2), Late(1)),
    elastic=True,
    form=0.25,
    plausible={"%": 100.0},
    note="while the load rests",
)
