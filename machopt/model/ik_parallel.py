"""Closed-form inverse kinematics of arms whose axes 2, 3 and 4 are parallel and 5 and 6 meet (the UR family).

With G = T_base_flange · T_zero⁻¹ = E₁E₂E₃E₄E₅E₆ and h = h₂ = ±h₃ = ±h₄, the motion E₂E₃E₄ keeps the
coordinate along h, and w, the point where axes 5 and 6 meet, is fixed by E₅E₆:

    q₁   h·(R₁ᵀ(G w − p₁)) = h·(w − p₁)             two roots (shoulder)
    q₅   h·(R₁ᵀ R h₆)      = h·(R₅ h₆)              two roots (wrist)
    q₆   R₆ᵀ … :  R₁ᵀR, transposed, applied to h    = R₆ᵀR₅ᵀh, one root
    q₃   |E₂E₃ p₄ − p₂|    = |x − p₂|, x known      two roots (elbow)
    q₂, then q₄ from what is left of the turn about h

Source: Paden 1986 and Murray, Li & Sastry 1994, section 3.3 (subproblems); Elias & Wen 2022 (arXiv:2211.05737),
section 3.4, for their order on arms with three parallel axes. Where h₆ ∥ h (wrist singularity) q₆ is free and set to 0.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from machopt.model.geometry import common_point
from machopt.model.robot import Robot
from machopt.se3 import axis_rotation, inverse, wrap

Array = NDArray[np.float64]
BRANCHES = 8
ROUNDING = 1e-10  # how far a cosine may exceed 1 and still count as 1: rounding at a fully stretched arm


@dataclass(frozen=True)
class ThreeParallel:
    """The constants of one arm for the closed form."""

    robot: Robot
    h: Array  # (3,) common direction of axes 2, 3, 4
    sense: Array  # (3,) ±1, sense of axes 2, 3, 4 along h
    wrist: Array  # (3,) m, where axes 5 and 6 meet at q = 0
    T_flange_zero_base: Array  # (4, 4) inverse of the flange pose at q = 0

    @classmethod
    def for_robot(cls, robot: Robot) -> ThreeParallel:
        h = robot.axis[1]
        return cls(
            robot=robot, h=h, sense=np.where(robot.axis[1:4] @ h > 0, 1.0, -1.0),
            wrist=common_point(robot, (4, 5))[0], T_flange_zero_base=inverse(robot.T_base_flange_zero),
        )  # fmt: skip

    def solve(self, T_base_flange: Array) -> Array:
        """All eight branches, index = 4·shoulder + 2·wrist + elbow.

        Args:
            T_base_flange: (M, 4, 4).

        Returns:
            (M, 8, 6) rad in (−π, π], NaN where the branch does not exist.
        """
        axis, point, h = self.robot.axis, self.robot.point, self.h
        G = np.asarray(T_base_flange, float) @ self.T_flange_zero_base
        R, M = G[:, :3, :3], len(G)
        Gw = np.einsum("mij,j->mi", R, self.wrist) + G[:, :3, 3]

        q1 = _height(h, axis[0], Gw - point[0], h @ (self.wrist - point[0]))  # (M, 2)
        R1t = axis_rotation(axis[0], -q1)  # (M, 2, 3, 3)
        R1tR = R1t @ R[:, None]
        goal = np.einsum("i,msij,j->ms", h, R1tR, axis[5])
        q5 = _height_angles(h, axis[4], axis[5], goal)  # (M, 2, 2)

        R5 = axis_rotation(axis[4], q5)  # (M, 2, 2, 3, 3)
        left = np.einsum("i,msij->msj", h, R1tR)[:, :, None]  # R6ᵀR5ᵀh
        right = np.einsum("i,mswij->mswj", h, R5)
        q6 = _turn(axis[5], right, np.broadcast_to(left, right.shape), inverse_sense=True)
        # wrist singularity: left ∥ h6, any q6 will do
        lost = np.linalg.norm(np.cross(axis[5], left), axis=-1) < 1e-9
        q6 = np.where(lost, 0.0, q6)

        R6t = axis_rotation(axis[5], -q6)
        R56t = np.swapaxes(R5, -1, -2)
        # x = E1⁻¹ G E6⁻¹ E5⁻¹ p4 = E2 E3 p4
        y = self.wrist + np.einsum("mswij,mswjk,k->mswi", R6t, R56t, point[3] - self.wrist)
        z = np.einsum("mij,mswj->mswi", R, y) + G[:, None, None, :3, 3] - point[0]
        x = point[0] + np.einsum("msij,mswj->mswi", R1t, z)
        R234 = R1tR[:, :, None] @ R6t @ R56t

        q3 = _reach(h * self.sense[1], point[2], point[3], point[1], x)  # (M, 2, 2, 2)
        u = point[2] + axis_rotation(axis[2], q3) @ (point[3] - point[2]) - point[1]
        q2 = _turn(axis[1], u, (x - point[1])[:, :, :, None], inverse_sense=False)
        total = _turn_of(h, R234)[..., None]  # q2 + s3 q3 + s4 q4
        q4 = self.sense[2] * (total - q2 - self.sense[1] * q3)

        shape = (M, 2, 2, 2)
        q = np.stack(
            [
                np.broadcast_to(q1[:, :, None, None], shape), q2, q3, q4,
                np.broadcast_to(q5[..., None], shape), np.broadcast_to(q6[..., None], shape),
            ],
            axis=-1,
        ).reshape(M, BRANCHES, 6)  # fmt: skip
        q = wrap(q)
        q[~np.isfinite(q).all(axis=-1)] = np.nan
        return q


def _height(h: Array, axis: Array, v: Array, height: float) -> Array:
    """Both roots q (..., 2) of h · Rot(axis, −q) v = height."""
    along = (v @ axis) * (h @ axis)
    c = v @ h - along  # coefficient of cos q
    s = np.einsum("...i,i->...", v, np.cross(axis, h))  # of sin q: h·(−axis × v) = v·(axis × h)
    return _two_roots(c, s, height - along)


def _height_angles(h: Array, axis: Array, v: Array, height: Array) -> Array:
    """Both roots q (..., 2) of h · Rot(axis, q) v = height for fixed v."""
    along = (v @ axis) * (h @ axis)
    c = np.full(height.shape, v @ h - along)
    s = np.full(height.shape, h @ np.cross(axis, v))
    return _two_roots(c, s, height - along)


def _two_roots(c: Array, s: Array, d: Array | float) -> Array:
    """q = atan2(s, c) ± acos(d / |(c, s)|), NaN where |d| exceeds the amplitude; + first."""
    amplitude = np.hypot(c, s)
    with np.errstate(invalid="ignore", divide="ignore"):
        ratio = d / amplitude
        ratio = np.where(np.abs(ratio) <= 1.0 + ROUNDING, np.clip(ratio, -1.0, 1.0), np.nan)
        half = np.arccos(ratio)
    middle = np.arctan2(s, c)
    return np.stack([middle + half, middle - half], axis=-1)


def _turn(axis: Array, u: Array, v: Array, *, inverse_sense: bool) -> Array:
    """The angle about ``axis`` from u to v (from v to u with ``inverse_sense``), components along it ignored."""
    angle: Array = np.arctan2(np.cross(u, v) @ axis, np.sum(u * v, axis=-1) - (u @ axis) * (v @ axis))
    return -angle if inverse_sense else angle


def _turn_of(axis: Array, R: Array) -> Array:
    """Angle of rotations R (..., 3, 3) known to be about ``axis``."""
    vee = np.stack([R[..., 2, 1] - R[..., 1, 2], R[..., 0, 2] - R[..., 2, 0], R[..., 1, 0] - R[..., 0, 1]], axis=-1)
    angle: Array = np.arctan2(vee @ axis, np.trace(R, axis1=-2, axis2=-1) - 1.0)
    return angle


def _reach(axis: Array, centre: Array, moved: Array, fixed: Array, x: Array) -> Array:
    """Both roots q (..., 2) of |centre + Rot(axis, q)(moved − centre) − fixed| = |x − fixed|, seen along axis."""
    a, b, t = _flat(axis, moved - centre), _flat(axis, centre - fixed), _flat(axis, x - fixed)
    d = 0.5 * (np.sum(t * t, axis=-1) - a @ a - b @ b)
    c = np.full(d.shape, b @ a)
    s = np.full(d.shape, b @ np.cross(axis, a))
    return _two_roots(c, s, d)


def _flat(axis: Array, v: Array) -> Array:
    return v - (v @ axis)[..., None] * axis if v.ndim > 1 else v - (v @ axis) * axis
