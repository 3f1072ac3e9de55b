"""Time delays: a recorded channel with its own clock, or an arm that follows its command late.

A delay is not linear. Its column is the secant (f(t − d̂) − f(t))/d̂ at the best-fitting delay d̂. It is exact if the
coefficient equals d̂. For delays near zero the tangent is used.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np

from machopt.effects.protocol import DelayedChannel, Effect, LawParameter, Quantity, Shape
from machopt.numerics.array_types import Array

MIN_SECANT_DELAY = 2e-5  # s; for smaller delays the tangent replaces the secant
LEAST_LAG = 1e-4  # s; for a smaller best delay only the tangent is tried
MIN_ENCODER_DELAY = 1e-5  # s; smaller mean encoder delays are not observable
DELAY_PARAMETER = LawParameter(key="late_ms", unit="s", factor=1e-3)


@dataclass(frozen=True)
class ChannelDelay:
    """Delay of a recorded channel: f_recorded(t) = f(t − d)."""

    name = "clock of its own"
    equation = "f_recorded(t) = f(t − d)"
    word = ""
    has_memory = False
    exact = True
    coefficients = (DELAY_PARAMETER,)
    shape = (LawParameter(key="secant_ms", unit="s", factor=1e-3),)

    def columns(self, shape: Array, delayed_channel: DelayedChannel) -> Array:
        """Return the change of the channel per second of delay.

        Args:
            shape: (1,) delay of the secant, s.
            delayed_channel: Samples of the delayed channel.

        Returns:
            (N, D, 1) channel units per s.
        """
        d = float(shape[0])
        if abs(d) > MIN_SECANT_DELAY:
            secant = delayed_channel.compute_change(d) / d
        else:
            d = delayed_channel.tangent_step
            secant = (delayed_channel.compute_change(d) - delayed_channel.compute_change(-d)) / (2.0 * d)
        return delayed_channel.sign * secant[:, :, None]

    def sizes(self, values: Array, shape: Array, delayed_channel: DelayedChannel) -> Mapping[str, Quantity]:
        """Return the delay.

        Args:
            values: (P,) coefficients of the law (linear), SI, in the order of ``self.coefficients``.
            shape: (S,) shape parameters of the law (nonlinear), SI, in the order of ``self.shape``.
            delayed_channel: Samples of the delayed channel.

        Returns:
            ``late`` in ms.
        """
        return {"late": Quantity(1e3 * float(values[0]), "ms")}

    def to_file_parameters(self, values: Array, delayed_channel: DelayedChannel) -> dict[str, float | list[float]]:
        """Return the parameters as the diagnosis file states them.

        Args:
            values: (P,) coefficients of the law (linear), SI, in the order of ``self.coefficients``.
            delayed_channel: Samples of the delayed channel.

        Returns:
            ``late_ms``.
        """
        return {"late_ms": 1e3 * float(values[0])}

    def grid(self, delayed_channel: DelayedChannel) -> tuple[Shape, ...]:
        # a single column, so that both descriptions of one clock difference are identical
        """Return the single secant delay that a search tries.

        Args:
            delayed_channel: Samples of the delayed channel.

        Returns:
            Shapes (delay,) in s.
        """
        return ((delayed_channel.best_delay if abs(delayed_channel.best_delay) > MIN_SECANT_DELAY else 0.0,),)


@dataclass(frozen=True)
class EncoderFollowingError:
    """Delay of the arm behind its command as measured by the encoders; the coefficient is the share of it."""

    name = "as the encoders show it"
    equation = "TCP = f(q) and not f(q_command): the encoders stay behind by Σ J_j q̇_j T_j"
    word = ""
    has_memory = False
    exact = True
    coefficients = (LawParameter(key="share", unit="1"),)
    shape: tuple[LawParameter, ...] = ()

    def columns(self, shape: Array, delayed_channel: DelayedChannel) -> Array:
        """Return the TCP error caused by the following error of the encoders.

        Args:
            shape: Empty; the law has no shape parameters.
            delayed_channel: Samples of the delayed channel.

        Returns:
            (N, D, 1) channel units.
        """
        assert delayed_channel.following_columns is not None  # ensured by grid
        return delayed_channel.following_columns

    def sizes(self, values: Array, shape: Array, delayed_channel: DelayedChannel) -> Mapping[str, Quantity]:
        """Return the mean delay, the share and the delay of each joint.

        Args:
            values: (P,) coefficients of the law (linear), SI, in the order of ``self.coefficients``.
            shape: (S,) shape parameters of the law (nonlinear), SI, in the order of ``self.shape``.
            delayed_channel: Samples of the delayed channel.

        Returns:
            Delays in ms, ``share`` in %.
        """
        share = float(values[0])
        return {"delay": Quantity(1e3 * share * delayed_channel.mean, "ms"), "share": Quantity(100.0 * share, "%")} | {
            f"delay_{j + 1}": Quantity(1e3 * float(share * v), "ms") for j, v in enumerate(delayed_channel.delays)
        }

    def to_file_parameters(self, values: Array, delayed_channel: DelayedChannel) -> dict[str, float | list[float]]:
        """Return the parameters as the diagnosis file states them.

        Args:
            values: (P,) coefficients of the law (linear), SI, in the order of ``self.coefficients``.
            delayed_channel: Samples of the delayed channel.

        Returns:
            ``delay_ms`` of each joint.
        """
        return {"delay_ms": [1e3 * float(values[0] * v) for v in delayed_channel.delays]}

    def grid(self, delayed_channel: DelayedChannel) -> tuple[Shape, ...]:
        """Return one empty shape; none if the encoders show no following error.

        Args:
            delayed_channel: Samples of the delayed channel.

        Returns:
            The shapes that a search tries.
        """
        return (
            ((),)
            if delayed_channel.following_columns is not None and abs(delayed_channel.mean) > MIN_ENCODER_DELAY
            else ()
        )


@dataclass(frozen=True)
class CommandDelay:
    """Common delay of all joints behind the command: q(t) = q_command(t − T), T ≥ 0."""

    name = "one delay of all joints"
    equation = "q(t) = q_command(t − T)"
    word = ""
    has_memory = False
    exact = False  # joints do not follow with exactly equal delays
    coefficients = (LawParameter(key="delay_ms", unit="s", factor=1e-3, lower_limit=0.0),)
    shape = (LawParameter(key="secant_ms", unit="s", factor=1e-3),)

    def columns(self, shape: Array, delayed_channel: DelayedChannel) -> Array:
        """Return the change of the channel per second of delay.

        Args:
            shape: (1,) delay of the secant, s.
            delayed_channel: Samples of the delayed channel.

        Returns:
            (N, D, 1) channel units per s.
        """
        d = float(shape[0]) if abs(shape[0]) > MIN_SECANT_DELAY else delayed_channel.tangent_step
        return np.asarray((delayed_channel.compute_change(d) / d)[:, :, None])

    def sizes(self, values: Array, shape: Array, delayed_channel: DelayedChannel) -> Mapping[str, Quantity]:
        """Return the delay.

        Args:
            values: (P,) coefficients of the law (linear), SI, in the order of ``self.coefficients``.
            shape: (S,) shape parameters of the law (nonlinear), SI, in the order of ``self.shape``.
            delayed_channel: Samples of the delayed channel.

        Returns:
            ``delay`` in ms.
        """
        return {"delay": Quantity(1e3 * float(values[0]), "ms")}

    def to_file_parameters(self, values: Array, delayed_channel: DelayedChannel) -> dict[str, float | list[float]]:
        """Return the parameters as the diagnosis file states them.

        Args:
            values: (P,) coefficients of the law (linear), SI, in the order of ``self.coefficients``.
            delayed_channel: Samples of the delayed channel.

        Returns:
            ``delay_ms``.
        """
        return {"delay_ms": 1e3 * float(values[0])}

    def grid(self, delayed_channel: DelayedChannel) -> tuple[Shape, ...]:
        """Return the secant delays that a search tries.

        Args:
            delayed_channel: Samples of the delayed channel.

        Returns:
            Shapes (delay,) in s.
        """
        return ((0.0,),) if delayed_channel.best_delay < LEAST_LAG else ((0.0,), (delayed_channel.best_delay,))


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
