"""What a term is, how one is made from the parameters of a file, and which effects exist."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Protocol

from machopt.arrays import Array
from machopt.domain.stiffness import Term
from machopt.model.robot import ArmState


@dataclass(frozen=True)
class Coefficient:
    """One number of a term that a fit can find, in SI; a compliance, so that zero means rigid."""

    name: str  # as in the file where the file holds it directly, e.g. "1/EI"
    unit: str  # SI
    lower: float = 0.0  # −inf where the sign is free


class LinearTerm(Protocol):
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

    def response(self, state: ArmState, wrench: Array) -> Array:
        """Twist of the TCP per unit of each coefficient.

        Args:
            state: M configurations with bodies.
            wrench: (M, 6) N, N·m at the TCP in base_link axes.

        Returns:
            (M, 6, P) m, rad per unit; base_link axes, at the TCP.
        """
        ...

    def with_values(self, values: Array) -> LinearTerm:
        """The same term with other coefficients (P,)."""
        ...

    def to_file(self) -> Term:
        """The term as stiffness.yaml holds it."""
        ...
