"""Rigid motions as unit dual quaternions, in batches: arrays (N, 8), real part (w, x, y, z) first, then the dual part.

Source: Clifford's dual numbers as used by Daniilidis, Int. J. Robotics Res. 18 (1999) 286. Lengths in m, angles in rad.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]


def _hamilton(a: Array, b: Array) -> Array:
    """Product of quaternions (..., 4)."""
    w, v = a[..., :1], a[..., 1:]
    s, u = b[..., :1], b[..., 1:]
    return np.concatenate([w * s - np.sum(v * u, axis=-1, keepdims=True), w * u + s * v + np.cross(v, u)], axis=-1)


def times(a: Array, b: Array) -> Array:
    """Motion b, then seen through a: T_a T_b. Shapes (N, 8) or (8,)."""
    a, b = np.broadcast_arrays(a, b)
    real = _hamilton(a[..., :4], b[..., :4])
    dual = _hamilton(a[..., :4], b[..., 4:]) + _hamilton(a[..., 4:], b[..., :4])
    return np.concatenate([real, dual], axis=-1)


def of(rotation: Array, translation: Array) -> Array:
    """From a unit quaternion (..., 4) and a translation (..., 3)."""
    pure = np.concatenate([np.zeros_like(translation[..., :1]), translation], axis=-1)
    rotation, pure = np.broadcast_arrays(rotation, pure)
    return np.concatenate([rotation, 0.5 * _hamilton(pure, rotation)], axis=-1)


def turned(vector: Array) -> Array:
    """Unit quaternion (..., 4) of a rotation vector (..., 3) in rad."""
    angle = np.linalg.norm(vector, axis=-1, keepdims=True)
    return np.concatenate([np.cos(angle / 2), 0.5 * np.sinc(angle / (2 * np.pi)) * vector], axis=-1)


def shifted(translation: Array) -> Array:
    """Pure translation (..., 3)."""
    one = np.zeros((*translation.shape[:-1], 4))
    one[..., 0] = 1.0
    return of(one, translation)


def twist(small: Array) -> Array:
    """Flexure (..., 6): translation in m and rotation vector in rad, both in the frame it sits in, taken at once."""
    return of(turned(small[..., 3:]), small[..., :3])


def fixed_axes(roll: float, pitch: float, yaw: float) -> Array:
    """Unit quaternion (4,) of roll, pitch, yaw about fixed x, y, z in rad."""
    x, y, z = (turned(a * np.eye(3)[i]) for i, a in enumerate((roll, pitch, yaw)))
    return _hamilton(z, _hamilton(y, x))


def place(motion: Array) -> Array:
    """Translation (..., 3)."""
    real = motion[..., :4]
    back = real * np.array([1.0, -1.0, -1.0, -1.0])
    return 2.0 * _hamilton(motion[..., 4:], back)[..., 1:]


def matrix(motion: Array) -> Array:
    """Rotation matrix (..., 3, 3)."""
    w, x, y, z = np.moveaxis(motion[..., :4], -1, 0)
    rows = [
        [1 - 2 * (y * y + z * z), 2 * (x * y - w * z), 2 * (x * z + w * y)],
        [2 * (x * y + w * z), 1 - 2 * (x * x + z * z), 2 * (y * z - w * x)],
        [2 * (x * z - w * y), 2 * (y * z + w * x), 1 - 2 * (x * x + y * y)],
    ]
    return np.moveaxis(np.array(rows), (0, 1), (-2, -1))


def turning(loaded: Array, unloaded: Array) -> Array:
    """Rotation vector (N, 3), rad, in base axes, from ``unloaded`` to ``loaded``."""
    back = unloaded[..., :4] * np.array([1.0, -1.0, -1.0, -1.0])
    r = _hamilton(loaded[..., :4], back)
    r = np.where(r[..., :1] < 0, -r, r)
    sine = np.linalg.norm(r[..., 1:], axis=-1, keepdims=True)
    angle = 2 * np.arctan2(sine, r[..., :1])
    return np.asarray(r[..., 1:] * np.where(sine > 1e-14, angle / np.maximum(sine, 1e-14), 2.0))
