"""Attitudes of the TCP as robot tables write them: angles, quaternions, rotation vectors. Tool axis −z, reference +x.

Each makes (N, 3, 3) matrices whose columns are the TCP's axes in the workpiece.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from machopt.domain.toolpath import Array

UNIT_QUATERNION = 1e-3  # off from unit length: printed decimals; beyond it the numbers are something else


@dataclass(frozen=True)
class Attitude:
    """One way to write an attitude: its columns, with the endings they may have, and what they mean."""

    columns: tuple[str, ...]
    angles: bool  # carry _deg or _rad
    words: str


ATTITUDES = {
    "abc": Attitude(("a", "b", "c"), True, "R = Rz(a) Ry(b) Rx(c)"),
    "wpr": Attitude(("w", "p", "r"), True, "R = Rz(r) Ry(p) Rx(w)"),
    "rpy": Attitude(("roll", "pitch", "yaw"), True, "R = Rz(yaw) Ry(pitch) Rx(roll)"),
    "quaternion": Attitude(("qw", "qx", "qy", "qz"), False, "unit quaternion"),
    "q1234": Attitude(("q1", "q2", "q3", "q4"), False, "unit quaternion, scalar first"),
    "vector": Attitude(("rvx", "rvy", "rvz"), True, "rotation vector: axis times angle"),
}


def rotations(kind: str, values: Array) -> Array:
    """(N, 3, 3) from (N, 3 or 4) values of one of :data:`ATTITUDES`; angles in radians."""
    if kind == "abc":
        return _zyx(values[:, 0], values[:, 1], values[:, 2])
    if kind in ("wpr", "rpy"):
        return _zyx(values[:, 2], values[:, 1], values[:, 0])
    if kind == "vector":
        return _rodrigues(values)
    return _from_quaternion(values / np.linalg.norm(values, axis=1)[:, None])


def _zyx(a: Array, b: Array, c: Array) -> Array:
    """Rz(a) Ry(b) Rx(c)."""
    ca, sa, cb, sb, cc, sc = np.cos(a), np.sin(a), np.cos(b), np.sin(b), np.cos(c), np.sin(c)
    rows = [
        [ca * cb, ca * sb * sc - sa * cc, ca * sb * cc + sa * sc],
        [sa * cb, sa * sb * sc + ca * cc, sa * sb * cc - ca * sc],
        [-sb, cb * sc, cb * cc],
    ]
    return np.moveaxis(np.array(rows), 2, 0)


def _rodrigues(v: Array) -> Array:
    """exp([v]×), v = axis · angle."""
    angle = np.linalg.norm(v, axis=1)
    n = v / np.where(angle > 0.0, angle, 1.0)[:, None]
    half = np.column_stack([np.cos(angle / 2.0), np.sin(angle / 2.0)[:, None] * n])
    return _from_quaternion(half)


def _from_quaternion(q: Array) -> Array:
    w, x, y, z = q.T
    rows = [
        [1 - 2 * (y * y + z * z), 2 * (x * y - w * z), 2 * (x * z + w * y)],
        [2 * (x * y + w * z), 1 - 2 * (x * x + z * z), 2 * (y * z - w * x)],
        [2 * (x * z - w * y), 2 * (y * z + w * x), 1 - 2 * (x * x + y * y)],
    ]
    return np.moveaxis(np.array(rows), 2, 0)
