"""Conversion between encoder angles and true angles: q_true = q + Δ(q), with Δ of the cell's kinematics.yaml.

Δ_j(q) = Σ_i f_ij(q_i): offsets, waves and couplings of :mod:`machopt.effects`, q the encoder angles. The planner
uses true angles. Robot programs and joint limits use encoder angles. The inverse is the fixed
point q = q_true − Δ(q), a contraction because |Δ'| < 1 (checked by the reader of kinematics.yaml).
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from machopt.data_types.cell import JointLimits
from machopt.data_types.effect_locations import parse_joint_location
from machopt.data_types.kinematic_corrections import KinematicCorrections
from machopt.effects import measured_angle_range, parameter_conversion, registry
from machopt.effects.effect_wording import format_effect_at_place
from machopt.effects.law_interfaces.parameter_reader import ParameterReader
from machopt.effects.protocol import JointAngleLaw
from machopt.effects.structure import as_built_joint_frames
from machopt.numerics.array_types import Array

CONVERGENCE_RAD = 1e-15  # rad, round-off of an angle
ANGLE_SAMPLES = 2001  # samples of a joint's range for the largest coupling, with its ends
MAX_ITERATIONS = 100  # of the fixed point; |Δ'| = ½, the largest accepted, needs 50


@dataclass(frozen=True, kw_only=True)
class CorrectionTerm:
    """One entry of kinematics.yaml: correction of one joint by the angle of a source joint; both 0-based."""

    source_joint: int
    corrected_joint: int
    law: JointAngleLaw
    values: Array  # (P,) SI
    shape: Array  # (S,) SI
    range_limits: measured_angle_range.AngleRange | None = (
        None  # angles of the source joint at which it is applied; None: everywhere
    )
    label: str = ""  # "transmission error of joint 2"

    def compute_angle(self, q: Array, derivative: int = 0) -> Array:
        """Return the (...,) correction in rad, or its derivative with respect to the source joint's angle.

        Args:
            q: (..., 6) rad, encoder angles.
            derivative: order of the derivative.
        """
        at = q[..., self.source_joint]
        if self.range_limits is None:
            return self._evaluate_law(at, derivative)
        whole = [self._evaluate_law(at, k) for k in range(derivative + 1)]
        return measured_angle_range.differentiate_weighted_product(self.range_limits, at, whole, derivative)

    def _evaluate_law(self, at: Array, derivative: int) -> Array:
        return np.asarray(self.law.columns(self.shape, at, derivative) @ self.values)


@dataclass(frozen=True)
class EncoderCorrection:
    """Δ and its inverse for batches of joint positions."""

    parts: tuple[CorrectionTerm, ...]

    def compute_correction(self, q: Array) -> Array:
        """Return Δ (..., 6) rad.

        Args:
            q: (..., 6) rad, encoder angles.
        """
        out = np.zeros(np.shape(q))
        for part in self.parts:
            out[..., part.corrected_joint] += part.compute_angle(q)
        return out

    def compute_true_angles(self, q: Array) -> Array:
        """Return the (..., 6) true angles in rad; NaN stays NaN.

        Args:
            q: (..., 6) rad, encoder angles.
        """
        q = np.asarray(q, float)
        return q + self.compute_correction(q)

    def compute_encoder_angles(self, q_true: Array) -> Array:
        """Return the (..., 6) encoder angles in rad; NaN stays NaN.

        Args:
            q_true: (..., 6) rad, true angles.
        """
        q_true = np.asarray(q_true, float)
        q = q_true - self.compute_correction(q_true)
        for _ in range(MAX_ITERATIONS):
            better = q_true - self.compute_correction(q)
            change = np.nan_to_num(np.abs(better - q)).max(initial=0.0)
            q = better
            if change < CONVERGENCE_RAD * 10.0:
                break
        return np.asarray(q)

    def compute_encoder_path(self, derivatives: Array) -> Array:
        """Return a path of true angles as a path of encoder angles.

        With F_n the n-th derivatives of f_ij by q_i, J = 1 + F_1:

        q_t' = J q', q_t'' = J q'' + F_2 q'², q_t''' = J q''' + 3 F_2 q' q'' + F_3 q'³.

        Args:
            derivatives: (M, 4, n) q_true and its first three derivatives along the path.

        Returns:
            (M, 4, n) q and its derivatives.
        """
        out = np.empty_like(derivatives)
        out[:, 0] = q = self.compute_encoder_angles(derivatives[:, 0])
        slope, bend, twist = (self._compute_angle_derivative(q, order) for order in (1, 2, 3))
        J = np.eye(derivatives.shape[-1]) + slope
        out[:, 1] = first = np.linalg.solve(J, derivatives[:, 1, :, None])[..., 0]
        rest = np.asarray(derivatives[:, 2] - _multiply(bend, np.square(first)))
        out[:, 2] = second = np.linalg.solve(J, rest[..., None])[..., 0]
        rest = derivatives[:, 3] - 3.0 * _multiply(bend, first * second) - _multiply(twist, np.power(first, 3))
        out[:, 3] = np.linalg.solve(J, rest[..., None])[..., 0]
        return out

    def compute_true_limits(self, limits: JointLimits) -> JointLimits:
        """Return position limits of true angles that keep the encoder angles within ``limits``; rates are unchanged.

        For a joint coupled with others the limits shrink by the largest coupling.
        The map is monotonic in the joint's own angle, so the ends of the range remain the ends.

        Args:
            limits: limits of the encoder angles.
        """
        low, high = limits.lower.copy(), limits.upper.copy()
        away = np.zeros(6)
        for part in self.parts:
            if part.source_joint != part.corrected_joint:
                q = np.linspace(limits.lower[:6], limits.upper[:6], ANGLE_SAMPLES)
                away[part.corrected_joint] += np.abs(part.compute_angle(q)).max()
        for bound, sign in ((low, 1.0), (high, -1.0)):
            at = bound[:6].copy()
            for part in self.parts:
                if part.source_joint == part.corrected_joint:
                    bound[part.corrected_joint] += part.compute_angle(at)
            bound[:6] += sign * away
        return JointLimits(low, high, limits.velocity, limits.acceleration, limits.jerk)

    def list_range_violations(self, q: Array) -> list[str]:
        """Return messages about corrections that are not applied at some of the angles.

        Args:
            q: (N, 6) rad, encoder angles.
        """
        out = []
        for part in self.parts:
            at = np.degrees(q[:, part.source_joint])
            low, high = float(np.nanmin(at, initial=np.inf)), float(np.nanmax(at, initial=-np.inf))
            if part.range_limits is None or (
                low >= np.degrees(part.range_limits.low) and high <= np.degrees(part.range_limits.high)
            ):
                continue
            ends = " to ".join(f"{np.degrees(v):.1f}°" for v in (part.range_limits.low, part.range_limits.high))
            out.append(
                f"The {part.label} was measured from {ends}; the joint goes from "
                f"{low:.1f}° to {high:.1f}°, and outside what was measured it is not applied."
            )
        return out

    def _compute_angle_derivative(self, q: Array, order: int) -> Array:
        """Return the (M, n, n) derivative of each joint's correction (row) with respect to each joint angle
        (column).
        """
        out = np.zeros((*np.shape(q), np.shape(q)[-1]))
        for part in self.parts:
            out[..., part.corrected_joint, part.source_joint] += part.compute_angle(q, order)
        return out


def build_encoder_correction(kinematics: KinematicCorrections | None) -> EncoderCorrection | None:
    """Return the corrections as one map; None where there are none.

    Args:
        kinematics: corrections of the cell.
    """
    if not kinematics:
        return None
    laws = registry.list_angle_effects_by_word()
    parts = []
    for c in kinematics.corrections:
        if c.effect == as_built_joint_frames.EFFECT.name:  # no angle: this changes the arm's geometry
            continue
        if c.effect not in laws:
            raise ValueError(f"{c.effect!r} is no kinematic correction")
        law = laws[c.effect][1]
        values, shape, _ = parameter_conversion.read_law_parameters(law, ParameterReader(c.parameters, c.effect))
        label = format_effect_at_place(c.effect, c.location)
        by, moved = parse_joint_location(c.location)
        stated = measured_angle_range.read_angle_range(c.parameters)
        parts.append(
            CorrectionTerm(
                source_joint=by,
                corrected_joint=moved,
                law=law,
                values=values,
                shape=shape,
                range_limits=stated,
                label=label,
            )
        )
    return EncoderCorrection(tuple(parts)) if parts else None


def _multiply(A: Array, x: Array) -> Array:
    return np.asarray(np.einsum("mij,mj->mi", A, x))
