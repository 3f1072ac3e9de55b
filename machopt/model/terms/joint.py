"""Joint-level terms that are linear in the load: coupling, a spring that changes with its joint's angle, creep.

Their coefficients may be negative, so a file can ask for springs that give way against the load:
:func:`machopt.model.terms.against.against_load`.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from machopt.domain.stiffness import Term
from machopt.model.robot import ArmState, Robot
from machopt.model.terms.base import Coefficient, LinearTerm, Maker, Parameters, plain

Array = NDArray[np.float64]
HARMONICS = ("cos_rad_per_Nm", "sin_rad_per_Nm", "cos2_rad_per_Nm", "sin2_rad_per_Nm")


@dataclass(frozen=True)
class JointCoupling:
    """A torque on one joint turns another: Δq_i = c_ij τ_j and Δq_j = c_ij τ_i (wrist gears)."""

    location: str  # joint:i-j
    i: int  # 0-based
    j: int
    values: Array  # (1,) rad/(N·m)
    effect: str = "joint_coupling"
    coefficients: tuple[Coefficient, ...] = (Coefficient("compliance_rad_per_Nm", "rad/(N·m)", -np.inf),)

    def response(self, state: ArmState, wrench: Array) -> Array:
        J = state.J
        tau = np.einsum("...ci,...c->...i", J, wrench)
        twist = J[..., :, self.i] * tau[..., self.j, None] + J[..., :, self.j] * tau[..., self.i, None]
        return np.asarray(twist[..., None])

    def with_values(self, values: Array) -> LinearTerm:
        return replace(self, values=np.asarray(values, float))

    def to_file(self) -> Term:
        return Term(self.effect, self.location, plain({"compliance_rad_per_Nm": float(self.values[0])}))


@dataclass(frozen=True)
class PoseDependentSpring:
    """c_i(q_i) = c_i + Σ_n (a_n cos n q_i + b_n sin n q_i); c_i is the joint's own constant spring."""

    location: str  # joint:i
    i: int  # 0-based
    values: Array  # (2,) or (4,) rad/(N·m): a_1, b_1, a_2, b_2
    effect: str = "joint_pose_dependent_stiffness"

    @property
    def coefficients(self) -> tuple[Coefficient, ...]:
        return tuple(Coefficient(name, "rad/(N·m)", -np.inf) for name in HARMONICS[: len(self.values)])

    def response(self, state: ArmState, wrench: Array) -> Array:
        column = state.J[..., :, self.i]
        twist = column * np.einsum("...c,...c->...", column, wrench)[..., None]
        angle = state.q[..., self.i]
        waves = [f(n * angle) for n in range(1, len(self.values) // 2 + 1) for f in (np.cos, np.sin)]
        return np.stack([twist * wave[..., None] for wave in waves], axis=-1)

    def own(self, angle: Array) -> Array:
        """(...,) rad/(N·m) beside c_i at joint angles (...,) rad."""
        waves = [f(n * angle) for n in range(1, len(self.values) // 2 + 1) for f in (np.cos, np.sin)]
        return np.asarray(np.stack(waves, axis=-1) @ self.values)

    def with_values(self, values: Array) -> LinearTerm:
        return replace(self, values=np.asarray(values, float))

    def to_file(self) -> Term:
        return Term(self.effect, self.location, dict(zip(HARMONICS, map(float, self.values), strict=False)))


@dataclass(frozen=True)
class SectorSpring:
    """c_i(q_i) = c_i + a exp(−½((q_i − q₀)/σ)²): teeth that give over a part of the turn; angles are not wrapped."""

    location: str  # joint:i
    i: int  # 0-based
    centre: float  # rad, q₀
    width: float  # rad, σ
    values: Array  # (1,) rad/(N·m): a
    effect: str = "joint_pose_dependent_stiffness"
    coefficients: tuple[Coefficient, ...] = (Coefficient("extra_rad_per_Nm", "rad/(N·m)", -np.inf),)

    def response(self, state: ArmState, wrench: Array) -> Array:
        column = state.J[..., :, self.i]
        twist = column * np.einsum("...c,...c->...", column, wrench)[..., None]
        return np.asarray((twist * self._share(state.q[..., self.i])[..., None])[..., None])

    def own(self, angle: Array) -> Array:
        """(...,) rad/(N·m) beside c_i at joint angles (...,) rad."""
        return np.asarray(self.values[0] * self._share(angle))

    def _share(self, angle: Array) -> Array:
        return np.asarray(np.exp(-0.5 * ((angle - self.centre) / self.width) ** 2))

    def with_values(self, values: Array) -> LinearTerm:
        return replace(self, values=np.asarray(values, float))

    def to_file(self) -> Term:
        return Term(self.effect, self.location, plain({
            "law": "sector", "extra_rad_per_Nm": float(self.values[0]), "centre_deg": float(np.degrees(self.centre)),
            "width_deg": float(np.degrees(self.width))}))  # fmt: skip


@dataclass(frozen=True)
class Creep:
    """What a joint gives in the end beside c_i τ: T ẋ + x = a τ fully relaxed, x = a τ.

    The worst case, reached after a few T of steady load; a shorter cut bends the arm less, by exp(−t/T) of this.
    """

    location: str  # joint:i
    i: int  # 0-based
    values: Array  # (1,) rad/(N·m): a
    constant: float | None = None  # s, T; kept for the file, a plan at rest has no use for it
    effect: str = "joint_creep"
    coefficients: tuple[Coefficient, ...] = (Coefficient("extra_rad_per_Nm", "rad/(N·m)"),)

    def response(self, state: ArmState, wrench: Array) -> Array:
        column = state.J[..., :, self.i]
        return np.asarray((column * np.einsum("...c,...c->...", column, wrench)[..., None])[..., None])

    def with_values(self, values: Array) -> LinearTerm:
        return replace(self, values=np.asarray(values, float))

    def to_file(self) -> Term:
        time = {} if self.constant is None else {"time_constant_s": self.constant}
        return Term(self.effect, self.location, plain({"extra_rad_per_Nm": float(self.values[0]), **time}))


def _coupling(robot: Robot, T_flange_tcp: Array, parameters: Parameters, location: str) -> LinearTerm:
    i, j = (int(n) - 1 for n in location.removeprefix("joint:").split("-"))
    value = parameters.number("compliance_rad_per_Nm", np.nan, positive=False)
    return JointCoupling(location, i, j, np.array([value]))


def _pose_dependent(robot: Robot, T_flange_tcp: Array, parameters: Parameters, location: str) -> LinearTerm:
    i = int(location.removeprefix("joint:")) - 1
    if parameters.choice("law", ("harmonics", "sector"), "harmonics") == "sector":
        centre, width = parameters.number("centre_deg", positive=False), parameters.number("width_deg")
        extra = parameters.number("extra_rad_per_Nm", np.nan, positive=False)
        return SectorSpring(location, i, float(np.radians(centre)), float(np.radians(width)), np.array([extra]))
    values = [parameters.number(name, np.nan, positive=False) for name in HARMONICS]
    second = parameters.has(HARMONICS[2]) or parameters.has(HARMONICS[3])
    return PoseDependentSpring(location, i, np.array(values if second else values[:2]))


def _creep(robot: Robot, T_flange_tcp: Array, parameters: Parameters, location: str) -> LinearTerm:
    value = parameters.number("extra_rad_per_Nm", np.nan, positive=False)
    if value < 0:
        raise parameters.error("extra_rad_per_Nm", f"found {value:g}; expected at least zero")
    constant = parameters.number("time_constant_s") if parameters.has("time_constant_s") else None
    return Creep(location, int(location.removeprefix("joint:")) - 1, np.array([value]), constant)


MAKERS: dict[str, Maker] = {
    "joint_coupling": _coupling, "joint_pose_dependent_stiffness": _pose_dependent, "joint_creep": _creep,
}  # fmt: skip
