"""What comes late: a channel of the record on a clock of its own, an arm behind its command.

A delay is not linear. Its column is a secant, (f(t − d̂) − f(t))/d̂ at the delay d̂ that fits best, exact where the
coefficient comes out as d̂; for delays near zero the tangent.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np

from machopt.arrays import Array
from machopt.effects.protocol import Delayed, Effect, Parameter, Quantity, Shape

STILL = 2e-5  # s; a secant over less is the tangent
LEAST_LAG = 1e-4  # s; a best delay below it is offered as the tangent alone
FOLLOWS = 1e-5  # s; encoders that stay nearer to their command show nothing
LATE = Parameter(key="late_ms", unit="s", factor=1e-3)


@dataclass(frozen=True)
class Clock:
    """f_recorded(t) = f(t − d)."""

    name = "clock of its own"
    equation = "f_recorded(t) = f(t − d)"
    word = ""
    remembers = False
    exact = True
    coefficients = (LATE,)
    shape = (Parameter(key="secant_ms", unit="s", factor=1e-3),)

    def columns(self, shape: Array, seen: Delayed) -> Array:
        d = float(shape[0])
        if abs(d) > STILL:
            secant = seen.change(d) / d
        else:
            d = seen.step
            secant = (seen.change(d) - seen.change(-d)) / (2.0 * d)
        return seen.sign * secant[:, :, None]

    def sizes(self, values: Array, shape: Array, seen: Delayed) -> Mapping[str, Quantity]:
        return {"late": Quantity(1e3 * float(values[0]), "ms")}

    def stated(self, values: Array, seen: Delayed) -> dict[str, float | list[float]]:
        return {"late_ms": 1e3 * float(values[0])}

    def grid(self, seen: Delayed) -> tuple[Shape, ...]:
        # one column, so that two names of one difference of clocks are one and the same
        return ((seen.best if abs(seen.best) > STILL else 0.0,),)


@dataclass(frozen=True)
class Shown:
    """The arm stays behind its command by as much as its encoders say; the coefficient is the share of it."""

    name = "as the encoders show it"
    equation = "TCP = f(q) and not f(q_command): the encoders stay behind by Σ J_j q̇_j T_j"
    word = ""
    remembers = False
    exact = True
    coefficients = (Parameter(key="share", unit="1"),)
    shape: tuple[Parameter, ...] = ()

    def columns(self, shape: Array, seen: Delayed) -> Array:
        assert seen.followed is not None  # grid looks
        return seen.followed

    def sizes(self, values: Array, shape: Array, seen: Delayed) -> Mapping[str, Quantity]:
        share = float(values[0])
        return {"delay": Quantity(1e3 * share * seen.mean, "ms"), "share": Quantity(100.0 * share, "%")} | {
            f"delay_{j + 1}": Quantity(1e3 * float(share * v), "ms") for j, v in enumerate(seen.delays)
        }

    def stated(self, values: Array, seen: Delayed) -> dict[str, float | list[float]]:
        return {"delay_ms": [1e3 * float(values[0] * v) for v in seen.delays]}

    def grid(self, seen: Delayed) -> tuple[Shape, ...]:
        return ((),) if seen.followed is not None and abs(seen.mean) > FOLLOWS else ()


@dataclass(frozen=True)
class Lags:
    """q(t) = q_command(t − T), all joints by the same time, never before the command."""

    name = "one delay of all joints"
    equation = "q(t) = q_command(t − T)"
    word = ""
    remembers = False
    exact = False  # no joint follows quite as another does
    coefficients = (Parameter(key="delay_ms", unit="s", factor=1e-3, least=0.0),)
    shape = (Parameter(key="secant_ms", unit="s", factor=1e-3),)

    def columns(self, shape: Array, seen: Delayed) -> Array:
        d = float(shape[0]) if abs(shape[0]) > STILL else seen.step
        return np.asarray((seen.change(d) / d)[:, :, None])

    def sizes(self, values: Array, shape: Array, seen: Delayed) -> Mapping[str, Quantity]:
        return {"delay": Quantity(1e3 * float(values[0]), "ms")}

    def stated(self, values: Array, seen: Delayed) -> dict[str, float | list[float]]:
        return {"delay_ms": 1e3 * float(values[0])}

    def grid(self, seen: Delayed) -> tuple[Shape, ...]:
        return ((0.0,),) if seen.best < LEAST_LAG else ((0.0,), (seen.best,))


CLOCK = Effect(
    name="time_skew",
    noun="time skew",
    spoken="a clock that is off",
    sentence="The channel is early or late against the others.",
    port="record",
    places=(),
    delays=(Clock(),),
    note="in proportion to speed, all joints by the same time",
)

LAG = Effect(
    name="servo_lag",
    noun="servo lag",
    sentence="The arm follows its command late, in proportion to speed.",
    port="angle",
    places=("controller",),
    delays=(Shown(), Lags()),
    of="",
    note="in proportion to speed",
)
