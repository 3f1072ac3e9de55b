"""What a term is, and what each is where its family says nothing else."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import Protocol

import numpy as np

from machopt.arrays import Array
from machopt.domain.stiffness import Term
from machopt.model.robot import ArmState


@dataclass(frozen=True)
class Coefficient:
    """One number of a term that a fit can find, in SI; a compliance, so that zero means rigid."""

    name: str  # as in the file where the file holds it directly, e.g. "1/EI"
    unit: str  # SI
    lower: float = 0.0  # −inf where the sign is free


@dataclass(frozen=True)
class Under:
    """The arm while it is pushed."""

    state: ArmState  # M configurations, with bodies
    gears: Array  # (M, 6) N·m/rad of the joints' own springs
    weight: Array | None = None  # (M, 6) N·m, torque of links and tool at the joints; None: zero


class Gives(Protocol):
    """Whatever adds to how the TCP moves under a wrench on top of weight."""

    @property
    def keeps(self) -> float | None:
        """Share of the compliance along a direction that it leaves at least; None: it is not held to any."""
        ...

    def twist(self, under: Under, wrench: Array, *, small: bool) -> Array:
        """(M, 6) m, rad at the TCP under wrenches (M, 6) N, N·m, base_link axes.

        ``small``: as if the wrench were so small that the tangent under weight holds.
        """
        ...


class LinearTerm(Gives, Protocol):
    """Elastic physics whose twist at the TCP is linear in its coefficients, and in the wrench but for two families.

    :class:`machopt.model.terms.joint.JointTerm` may follow the joint's torque along a curve, and
    :class:`machopt.model.terms.compensator.GravityCompensator` is a spring beside one of the joints.
    """

    @property
    def effect(self) -> str: ...

    @property
    def location(self) -> str: ...

    @property
    def coefficients(self) -> tuple[Coefficient, ...]: ...

    @property
    def values(self) -> Array:
        """(P,) the coefficients' values in SI; NaN for a term that is still to be fitted."""
        ...

    @property
    def lacking(self) -> tuple[str, ...]:
        """Keys of the file without which it is no curve or has no place."""
        ...

    @property
    def weighs(self) -> bool:
        """The weight at the joint makes a difference."""
        ...

    @property
    def balances(self) -> int | None:
        """0-based joint beside whose gear it is a spring, so that it counts in that joint's stiffness."""
        ...

    @property
    def couples(self) -> tuple[int, int, float] | None:
        """Two joints, 0-based, and how far the torque of each turns the other, rad/(N·m)."""
        ...

    def response(self, state: ArmState, wrench: Array) -> Array:
        """Twist of the TCP per unit of each coefficient.

        Args:
            state: M configurations with bodies.
            wrench: (M, 6) N, N·m at the TCP in base_link axes.

        Returns:
            (M, 6, P) m, rad per unit; base_link axes, at the TCP.
        """
        ...

    def loaded(self, state: ArmState, wrench: Array, weight: Array | None, *, small: bool) -> Array:
        """(M, 6, P) like :meth:`response`, on top of weight (M, 6) N·m; zero of what counts in a joint's own error."""
        ...

    def folded(self) -> LinearTerm | None:
        """The same for a plan, where its coefficients stand; None of what counts in a joint's stiffness."""
        ...

    def on(self, gears: Callable[[ArmState], Array]) -> LinearTerm:
        """The same on an arm whose joints have these stiffnesses, (M, 6) N·m/rad."""
        ...

    def added(self, angle: Array) -> Array:
        """(...,) N·m/rad beside the gear that it balances, at angles (...,) rad of that joint."""
        ...

    def takes(self, low: Array, high: Array) -> tuple[int, float, float] | None:
        """The 0-based joint that it follows, what it adds at least to its compliance, rad/(N·m), and at which angle.

        −inf where that has no end. None: it follows no single joint.

        Args:
            low, high: (6,) rad, between which angles.
        """
        ...

    def within(self, room: Array) -> LinearTerm:
        """The same held to where it is a spring still, where it may take ``room`` (6,) rad/(N·m) from the joints."""
        ...

    def with_values(self, values: Array) -> LinearTerm:
        """The same term with other coefficients (P,)."""
        ...

    def to_file(self) -> Term:
        """The term as stiffness.yaml holds it."""
        ...


class Plain:
    """A term as most are: complete, deaf to weight, beside no gear, and following no single joint."""

    @property
    def keeps(self) -> float | None:
        return None

    @property
    def lacking(self) -> tuple[str, ...]:
        return ()

    @property
    def weighs(self) -> bool:
        return False

    @property
    def balances(self) -> int | None:
        return None

    @property
    def couples(self) -> tuple[int, int, float] | None:
        return None

    def loaded(self: LinearTerm, state: ArmState, wrench: Array, weight: Array | None, *, small: bool) -> Array:
        return self.response(state, wrench)

    def twist(self: LinearTerm, under: Under, wrench: Array, *, small: bool) -> Array:
        return np.asarray(self.loaded(under.state, wrench, under.weight, small=small) @ self.values)

    def folded(self: LinearTerm) -> LinearTerm | None:
        return self

    def on(self: LinearTerm, gears: Callable[[ArmState], Array]) -> LinearTerm:
        return self

    def added(self, angle: Array) -> Array:
        return np.zeros_like(angle)

    def takes(self, low: Array, high: Array) -> tuple[int, float, float] | None:
        return None

    def within(self: LinearTerm, room: Array) -> LinearTerm:
        return self
