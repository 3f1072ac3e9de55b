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

import math
from dataclasses import dataclass

import numpy as np

from machopt.kinematics.axis_geometry import compute_common_point
from machopt.kinematics.inverse.compiled_vectors import (
    Vector,
    add_vectors,
    compute_angle_about_axis,
    cross_product,
    dot_product,
    rotate_vector,
    wrap_angle,
)
from machopt.kinematics.robot import Robot
from machopt.numerics.array_types import Array
from machopt.numerics.compiled_functions import jit_compile
from machopt.numerics.rigid_transforms import invert_transform

BRANCH_COUNT = 8
ROUNDING_TOLERANCE = 1e-10  # how far a cosine may exceed 1 and still count as 1: rounding at a fully stretched arm
ALIGNMENT_TOLERANCE = 1e-9  # sine of the angle between axes 2 and 6 below which q₆ is free


@dataclass(frozen=True)
class ThreeParallelSolver:
    """The constants of one arm for the closed form."""

    vectors: tuple[Vector, ...]  # the lines' axes, and other vectors of the arm for :func:`_compute_branches`
    numbers: tuple[float, ...]
    T_flange_zero_base: Array  # (4, 4) inverse of the flange pose at q = 0

    @classmethod
    def for_robot(cls, robot: Robot) -> ThreeParallelSolver:
        """Compute the constants of an arm.

        Args:
            robot: kinematic model.
        """
        axis, p, h = robot.axis, robot.point, robot.axis[1]
        wrist = compute_common_point(robot, (4, 5))[0]  # where axes 5 and 6 meet at q = 0

        def flat(v: Array) -> Array:
            return np.asarray(v - (v @ h) * h)

        across = flat(np.eye(3)[np.abs(h).argmin()])
        across /= np.linalg.norm(across)
        sense2, sense3 = (1.0 if axis[i] @ h > 0 else -1.0 for i in (2, 3))
        a, b = flat(p[3] - p[2]), flat(p[2] - p[1])  # the two links as seen along h
        along5 = (axis[5] @ axis[4]) * (h @ axis[4])
        c5, s5 = axis[5] @ h - along5, h @ np.cross(axis[4], axis[5])
        c3, s3 = b @ a, b @ np.cross(sense2 * h, a)
        vectors = (*axis, across, p[0], p[1] - p[0], p[3] - p[2], p[2] - p[1], p[3] - wrist, wrist)
        numbers = (
            h @ (wrist - p[0]),
            along5,
            np.hypot(c5, s5),
            np.arctan2(s5, c5),
            a @ a + b @ b,
            np.hypot(c3, s3),
            np.arctan2(s3, c3),
            sense2,
            sense3,
        )
        return cls(
            tuple((float(x), float(y), float(z)) for x, y, z in vectors),
            tuple(map(float, numbers)),
            invert_transform(robot.T_base_flange_zero),
        )

    def solve(self, T_base_flange: Array) -> Array:
        """All eight branches, index = 4·shoulder + 2·wrist + elbow.

        Args:
            T_base_flange: (M, 4, 4).

        Returns:
            (M, 8, 6) rad in (−π, π], NaN where the branch does not exist.
        """
        G = np.ascontiguousarray(np.asarray(T_base_flange, float) @ self.T_flange_zero_base)
        q = np.full((len(G), BRANCH_COUNT, 6), np.nan)
        _solve_all(self.vectors, self.numbers, G, q)
        return q


@jit_compile
def _solve_all(vectors: tuple[Vector, ...], numbers: tuple[float, ...], G: Array, q: Array) -> None:
    for m in range(len(G)):
        _compute_branches(vectors, numbers, G[m], q[m])


@jit_compile
def _compute_branches(vectors: tuple[Vector, ...], numbers: tuple[float, ...], G: Array, q: Array) -> None:
    """Fill q (8, 6), initially NaN, with the existing branches; G (4, 4) is the motion from the pose at q = 0."""
    h1, h, h3, _, h5, h6, across, p1, p12, link, upper, fore, wrist = vectors
    height, along5, n5, centre5, links, n3, centre3, sense3, sense4 = numbers
    X, Y, Z = (G[0, 0], G[0, 1], G[0, 2]), (G[1, 0], G[1, 1], G[1, 2]), (G[2, 0], G[2, 1], G[2, 2])
    t = (G[0, 3], G[1, 3], G[2, 3])
    v = (
        dot_product(X, wrist) + t[0] - p1[0],
        dot_product(Y, wrist) + t[1] - p1[1],
        dot_product(Z, wrist) + t[2] - p1[2],
    )
    along = dot_product(v, h1) * dot_product(h, h1)
    c, s = dot_product(v, h) - along, dot_product(v, cross_product(h1, h))
    half1, centre1 = _compute_half_angle(height - along, math.hypot(c, s)), math.atan2(s, c)
    if math.isnan(half1):
        return
    for shoulder in range(2):
        q1 = centre1 + half1 if shoulder == 0 else centre1 - half1
        c1, s1 = math.cos(q1), math.sin(q1)
        k = rotate_vector(h1, c1, s1, h)
        seen = (
            X[0] * k[0] + Y[0] * k[1] + Z[0] * k[2],
            X[1] * k[0] + Y[1] * k[1] + Z[1] * k[2],
            X[2] * k[0] + Y[2] * k[1] + Z[2] * k[2],
        )  # R6ᵀR5ᵀh
        half5 = _compute_half_angle(dot_product(seen, h6) - along5, n5)
        if math.isnan(half5):
            continue
        lost = cross_product(h6, seen)
        free = dot_product(lost, lost) < ALIGNMENT_TOLERANCE * ALIGNMENT_TOLERANCE  # wrist singularity: q6 is arbitrary
        for bend in range(2):
            q5 = centre5 + half5 if bend == 0 else centre5 - half5
            c5, s5 = math.cos(q5), math.sin(q5)
            q6 = 0.0 if free else -compute_angle_about_axis(h6, rotate_vector(h5, c5, -s5, h), seen)
            c6, s6 = math.cos(q6), math.sin(q6)
            # from p1 to the position of axis 4, before the rotation of joint 1
            y = add_vectors(wrist, rotate_vector(h6, c6, -s6, rotate_vector(h5, c5, -s5, fore)))
            z = rotate_vector(
                h1,
                c1,
                -s1,
                (dot_product(X, y) + t[0] - p1[0], dot_product(Y, y) + t[1] - p1[1], dot_product(Z, y) + t[2] - p1[2]),
            )
            x = (z[0] - p12[0], z[1] - p12[1], z[2] - p12[2])  # from axis 2
            e = rotate_vector(h6, c6, -s6, rotate_vector(h5, c5, -s5, across))
            e = rotate_vector(h1, c1, -s1, (dot_product(X, e), dot_product(Y, e), dot_product(Z, e)))
            total = compute_angle_about_axis(h, across, e)  # q2 ± q3 ± q4
            parallel_part = dot_product(x, h)
            half3 = _compute_half_angle(0.5 * (dot_product(x, x) - parallel_part * parallel_part - links), n3)
            if math.isnan(half3):
                continue
            for elbow in range(2):
                q3 = centre3 + half3 if elbow == 0 else centre3 - half3
                u = add_vectors(upper, rotate_vector(h3, math.cos(q3), math.sin(q3), link))
                q2 = compute_angle_about_axis(h, u, x)
                out = q[4 * shoulder + 2 * bend + elbow]
                out[0], out[1], out[2], out[4], out[5] = q1, q2, q3, q5, q6
                out[3] = sense4 * (total - q2 - sense3 * q3)
                for i in range(6):
                    out[i] = wrap_angle(out[i])


@jit_compile
def _compute_half_angle(d: float, amplitude: float) -> float:
    """Half the angle between both solutions of amplitude · cos(q − q₀) = d, NaN where there is none."""
    ratio = d / amplitude if amplitude > 0.0 else math.nan
    return math.acos(min(max(ratio, -1.0), 1.0)) if abs(ratio) <= 1.0 + ROUNDING_TOLERANCE else math.nan
