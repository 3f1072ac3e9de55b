"""Forward kinematics of n revolute joints by the product of exponentials, compiled (Lynch & Park 2017, section 4.1)."""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import NDArray

from machopt.numerics.array_types import Array
from machopt.numerics.compiled_functions import jit_compile


@jit_compile
def _rotate_about_line(R: Array, p: Array, h: Array, x: Array, angle: float) -> None:
    """Multiply a motion (R, p) by a rotation about the line through x along unit h, in place."""
    c, s = math.cos(angle), math.sin(angle)
    v = 1.0 - c
    q00, q01, q02 = c + v * h[0] * h[0], v * h[0] * h[1] - s * h[2], v * h[0] * h[2] + s * h[1]
    q10, q11, q12 = v * h[1] * h[0] + s * h[2], c + v * h[1] * h[1], v * h[1] * h[2] - s * h[0]
    q20, q21, q22 = v * h[2] * h[0] - s * h[1], v * h[2] * h[1] + s * h[0], c + v * h[2] * h[2]
    # translation part of the rotation about the line: x − Q x
    tx = x[0] - (q00 * x[0] + q01 * x[1] + q02 * x[2])
    ty = x[1] - (q10 * x[0] + q11 * x[1] + q12 * x[2])
    tz = x[2] - (q20 * x[0] + q21 * x[1] + q22 * x[2])
    for r in range(3):
        a, b, d = R[r, 0], R[r, 1], R[r, 2]
        p[r] += a * tx + b * ty + d * tz
        R[r, 0] = a * q00 + b * q10 + d * q20
        R[r, 1] = a * q01 + b * q11 + d * q21
        R[r, 2] = a * q02 + b * q12 + d * q22


@jit_compile
def _set_identity(R: Array, p: Array) -> None:
    for r in range(3):
        for c in range(3):
            R[r, c] = 1.0 if r == c else 0.0
        p[r] = 0.0


@jit_compile
def _compute_pose(R: Array, p: Array, zero: Array, T: Array) -> None:
    """T (4, 4): the pose ``zero`` moved by (R, p)."""
    for r in range(3):
        for c in range(4):
            T[r, c] = R[r, 0] * zero[0, c] + R[r, 1] * zero[1, c] + R[r, 2] * zero[2, c]
        T[r, 3] += p[r]
        T[3, r] = 0.0
    T[3, 3] = 1.0


@jit_compile
def compute_poses(axis: Array, point: Array, zero: Array, q: Array, T: Array) -> None:
    """Compute the poses of a frame.

    Args:
        axis: (n, 3) unit, the lines in base_link at q = 0.
        point: (n, 3) m, a point of each.
        zero: (4, 4) the frame at q = 0.
        q: (M, n) rad.
        T: (M, 4, 4) receives the poses.
    """
    R, p = np.empty((3, 3)), np.empty(3)
    for m in range(len(q)):
        _set_identity(R, p)
        for i in range(len(axis)):
            _rotate_about_line(R, p, axis[i], point[i], q[m, i])
        _compute_pose(R, p, zero, T[m])


@jit_compile
def compute_link_motions(axis: Array, point: Array, q: Array, R: Array, p: Array) -> None:
    """Compute the link motions: a point x of link i at q = 0 moves to R[i] x + p[i].

    Args:
        axis: (n, 3) unit, the lines in base_link at q = 0.
        point: (n, 3) m, a point of each.
        q: (M, n) rad.
        R: (M, n + 1, 3, 3) receives the rotations.
        p: (M, n + 1, 3) m, receives the translations.
    """
    for m in range(len(q)):
        _set_identity(R[m, 0], p[m, 0])
        for i in range(len(axis)):
            for r in range(3):
                for c in range(3):
                    R[m, i + 1, r, c] = R[m, i, r, c]
                p[m, i + 1, r] = p[m, i, r]
            _rotate_about_line(R[m, i + 1], p[m, i + 1], axis[i], point[i], q[m, i])


@jit_compile
def compute_chain_motions(
    axis: Array, point: Array, slides: NDArray[np.bool_], theta: Array, R: Array, p: Array
) -> None:
    """Compute the link motions of n lines, some of them prismatic, as :func:`compute_link_motions`.

    Args:
        axis: (n, 3) unit, the lines in base_link at zero.
        point: (n, 3) m, a point of each.
        slides: (n,) prismatic joints.
        theta: (M, n) rad or m.
        R: (M, n + 1, 3, 3) receives the rotations.
        p: (M, n + 1, 3) m, receives the translations.
    """
    n = len(axis)
    for m in range(len(theta)):
        _set_identity(R[m, 0], p[m, 0])
        for i in range(n):
            for r in range(3):
                for c in range(3):
                    R[m, i + 1, r, c] = R[m, i, r, c]
                p[m, i + 1, r] = p[m, i, r]
            if slides[i]:
                for r in range(3):
                    way = R[m, i, r, 0] * axis[i, 0] + R[m, i, r, 1] * axis[i, 1] + R[m, i, r, 2] * axis[i, 2]
                    p[m, i + 1, r] += theta[m, i] * way
            else:
                _rotate_about_line(R[m, i + 1], p[m, i + 1], axis[i], point[i], theta[m, i])


@jit_compile
def compute_relative_motion(
    axis: Array, point: Array, slides: NDArray[np.bool_], first: int, last: int, theta: Array, T: Array
) -> None:
    """Compute the motion of link ``last`` relative to link ``first``, as :func:`compute_chain_motions`.

    Args:
        axis: (n, 3) unit, the lines in base_link at zero.
        point: (n, 3) m, a point of each.
        slides: (n,) prismatic joints.
        first: first line of the product.
        last: line after the last one of the product.
        theta: (M, n) rad or m.
        T: (M, 4, 4) receives the motions.
    """
    R, p = np.empty((3, 3)), np.empty(3)
    for m in range(len(theta)):
        _set_identity(R, p)
        for i in range(first, last):
            if slides[i]:
                for r in range(3):
                    way = R[r, 0] * axis[i, 0] + R[r, 1] * axis[i, 1] + R[r, 2] * axis[i, 2]
                    p[r] += theta[m, i] * way
            else:
                _rotate_about_line(R, p, axis[i], point[i], theta[m, i])
        for r in range(3):
            for c in range(3):
                T[m, r, c] = R[r, c]
            T[m, r, 3], T[m, 3, r] = p[r], 0.0
        T[m, 3, 3] = 1.0


@jit_compile
def compute_jacobians(axis: Array, point: Array, zero: Array, q: Array, T: Array, J: Array) -> None:
    """Compute poses as :func:`compute_poses`, and Jacobians at the frame's origin, linear part first.

    Args:
        axis: (n, 3) unit, the lines in base_link at q = 0.
        point: (n, 3) m, a point of each.
        zero: (4, 4) the frame at q = 0.
        q: (M, n) rad.
        T: (M, 4, 4) receives the poses.
        J: (M, 6, n) receives the Jacobians.
    """
    R, p, h, o = np.empty((3, 3)), np.empty(3), np.empty(axis.shape), np.empty(axis.shape)
    for m in range(len(q)):
        _set_identity(R, p)
        for i in range(len(axis)):
            for r in range(3):
                h[i, r] = R[r, 0] * axis[i, 0] + R[r, 1] * axis[i, 1] + R[r, 2] * axis[i, 2]
                o[i, r] = R[r, 0] * point[i, 0] + R[r, 1] * point[i, 1] + R[r, 2] * point[i, 2] + p[r]
            _rotate_about_line(R, p, axis[i], point[i], q[m, i])
        _compute_pose(R, p, zero, T[m])
        for i in range(len(axis)):
            x, y, z = T[m, 0, 3] - o[i, 0], T[m, 1, 3] - o[i, 1], T[m, 2, 3] - o[i, 2]
            J[m, 0, i] = h[i, 1] * z - h[i, 2] * y
            J[m, 1, i] = h[i, 2] * x - h[i, 0] * z
            J[m, 2, i] = h[i, 0] * y - h[i, 1] * x
            J[m, 3, i], J[m, 4, i], J[m, 5, i] = h[i, 0], h[i, 1], h[i, 2]
