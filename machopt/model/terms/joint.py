"""Joint-level terms: coupling of two joints, and a spring that changes with its joint's own angle."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from machopt.domain.stiffness import Term
from machopt.model.robot import ArmState, Robot
from machopt.model.terms.base import Coefficient, LinearTerm, Maker, Parameters, plain

Array = NDArray[np.float64]


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
    """c_i(q_i) = c_i + a cos q_i + b sin q_i; c_i is the joint's own constant spring."""

    location: str  # joint:i
    i: int  # 0-based
    values: Array  # (2,) rad/(N·m)
    effect: str = "joint_pose_dependent_stiffness"
    coefficients: tuple[Coefficient, ...] = (
        Coefficient("cos_rad_per_Nm", "rad/(N·m)", -np.inf),
        Coefficient("sin_rad_per_Nm", "rad/(N·m)", -np.inf),
    )

    def response(self, state: ArmState, wrench: Array) -> Array:
        column = state.J[..., :, self.i]
        twist = column * np.einsum("...c,...c->...", column, wrench)[..., None]
        angle = state.q[..., self.i]
        return np.stack([twist * np.cos(angle)[..., None], twist * np.sin(angle)[..., None]], axis=-1)

    def with_values(self, values: Array) -> LinearTerm:
        return replace(self, values=np.asarray(values, float))

    def to_file(self) -> Term:
        names = ("cos_rad_per_Nm", "sin_rad_per_Nm")
        return Term(self.effect, self.location, dict(zip(names, map(float, self.values), strict=True)))


def _coupling(robot: Robot, T_flange_tcp: Array, parameters: Parameters, location: str) -> LinearTerm:
    i, j = (int(n) - 1 for n in location.removeprefix("joint:").split("-"))
    value = parameters.number("compliance_rad_per_Nm", np.nan, positive=False)
    return JointCoupling(location, i, j, np.array([value]))


def _pose_dependent(robot: Robot, T_flange_tcp: Array, parameters: Parameters, location: str) -> LinearTerm:
    values = [parameters.number(f"{f}_rad_per_Nm", np.nan, positive=False) for f in ("cos", "sin")]
    return PoseDependentSpring(location, int(location.removeprefix("joint:")) - 1, np.array(values))


MAKERS: dict[str, Maker] = {"joint_coupling": _coupling, "joint_pose_dependent_stiffness": _pose_dependent}
