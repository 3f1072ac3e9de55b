"""Rotations as robot controllers write them. Everything in degrees, mm, or without unit; arrays (..., 3, 3) in."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]
UPRIGHT = 1e-9  # cosine of the middle angle below which the other two turn about one line


def abc_deg(R: Array) -> Array:
    """A, B, C in degrees (..., 3): R = Rz(A) Ry(B) Rx(C); A = 0 where |B| = 90°.

    The same three numbers in the other order are roll, pitch and yaw about fixed axes: FANUC's W, P, R and
    Yaskawa's Rx, Ry, Rz.
    """
    R = np.asarray(R, float)
    cos_b = np.hypot(R[..., 0, 0], R[..., 1, 0])
    b = np.arctan2(-R[..., 2, 0], cos_b)
    upright = cos_b < UPRIGHT
    a = np.where(upright, 0.0, np.arctan2(R[..., 1, 0], R[..., 0, 0]))
    c = np.where(upright, np.arctan2(-R[..., 1, 2], R[..., 1, 1]), np.arctan2(R[..., 2, 1], R[..., 2, 2]))
    return np.asarray(np.degrees(np.stack([a, b, c], axis=-1)))


def xyz_deg(R: Array) -> Array:
    """Stäubli's rx, ry, rz in degrees (..., 3): R = Rx(rx) Ry(ry) Rz(rz); rz = 0 where |ry| = 90°."""
    R = np.asarray(R, float)
    cos_y = np.hypot(R[..., 1, 2], R[..., 2, 2])
    y = np.arctan2(R[..., 0, 2], cos_y)
    upright = cos_y < UPRIGHT
    x = np.where(upright, np.arctan2(R[..., 2, 1], R[..., 1, 1]), np.arctan2(-R[..., 1, 2], R[..., 2, 2]))
    z = np.where(upright, 0.0, np.arctan2(-R[..., 0, 1], R[..., 0, 0]))
    return np.asarray(np.degrees(np.stack([x, y, z], axis=-1)))


def quaternion(R: Array) -> Array:
    """Unit quaternion (..., 4), scalar first and not negative, from its largest component (no loss anywhere)."""
    R = np.asarray(R, float)
    d = np.stack([R[..., 0, 0], R[..., 1, 1], R[..., 2, 2]], axis=-1)
    trace = d.sum(axis=-1)
    squares = np.concatenate([(1.0 + trace)[..., None], 1.0 + 2.0 * d - trace[..., None]], axis=-1)  # 4 q_i²
    off = np.stack([R[..., 2, 1], R[..., 0, 2], R[..., 1, 0]], axis=-1)
    low = np.stack([R[..., 1, 2], R[..., 2, 0], R[..., 0, 1]], axis=-1)
    w_by = off - low  # 4 w x, 4 w y, 4 w z
    by = off + low  # 4 y z, 4 x z, 4 x y
    table = np.empty((*R.shape[:-2], 4, 4))  # row i: 4 q_i q
    table[..., 0, 0], table[..., 0, 1:] = squares[..., 0], w_by
    table[..., 1:, 0] = w_by
    for i in range(3):
        table[..., i + 1, i + 1] = squares[..., i + 1]
    for i, j, k in ((0, 1, 2), (0, 2, 1), (1, 2, 0)):
        table[..., i + 1, j + 1] = table[..., j + 1, i + 1] = by[..., k]
    largest = np.argmax(squares, axis=-1)
    row = np.take_along_axis(table, largest[..., None, None], axis=-2)[..., 0, :]
    q = row / np.linalg.norm(row, axis=-1, keepdims=True)
    return np.asarray(np.where(q[..., :1] < 0.0, -q, q) + 0.0)


def rotation_vector(R: Array) -> Array:
    """Universal Robots' rx, ry, rz in rad (..., 3): axis times angle, at most π long."""
    q = quaternion(R)
    sine = np.linalg.norm(q[..., 1:], axis=-1)
    angle = 2.0 * np.arctan2(sine, q[..., 0])
    scale = np.where(sine > 1e-12, angle / np.where(sine > 1e-12, sine, 1.0), 2.0)
    return np.asarray(scale[..., None] * q[..., 1:])
