"""Encoder angles and true angles: q_true = q + Δ(q), with Δ of the cell's kinematics.yaml.

Δ_j(q) = Σ_i f_ij(q_i): offsets, waves and couplings of :mod:`machopt.effects`, q what the encoders say. The planner
thinks in true angles; what a robot is told, and what limits hold for, are encoder angles. The way back is the fixed
point q = q_true − Δ(q), a contraction because |Δ'| < 1 (the reader of kinematics.yaml sees to that).
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from machopt.arrays import Array
from machopt.domain.cell import JointLimits
from machopt.domain.kinematics import Kinematics
from machopt.domain.location import joints_of
from machopt.effects import files, geometry, registry, within
from machopt.effects.given import Parameters
from machopt.effects.protocol import Unloaded
from machopt.effects.words import named

SETTLED = 1e-15  # rad, round-off of an angle
AT = 2001  # angles of a joint's range at which what it does to another one is looked at, its ends among them
PASSES = 100  # of the fixed point; |Δ'| = ½, the most that is let in, needs 50


@dataclass(frozen=True, kw_only=True)
class Part:
    """One entry of kinematics.yaml: by the angle of joint ``by`` joint ``moved`` stands elsewhere; both 0-based."""

    by: int
    moved: int
    law: Unloaded
    values: Array  # (P,) SI
    shape: Array  # (S,) SI
    within: within.Range | None = None  # angles of joint ``by`` that it is applied at; None: everywhere
    said: str = ""  # "transmission error of joint 2"

    def angle(self, q: Array, derivative: int = 0) -> Array:
        """(...,) rad at encoder angles q (..., 6) rad, or a derivative by the joint's angle."""
        at = q[..., self.by]
        if self.within is None:
            return self._everywhere(at, derivative)
        whole = [self._everywhere(at, k) for k in range(derivative + 1)]
        return within.product(self.within, at, whole, derivative)

    def _everywhere(self, at: Array, derivative: int) -> Array:
        return np.asarray(self.law.columns(self.shape, at, derivative) @ self.values)


@dataclass(frozen=True)
class Correction:
    """Δ and its inverse for batches of joint positions."""

    parts: tuple[Part, ...]

    def delta(self, q: Array) -> Array:
        """Δ (..., 6) rad at encoder angles q (..., 6) rad."""
        out = np.zeros(np.shape(q))
        for part in self.parts:
            out[..., part.moved] += part.angle(q)
        return out

    def true_angles(self, q: Array) -> Array:
        """(..., 6) rad that the arm stands at when the encoders say q; NaN stays NaN."""
        q = np.asarray(q, float)
        return q + self.delta(q)

    def encoder_angles(self, q_true: Array) -> Array:
        """(..., 6) rad that the encoders say when the arm stands at q_true; NaN stays NaN."""
        q_true = np.asarray(q_true, float)
        q = q_true - self.delta(q_true)
        for _ in range(PASSES):
            better = q_true - self.delta(q)
            change = np.nan_to_num(np.abs(better - q)).max(initial=0.0)
            q = better
            if change < SETTLED * 10.0:
                break
        return np.asarray(q)

    def encoder_path(self, derivatives: Array) -> Array:
        """A path of true angles as one of encoder angles.

        With F_n the n-th derivatives of f_ij by q_i, J = 1 + F_1:
        q_t' = J q', q_t'' = J q'' + F_2 q'², q_t''' = J q''' + 3 F_2 q' q'' + F_3 q'³.

        Args:
            derivatives: (M, 4, 6) q_true and its first three derivatives along the path.

        Returns:
            (M, 4, 6) q and its derivatives.
        """
        out = np.empty_like(derivatives)
        out[:, 0] = q = self.encoder_angles(derivatives[:, 0])
        slope, bend, twist = (self._by_angles(q, order) for order in (1, 2, 3))
        J = np.eye(6) + slope
        out[:, 1] = first = np.linalg.solve(J, derivatives[:, 1, :, None])[..., 0]
        rest = np.asarray(derivatives[:, 2] - _times(bend, np.square(first)))
        out[:, 2] = second = np.linalg.solve(J, rest[..., None])[..., 0]
        rest = derivatives[:, 3] - 3.0 * _times(bend, first * second) - _times(twist, np.power(first, 3))
        out[:, 3] = np.linalg.solve(J, rest[..., None])[..., 0]
        return out

    def true_limits(self, limits: JointLimits) -> JointLimits:
        """Positions that true angles must keep to, so that the encoders keep to ``limits``; rates are left as they are.

        A joint that others pull along needs room for their whole range: the limits shrink by the most they do to it.
        Monotonic in the joint's own angle, so the ends of the range stay the ends.
        """
        low, high = limits.lower.copy(), limits.upper.copy()
        away = np.zeros(6)
        for part in self.parts:
            if part.by != part.moved:
                q = np.linspace(limits.lower[:6], limits.upper[:6], AT)
                away[part.moved] += np.abs(part.angle(q)).max()
        for bound, sign in ((low, 1.0), (high, -1.0)):
            at = bound[:6].copy()
            for part in self.parts:
                if part.by == part.moved:
                    bound[part.moved] += part.angle(at)
            bound[:6] += sign * away
        return JointLimits(low, high, limits.velocity, limits.acceleration, limits.jerk)

    def beyond(self, q: Array) -> list[str]:
        """What is not applied somewhere at encoder angles q (N, 6) rad, in words."""
        out = []
        for part in self.parts:
            at = np.degrees(q[:, part.by])
            low, high = float(np.nanmin(at, initial=np.inf)), float(np.nanmax(at, initial=-np.inf))
            if part.within is None or (low >= np.degrees(part.within.low) and high <= np.degrees(part.within.high)):
                continue
            ends = " to ".join(f"{np.degrees(v):.1f}°" for v in (part.within.low, part.within.high))
            out.append(
                f"The {part.said} was measured from {ends}; the joint goes from "
                f"{low:.1f}° to {high:.1f}°, and outside what was measured it is not applied."
            )
        return out

    def _by_angles(self, q: Array, order: int) -> Array:
        """(M, 6, 6) derivative of what moves a joint (row) by the angle of another (column)."""
        out = np.zeros((*np.shape(q), 6))
        for part in self.parts:
            out[..., part.moved, part.by] += part.angle(q, order)
        return out


def correction_of(kinematics: Kinematics | None) -> Correction | None:
    """The corrections as one map; None where there are none."""
    if not kinematics:
        return None
    laws = registry.without_load()
    parts = []
    for c in kinematics.corrections:
        if c.effect == geometry.EFFECT.name:  # no angle: the arm itself is built otherwise
            continue
        if c.effect not in laws:
            raise ValueError(f"{c.effect!r} is no kinematic correction")
        law = laws[c.effect][1]
        values, shape, _ = files.read(law, Parameters(c.parameters, c.effect))
        said = named(c.effect, c.location)
        by, moved = joints_of(c.location)
        stated = within.stated(c.parameters)
        parts.append(Part(by=by, moved=moved, law=law, values=values, shape=shape, within=stated, said=said))
    return Correction(tuple(parts)) if parts else None


def _times(A: Array, x: Array) -> Array:
    return np.asarray(np.einsum("mij,mj->mi", A, x))
