"""What a stiffness file says it lacks (``discrepancy``), read again: how it moves the TCP, how unsure it is.

Each of ``parts`` is one compliant part with a coefficient x (SI), τ = Jᵀw of the process, g of the weight:

* ``joint j``: x τ_j; ``coupling i-j``: x τ_j and x τ_i; ``cos j``, ``sin j``: x cos(q_j) τ_j, x sin(q_j) τ_j;
* ``play j``, ``slack j``, ``knee j``, ``bow j``: x (tanh((g + τ)/s) − tanh(g/s)), s = 0.05, 0.13, 0.35 and 1 of the
  joint's entry of ``torques_Nm``;
* ``loop j``: x tanh(τ/s), s = 0.05 of the same, nothing for a small load: a gear is reached from either side;
* ``base``, ``link:i``, ``tool`` with an axis: one compliance on the diagonal, axes of the body at q = 0, where link i
  ends (base: its frame, tool: the flange);
* ``term n p``: coefficient p of the n-th term of the file;
* ``loaded``: the share x of J'(1/k + 1/k (∂g/∂q + K_C) 1/k) J'ᵀw − J (1/k) Jᵀw, J' and ∂g/∂q where weight has bent the
  springs to, K_C of the process force, which a small load has none of; where the file has the term
  ``geometric_stiffness``, less J (1/k + 1/k K_C 1/k) Jᵀw in place of J (1/k) Jᵀw: the load's own part is in the model.

``shift`` is their mean, and part of what is predicted where ``counted``; the rows of ``modes`` are 1 σ each, and
``local_m_per_N`` is another on every coordinate. Where the mean is not counted, ± 1.645 of the stated σ holds 90 %
about a number that is off by it: (1.645 σ)² is the 90 % quantile of s² χ'²(1, b²/s²).
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from typing import Any

import numpy as np

from machopt.data_types.discrepancy_names import COUPLING, LOADED, TERM, DiscrepancyName, parse_discrepancy_name
from machopt.data_types.effect_locations import format_link_location, parse_joint_location
from machopt.data_types.stiffness import ModelDiscrepancy, StiffnessTerm
from machopt.numerics.array_types import Array
from machopt.verification.motion.kinematics.arm_configuration import ArmConfiguration
from machopt.verification.motion.kinematics.urdf_kinematics import UrdfKinematics
from machopt.verification.motion.stiffness import spring_terms

Z_90_PERCENT = 1.6448536269514722  # σ on either side
FAR_RATIO = 30.0  # b/s from which only the nearer end of the interval counts
DIFFERENCE_STEP_RAD = 1e-4  # rad, of ∂g/∂q
CURVE_SMOOTHING = {"play": 0.05, "slack": 0.13, "knee": 0.35, "bow": 1.0}
LOOP_SMOOTHING = 0.05
BEAM_KEYS = ("EI_Nm2", "EI_across_Nm2", "GJ_Nm2", "EA_N")
ARCMIN_PER_RAD = 10800.0 / np.pi  # a rad
UNIT_PARAMETERS = {
    "joint_coupling": ("compliance_rad_per_Nm", 1.0),
    "joint_creep": ("extra_rad_per_Nm", 1.0),
    "joint_backlash": ("width_arcmin", ARCMIN_PER_RAD),
}


@dataclass(frozen=True)
class CoefficientEffect:
    """Effect of a term's coefficient per unit: a matrix in the joints, a curve, or a compliance of a body."""

    term: StiffnessTerm | None = None
    curve: spring_terms.TorqueCurve | None = None
    body: tuple[int, Array, Array] | None = None


class StatedDiscrepancy:
    """Model discrepancy of a stiffness file.

    Raises:
        UnknownTermError: The discrepancy has a part without a law here.
    """

    def __init__(
        self,
        model_discrepancy: ModelDiscrepancy,
        terms: Sequence[StiffnessTerm],
        arm: UrdfKinematics,
        zero: ArmConfiguration,
        T_flange_tcp: Array,
        curves: Sequence[spring_terms.TorqueCurve],
    ) -> None:
        """``curves``: of all terms, as they bend; the tangent of a cubic that hardens begins where they say."""
        self.found, self.arm = model_discrepancy, arm
        self.geometric = any(t.effect == "geometric_stiffness" for t in terms)
        compiled = [t for t in terms if t.effect != "geometric_stiffness"]
        self.units: dict[str, CoefficientEffect] = {}
        self.parts = [_parse_part(name) for name in model_discrepancy.parts]
        for name, part in zip(model_discrepancy.parts, self.parts, strict=True):
            if part.kind != TERM:
                continue
            n, p = part.numbers
            if n >= len(compiled):
                raise spring_terms.UnknownTermError(f"{name!r} of its discrepancy")
            if compiled[n].effect != "gravity_compensator":  # what it adds is in the joint's own part
                self.units[name] = _build_unit_effect(compiled[n], p, zero, T_flange_tcp, curves)
        self.places = {"base": (0, np.zeros(3)), "tool": (6, zero.flange[0, :3, 3])}
        ends = [*zero.origin[0, 1:], zero.flange[0, :3, 3]]
        self.places |= {format_link_location(i + 1): (i + 1, end) for i, end in enumerate(ends)}
        self.zero = zero.frames[0]

    def evaluate(self, stance: ArmConfiguration, k: Array, weight: Array) -> DiscrepancyState:
        """Return the discrepancy at N configurations.

        Args:
            stance: The arm at N configurations, base_link axes.
            k: (N, 6) stiffness of the gears, N·m/rad.
            weight: (N, 6) joint torques of the weight, N·m.
        """
        return DiscrepancyState(self, stance, k, weight)


@dataclass(frozen=True)
class DiscrepancyState:
    """Model discrepancy at N configurations, base_link axes."""

    discrepancy: StatedDiscrepancy
    stance: ArmConfiguration
    k: Array  # (N, 6) N·m/rad of the gears
    weight: Array  # (N, 6) N·m, joint torques of the weight

    def compute_columns(self, wrench: Array, *, small: bool) -> Array:
        """Return the (N, 6, K) twist of the TCP per unit of each part.

        Args:
            wrench: (N, 6) wrenches at the TCP, N and N·m, base_link axes.
            small: Linearise about zero load.
        """
        tau = np.einsum("nci,nc->ni", self.stance.J, wrench)
        out = np.zeros((*wrench.shape, len(self.discrepancy.found.parts)))
        for n, name in enumerate(self.discrepancy.found.parts):
            part = self.discrepancy.parts[n]
            if part.kind in self.discrepancy.places:
                out[:, :, n] = np.einsum("nij,nj->ni", self._compute_body_compliance(part), wrench)
            elif part.kind == TERM:
                out[:, :, n] = self._compute_term_twist(self.discrepancy.units.get(name), wrench, tau, small=small)
            elif part.kind == LOADED:
                out[:, :, n] = self._compute_load_coupling(wrench, small=small)
            else:
                out[:, :, n] = np.einsum(
                    "nci,ni->nc", self.stance.J, self._compute_joint_rotation(part, tau, small=small)
                )
        return out

    def compute_mean_shift(self, force: Array) -> Array:
        """Return the (N, 3) displacement that the mean discrepancy adds, m.

        Args:
            force: (N, 3) forces, N, base_link axes.
        """
        return np.asarray(self.compute_columns(_convert_to_wrench(force), small=False)[:, :3] @ self._mean)

    @cached_property
    def small_load_compliance(self) -> Array:
        """(N, 6, 6) that the mean adds to the compliance for a small load."""
        unit = [self.compute_columns(np.tile(row, (len(self.k), 1)), small=True) @ self._mean for row in np.eye(6)]
        return np.stack(unit, axis=2)

    @property
    def _mean(self) -> Array:
        d = self.discrepancy.found
        return d.shift if d.counted else np.zeros_like(d.shift)

    def compute_stated_std(self, along: Array, force: Array, beside: Array, *, small: bool) -> Array:
        """Return the (N,) reported standard uncertainty of the displacement along unit vectors.

        Args:
            along: (N, 3) unit vectors.
            force: (N, 3) forces, N, base_link axes.
            beside: (N,) standard uncertainty of all other sources.
            small: Linearise about zero load.
        """
        from scipy.special import chndtrix, ndtri

        d = self.discrepancy.found
        each = np.einsum("nc,nck->nk", along, self.compute_columns(_convert_to_wrench(force), small=small)[:, :3])
        own = d.local * np.linalg.norm(force, axis=1)
        s = np.sqrt(np.sum((each @ d.modes.T) ** 2, axis=1) + beside**2 + own**2)
        if d.counted:
            return np.asarray(s)
        b = np.abs(each @ d.shift)
        safe = np.maximum(s, np.finfo(float).tiny)
        near = np.minimum(b / safe, FAR_RATIO)
        half = np.where(b > FAR_RATIO * s, b + ndtri(0.9) * s, safe * np.sqrt(chndtrix(0.9, 1, near**2)))
        return np.asarray(half / Z_90_PERCENT)

    def _compute_joint_rotation(self, part: DiscrepancyName, tau: Array, *, small: bool) -> Array:
        """(N, 6) rad of the joints."""
        out = np.zeros_like(tau)
        word, (i, *other) = part.kind, part.numbers
        if word == COUPLING:
            j = other[0]
            out[:, i], out[:, j] = tau[:, j], tau[:, i]
        elif word == "loop":
            out[:, i] = 0.0 if small else np.tanh(tau[:, i] / (LOOP_SMOOTHING * self.discrepancy.found.torque[i]))
        elif word in CURVE_SMOOTHING:
            s = CURVE_SMOOTHING[word] * self.discrepancy.found.torque[i]
            g = self.weight[:, i]
            if small:
                out[:, i] = tau[:, i] / (s * np.cosh(np.minimum(np.abs(g / s), 300.0)) ** 2)
            else:
                out[:, i] = np.tanh((g + tau[:, i]) / s) - np.tanh(g / s)
        else:
            q = self.stance.q[:, i]
            out[:, i] = {"joint": np.ones_like(q), "cos": np.cos(q), "sin": np.sin(q)}[word] * tau[:, i]
        return out

    def _compute_body_compliance(self, part: DiscrepancyName) -> Array:
        """(N, 6, 6) compliance at the TCP."""
        body, end = self.discrepancy.places[part.kind]
        C = np.zeros((6, 6))
        C[part.axis, part.axis] = 1.0
        S = np.eye(4)
        S[:3, 3] = end
        return self._transform_to_tcp(body, S, C)

    def _transform_to_tcp(self, body: int, S: Array, C: Array) -> Array:
        now = self.stance.frames[:, body] @ np.linalg.inv(self.discrepancy.zero[body]) @ S
        return spring_terms.shift_compliance(
            spring_terms.rotate_compliance(C, now[:, :3, :3]), self.stance.tcp[:, :3, 3] - now[:, :3, 3]
        )

    def _compute_term_twist(self, unit: CoefficientEffect | None, wrench: Array, tau: Array, *, small: bool) -> Array:
        if unit is None:
            return np.zeros_like(wrench)
        if unit.body is not None:
            return np.asarray(np.einsum("nij,nj->ni", self._transform_to_tcp(*unit.body), wrench))
        turn = np.zeros_like(tau)
        if unit.curve is not None:
            i, before = unit.curve.joint, self.weight[:, unit.curve.joint] * unit.curve.feels_weight
            more = unit.curve.compute_rotation(before + tau[:, i]) - unit.curve.compute_rotation(before)
            turn[:, i] = unit.curve.compute_slope(before) * tau[:, i] if small else more
        elif unit.term is not None:
            turn = np.einsum("nij,nj->ni", spring_terms.compute_joint_compliance([unit.term], self.stance.q), tau)
        return np.asarray(np.einsum("nci,ni->nc", self.stance.J, turn))

    @cached_property
    def _loaded_jacobians(self) -> tuple[Array, Array]:
        """(N, 6, 6) J and ∂g/∂q where weight has bent the springs to."""
        q, external = self.stance.q + self.weight / self.k, self.stance.external
        slope = np.empty((len(q), 6, 6))
        for j in range(6):
            step = DIFFERENCE_STEP_RAD * np.eye(6)[j]
            slope[:, :, j] = self.discrepancy.arm.compute_gravity_torque(
                q + step, external
            ) - self.discrepancy.arm.compute_gravity_torque(q - step, external)
        return self.discrepancy.arm.compute_configuration(q, external).J, slope / (2.0 * DIFFERENCE_STEP_RAD)

    def _compute_load_coupling(self, wrench: Array, *, small: bool) -> Array:
        J, H = self._loaded_jacobians
        turn = np.einsum("nci,nc->ni", J, wrench) / self.k
        alone = np.einsum("nci,nc->ni", self.stance.J, wrench) / self.k
        if not small:
            turn += np.einsum("nij,nj->ni", _compute_lever_change(J, wrench), turn) / self.k
            if self.discrepancy.geometric:
                alone += np.einsum("nij,nj->ni", _compute_lever_change(self.stance.J, wrench), alone) / self.k
        turn += np.einsum("nij,nj->ni", H, np.einsum("nci,nc->ni", J, wrench) / self.k) / self.k
        bare = np.einsum("nci,ni->nc", self.stance.J, alone)
        return np.asarray(np.einsum("nci,ni->nc", J, turn) - bare)


def _parse_part(name: str) -> DiscrepancyName:
    try:
        return parse_discrepancy_name(name)
    except ValueError:
        raise spring_terms.UnknownTermError(f"{name!r} of its discrepancy") from None


def _build_unit_effect(
    term: StiffnessTerm, p: int, zero: ArmConfiguration, T_flange_tcp: Array, curves: Sequence[spring_terms.TorqueCurve]
) -> CoefficientEffect:
    """Coefficient p of a term alone, at 1 SI."""
    if term.effect == "joint_nonlinear_stiffness" and term.parameters["law"] == "cubic":
        joint, size = parse_joint_location(term.location)[0], float(term.parameters["cubic_rad_per_Nm3"])
        own = next(c for c in curves if c.form == "cubic" and c.joint == joint and float(c.size[0]) == size)
        return CoefficientEffect(curve=replace(own, size=np.ones(1)))
    alone = StiffnessTerm(term.effect, term.location, {**term.parameters, **_build_unit_parameters(term, p)})
    if term.effect in ("base_compliance", "link_compliance", "tool_compliance"):
        parameters = {key: v for key, v in alone.parameters.items() if key not in BEAM_KEYS or np.isfinite(v)}
        made = spring_terms.build_body_springs(
            [StiffnessTerm(term.effect, term.location, parameters)], zero.origin[0], zero.flange[0], T_flange_tcp
        )
        return CoefficientEffect(body=made[0])
    if term.effect in ("joint_coupling", spring_terms.ANGLE_DEPENDENT_EFFECT, "joint_creep"):
        return CoefficientEffect(term=alone)
    limits = np.full(6, -1.0), np.full(6, 1.0)
    return CoefficientEffect(curve=spring_terms.build_torque_curves([alone], np.ones((1, 6)), *limits)[0])


def _build_unit_parameters(term: StiffnessTerm, p: int) -> Mapping[str, Any]:
    """The parameters of a term that say its coefficients, with the p-th at 1 SI and the others at nothing."""
    has, effect = term.parameters, term.effect
    key, factor = UNIT_PARAMETERS.get(effect, ("", 1.0))
    if effect == spring_terms.ANGLE_DEPENDENT_EFFECT and has.get("law") == "sector":
        key = "extra_rad_per_Nm"
    elif effect == spring_terms.ANGLE_DEPENDENT_EFFECT:
        pairs = [
            pair for pair in (spring_terms.HARMONIC_KEYS[:2], spring_terms.HARMONIC_KEYS[2:]) if set(pair) & set(has)
        ]
        names = [name for pair in pairs for name in pair]
        return {name: float(n == p) for n, name in enumerate(names)}
    elif effect == "joint_nonlinear_stiffness" and has["law"] != "cubic":
        key = "extra_rad_per_Nm"
    elif effect == "joint_hysteresis":
        key = {"bouc_wen": "drag_arcmin", "used_up": "half_clearance_arcmin"}.get(
            has.get("law", ""), "weights_rad_per_Nm"
        )
        factor = 1.0 if key == "weights_rad_per_Nm" else ARCMIN_PER_RAD
    elif "cylinders" in has:
        return {"scale": 1.0}
    elif "compliance_diagonal" in has:
        return {"compliance_diagonal": np.eye(6)[p].tolist()}
    elif "compliance" in has:
        i, j = (int(rows[p]) for rows in np.triu_indices(6))
        C = np.zeros((6, 6))
        C[i, j] = C[j, i] = 1.0
        return {"compliance": C.tolist()}
    elif not key and any(bar in has for bar in BEAM_KEYS):
        bars = [bar for bar in BEAM_KEYS if bar in has]
        return {bar: 1.0 if n == p else np.inf for n, bar in enumerate(bars)}
    if not key or key not in has:
        raise spring_terms.UnknownTermError(f"what {effect} at {term.location} may lack")
    size = np.zeros(np.size(has[key]))
    size[p] = factor
    return {key: size.tolist() if isinstance(has[key], list | tuple) else float(size[0])}


def _compute_lever_change(J: Array, wrench: Array) -> Array:
    """(N, 6, 6) N·m/rad: how a force turns its own levers, ∂(Jᵀw)/∂q."""
    z, moved = np.swapaxes(J[:, 3:], 1, 2), np.swapaxes(J[:, :3], 1, 2)
    low, high = np.minimum.outer(range(6), range(6)), np.maximum.outer(range(6), range(6))
    return np.asarray(np.einsum("nijc,nc->nij", np.cross(z[:, low], moved[:, high]), wrench[:, :3]))


def _convert_to_wrench(force: Array) -> Array:
    return np.hstack([force, np.zeros_like(force)])
