"""Rigid transforms, and the rotation about the tool axis. Arrays broadcast over leading dimensions."""

from __future__ import annotations

import numpy as np

from machopt.numerics.array_types import Array

SAME_AXIS = 1e-12  # sine of the angle below which two axes are one


def compute_rpy_matrix(rpy: Array) -> Array:
    """Return the rotation Rz(yaw) Ry(pitch) Rx(roll) (URDF's fixed-axis convention), (..., 3, 3).

    Args:
        rpy: (..., 3) roll, pitch, yaw in rad.
    """
    rpy = np.asarray(rpy, dtype=float)
    cr, cp, cy = np.moveaxis(np.cos(rpy), -1, 0)
    sr, sp, sy = np.moveaxis(np.sin(rpy), -1, 0)
    rows = [
        [cy * cp, cy * sp * sr - sy * cr, cy * sp * cr + sy * sr],
        [sy * cp, sy * sp * sr + cy * cr, sy * sp * cr - cy * sr],
        [-sp, cp * sr, cp * cr],
    ]
    return np.stack([np.stack(row, axis=-1) for row in rows], axis=-2)


def build_transform(rotation: Array, translation: Array) -> Array:
    """Return the (..., 4, 4) homogeneous matrix.

    Args:
        rotation: (..., 3, 3).
        translation: (..., 3) m.
    """
    rotation, translation = np.asarray(rotation, float), np.asarray(translation, float)
    shape = np.broadcast_shapes(rotation.shape[:-2], translation.shape[:-1])
    T = np.zeros((*shape, 4, 4))
    T[..., :3, :3] = rotation
    T[..., :3, 3] = translation
    T[..., 3, 3] = 1.0
    return T


def invert_transform(T: Array) -> Array:
    """Return the inverse of rigid transforms.

    Args:
        T: (..., 4, 4).
    """
    R = np.swapaxes(T[..., :3, :3], -1, -2)
    return build_transform(R, -np.einsum("...ij,...j->...i", R, T[..., :3, 3]))


def compute_axis_rotation(axis: Array, angle: Array) -> Array:
    """Return the rotation (..., 3, 3) about an axis (Rodrigues).

    Args:
        axis: (..., 3) unit.
        angle: (...,) rad.
    """
    axis, angle = np.asarray(axis, float), np.asarray(angle, float)
    c, s = np.cos(angle)[..., None, None], np.sin(angle)[..., None, None]
    K = skew_matrix(axis)
    return np.eye(3) + s * K + (1.0 - c) * (K @ K)


def skew_matrix(v: Array) -> Array:
    """Return the cross-product matrix (..., 3, 3).

    Args:
        v: (..., 3).
    """
    v = np.asarray(v, float)
    K = np.zeros((*v.shape[:-1], 3, 3))
    K[..., 2, 1], K[..., 0, 2], K[..., 1, 0] = v[..., 0], v[..., 1], v[..., 2]
    K[..., 1, 2], K[..., 2, 0], K[..., 0, 1] = -v[..., 0], -v[..., 1], -v[..., 2]
    return K


def compute_frame_motion_matrix(points: Array, about: Array) -> Array:
    """Return (N, 6, 6) the motion of points and their axes per unit translation and rotation of a frame.

    Args:
        points: (N, 3) m.
        about: (3,) m, centre of the rotation.
    """
    out = np.zeros((len(points), 6, 6))
    out[:] = np.eye(6)
    out[:, :3, 3:] = -skew_matrix(points - about)
    return out


def normalise_vectors(v: Array) -> Array:
    """Return v / |v| along the last axis; zero vectors become NaN.

    Args:
        v: (..., n).
    """
    n = np.linalg.norm(v, axis=-1, keepdims=True)
    with np.errstate(invalid="ignore", divide="ignore"):
        return np.where(n > 0, v / n, np.nan)


def compute_tool_rotation(tool_axis: Array, reference: Array, gamma: Array) -> Array:
    """Return the TCP rotation from the CAM tool axis, a reference direction and gamma.

    TCP z = −tool_axis; TCP x at gamma = 0 is ``reference`` projected on the plane normal to the axis;
    gamma rotates the TCP about its own z, right-handed.

    Args:
        tool_axis: (..., 3) unit, tip to shank.
        reference: (..., 3), not parallel to ``tool_axis``.
        gamma: (...,) rad.

    Returns:
        (..., 3, 3) columns x, y, z of the TCP in the frame of the inputs.
    """
    z = -np.asarray(tool_axis, float)
    ref = np.asarray(reference, float)
    x0 = normalise_vectors(ref - np.sum(ref * z, axis=-1, keepdims=True) * z)
    y0 = np.cross(z, x0)
    c, s = np.cos(gamma)[..., None], np.sin(gamma)[..., None]
    x = c * x0 + s * y0
    y = -s * x0 + c * y0
    x, y, z = np.broadcast_arrays(x, y, z)
    return np.stack([x, y, z], axis=-1)


def interpolate_axis(start: Array, end: Array, share: Array) -> Array:
    """Return unit vectors interpolated at constant angular rate in the plane of both ends (great circle; Shoemake
    1985).

    Robot controllers interpolate the tool axis between two points of a path in this way.

    Args:
        start: (n, 3) unit.
        end: (n, 3) unit; not opposite to ``start``, where no plane is defined.
        share: (n,) of the angle between them, 0 to 1.

    Returns:
        (n, 3) unit.
    """
    share = np.asarray(share, float)[:, None]
    sine = np.linalg.norm(np.cross(start, end), axis=1, keepdims=True)
    angle = np.arctan2(sine, np.sum(start * end, axis=1, keepdims=True))
    turns = sine > SAME_AXIS
    divisor = np.where(turns, sine, 1.0)
    before = np.where(turns, np.sin((1.0 - share) * angle) / divisor, 1.0 - share)
    after = np.where(turns, np.sin(share * angle) / divisor, share)
    return normalise_vectors(before * start + after * end)


def wrap_angle(angle: Array) -> Array:
    """Return the angle in (−π, π].

    Args:
        angle: (...,) rad.
    """
    return -np.remainder(np.pi - np.asarray(angle, float), 2 * np.pi) + np.pi


def convert_to_quaternion(R: Array) -> Array:
    """Return the unit quaternion (..., 4), w x y z with the largest component positive.

    The rows of 4 q qᵀ are linear in R; the one with the largest pivot is used, which is never small.

    Args:
        R: (..., 3, 3) rotation.
    """
    R = np.asarray(R, float)
    (a, b, c), (d, e, f), (g, h, i) = (np.moveaxis(R[..., k, :], -1, 0) for k in range(3))
    rows = [
        [1 + a + e + i, h - f, c - g, d - b],
        [h - f, 1 + a - e - i, b + d, c + g],
        [c - g, b + d, 1 - a + e - i, f + h],
        [d - b, c + g, f + h, 1 - a - e + i],
    ]
    Q = np.stack([np.stack(row, axis=-1) for row in rows], axis=-2)
    pivot = np.argmax(np.diagonal(Q, axis1=-2, axis2=-1), axis=-1)
    return normalise_vectors(np.take_along_axis(Q, pivot[..., None, None], axis=-2)[..., 0, :])


def convert_quaternion_to_matrix(q: Array) -> Array:
    """Return the rotation (..., 3, 3).

    Args:
        q: (..., 4) unit quaternion, w x y z.
    """
    q = np.asarray(q, float)
    w, v = q[..., :1, None], q[..., 1:]
    K = skew_matrix(v)
    return np.eye(3) + 2.0 * (w * K + K @ K)


def convert_to_rotation_vector(R: Array) -> Array:
    """Return the rotation vector (..., 3) in rad, angle in [0, π]; accurate to round-off at every angle.

    Args:
        R: (..., 3, 3) rotation.
    """
    q = convert_to_quaternion(R)
    w, v = q[..., 0], q[..., 1:]
    s = np.linalg.norm(v, axis=-1)
    with np.errstate(invalid="ignore", divide="ignore"):
        per_sine = np.where(s > 0, 2.0 * np.arctan2(s, np.abs(w)) / s, 2.0)
    return np.asarray(v * (per_sine * np.where(w < 0, -1.0, 1.0))[..., None])


def convert_vector_to_rotation(v: Array) -> Array:
    """Return the rotation (..., 3, 3) of a rotation vector; inverse of :func:`convert_to_rotation_vector`.

    Args:
        v: (..., 3) rad.
    """
    v = np.asarray(v, float)
    angle = np.linalg.norm(v, axis=-1)
    K = skew_matrix(v)
    half = np.sinc(angle / (2.0 * np.pi))[..., None, None]  # sin(a/2)/(a/2)
    return np.asarray(np.eye(3) + np.sinc(angle / np.pi)[..., None, None] * K + 0.5 * half**2 * (K @ K))


def cross_product(a: Array, b: Array) -> Array:
    """Return a × b over the last axis, in a third of the time of numpy.cross.

    Args:
        a: (..., 3).
        b: (..., 3).
    """
    x, y, z = a[..., 0], a[..., 1], a[..., 2]
    u, v, w = b[..., 0], b[..., 1], b[..., 2]
    return np.stack([y * w - z * v, z * u - x * w, x * v - y * u], axis=-1)
