"""Encoder angles and true angles: q_true = q + Δ(q), with Δ of the cell's kinematics.yaml.

Δ_j(q) = offset_j + Σ_w (a_w cos N_w q_j + b_w sin N_w q_j) + Σ_i κ_ij q_i, q what the encoders say. The planner thinks
in true angles; what a robot is told, and what limits hold for, are encoder angles. The way back is the fixed point
q = q_true − Δ(q), a contraction because |Δ'| < 1 (the reader of kinematics.yaml sees to that).
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from machopt.domain.cell import JointLimits
from machopt.domain.kinematics import Kinematics, waves

Array = NDArray[np.float64]
ARCSEC = np.pi / 648000.0
SETTLED = 1e-15  # rad, round-off of an angle
PASSES = 100  # of the fixed point; |Δ'| = ½, the most that is let in, needs 50


@dataclass(frozen=True)
class Correction:
    """Δ and its inverse for batches of joint positions."""

    offset: Array  # (6,) rad
    coupling: Array  # (6, 6) rad/rad: Δ_j = coupling[j] @ q
    wave_joint: NDArray[np.int64]  # (W,) 0-based joint of each wave
    wave_order: Array  # (W,) per turn of the joint
    wave_cos: Array  # (W,) rad
    wave_sin: Array  # (W,) rad

    def delta(self, q: Array) -> Array:
        """Δ (..., 6) rad at encoder angles q (..., 6) rad."""
        return np.asarray(self.offset + q @ self.coupling.T + self._waves(q, 0))

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

        With J = 1 + ∂Δ/∂q, f'' and f''' the higher derivatives of each joint's waves by its own angle:
        q_t' = J q', q_t'' = J q'' + f'' q'², q_t''' = J q''' + 3 f'' q' q'' + f''' q'³.

        Args:
            derivatives: (M, 4, 6) q_true and its first three derivatives along the path.

        Returns:
            (M, 4, 6) q and its derivatives.
        """
        out = np.empty_like(derivatives)
        out[:, 0] = q = self.encoder_angles(derivatives[:, 0])
        slope, bend, twist = (self._waves(q, order) for order in (1, 2, 3))
        J = np.eye(6) + self.coupling + slope[:, :, None] * np.eye(6)
        out[:, 1] = first = np.linalg.solve(J, derivatives[:, 1, :, None])[..., 0]
        rest = derivatives[:, 2] - bend * first**2
        out[:, 2] = second = np.linalg.solve(J, rest[..., None])[..., 0]
        rest = derivatives[:, 3] - 3.0 * bend * first * second - twist * first**3
        out[:, 3] = np.linalg.solve(J, rest[..., None])[..., 0]
        return out

    def true_limits(self, limits: JointLimits) -> JointLimits:
        """Positions that true angles must keep to, so that the encoders keep to ``limits``; rates are left as they are.

        A joint that couples pull along needs room for their whole range: the limits shrink by |κ| max|q_i|, exactly
        as much as could be needed. Monotonic in the joint's own angle, so the ends of the range stay the ends.
        """
        low, high = limits.lower.copy(), limits.upper.copy()
        reach = np.maximum(np.abs(low[:6]), np.abs(high[:6]))
        away = np.abs(self.coupling) @ reach
        for bound, sign in ((low, 1.0), (high, -1.0)):
            bound[:6] = bound[:6] + self.offset + self._waves(bound[:6], 0) + sign * away
        return JointLimits(low, high, limits.velocity, limits.acceleration, limits.jerk)

    def _waves(self, q: Array, order: int) -> Array:
        """(..., 6) derivative of the waves by each joint's own angle."""
        out = np.zeros(np.shape(q))
        for j, n, a, b in zip(self.wave_joint, self.wave_order, self.wave_cos, self.wave_sin, strict=True):
            angle = n * q[..., j] + order * 0.5 * np.pi  # d/dx of cos is cos a quarter turn later
            out[..., j] += n**order * (a * np.cos(angle) + b * np.sin(angle))
        return out


def correction_of(kinematics: Kinematics | None) -> Correction | None:
    """The corrections as one map; None where there are none."""
    if not kinematics:
        return None
    offset, coupling = np.zeros(6), np.zeros((6, 6))
    rows: list[tuple[int, float, float, float]] = []
    for c in kinematics.corrections:
        place = [int(n) - 1 for n in c.location.removeprefix("joint:").split("-")]
        if c.effect == "joint_zero_offset":
            offset[place[0]] += np.radians(c.parameters["offset_deg"])
        elif c.effect == "joint_coupling":
            coupling[place[1], place[0]] += c.parameters["ratio"]
        elif c.effect == "transmission_error":
            rows += [(place[0], order, cos * ARCSEC, sin * ARCSEC) for order, cos, sin in waves(c.parameters)]
        else:
            raise ValueError(f"{c.effect!r} is no kinematic correction")
    columns = np.array(rows, float).reshape(-1, 4).T
    return Correction(offset, coupling, columns[0].astype(np.int64), *columns[1:])
