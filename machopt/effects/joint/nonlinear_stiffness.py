"""Nonlinear joint stiffness: a gear whose stiffness at small torque differs from that near its rated torque."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, replace

import numpy as np

from machopt.effects.protocol import (
    ARCMIN,
    COMPLIANCE,
    JOINTS,
    Effect,
    JointLaw,
    JointLawDefaults,
    JointLoading,
    JointLoadRange,
    LawParameter,
    Quantity,
    Shape,
    compute_compliance_percent,
)
from machopt.numerics.array_types import Array

MAX_CUBIC_SHARE = (
    0.9  # largest share of the joint's compliance that a cubic term may remove: at most ten times as stiff
)
STEPS = (0.12, 0.2, 0.3, 0.45, 0.6)  # knee torques tried in load tests, relative to the largest torque
SAMPLES = (0.1, 0.2, 0.3, 0.45, 0.6, 0.75)  # in motions
TWO_KNEE_STEPS = ((0.06, 0.25), (0.1, 0.35), (0.15, 0.5), (0.25, 0.6))


@dataclass(frozen=True)
class PiecewiseStiffness(JointLawDefaults):
    """φ = Σ a_n clip(τ, ±τ_n): a piecewise linear spring with knees at ±τ_n."""

    count: int
    includes_weight = True

    @property
    def word(self) -> str:  # type: ignore[override]
        return "knee" if self.count == 1 else "knees"

    @property
    def name(self) -> str:
        return "two slopes" if self.count == 1 else "three slopes"

    @property
    def equation(self) -> str:
        if self.count > 1:
            return "φ = c τ + a clip(τ, ±τ₁) + b clip(τ, ±τ₂)"
        return (
            "φ = c τ + a clip(τ, ±τ₀): softer (a > 0) or harder below the knee τ₀; gear stiffness of RV and harmonic "
            "drives is catalogued so"
        )

    @property
    def coefficients(self) -> tuple[LawParameter, ...]:
        return (LawParameter(key="extra_rad_per_Nm", unit=COMPLIANCE, is_list=self.count > 1),)

    @property
    def shape(self) -> tuple[LawParameter, ...]:
        if self.count > 1:
            return (LawParameter(key="knees_Nm", unit="N·m", positive=True, is_list=True),)
        return (LawParameter(key="knee_Nm", unit="N·m", positive=True),)

    def columns(self, shape: Array, drive: JointLoading) -> Array:
        """Return the clipped torque for each knee.

        Args:
            shape: (P,) knee torques τ_n, N·m.
            drive: Torque, angle and load history of the joint, one entry per state.

        Returns:
            (..., P) N·m.
        """
        return np.asarray(np.clip(drive.torque[..., None], -shape, shape))

    def tangent(self, shape: Array, drive: JointLoading) -> Array:
        """Return the slope of each term: 1 below its knee torque, 0 above.

        Args:
            shape: (P,) knee torques τ_n, N·m.
            drive: Torque, angle and load history of the joint, one entry per state.

        Returns:
            (..., P) 0 or 1.
        """
        return np.asarray((np.abs(drive.torque[..., None]) < shape) * 1.0)

    def compute_max_slope(self, values: Array, shape: Array, low: float, high: float) -> tuple[float, float]:
        # from the outermost knee inwards the slopes add up; beyond all knees none contributes
        """Return the largest reduction of the joint compliance by the law.

        Args:
            values: (P,) coefficients of the law (linear), SI, in the order of ``self.coefficients``.
            shape: (P,) knee torques τ_n, N·m.
            low: Lower end of the joint's angle range, rad.
            high: Upper end of the joint's angle range, rad.

        Returns:
            Compliance change, ≤ 0 rad/(N·m), and NaN: it does not depend on the angle.
        """
        return min(0.0, float(np.cumsum(values[np.argsort(-shape)]).min())), np.nan

    def limit_to_compliance(self, values: Array, room: float) -> JointLaw:
        """Return the law unchanged.

        Args:
            values: (P,) coefficients of the law (linear), SI, in the order of ``self.coefficients``.
            room: Compliance that the joint has left to lose before its slope becomes zero, rad/(N·m).

        Returns:
            The law.
        """
        return self

    def sizes(self, values: Array, shape: Array, scale: JointLoadRange) -> Mapping[str, Quantity]:
        """Return the compliance change relative to the joint's compliance, and the first knee torque.

        Args:
            values: (P,) coefficients of the law (linear), SI, in the order of ``self.coefficients``.
            shape: (P,) knee torques τ_n, N·m.
            scale: Range of torque, angle and time that the recording or plan covers at this joint.

        Returns:
            ``stiffness_change`` in % and ``knee_torque`` in N·m; ``twist`` in arcmin if the joint's compliance is
            not known.
        """
        knee = Quantity(float(shape[0]), "N·m")
        if scale.compliance is None:
            return {"twist": Quantity(abs(float(values[0])) * float(shape[0]) / ARCMIN, "arcmin"), "knee_torque": knee}
        return {
            "stiffness_change": compute_compliance_percent(abs(float(np.sum(values))), scale.compliance),
            "knee_torque": knee,
        }

    def grid(self, scale: JointLoadRange) -> tuple[Shape, ...]:
        """Return the knee torques that a search tries.

        Args:
            scale: Range of torque, angle and time that the recording or plan covers at this joint.

        Returns:
            Shapes of ``count`` knee torques in N·m.
        """
        if self.count > 1:
            return (
                () if scale.is_motion else tuple(tuple(s * scale.max_torque for s in pair) for pair in TWO_KNEE_STEPS)
            )
        return tuple((s * scale.max_torque,) for s in (SAMPLES if scale.is_motion else STEPS))


@dataclass(frozen=True)
class CubicStiffness(JointLawDefaults):
    """φ = b τ³. For b < 0 the curve continues along its tangent from ``max_torque``, before it would turn back."""

    max_torque: float = np.inf  # N·m
    word = "cubic"
    name = "cubic"
    equation = "φ = c τ + b τ³ (c(τ − βτ³), hardening for b < 0)"
    coefficients = (LawParameter(key="cubic_rad_per_Nm3", unit="rad/(N·m)³"),)
    shape: tuple[LawParameter, ...] = ()
    includes_weight = True

    def columns(self, shape: Array, drive: JointLoading) -> Array:
        """Return the cubic term, continued along its tangent beyond ``max_torque``.

        Args:
            shape: Empty; the law has no shape parameters.
            drive: Torque, angle and load history of the joint, one entry per state.

        Returns:
            (..., 1) (N·m)³.
        """
        tau = drive.torque[..., None]
        inside = np.clip(tau, -self.max_torque, self.max_torque)
        more = 0.0 if np.isinf(self.max_torque) else 3.0 * self.max_torque**2 * (tau - inside)
        return np.asarray(inside**3 + more)

    def tangent(self, shape: Array, drive: JointLoading) -> Array:
        """Return the slope of the cubic term.

        Args:
            shape: Empty; the law has no shape parameters.
            drive: Torque, angle and load history of the joint, one entry per state.

        Returns:
            (..., 1) (N·m)².
        """
        return np.asarray(3.0 * np.minimum(np.abs(drive.torque[..., None]), self.max_torque) ** 2)

    def compute_max_slope(self, values: Array, shape: Array, low: float, high: float) -> tuple[float, float]:
        """Return the largest reduction of the joint compliance by the law.

        Args:
            values: (P,) coefficients of the law (linear), SI, in the order of ``self.coefficients``.
            shape: Empty; the law has no shape parameters.
            low: Lower end of the joint's angle range, rad.
            high: Upper end of the joint's angle range, rad.

        Returns:
            Compliance change, ≤ 0 rad/(N·m) (−∞ without a torque limit), and NaN: it does not depend on the angle.
        """
        if not values[0] < 0.0:
            return 0.0, np.nan
        return (3.0 * float(values[0]) * self.max_torque**2 if np.isfinite(self.max_torque) else -np.inf), np.nan

    def limit_to_compliance(self, values: Array, room: float) -> JointLaw:
        """Limit a hardening cubic (b < 0) before c τ + b τ³ turns back at τ² = c/(3|b|).

        Args:
            values: (P,) coefficients of the law (linear), SI, in the order of ``self.coefficients``.
            room: Compliance that the joint has left to lose before its slope becomes zero, rad/(N·m).

        Returns:
            The law with ``max_torque`` where it has removed :data:`MAX_CUBIC_SHARE` of c.
        """
        if not values[0] < 0.0:
            return self
        return replace(self, max_torque=float(np.sqrt(MAX_CUBIC_SHARE * max(room, 0.0) / (3.0 * -values[0]))))

    def sizes(self, values: Array, shape: Array, scale: JointLoadRange) -> Mapping[str, Quantity]:
        """Return the compliance change at the largest torque relative to the joint's compliance.

        Args:
            values: (P,) coefficients of the law (linear), SI, in the order of ``self.coefficients``.
            shape: Empty; the law has no shape parameters.
            scale: Range of torque, angle and time that the recording or plan covers at this joint.

        Returns:
            ``stiffness_change`` in %; ``twist`` in arcmin if the joint's compliance is not known.
        """
        at_reach = abs(float(values[0])) * scale.max_torque**2
        if scale.compliance is None:
            return {"twist": Quantity(at_reach * scale.max_torque / ARCMIN, "arcmin")}
        return {"stiffness_change": compute_compliance_percent(3.0 * at_reach, scale.compliance)}

    def grid(self, scale: JointLoadRange) -> tuple[Shape, ...]:
        """Return one empty shape: the law has no shape parameters to search.

        Args:
            scale: Range of torque, angle and time that the recording or plan covers at this joint.

        Returns:
            The shapes that a search tries.
        """
        return ((),)


EFFECT = Effect(
    name="joint_nonlinear_stiffness",
    noun="nonlinear stiffness",
    sentence="The reducer is softer or stiffer at small torque than near its rated torque.",
    port="twist",
    places=JOINTS,
    joint_laws=(PiecewiseStiffness(1), PiecewiseStiffness(2), CubicStiffness()),
    is_elastic=True,
    note="the slope changes with the load",
)
