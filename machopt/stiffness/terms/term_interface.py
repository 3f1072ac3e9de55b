"""Interface of elastic terms, and their default behaviour."""

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
    """One coefficient of a term that a fit can estimate, in SI; a compliance, so that zero means rigid."""

    name: str  # as in the file where the file contains it directly, e.g. "1/EI"
    unit: str  # SI
    lower: float = 0.0  # −inf where the sign is free


@dataclass(frozen=True)
class LoadedArm:
    """State of the arm under load."""

    state: ArmState  # M configurations, with bodies
    gears: Array  # (M, 6) N·m/rad of the joints' own springs
    weight: Array | None = None  # (M, 6) N·m, torque of links and tool at the joints; None: zero


class ElasticContribution(Protocol):
    """Contribution to the motion of the TCP under a wrench on top of weight."""

    @property
    def retained_share(self) -> float | None:
        """Minimum share of the compliance along a direction that remains; None: no minimum."""
        ...

    def compute_twist(self, under: LoadedArm, wrench: Array, *, small: bool) -> Array:
        """Return the (M, 6) twist in m, rad at the TCP, base_link axes.

        Args:
            under: state of the arm under load.
            wrench: (M, 6) N, N·m at the TCP in base_link axes.
            small: use the tangent under weight, as for a very small wrench.
        """
        ...


class LinearTerm(ElasticContribution, Protocol):
    """Elastic effect whose twist at the TCP is linear in its coefficients, and in the wrench except for two families.

    :class:`machopt.stiffness.terms.joint_term.JointTerm` may follow the joint's torque along a curve, and
    :class:`machopt.stiffness.terms.gravity_compensator.GravityCompensator` is a spring parallel to one of the joints.
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
        """Missing keys of the file that define its curve or location."""
        ...

    @property
    def depends_on_weight(self) -> bool:
        """Whether the term depends on the weight at the joint."""
        ...

    @property
    def parallel_joint(self) -> int | None:
        """0-based joint to whose gear it is parallel, so that it counts in that joint's stiffness."""
        ...

    @property
    def coupled_joints(self) -> tuple[int, int, float] | None:
        """Two joints, 0-based, and the rotation of each per torque of the other, rad/(N·m)."""
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
        """Return (M, 6, P) like :meth:`compute_response`, on top of weight; zero for terms in a joint's own stiffness.

        Args:
            state: M configurations with bodies.
            wrench: (M, 6) N, N·m at the TCP in base_link axes.
            weight: (M, 6) N·m, torque of weight at the joints; None: zero.
            small: use the tangent under weight.
        """
        ...

    def combine_coefficients(self) -> LinearTerm | None:
        """Return the same term with fixed coefficients for a plan; None for terms in a joint's stiffness."""
        ...

    def with_joint_stiffness(self, gears: Callable[[ArmState], Array]) -> LinearTerm:
        """Return the same term for an arm with given joint stiffness.

        Args:
            gears: returns (M, 6) N·m/rad of an arm state.
        """
        ...

    def compute_parallel_stiffness(self, angle: Array) -> Array:
        """Return (...,) N·m/rad parallel to the gear that it balances.

        Args:
            angle: (...,) rad of that joint.
        """
        ...

    def bound_compliance(self, low: Array, high: Array) -> tuple[int, float, float] | None:
        """Return its 0-based joint, the lower bound of its contribution to the compliance, rad/(N·m), and the angle.

        −inf where it is unbounded. None: it follows no single joint.

        Args:
            low: (6,) rad, lower ends of the angles.
            high: (6,) rad, upper ends.
        """
        ...

    def limit_to_spring_range(self, room: Array) -> LinearTerm:
        """Return the same term limited to the range where it is a spring.

        Args:
            room: (6,) rad/(N·m), compliance of each joint that it may use up.
        """
        ...

    def with_values(self, values: Array) -> LinearTerm:
        """Return the same term with other coefficients.

        Args:
            values: (P,) SI.
        """
        ...

    def to_file(self) -> StiffnessTerm:
        """Return the term as in stiffness.yaml."""
        ...


class DefaultTerm:
    """Default behaviour of a term: complete, independent of weight, parallel to no gear, and following no single
    joint.
    """

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
        """Return the response, which does not depend on weight.

        Args:
            state: M configurations with bodies.
            wrench: (M, 6) N, N·m at the TCP in base_link axes.
            weight: not used.
            small: not used.
        """
        return self.compute_response(state, wrench)

    def compute_twist(self: LinearTerm, under: LoadedArm, wrench: Array, *, small: bool) -> Array:
        """Return the (M, 6) twist in m, rad at the TCP, base_link axes.

        Args:
            under: state of the arm under load.
            wrench: (M, 6) N, N·m at the TCP in base_link axes.
            small: use the tangent under weight.
        """
        return np.asarray(
            self.compute_response_under_weight(under.state, wrench, under.weight, small=small) @ self.values
        )

    def combine_coefficients(self: LinearTerm) -> LinearTerm | None:
        return self

    def with_joint_stiffness(self: LinearTerm, gears: Callable[[ArmState], Array]) -> LinearTerm:
        """Return the term itself, which does not depend on joint stiffness.

        Args:
            gears: not used.
        """
        return self

    def compute_parallel_stiffness(self, angle: Array) -> Array:
        """Return zeros: the term is parallel to no gear.

        Args:
            angle: (...,) rad.
        """
        return np.zeros_like(angle)

    def bound_compliance(self, low: Array, high: Array) -> tuple[int, float, float] | None:
        """Return None: the term follows no single joint.

        Args:
            low: not used.
            high: not used.
        """
        return None

    def limit_to_spring_range(self: LinearTerm, room: Array) -> LinearTerm:
        """Return the term itself, which is a spring everywhere.

        Args:
            room: not used.
        """
        return self
