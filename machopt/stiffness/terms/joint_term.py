"""Terms of single joints, whose laws :mod:`machopt.effects` holds, at the TCP; and the coupling of two joints.

A process force comes on top of weight, so a law φ that follows the whole torque of the gear gives
``φ(τ_g + τ_w) − φ(τ_g)``, τ_g = weight of links and tool at the configuration, τ_w = Jᵀw. Weight counts as zero where
masses are unknown, and the torque of a gravity compensator is not in it: diagnose fits the laws over the same τ. A plan
has no history: each load rises from a gear at rest and lasts.

What a *small* load meets (stiffness indices, maps, compliance matrices) is the law's tangent under weight.
Coefficients may be negative, so a file can ask for springs that give way against the load:
:func:`machopt.stiffness.terms.stability_check.find_unstable_term`.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from machopt.data_types.locations import parse_joint_location
from machopt.data_types.stiffness import StiffnessTerm
from machopt.effects import parameter_conversion, registry
from machopt.effects.law_interfaces.parameter_reader import ParameterReader
from machopt.effects.protocol import JointLaw, JointLoading
from machopt.errors import InputError
from machopt.kinematics.robot import ArmState
from machopt.numerics.array_types import Array
from machopt.stiffness.terms.protocol import DefaultTerm, LinearTerm, TermCoefficient


@dataclass(frozen=True, kw_only=True)
class JointTerm(DefaultTerm):
    """Extra twist of joint i: Σ_p x_p (B_p(τ_g + τ_w) − B_p(τ_g)), B the columns of a law."""

    effect: str
    location: str  # joint:i
    i: int  # 0-based
    law: JointLaw
    shape: Array  # (S,) SI; NaN: still to be found
    values: Array  # (P,) SI
    memory: str = ""  # of the gear, as the file says it; a plan at rest has no use for it

    @property
    def coefficients(self) -> tuple[TermCoefficient, ...]:
        return tuple(
            TermCoefficient(*c) for c in parameter_conversion.list_coefficient_names(self.law, len(self.values))
        )

    @property
    def missing_keys(self) -> tuple[str, ...]:
        """Keys of the file without which the law is no curve; what lasts for ever needs no time."""
        if np.isfinite(self.shape).all():
            return ()
        return tuple(p.key for p in self.law.shape if p.unit != "s")

    @property
    def depends_on_weight(self) -> bool:
        """The weight at the joint makes a difference."""
        return self.law.includes_weight

    def compute_response(self, state: ArmState, wrench: Array, weight: Array | None = None) -> Array:
        """Twist of the TCP per unit of each coefficient, under a wrench on top of weight.

        Args:
            state: M configurations.
            wrench: (M, 6) N, N·m at the TCP in base_link axes.
            weight: (M, 6) N·m, torque of weight at the joints; None: zero.

        Returns:
            (M, 6, P) m, rad per unit; base_link axes, at the TCP.

        Raises:
            InputError: the law's shape is not known.
        """
        self._check_complete()
        column, angle = state.J[..., :, self.i], state.q[..., self.i]
        load = np.einsum("...c,...c->...", column, wrench)
        if weight is None or not self.depends_on_weight:
            turned = self.law.columns(self.shape, JointLoading(load, angle))
        else:
            before = weight[..., self.i]
            turned = self.law.columns(self.shape, JointLoading(before + load, angle))
            turned = turned - self.law.columns(self.shape, JointLoading(before, angle))
        return np.asarray(column[..., :, None] * turned[..., None, :])

    def compute_small_load_response(self, state: ArmState, wrench: Array, weight: Array | None = None) -> Array:
        """(M, 6, P) like :meth:`response`, for a wrench so small that the tangent holds."""
        self._check_complete()
        column = state.J[..., :, self.i]
        load = np.einsum("...c,...c->...", column, wrench)
        under = np.zeros_like(load) if weight is None or not self.depends_on_weight else weight[..., self.i]
        slope = self.law.tangent(self.shape, JointLoading(under, state.q[..., self.i]))
        return np.asarray(column[..., :, None] * (slope * load[..., None])[..., None, :])

    def compute_response_under_weight(
        self, state: ArmState, wrench: Array, weight: Array | None, *, small: bool
    ) -> Array:
        return (
            self.compute_small_load_response(state, wrench, weight)
            if small
            else self.compute_response(state, wrench, weight)
        )

    def bound_compliance(self, low: Array, high: Array) -> tuple[int, float, float] | None:
        return self.i, *self.law.compute_max_slope(self.values, self.shape, float(low[self.i]), float(high[self.i]))

    def limit_to_spring_range(self, room: Array) -> LinearTerm:
        return replace(self, law=self.law.limit_to_compliance(self.values, float(room[self.i])))

    def with_values(self, values: Array) -> LinearTerm:
        return replace(self, values=np.asarray(values, float))

    def to_file(self) -> StiffnessTerm:
        return StiffnessTerm(
            self.effect,
            self.location,
            parameter_conversion.write_law_parameters(self.law, self.values, self.shape, self.memory),
        )

    def _check_complete(self) -> None:
        if self.missing_keys:
            raise InputError(
                f"{self.effect} at {self.location} lacks {', '.join(self.missing_keys)}, without which it is no curve; "
                "machopt diagnose searches for it",
                where="terms",
            )


@dataclass(frozen=True, kw_only=True)
class JointCoupling(DefaultTerm):
    """A torque on one joint turns another and the other way round: Δq_i = φ(τ_j) and Δq_j = φ(τ_i), φ linear."""

    effect: str
    location: str  # joint:i-j
    i: int  # 0-based
    j: int
    law: JointLaw
    values: Array  # (P,) SI

    @property
    def coefficients(self) -> tuple[TermCoefficient, ...]:
        return tuple(
            TermCoefficient(*c) for c in parameter_conversion.list_coefficient_names(self.law, len(self.values))
        )

    @property
    def coupled_joints(self) -> tuple[int, int, float] | None:
        return self.i, self.j, float((self.law.tangent(np.empty(0), JointLoading(np.zeros(1))) @ self.values)[0])

    def compute_response(self, state: ArmState, wrench: Array) -> Array:
        J = state.J
        tau = np.einsum("...ci,...c->...i", J, wrench)
        by_j, by_i = (self.law.columns(np.empty(0), JointLoading(tau[..., k])) for k in (self.j, self.i))
        return np.asarray(J[..., :, self.i, None] * by_j[..., None, :] + J[..., :, self.j, None] * by_i[..., None, :])

    def with_values(self, values: Array) -> LinearTerm:
        return replace(self, values=np.asarray(values, float))

    def to_file(self) -> StiffnessTerm:
        return StiffnessTerm(
            self.effect, self.location, parameter_conversion.write_law_parameters(self.law, self.values, np.empty(0))
        )


def build_joint_term(effect: str, parameters: ParameterReader, location: str) -> LinearTerm:
    """A term of one joint, or between two, from a file."""
    known = registry.find_elastic_effect(effect)
    law = parameter_conversion.find_law(known, parameters)
    values, shape, memory = parameter_conversion.read_law_parameters(law, parameters)
    i, j = parse_joint_location(location)
    if known.is_joint_pair:
        return JointCoupling(effect=effect, location=location, i=i, j=j, law=law, values=values)
    return JointTerm(effect=effect, location=location, i=i, law=law, shape=shape, values=values, memory=memory)
