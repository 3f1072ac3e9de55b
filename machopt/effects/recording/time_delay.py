"""What comes late: a channel of the record on a clock of its own, an arm behind its command.

A delay is not linear. Its column is a secant, (f(t − d̂) − f(t))/d̂ at the delay d̂ that fits best, exact where the
coefficient comes out as d̂; for delays near zero the tangent.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np

from machopt.effects.protocol import DelayedChannel, Effect, LawParameter, Quantity, Shape
from machopt.numerics.array_types import Array

MIN_SECANT_DELAY = 2e-5  # s; a secant over less is the tangent
LEAST_LAG = 1e-4  # s; a best delay below it is offered as the tangent alone
MIN_ENCODER_DELAY = 1e-5  # s; encoders that stay nearer to their command show nothing
DELAY_PARAMETER = LawParameter(key="late_ms", unit="s", factor=1e-3)


@dataclass(frozen=True)
class ChannelDelay:
    """f_recorded(t) = f(t − d)."""

    name = "clock of its own"
    equation = "f_recorded(t) = f(t − d)"
    word = ""
    has_memory = False
    exact = True
    coefficients = (DELAY_PARAMETER,)
    shape = (LawParameter(key="secant_ms", unit="s", factor=1e-3),)

    def columns(self, shape: Array, seen: DelayedChannel) -> Array:
        d = float(shape[0])
        if abs(d) > MIN_SECANT_DELAY:
            secant = seen.compute_change(d) / d
        else:
            d = seen.tangent_step
            secant = (seen.compute_change(d) - seen.compute_change(-d)) / (2.0 * d)
        return seen.sign * secant[:, :, None]

    def sizes(self, values: Array, shape: Array, seen: DelayedChannel) -> Mapping[str, Quantity]:
        return {"late": Quantity(1e3 * float(values[0]), "ms")}

    def to_file_parameters(self, values: Array, seen: DelayedChannel) -> dict[str, float | list[float]]:
        return {"late_ms": 1e3 * float(values[0])}

    def grid(self, seen: DelayedChannel) -> tuple[Shape, ...]:
        # one column, so that two names of one difference of clocks are one and the same
        return ((seen.best_delay if abs(seen.best_delay) > MIN_SECANT_DELAY else 0.0,),)


@dataclass(frozen=True)
class EncoderFollowingError:
    """The arm stays behind its command by as much as its encoders say; the coefficient is the share of it."""

    name = "as the encoders show it"
    equation = "TCP = f(q) and not f(q_command): the encoders stay behind by Σ J_j q̇_j T_j"
    word = ""
    has_memory = False
    exact = True
    coefficients = (LawParameter(key="share", unit="1"),)
    shape: tuple[LawParameter, ...] = ()

    def columns(self, shape: Array, seen: DelayedChannel) -> Array:
        assert seen.following_columns is not None  # grid looks
        return seen.following_columns

    def sizes(self, values: Array, shape: Array, seen: DelayedChannel) -> Mapping[str, Quantity]:
        share = float(values[0])
        return {"delay": Quantity(1e3 * share * seen.mean, "ms"), "share": Quantity(100.0 * share, "%")} | {
            f"delay_{j + 1}": Quantity(1e3 * float(share * v), "ms") for j, v in enumerate(seen.delays)
        }

    def to_file_parameters(self, values: Array, seen: DelayedChannel) -> dict[str, float | list[float]]:
        return {"delay_ms": [1e3 * float(values[0] * v) for v in seen.delays]}

    def grid(self, seen: DelayedChannel) -> tuple[Shape, ...]:
        return ((),) if seen.following_columns is not None and abs(seen.mean) > MIN_ENCODER_DELAY else ()


@dataclass(frozen=True)
class CommandDelay:
    """q(t) = q_command(t − T), all joints by the same time, never before the command."""

    name = "one delay of all joints"
    equation = "q(t) = q_command(t − T)"
    word = ""
    has_memory = False
    exact = False  # no joint follows quite as another does
    coefficients = (LawParameter(key="delay_ms", unit="s", factor=1e-3, lower_limit=0.0),)
    shape = (LawParameter(key="secant_ms", unit="s", factor=1e-3),)

    def columns(self, shape: Array, seen: DelayedChannel) -> Array:
        d = float(shape[0]) if abs(shape[0]) > MIN_SECANT_DELAY else seen.tangent_step
        return np.asarray((seen.compute_change(d) / d)[:, :, None])

    def sizes(self, values: Array, shape: Array, seen: DelayedChannel) -> Mapping[str, Quantity]:
        return {"delay": Quantity(1e3 * float(values[0]), "ms")}

    def to_file_parameters(self, values: Array, seen: DelayedChannel) -> dict[str, float | list[float]]:
        return {"delay_ms": 1e3 * float(values[0])}

    def grid(self, seen: DelayedChannel) -> tuple[Shape, ...]:
        return ((0.0,),) if seen.best_delay < LEAST_LAG else ((0.0,), (seen.best_delay,))


CLOCK_EFFECT = Effect(
    name="time_skew",
    noun="time skew",
    short_noun="a clock that is off",
    sentence="The channel is early or late against the others.",
    port="record",
    places=(),
    delay_laws=(ChannelDelay(),),
    note="in proportion to speed, all joints by the same time",
)

COMMAND_DELAY_EFFECT = Effect(
    name="servo_lag",
    noun="servo lag",
    sentence="The arm follows its command late, in proportion to speed.",
    port="angle",
    places=("controller",),
    delay_laws=(EncoderFollowingError(), CommandDelay()),
    preposition="",
    note="in proportion to speed",
)
