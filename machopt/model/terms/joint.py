"""Terms of single joints, whose laws :mod:`machopt.effects` holds, at the TCP; and the coupling of two joints.

A process force comes on top of weight, so a law φ that follows the whole torque of the gear gives
``φ(τ_g + τ_w) − φ(τ_g)``, τ_g = weight of links and tool at the configuration, τ_w = Jᵀw. Weight counts as zero where
masses are unknown, and the torque of a gravity compensator is not in it: diagnose fits the laws over the same τ. A plan
has no history: each load rises from a gear at rest and lasts.

What a *small* load meets (stiffness indices, maps, compliance matrices) is the law's tangent under weight.
Coefficients may be negative, so a file can ask for springs that give way against the load:
:func:`machopt.model.terms.against.against_load`.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from machopt.arrays import Array
from machopt.domain.location import joints_of
from machopt.domain.stiffness import Term
from machopt.effects import files, registry
from machopt.effects.given import Parameters
from machopt.effects.protocol import Drive, Law
from machopt.errors import InputError
from machopt.model.robot import ArmState
from machopt.model.terms.base import Coefficient, LinearTerm, Plain


@dataclass(frozen=True, kw_only=True)
class JointTerm(Plain):
    """Extra twist of joint i: Σ_p x_p (B_p(τ_g + τ_w) − B_p(τ_g)), B the columns of a law."""

    effect: str
    location: str  # joint:i
    i: int  # 0-based
    law: Law
    shape: Array  # (S,) SI; NaN: still to be found
    values: Array  # (P,) SI
    memory: str = ""  # of the gear, as the file says it; a plan at rest has no use for it

    @property
    def coefficients(self) -> tuple[Coefficient, ...]:
        return tuple(Coefficient(*c) for c in files.named(self.law, len(self.values)))

    @property
    def lacking(self) -> tuple[str, ...]:
        """Keys of the file without which the law is no curve; what lasts for ever needs no time."""
        if np.isfinite(self.shape).all():
            return ()
        return tuple(p.key for p in self.law.shape if p.unit != "s")

    @property
    def weighs(self) -> bool:
        """The weight at the joint makes a difference."""
        return self.law.weighs

    def response(self, state: ArmState, wrench: Array, weight: Array | None = None) -> Array:
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
        self._complete()
        column, angle = state.J[..., :, self.i], state.q[..., self.i]
        load = np.einsum("...c,...c->...", column, wrench)
        if weight is None or not self.weighs:
            turned = self.law.columns(self.shape, Drive(load, angle))
        else:
            before = weight[..., self.i]
            turned = self.law.columns(self.shape, Drive(before + load, angle))
            turned = turned - self.law.columns(self.shape, Drive(before, angle))
        return np.asarray(column[..., :, None] * turned[..., None, :])

    def small(self, state: ArmState, wrench: Array, weight: Array | None = None) -> Array:
        """(M, 6, P) like :meth:`response`, for a wrench so small that the tangent holds."""
        self._complete()
        column = state.J[..., :, self.i]
        load = np.einsum("...c,...c->...", column, wrench)
        under = np.zeros_like(load) if weight is None or not self.weighs else weight[..., self.i]
        slope = self.law.tangent(self.shape, Drive(under, state.q[..., self.i]))
        return np.asarray(column[..., :, None] * (slope * load[..., None])[..., None, :])

    def loaded(self, state: ArmState, wrench: Array, weight: Array | None, *, small: bool) -> Array:
        return self.small(state, wrench, weight) if small else self.response(state, wrench, weight)

    def takes(self, low: Array, high: Array) -> tuple[int, float, float] | None:
        return self.i, *self.law.steepest(self.values, self.shape, float(low[self.i]), float(high[self.i]))

    def within(self, room: Array) -> LinearTerm:
        return replace(self, law=self.law.within(self.values, float(room[self.i])))

    def with_values(self, values: Array) -> LinearTerm:
        return replace(self, values=np.asarray(values, float))

    def to_file(self) -> Term:
        return Term(self.effect, self.location, files.write(self.law, self.values, self.shape, self.memory))

    def _complete(self) -> None:
        if self.lacking:
            raise InputError(
                f"{self.effect} at {self.location} lacks {', '.join(self.lacking)}, without which it is no curve; "
                "machopt diagnose searches for it",
                where="terms",
            )


@dataclass(frozen=True, kw_only=True)
class JointCoupling(Plain):
    """A torque on one joint turns another and the other way round: Δq_i = φ(τ_j) and Δq_j = φ(τ_i), φ linear."""

    effect: str
    location: str  # joint:i-j
    i: int  # 0-based
    j: int
    law: Law
    values: Array  # (P,) SI

    @property
    def coefficients(self) -> tuple[Coefficient, ...]:
        return tuple(Coefficient(*c) for c in files.named(self.law, len(self.values)))

    @property
    def couples(self) -> tuple[int, int, float] | None:
        return self.i, self.j, float((self.law.tangent(np.empty(0), Drive(np.zeros(1))) @ self.values)[0])

    def response(self, state: ArmState, wrench: Array) -> Array:
        J = state.J
        tau = np.einsum("...ci,...c->...i", J, wrench)
        by_j, by_i = (self.law.columns(np.empty(0), Drive(tau[..., k])) for k in (self.j, self.i))
        return np.asarray(J[..., :, self.i, None] * by_j[..., None, :] + J[..., :, self.j, None] * by_i[..., None, :])

    def with_values(self, values: Array) -> LinearTerm:
        return replace(self, values=np.asarray(values, float))

    def to_file(self) -> Term:
        return Term(self.effect, self.location, files.write(self.law, self.values, np.empty(0)))


def joint_term(effect: str, parameters: Parameters, location: str) -> LinearTerm:
    """A term of one joint, or between two, from a file."""
    known = registry.elastic(effect)
    law = files.law_of(known, parameters)
    values, shape, memory = files.read(law, parameters)
    i, j = joints_of(location)
    if known.paired:
        return JointCoupling(effect=effect, location=location, i=i, j=j, law=law, values=values)
    return JointTerm(effect=effect, location=location, i=i, law=law, shape=shape, values=values, memory=memory)
