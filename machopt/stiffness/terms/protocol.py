"""What a term is, and what each is where its family says nothing else."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import Protocol

import numpy as np

from machopt.data_types.stiffness import StiffnessTerm
from machopt.kinematics.robot import ArmState
from machopt.numerics.array_types import Array


@dataclass(frozen=True)
class TermCoefficient:
    """One number of a term that a fit can find, in SI; a compliance, so that zero means rigid."""

    name: str  # as in the file where the file holds it directly, e.g. "1/EI"
    unit: str  # SI
    lower: float = 0.0  # −inf where the sign is free


@dataclass(frozen=True)
class LoadedArm:
    """The arm while it is pushed."""

    state: ArmState  # M configurations, with bodies
    gears: Array  # (M, 6) N·m/rad of the joints' own springs
    weight: Array | None = None  # (M, 6) N·m, torque of links and tool at the joints; None: zero


class ElasticContribution(Protocol):
    """Whatever adds to how the TCP moves under a wrench on top of weight."""

    @property
    def retained_share(self) -> float | None:
        """Share of the compliance along a direction that it leaves at least; None: it is not held to any."""
        ...

    def compute_twist(self, under: LoadedArm, wrench: Array, *, small: bool) -> Array:
        """(M, 6) m, rad at the TCP under wrenches (M, 6) N, N·m, base_link axes.

        ``small``: as if the wrench were so small that the tangent under weight holds.
        """
        ...


class LinearTerm(ElasticContribution, Protocol):
    """Elastic physics whose twist at the TCP is linear in its coefficients, and in the wrench but for two families.

    :class:`machopt.stiffness.terms.joint_term.JointTerm` may follow the joint's torque along a curve, and
    :class:`machopt.stiffness.terms.gravity_compensator.GravityCompensator` is a spring beside one of the joints.
    """

    @property
    def effect(self) -> str: ...

    @property
    def location(self) -> str: ...

    @property
    def coefficients(self) -> tuple[TermCoefficient, ...]: ...

    @property
    def values(self) -> Array:
        """(P,) the coefficients' values in SI; NaN for a term that is still to be fitted."""
        ...

    @property
    def missing_keys(self) -> tuple[str, ...]:
        """Keys of the file without which it is no curve or has no place."""
        ...

    @property
    def depends_on_weight(self) -> bool:
        """The weight at the joint makes a difference."""
        ...

    @property
    def parallel_joint(self) -> int | None:
        """0-based joint beside whose gear it is a spring, so that it counts in that joint's stiffness."""
        ...

    @property
    def coupled_joints(self) -> tuple[int, int, float] | None:
        """Two joints, 0-based, and how far the torque of each turns the other, rad/(N·m)."""
        ...

    def compute_response(self, state: ArmState, wrench: Array) -> Array:
        """Twist of the TCP per unit of each coefficient.

        Args:
            state: M configurations with bodies.
            wrench: (M, 6) N, N·m at the TCP in base_link axes.

        Returns:
            (M, 6, P) m, rad per unit; base_link axes, at the TCP.
        """
        ...

    def compute_response_under_weight(
        self, state: ArmState, wrench: Array, weight: Array | None, *, small: bool
    ) -> Array:
        """(M, 6, P) like :meth:`response`, on top of weight (M, 6) N·m; zero of what counts in a joint's own error."""
        ...

    def combine_coefficients(self) -> LinearTerm | None:
        """The same for a plan, where its coefficients stand; None of what counts in a joint's stiffness."""
        ...

    def with_joint_stiffness(self, gears: Callable[[ArmState], Array]) -> LinearTerm:
        """The same on an arm whose joints have these stiffnesses, (M, 6) N·m/rad."""
        ...

    def compute_parallel_stiffness(self, angle: Array) -> Array:
        """(...,) N·m/rad beside the gear that it balances, at angles (...,) rad of that joint."""
        ...

    def bound_compliance(self, low: Array, high: Array) -> tuple[int, float, float] | None:
        """The 0-based joint that it follows, what it adds at least to its compliance, rad/(N·m), and at which angle.

        −inf where that has no end. None: it follows no single joint.

        Args:
            low, high: (6,) rad, between which angles.
        """
        ...

    def limit_to_spring_range(self, room: Array) -> LinearTerm:
        """The same held to where it is a spring still, where it may take ``room`` (6,) rad/(N·m) from the joints."""
        ...

    def with_values(self, values: Array) -> LinearTerm:
        """The same term with other coefficients (P,)."""
        ...

    def to_file(self) -> StiffnessTerm:
        """The term as stiffness.yaml holds it."""
        ...


class DefaultTerm:
    """A term as most are: complete, deaf to weight, beside no gear, and following no single joint."""

    @property
    def retained_share(self) -> float | None:
        return None

    @property
    def missing_keys(self) -> tuple[str, ...]:
        return ()

    @property
    def depends_on_weight(self) -> bool:
        return False

    @property
    def parallel_joint(self) -> int | None:
        return None

    @property
    def coupled_joints(self) -> tuple[int, int, float] | None:
        return None

    def compute_response_under_weight(
        self: LinearTerm, state: ArmState, wrench: Array, weight: Array | None, *, small: bool
    ) -> Array:
        return self.compute_response(state, wrench)

    def compute_twist(self: LinearTerm, under: LoadedArm, wrench: Array, *, small: bool) -> Array:
        return np.asarray(
            self.compute_response_under_weight(under.state, wrench, under.weight, small=small) @ self.values
        )

    def combine_coefficients(self: LinearTerm) -> LinearTerm | None:
        return self

    def with_joint_stiffness(self: LinearTerm, gears: Callable[[ArmState], Array]) -> LinearTerm:
        return self

    def compute_parallel_stiffness(self, angle: Array) -> Array:
        return np.zeros_like(angle)

    def bound_compliance(self, low: Array, high: Array) -> tuple[int, float, float] | None:
        return None

    def limit_to_spring_range(self: LinearTerm, room: Array) -> LinearTerm:
        return self
