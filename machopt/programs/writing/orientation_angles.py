"""Orientation representations of robot controllers, in degrees, mm or without unit, from rotations (..., 3, 3)."""

from __future__ import annotations

import numpy as np

from machopt.numerics import rigid_transforms
from machopt.numerics.array_types import Array

UPRIGHT = 1e-9  # cosine of the middle angle below which the other two turn about one line


def convert_to_abc_deg(R: Array) -> Array:
    """Convert to A, B, C: R = Rz(A) Ry(B) Rx(C); A = 0 where |B| = 90°.

    In reverse order they are roll, pitch and yaw about fixed axes: FANUC's W, P, R and Yaskawa's Rx, Ry, Rz.

    Args:
        R: Rotations (..., 3, 3).

    Returns:
        Angles (..., 3), degrees.
    """
    R = np.asarray(R, float)
    cos_b = np.hypot(R[..., 0, 0], R[..., 1, 0])
    b = np.arctan2(-R[..., 2, 0], cos_b)
    upright = cos_b < UPRIGHT
    a = np.where(upright, 0.0, np.arctan2(R[..., 1, 0], R[..., 0, 0]))
    c = np.where(upright, np.arctan2(-R[..., 1, 2], R[..., 1, 1]), np.arctan2(R[..., 2, 1], R[..., 2, 2]))
    return np.asarray(np.degrees(np.stack([a, b, c], axis=-1)))


def convert_to_xyz_deg(R: Array) -> Array:
    """Convert to Stäubli's rx, ry, rz: R = Rx(rx) Ry(ry) Rz(rz); rz = 0 where |ry| = 90°.

    Args:
        R: Rotations (..., 3, 3).

    Returns:
        Angles (..., 3), degrees.
    """
    R = np.asarray(R, float)
    cos_y = np.hypot(R[..., 1, 2], R[..., 2, 2])
    y = np.arctan2(R[..., 0, 2], cos_y)
    upright = cos_y < UPRIGHT
    x = np.where(upright, np.arctan2(R[..., 2, 1], R[..., 1, 1]), np.arctan2(-R[..., 1, 2], R[..., 2, 2]))
    z = np.where(upright, 0.0, np.arctan2(-R[..., 0, 1], R[..., 0, 0]))
    return np.asarray(np.degrees(np.stack([x, y, z], axis=-1)))


def convert_to_positive_quaternion(R: Array) -> Array:
    """Convert to unit quaternions with a scalar part that is not negative.

    Args:
        R: Rotations (..., 3, 3).

    Returns:
        Quaternions (..., 4), scalar first.
    """
    q = rigid_transforms.convert_to_quaternion(R)
    return np.asarray(np.where(q[..., :1] < 0.0, -q, q) + 0.0)


def convert_to_ur_rotation_vector(R: Array) -> Array:
    """Convert to the rotation vectors of Universal Robots: axis times angle, at most π long.

    Args:
        R: Rotations (..., 3, 3).

    Returns:
        Rotation vectors (..., 3), rad.
    """
    return rigid_transforms.convert_to_rotation_vector(R) + 0.0  # no -0
