"""Joints whose twist is a curve over their torque: stiffer or softer by load, backlash, play.

A process force comes on top of weight, so a law φ of the torque that the gear bears gives ``φ(τ_g + τ_w) − φ(τ_g)``,
τ_g = weight of links and tool at the configuration, τ_w = Jᵀw. Weight counts as zero where masses are unknown, and the
torque of a gravity compensator is not in it: diagnose fits the laws over the same τ.

=========================  ==================================================  ====================
effect                     φ, beside the joint's own c τ                       of the torque
=========================  ==================================================  ====================
joint_nonlinear_stiffness  a clip(τ, ±τ₀); Σ a_n clip(τ, ±τ_n); b τ³           with weight
joint_backlash             ½ w clip(τ/τ_t, ±1)                                 with weight
joint_hysteresis           Σ a_n P_n[τ], P_n the play of half-width r_n        of the process alone
=========================  ==================================================  ====================

Play has a memory that a plan does not: what counts is the branch of a load that rises from a gear at rest,
P_r = sgn(τ) max(|τ| − r, 0). A gear left on the far side of its play by a load before gives up to a·r more, once.

What a *small* load meets (stiffness indices, maps, compliance matrices) is the tangent φ'(τ_g); of play Σ a, the slope
once it is taken up, which is the softest the gear can be.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from machopt.domain.stiffness import Term
from machopt.errors import InputError
from machopt.model.robot import ArmState, Robot
from machopt.model.terms.base import Coefficient, LinearTerm, Maker, Parameters, plain

Array = NDArray[np.float64]
ARCMIN = np.pi / 10800.0
COMPLIANCE = "rad/(N·m)"


@dataclass(frozen=True)
class TorqueLaw:
    """Extra twist of joint i: Σ_p x_p (B_p(τ_g + τ_w) − B_p(τ_g))."""

    effect: str
    location: str  # joint:i
    i: int  # 0-based
    law: str  # knee | knees | cubic | backlash | play
    bounds: Array  # (P,) N·m: knees, transition, thresholds; NaN: still to be found; of no use for the cubic
    coefficients: tuple[Coefficient, ...]
    values: Array  # (P,) rad/(N·m); rad of the backlash, rad/(N·m)³ of the cubic
    reach: float = np.inf  # N·m, beyond which the cubic goes on along its tangent

    @property
    def lacking(self) -> tuple[str, ...]:
        """Keys of the file without which the law is no curve."""
        key = {"knee": "knee_Nm", "knees": "knees_Nm", "backlash": "transition_Nm", "play": "thresholds_Nm"}
        return () if np.isfinite(self.bounds).all() or self.law == "cubic" else (key[self.law],)

    @property
    def weighs(self) -> bool:
        """The weight at the joint makes a difference."""
        return self.law != "play"

    def twist(self, torque: Array) -> Array:
        """B (..., P): the curve per unit of each coefficient over a torque (...,) N·m."""
        tau = torque[..., None]
        if self.law == "cubic":
            inside = np.clip(tau, -self.reach, self.reach)
            more = 0.0 if np.isinf(self.reach) else 3.0 * self.reach**2 * (tau - inside)
            return np.asarray(inside**3 + more)
        if self.law == "play":
            return np.asarray(tau - np.clip(tau, -self.bounds, self.bounds))
        clipped = np.clip(tau, -self.bounds, self.bounds)
        return np.asarray(0.5 * clipped / self.bounds if self.law == "backlash" else clipped)

    def slope(self, torque: Array) -> Array:
        """B' (..., P) at a torque (...,) N·m; of play the slope beyond its threshold."""
        tau = torque[..., None]
        if self.law == "cubic":
            return np.asarray(3.0 * np.minimum(np.abs(tau), self.reach) ** 2)
        if self.law == "play":
            return np.ones((*torque.shape, len(self.bounds)))
        inside = np.abs(tau) < self.bounds
        return np.asarray(inside * (0.5 / self.bounds if self.law == "backlash" else 1.0))

    def response(self, state: ArmState, wrench: Array, weight: Array | None = None) -> Array:
        """Twist of the TCP per unit of each coefficient, under a wrench on top of weight.

        Args:
            state: M configurations.
            wrench: (M, 6) N, N·m at the TCP in base_link axes.
            weight: (M, 6) N·m, torque of weight at the joints; None: zero.

        Returns:
            (M, 6, P) m, rad per unit; base_link axes, at the TCP.

        Raises:
            InputError: the law's torque bounds are not known.
        """
        self._complete()
        column = state.J[..., :, self.i]
        load = np.einsum("...c,...c->...", column, wrench)
        if weight is None or not self.weighs:
            turned = self.twist(load)
        else:
            before = weight[..., self.i]
            turned = self.twist(before + load) - self.twist(before)
        return np.asarray(column[..., :, None] * turned[..., None, :])

    def small(self, state: ArmState, wrench: Array, weight: Array | None = None) -> Array:
        """(M, 6, P) like :meth:`response`, for a wrench so small that the tangent holds."""
        self._complete()
        column = state.J[..., :, self.i]
        load = np.einsum("...c,...c->...", column, wrench)
        slope = self.slope(np.zeros_like(load) if weight is None else weight[..., self.i])
        return np.asarray(column[..., :, None] * (slope * load[..., None])[..., None, :])

    def least_slope(self) -> float:
        """The smallest slope of the whole curve, rad/(N·m): at most zero, for far out it is flat."""
        if self.law == "cubic":
            bent = 3.0 * float(self.values[0]) * self.reach**2 if np.isfinite(self.reach) else -np.inf
            return min(0.0, bent) if self.values[0] < 0.0 else 0.0
        if self.law == "play":
            slopes = np.cumsum(self.values[np.argsort(self.bounds)])
        else:  # from the far knee inwards more and more of them slope
            scale = 0.5 / self.bounds if self.law == "backlash" else np.ones(len(self.bounds))
            slopes = np.cumsum((self.values * scale)[np.argsort(-self.bounds)])
        return min(0.0, float(slopes.min()))

    def with_values(self, values: Array) -> LinearTerm:
        return replace(self, values=np.asarray(values, float))

    def to_file(self) -> Term:
        names = {
            "knee": ("extra_rad_per_Nm", "knee_Nm"), "knees": ("extra_rad_per_Nm", "knees_Nm"),
            "cubic": ("cubic_rad_per_Nm3", ""), "backlash": ("width_arcmin", "transition_Nm"),
            "play": ("weights_rad_per_Nm", "thresholds_Nm"),
        }[self.law]  # fmt: skip
        x = self.values / ARCMIN if self.law == "backlash" else self.values
        many = self.law in ("knees", "play")
        law = {} if self.law == "backlash" else {"law": self.law}
        numbers = {n: v if many else v[0] for n, v in zip(names, (x, self.bounds), strict=True) if n}
        return Term(self.effect, self.location, plain({**law, **numbers}))

    def _complete(self) -> None:
        if self.lacking:
            raise InputError(
                f"{self.effect} at {self.location} lacks {', '.join(self.lacking)}, without which it is no curve; "
                "machopt diagnose searches for it",
                where="terms",
            )  # fmt: skip


def _nonlinear(robot: Robot, T_flange_tcp: Array, parameters: Parameters, location: str) -> LinearTerm:
    law = parameters.choice("law", ("knee", "knees", "cubic"), "knee" if parameters.empty else "")
    effect = "joint_nonlinear_stiffness"
    if law == "cubic":
        value = np.array([parameters.number("cubic_rad_per_Nm3", np.nan, positive=False)])
        cubic = Coefficient("cubic_rad_per_Nm3", "rad/(N·m)³", -np.inf)
        return TorqueLaw(effect, location, _index(location), law, np.full(1, np.nan), (cubic,), value)
    if law == "knees":
        values, knees = _rows(parameters, "extra_rad_per_Nm", "knees_Nm")
        names = tuple(Coefficient(f"extra_rad_per_Nm[{n}]", COMPLIANCE, -np.inf) for n in range(len(knees)))
        return TorqueLaw(effect, location, _index(location), law, knees, names, values)
    if law == "":
        raise parameters.error("law", "is missing; valid: knee, knees, cubic")
    value = np.array([parameters.number("extra_rad_per_Nm", np.nan, positive=False)])
    knee = np.array([parameters.number("knee_Nm", np.nan)])
    extra = Coefficient("extra_rad_per_Nm", COMPLIANCE, -np.inf)
    return TorqueLaw(effect, location, _index(location), law, knee, (extra,), value)


def _backlash(robot: Robot, T_flange_tcp: Array, parameters: Parameters, location: str) -> LinearTerm:
    width = parameters.number("width_arcmin", np.nan, positive=False)
    if width < 0:
        raise parameters.error("width_arcmin", f"found {width:g}; expected at least zero")
    transition = np.array([parameters.number("transition_Nm", np.nan)])
    return TorqueLaw(
        "joint_backlash", location, _index(location), "backlash", transition, (Coefficient("width", "rad"),),
        np.array([width * ARCMIN]),
    )  # fmt: skip


def _hysteresis(robot: Robot, T_flange_tcp: Array, parameters: Parameters, location: str) -> LinearTerm:
    parameters.choice("law", ("play",), "play")
    values, thresholds = _rows(parameters, "weights_rad_per_Nm", "thresholds_Nm", least=0.0)
    names = tuple(Coefficient(f"weights_rad_per_Nm[{n}]", COMPLIANCE) for n in range(len(thresholds)))
    return TorqueLaw("joint_hysteresis", location, _index(location), "play", thresholds, names, values)


def _rows(parameters: Parameters, slopes: str, bounds: str, least: float = -np.inf) -> tuple[Array, Array]:
    """Coefficients and torque bounds of one curve, one of each a place; NaN for what is not stated."""
    r, x = parameters.row(bounds, least=0.0), parameters.row(slopes, least=least)
    if not len(r) and not len(x):
        return np.full(1, np.nan), np.full(1, np.nan)
    if len(r) != len(x) and len(r) and len(x):
        raise parameters.error(slopes, f"found {len(x)} numbers; expected {len(r)}, one for each of {bounds}")
    if not (r > 0.0).all():
        raise parameters.error(bounds, "found 0; expected torques above zero")
    n = max(len(r), len(x))
    return (x if len(x) else np.full(n, np.nan)), (r if len(r) else np.full(n, np.nan))


def _index(location: str) -> int:
    return int(location.removeprefix("joint:")) - 1


MAKERS: dict[str, Maker] = {
    "joint_nonlinear_stiffness": _nonlinear, "joint_backlash": _backlash, "joint_hysteresis": _hysteresis,
}  # fmt: skip
