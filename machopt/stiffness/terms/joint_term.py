"""Terms of single joints at the TCP, with the laws of :mod:`machopt.effects`; and the coupling of two joints.

A process force acts in addition to weight, so a law φ that follows the whole torque of the gear gives
``φ(τ_g + τ_w) − φ(τ_g)``, τ_g = weight of links and tool at the configuration, τ_w = Jᵀw. Weight counts as zero where
masses are unknown, and the torque of a gravity compensator is not included: diagnose fits the laws over the same τ. A
plan has no history: each load starts at a gear at rest and is constant.

For a *small* load (stiffness indices, maps, compliance matrices) the law's tangent under weight is used.
Coefficients may be negative, so a file can define springs that are unstable under load:
:func:`machopt.stiffness.terms.stability_check.find_unstable_term`.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from machopt.data_types.effect_locations import parse_joint_location
from machopt.data_types.stiffness import StiffnessTerm
from machopt.effects import parameter_conversion, registry
from machopt.effects.law_interfaces.parameter_reader import ParameterReader
from machopt.effects.protocol import JointLaw, JointLoading
from machopt.errors import InputError
from machopt.kinematics.robot import ArmState
from machopt.numerics.array_types import Array
from machopt.stiffness.terms.term_interface import DefaultTerm, LinearTerm, TermCoefficient


@dataclass(frozen=True, kw_only=True)
class JointTerm(DefaultTerm):
    """Additional twist of joint i: Σ_p x_p (B_p(τ_g + τ_w) − B_p(τ_g)), B the columns of a law."""

    effect: str
    location: str  # joint:i
    i: int  # 0-based
    law: JointLaw
    shape: Array  # (S,) SI; NaN: not yet known
    values: Array  # (P,) SI
    memory: str = ""  # memory law of the gear, as in the file; not used by a plan

    @property
    def coefficients(self) -> tuple[TermCoefficient, ...]:
        return tuple(
            TermCoefficient(*c) for c in parameter_conversion.list_coefficient_names(self.law, len(self.values))
        )

    @property
    def missing_keys(self) -> tuple[str, ...]:
        """Missing keys of the file that define the curve of the law; a static law needs no time constant."""
        if np.isfinite(self.shape).all():
            return ()
        return tuple(p.key for p in self.law.shape if p.unit != "s")

    @property
    def depends_on_weight(self) -> bool:
        """Whether the term depends on the weight at the joint."""
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
        """Return (M, 6, P) like :meth:`compute_response`, for a wrench so small that the tangent holds.

        Args:
            state: M configurations.
            wrench: (M, 6) N, N·m at the TCP in base_link axes.
            weight: (M, 6) N·m, torque of weight at the joints; None: zero.
        """
        self._check_complete()
        column = state.J[..., :, self.i]
        load = np.einsum("...c,...c->...", column, wrench)
        under = np.zeros_like(load) if weight is None or not self.depends_on_weight else weight[..., self.i]
        slope = self.law.tangent(self.shape, JointLoading(under, state.q[..., self.i]))
        return np.asarray(column[..., :, None] * (slope * load[..., None])[..., None, :])

    def compute_response_under_weight(
        self, state: ArmState, wrench: Array, weight: Array | None, *, small: bool
    ) -> Array:
        """Return the (M, 6, P) response on top of weight.

        Args:
            state: M configurations.
            wrench: (M, 6) N, N·m at the TCP in base_link axes.
            weight: (M, 6) N·m, torque of weight at the joints; None: zero.
            small: use the tangent under weight.
        """
        return (
            self.compute_small_load_response(state, wrench, weight)
            if small
            else self.compute_response(state, wrench, weight)
        )

    def bound_compliance(self, low: Array, high: Array) -> tuple[int, float, float] | None:
        """Return the joint, its greatest reduction of compliance in rad/(N·m), and the angle, as in
        :class:`LinearTerm`.

        Args:
            low: (6,) rad, lower ends of the angles.
            high: (6,) rad, upper ends.
        """
        return self.i, *self.law.compute_max_slope(self.values, self.shape, float(low[self.i]), float(high[self.i]))

    def limit_to_spring_range(self, room: Array) -> LinearTerm:
        """Return the same term limited to the range where it is a spring.

        Args:
            room: (6,) rad/(N·m), compliance of each joint that it may use up.
        """
        return replace(self, law=self.law.limit_to_compliance(self.values, float(room[self.i])))

    def with_values(self, values: Array) -> LinearTerm:
        """Return the same term with other coefficients.

        Args:
            values: (P,) SI.
        """
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
    """Coupling of two joints: Δq_i = φ(τ_j) and Δq_j = φ(τ_i), φ linear."""

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
        """Return the (M, 6, P) twist of the TCP per unit of each coefficient, base_link axes.

        Args:
            state: M configurations.
            wrench: (M, 6) N, N·m at the TCP in base_link axes.
        """
        J = state.J
        tau = np.einsum("...ci,...c->...i", J, wrench)
        by_j, by_i = (self.law.columns(np.empty(0), JointLoading(tau[..., k])) for k in (self.j, self.i))
        return np.asarray(J[..., :, self.i, None] * by_j[..., None, :] + J[..., :, self.j, None] * by_i[..., None, :])

    def with_values(self, values: Array) -> LinearTerm:
        """Return the same term with other coefficients.

        Args:
            values: (P,) SI.
        """
        return replace(self, values=np.asarray(values, float))

    def to_file(self) -> StiffnessTerm:
        return StiffnessTerm(
            self.effect, self.location, parameter_conversion.write_law_parameters(self.law, self.values, np.empty(0))
        )


def build_joint_term(effect: str, parameters: ParameterReader, location: str) -> LinearTerm:
    """Return a term of one joint, or between two, from a file.

    Args:
        effect: name of the effect.
        parameters: parameters of the file.
        location: joint:i or joint:i-j.
    """
    known = registry.find_elastic_effect(effect)
    law = parameter_conversion.find_law(known, parameters)
    values, shape, memory = parameter_conversion.read_law_parameters(law, parameters)
    i, j = parse_joint_location(location)
    if known.is_joint_pair:
        return JointCoupling(effect=effect, location=location, i=i, j=j, law=law, values=values)
    return JointTerm(effect=effect, location=location, i=i, law=law, shape=shape, values=values, memory=memory)
