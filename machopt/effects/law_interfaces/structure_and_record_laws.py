"""Ports of what is no joint: bodies that give way, heat, the load at the flange, clocks, what a record has wrong."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from typing import Any, Protocol

import numpy as np

from machopt.effects.law_interfaces.law_parameters import DescribedLaw, LawParameterSet, Quantity, Shape
from machopt.effects.law_interfaces.parameter_reader import ParameterReader
from machopt.numerics.array_types import Array


@dataclass(frozen=True, kw_only=True)
class CompliantBody:
    """A body where it gives way, all joints at zero: between its root and the frame S at its loaded end."""

    axes: Array  # (3, 3) axes of S in base_link: x along the body, or out of the tool
    length: float = 0.0  # m; 0: the joints leave none
    root: Array | None = None  # (4, 4) the flange as seen from S; None: a body that begins anywhere
    normal: Array | None = None  # (3,) base_link axes: across the body, what the arm moves about in its plane
    uses_own_axes: bool = False  # what is no beam is stated in axes of S; else in base_link's


class BodyLaw(DescribedLaw, Protocol):
    """How a body gives way under what it bears, linear in that: a twist of S by the wrench there. Stateless; SI."""

    @property
    def note(self) -> str:
        """Where it shows; empty: where joints' torques explain nothing."""
        ...

    @property
    def includes_weight(self) -> bool:
        """Tried where weight bends too, which shows little of a body."""
        ...

    @property
    def bounded(self) -> bool:
        """A search keeps the coefficients above their least; else noise may leave a direction that pushes back."""
        ...

    def axes(self, body: CompliantBody) -> Array:
        """(3, 3) in base_link, the law's own axes at S with all joints at zero."""
        ...

    def matrices(self, shape: Array, body: CompliantBody) -> Array:
        """(P, 6, 6) compliance at S per unit of each coefficient, in the law's axes."""
        ...

    def compute_own_weight_deflection(
        self, shape: Array, body: CompliantBody, own: Sequence[tuple[Array, float]]
    ) -> Array | None:
        """(K, 6, P) twist of S under weights that are spread evenly along the body; None: they count at S.

        Args:
            own: of each weight the whole of it (K, 3) N in the law's axes, and how far from the root it reaches, m.
        """
        ...

    def project_to_admissible(self, values: Array, metric: Array) -> Array:
        """Coefficients of a body that pushes back nowhere.

        Args:
            values: (p,) where noise has its way.
            metric: (p, p) how the sum of squares that readings leave grows with a change of them.
        """
        ...

    def to_file_parameters(self, values: Array, shape: Array, body: CompliantBody) -> dict[str, Any]:
        """The parameters of a file."""
        ...

    def sizes(self, values: Array, shape: Array) -> Mapping[str, Quantity]:
        """Numbers of the trade; the first is the effect's size and grows in proportion to the coefficients."""
        ...

    def grid(self, body: CompliantBody) -> tuple[Shape, ...]:
        """Shapes that a search tries; none of a body that makes no such thing."""
        ...

    def restrict_to_observed(self, dimensions: int, *, turning: bool) -> BodyLaw:
        """As readings of 3 or 6 coordinates show it, whose loads turn the tool by moments or only pull."""
        ...


Reader = Callable[[ParameterReader, CompliantBody], tuple[BodyLaw, Array, Array, CompliantBody]]
"""Law, coefficients and shape that a file means, and the body as the file has it."""


@dataclass(frozen=True)
class RecordedLoad:
    """What K readings at rest record, as far as sensors may have it wrong. base_link axes."""

    wrench: Array  # (K, 6) N, N·m at the TCP
    displacement: Array  # (K, D) m, rad of the TCP, as predicted so far
    axes: Array  # (K, 3, 3) of the sensor, its axes in columns
    tool: Array  # (K, 3, 3) of the tool
    position: Array | None = None  # (K, 3) m of the TCP in measured poses; None: a load test


class RecordLaw(DescribedLaw, Protocol):
    """What acts beyond what is recorded, linear in its coefficients. Stateless; SI."""

    @property
    def affected_quantity(self) -> str:
        """What it changes: "wrench", which acts through the arm, "displacement", "position" of measured poses, or the
        "point" of the tool at which load and displacement are recorded."""
        ...

    def columns(self, shape: Array, seen: RecordedLoad) -> Array:
        """(K, 6, P) N, N·m, of others (K, D, P) m, rad, of a point m in the first three, per unit of a coefficient."""
        ...

    def sizes(self, values: Array, shape: Array) -> Mapping[str, Quantity]:
        """Numbers of the trade; the first is the effect's size and grows in proportion to small coefficients."""
        ...

    def grid(self) -> tuple[Shape, ...]:
        """Shapes that a search tries."""
        ...


@dataclass(frozen=True, kw_only=True)
class ThermalState:
    """What heat may follow in N readings, and which way it moves the TCP."""

    time_since_start: Array | None  # (N,) s since the session began; None: nobody knows
    unloaded_time_since_start: (
        Array | None
    )  # (N,) s, the same of the state that each reading counts from; None: it counts as it is
    temperature_rise: Array | None  # (N,) K beyond the first reading; None: not recorded
    casting_columns: Array  # (N, D, 3) m per unit strain of carousel, upper arm, forearm
    stand_columns: Array  # (N, D, 6) m, rad per m and rad of a shift and a turn of the stand
    is_relative: bool  # readings count from a state without load

    @property
    def longest_session(self) -> float:
        """s, of a session; 0 where nobody knows."""
        return 0.0 if self.time_since_start is None else float(self.time_since_start.max())


class DriftLaw(DescribedLaw, Protocol):
    """What moves with time or temperature, linear in its coefficients. Stateless; SI."""

    @property
    def penalty(self) -> float:
        """Gain beyond that of its coefficients that it must bring: flexible enough to fit much."""
        ...

    def columns(self, shape: Array, seen: ThermalState) -> Array:
        """(N, D, P) m, rad of the TCP per unit of each coefficient."""
        ...

    def sizes(self, values: Array, shape: Array, seen: ThermalState) -> Mapping[str, Quantity]:
        """Numbers of the trade; the first is the effect's size and grows in proportion to the coefficients."""
        ...

    def grid(self, seen: ThermalState) -> tuple[Shape, ...]:
        """Shapes that a search tries; none where the readings cannot show it."""
        ...


@dataclass(frozen=True)
class ToolSideLoad:
    """What the tool side carries by the cell, and what more of it does to N readings. Axes of the flange."""

    mass: float  # kg
    centre: Array  # (3,) m
    reference_point: Array  # (3,) m, where the kilogram of the first column hangs
    columns: Array  # (N, D, 4) per kg there, and per kg·m of first moment along each axis


class PayloadLaw(LawParameterSet, Protocol):
    """A load at the flange beyond the cell's, linear in its coefficients. Stateless; SI."""

    @property
    def name(self) -> str: ...

    @property
    def equation(self) -> str:
        """What acts, in words that follow on the channel's own equation."""
        ...

    def columns(self, seen: ToolSideLoad) -> Array:
        """(N, D, P) of the readings per unit of each coefficient."""
        ...

    def sizes(self, values: Array, seen: ToolSideLoad) -> Mapping[str, Quantity]:
        """Numbers of the trade; the first is the effect's size and grows in proportion to the coefficients."""
        ...

    def grid(self, seen: ToolSideLoad) -> tuple[Shape, ...]:
        """Shapes that a search tries; none where the cell states nothing that could be so."""
        ...


@dataclass(frozen=True, kw_only=True)
class DelayedChannel:
    """N samples of a channel as they would be had something come late."""

    compute_change: Callable[[float], Array]  # s → (N, D) f(t − d) − f(t), f what the channel should have shown
    best_delay: float  # s that fits best
    tangent_step: float  # s over which a tangent is taken
    sign: float = 1.0  # −1 where a channel that is late makes the difference look early
    following_columns: Array | None = (
        None  # (N, D, 1) what the encoders say of following a command; None: no such thing
    )
    delays: tuple[float, ...] = ()  # s by which each encoder follows its command; 0 where it stays with it

    @property
    def mean(self) -> float:
        """s, of the encoders that stay behind."""
        behind = [d for d in self.delays if d]
        return float(np.mean(behind)) if behind else 0.0


class DelayLaw(DescribedLaw, Protocol):
    """Something that comes late, linear in its coefficient about the delay of its shape. Stateless; SI."""

    @property
    def exact(self) -> bool:
        """Its column leaves nothing of the effect, however large that is."""
        ...

    def columns(self, shape: Array, seen: DelayedChannel) -> Array:
        """(N, D, P) of the channel per unit of each coefficient."""
        ...

    def sizes(self, values: Array, shape: Array, seen: DelayedChannel) -> Mapping[str, Quantity]:
        """Numbers of the trade; the first is the effect's size and grows in proportion to the coefficients."""
        ...

    def to_file_parameters(self, values: Array, seen: DelayedChannel) -> dict[str, float | list[float]]:
        """What the diagnosis says of it in units of the trade."""
        ...

    def grid(self, seen: DelayedChannel) -> tuple[Shape, ...]:
        """Shapes that a search tries; none where the samples cannot show it."""
        ...
