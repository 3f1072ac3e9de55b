"""Joint-level terms: coupling of two joints, and a spring that changes with its joint's own angle.

Their coefficients may be negative, so a file can ask for springs that give way against the load: :func:`against_load`.
"""

from __future__ import annotations

from collections.abc import Sequence
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


LEAST = 1e-9  # of the joints' own compliances: less than that in some direction is rounding or negative


def against_load(terms: Sequence[LinearTerm], k: Array, limits: tuple[Array, Array] | None) -> str:
    """What makes the joints' compliance matrix not positive somewhere, in words; empty where nothing does.

    The matrix is diag(1/k + a cos q + b sin q) with the couplings beside the diagonal; each joint is looked at where
    it is stiffest within its limits.

    Args:
        terms: of a stiffness file; those of bodies are positive by themselves.
        k: (C, 6) N·m/rad, of each grid cell and of the constant model.
        limits: lower and upper (6,) rad; None: any angle.
    """
    least, angle = np.zeros(6), np.zeros(6)
    coupling = np.zeros((6, 6))
    for term in terms:
        if isinstance(term, PoseDependentSpring):
            i = term.i
            low, high = (-np.pi, np.pi) if limits is None else (limits[0][i], limits[1][i])
            at = np.arctan2(-term.values[1], -term.values[0])  # where a cos q + b sin q is least
            at += 2 * np.pi * np.arange(np.ceil((low - at) / (2 * np.pi)), np.floor((high - at) / (2 * np.pi)) + 1)
            at = np.concatenate([at, [low, high]])
            value = term.values[0] * np.cos(at) + term.values[1] * np.sin(at)
            least[i], angle[i] = value.min(), at[value.argmin()]
        elif isinstance(term, JointCoupling):
            coupling[term.i, term.j] = coupling[term.j, term.i] = term.values[0]
    own = 1.0 / np.asarray(k, float)
    lost = own + least <= LEAST * own
    if lost.any():
        row, i = np.argwhere(lost)[0]
        return (
            f"joint_pose_dependent_stiffness takes {-least[i]:.3g} rad/(N·m) from joint {i + 1} at "
            f"{np.degrees(angle[i]):.0f} deg, which has {own[row, i]:.3g} (1/stiffness); less than that would work"
        )
    scale = np.sqrt(own + least)
    values = np.linalg.eigvalsh(np.eye(6) + coupling / scale[:, :, None] / scale[:, None, :])
    row = int(values[:, 0].argmin())
    if values[row, 0] > LEAST:
        return ""
    share = np.abs(coupling) / np.outer(scale[row], scale[row])
    i, j = (int(v) for v in np.unravel_index(int(share.argmax()), share.shape))
    return (
        f"with a joint_coupling of {coupling[i, j]:.3g} rad/(N·m) between joints {i + 1} and {j + 1} some load moves "
        f"the arm towards itself; at most √(c{i + 1} c{j + 1}) = {scale[row, i] * scale[row, j]:.3g} is possible"
    )


def _coupling(robot: Robot, T_flange_tcp: Array, parameters: Parameters, location: str) -> LinearTerm:
    i, j = (int(n) - 1 for n in location.removeprefix("joint:").split("-"))
    value = parameters.number("compliance_rad_per_Nm", np.nan, positive=False)
    return JointCoupling(location, i, j, np.array([value]))


def _pose_dependent(robot: Robot, T_flange_tcp: Array, parameters: Parameters, location: str) -> LinearTerm:
    values = [parameters.number(f"{f}_rad_per_Nm", np.nan, positive=False) for f in ("cos", "sin")]
    return PoseDependentSpring(location, int(location.removeprefix("joint:")) - 1, np.array(values))


MAKERS: dict[str, Maker] = {"joint_coupling": _coupling, "joint_pose_dependent_stiffness": _pose_dependent}
