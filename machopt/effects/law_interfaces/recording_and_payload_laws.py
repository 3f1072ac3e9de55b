"""Interfaces of laws of the recording and the payload: errors of a recording, masses at the tool, time delays."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass
from typing import Protocol

import numpy as np

from machopt.effects.law_interfaces.law_parameters import DescribedLaw, LawParameterSet, Quantity, Shape
from machopt.numerics.array_types import Array


@dataclass(frozen=True)
class RecordedLoad:
    """Recorded loads and predicted displacements of K static readings, as input to laws of recording errors.
    base_link axes.
    """

    wrench: Array  # (K, 6) recorded N, N·m at the TCP
    displacement: Array  # (K, D) m, rad of the TCP, predicted by the current model
    axes: Array  # (K, 3, 3) sensor axes in columns
    tool: Array  # (K, 3, 3) tool axes in columns
    position: Array | None = None  # (K, 3) m, TCP of measured poses; None for a load test


class RecordLaw(DescribedLaw, Protocol):
    """Law of an error of the recording, linear in its coefficients: what acted beyond the recorded values. Stateless;
    SI.
    """

    @property
    def affected_quantity(self) -> str:
        """Affected quantity.

        ``wrench`` acts through the compliance of the arm. ``displacement`` and ``position`` change the measured
        values. ``point`` moves the tool point at which load and displacement are recorded.
        """
        ...

    def columns(self, shape: Array, recorded_load: RecordedLoad) -> Array:
        """Return the change of the affected quantity per unit of each coefficient.

        Args:
            shape: (S,) shape parameters of the law (nonlinear), SI, in the order of ``self.shape``.
            recorded_load: Recorded loads and predicted displacements of K readings.

        Returns:
            Wrench: (K, 6, P) N, N·m. Displacement or position: (K, D, P) m, rad. Point: (K, 6, P) m in the first
            three rows.
        """
        ...

    def sizes(self, values: Array, shape: Array) -> Mapping[str, Quantity]:
        """Return the coefficients as reported quantities.

        Args:
            values: (P,) coefficients of the law (linear), SI, in the order of ``self.coefficients``.
            shape: (S,) shape parameters of the law (nonlinear), SI, in the order of ``self.shape``.

        Returns:
            Quantities by name. The first one is the size of the effect and is proportional to small coefficients.
        """
        ...

    def grid(self) -> tuple[Shape, ...]:
        """Shapes that a search tries."""
        ...


@dataclass(frozen=True)
class ToolSideLoad:
    """Payload as stated by the cell, and the sensitivity of N readings to additional payload. Flange axes."""

    mass: float  # kg
    centre: Array  # (3,) m
    reference_point: Array  # (3,) m, position of the unit mass of the first column
    columns: Array  # (N, D, 4) reading per kg at the reference point, and per kg·m of first moment along each axis


class PayloadLaw(LawParameterSet, Protocol):
    """Law of a payload error relative to the cell, linear in its coefficients. Stateless; SI."""

    @property
    def name(self) -> str: ...

    @property
    def equation(self) -> str:
        """Description of the load, appended to the equation of the channel."""
        ...

    def columns(self, tool_side_load: ToolSideLoad) -> Array:
        """Return the change of the readings per unit of each coefficient.

        Args:
            tool_side_load: Stated payload and sensitivity of N readings.

        Returns:
            (N, D, P) in units of the readings.
        """
        ...

    def sizes(self, values: Array, tool_side_load: ToolSideLoad) -> Mapping[str, Quantity]:
        """Return the coefficients as reported quantities.

        Args:
            values: (P,) coefficients of the law (linear), SI, in the order of ``self.coefficients``.
            tool_side_load: Stated payload and sensitivity of N readings.

        Returns:
            Quantities by name. The first one is the size of the effect and is proportional to the coefficients.
        """
        ...

    def grid(self, tool_side_load: ToolSideLoad) -> tuple[Shape, ...]:
        """Return the shapes that a search tries.

        Args:
            tool_side_load: Stated payload and sensitivity of N readings.

        Returns:
            Shapes in SI; empty if the law is not applicable to the stated payload.
        """
        ...


@dataclass(frozen=True, kw_only=True)
class DelayedChannel:
    """N samples of a channel that may be recorded with a delay."""

    compute_change: Callable[[float], Array]  # delay d in s → (N, D) f(t − d) − f(t), where f is the undelayed signal
    best_delay: float  # s, delay of the best fit
    tangent_step: float  # s, step of the finite difference for the tangent
    sign: float = 1.0  # −1 if a late channel makes the difference appear early
    following_columns: Array | None = None  # (N, D, 1) following error by the encoders; None: not available
    delays: tuple[float, ...] = ()  # s, delay of each encoder behind its command; 0: no delay

    @property
    def mean(self) -> float:
        """Mean delay of the encoders that lag behind their command, s."""
        behind = [d for d in self.delays if d]
        return float(np.mean(behind)) if behind else 0.0


class DelayLaw(DescribedLaw, Protocol):
    """Law of a time delay, linear in its coefficient about the delay of its shape. Stateless; SI."""

    @property
    def exact(self) -> bool:
        """Whether the column describes a delay of any size without remainder."""
        ...

    def columns(self, shape: Array, delayed_channel: DelayedChannel) -> Array:
        """Return the change of the channel per unit of each coefficient.

        Args:
            shape: (S,) shape parameters of the law (nonlinear), SI, in the order of ``self.shape``.
            delayed_channel: Samples of the delayed channel.

        Returns:
            (N, D, P) in units of the channel.
        """
        ...

    def sizes(self, values: Array, shape: Array, delayed_channel: DelayedChannel) -> Mapping[str, Quantity]:
        """Return the coefficients as reported quantities.

        Args:
            values: (P,) coefficients of the law (linear), SI, in the order of ``self.coefficients``.
            shape: (S,) shape parameters of the law (nonlinear), SI, in the order of ``self.shape``.
            delayed_channel: Samples of the delayed channel.

        Returns:
            Quantities by name. The first one is the size of the effect and is proportional to the coefficients.
        """
        ...

    def to_file_parameters(self, values: Array, delayed_channel: DelayedChannel) -> dict[str, float | list[float]]:
        """Return the parameters as the diagnosis file states them.

        Args:
            values: (P,) coefficients of the law (linear), SI, in the order of ``self.coefficients``.
            delayed_channel: Samples of the delayed channel.

        Returns:
            Keys and values in the units of the keys.
        """
        ...

    def grid(self, delayed_channel: DelayedChannel) -> tuple[Shape, ...]:
        """Return the shapes that a search tries.

        Args:
            delayed_channel: Samples of the delayed channel.

        Returns:
            Shapes in SI; empty if the samples cannot show the effect.
        """
        ...
