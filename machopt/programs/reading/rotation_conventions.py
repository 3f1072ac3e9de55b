"""Rotation conventions of robot programs, for one target at a time: nine floats, row by row."""

from __future__ import annotations

import math

import numpy as np

from machopt.numerics.array_types import Array

Rows = tuple[float, float, float, float, float, float, float, float, float]
FLAT = 1e-18  # m³·m²: three places within a micrometre of a line
LEAST_NORM = 0.9  # of a quaternion as printed; programs with four decimals are far closer to 1


def compute_fixed_xyz_rotation(x_deg: float, y_deg: float, z_deg: float) -> Rows:
    """Compute rotations about the fixed x, then y, then z axis: KUKA's C, B, A; FANUC's W, P, R; Yaskawa's Rx, Ry, Rz.

    Args:
        x_deg: Angle about x, degrees.
        y_deg: Angle about y, degrees.
        z_deg: Angle about z, degrees.

    Returns:
        Rotation, nine numbers row by row.
    """
    x, y, z = math.radians(x_deg), math.radians(y_deg), math.radians(z_deg)
    cx, sx, cy, sy, cz, sz = math.cos(x), math.sin(x), math.cos(y), math.sin(y), math.cos(z), math.sin(z)
    return (
        cz * cy,
        cz * sy * sx - sz * cx,
        cz * sy * cx + sz * sx,
        sz * cy,
        sz * sy * sx + cz * cx,
        sz * sy * cx - cz * sx,
        -sy,
        cy * sx,
        cy * cx,
    )


def compute_moving_xyz_rotation(x_deg: float, y_deg: float, z_deg: float) -> Rows:
    """Compute rotations about the own x, then the new y, then the new z axis: Stäubli's rx, ry, rz.

    Args:
        x_deg: Angle about x, degrees.
        y_deg: Angle about y, degrees.
        z_deg: Angle about z, degrees.

    Returns:
        Rotation, nine numbers row by row.
    """
    x, y, z = math.radians(x_deg), math.radians(y_deg), math.radians(z_deg)
    cx, sx, cy, sy, cz, sz = math.cos(x), math.sin(x), math.cos(y), math.sin(y), math.cos(z), math.sin(z)
    return (
        cy * cz,
        -cy * sz,
        sy,
        cx * sz + sx * sy * cz,
        cx * cz - sx * sy * sz,
        -sx * cy,
        sx * sz - cx * sy * cz,
        sx * cz + cx * sy * sz,
        cx * cy,
    )


def convert_quaternion(w: float, x: float, y: float, z: float) -> Rows | None:
    """Convert a quaternion, which is normalised.

    Args:
        w: Scalar part.
        x: First vector component.
        y: Second vector component.
        z: Third vector component.

    Returns:
        Rotation, nine numbers row by row; None where the quaternion is far from unit length.
    """
    square = w * w + x * x + y * y + z * z
    if not LEAST_NORM < square < 1.0 / LEAST_NORM:
        return None
    s = 2.0 / square
    return (
        1.0 - s * (y * y + z * z),
        s * (x * y - w * z),
        s * (x * z + w * y),
        s * (x * y + w * z),
        1.0 - s * (x * x + z * z),
        s * (y * z - w * x),
        s * (x * z - w * y),
        s * (y * z + w * x),
        1.0 - s * (x * x + y * y),
    )


def convert_rotation_vector(x: float, y: float, z: float) -> Rows:
    """Convert a rotation vector as Universal Robots writes it.

    Args:
        x: Component along x, rad.
        y: Component along y, rad.
        z: Component along z, rad.

    Returns:
        Rotation, nine numbers row by row.
    """
    angle = math.sqrt(x * x + y * y + z * z)
    if angle < 1e-12:
        return (1.0, -z, y, z, 1.0, -x, -y, x, 1.0)
    half = angle / 2.0
    s = math.sin(half) / angle
    rows = convert_quaternion(math.cos(half), s * x, s * y, s * z)
    assert rows is not None  # cos² + sin² is 1
    return rows


def build_pose_matrix(rows: Rows, x: float, y: float, z: float) -> Array:
    """Build a pose from a rotation and a position.

    Args:
        rows: Rotation, nine numbers row by row.
        x: Position along x, m.
        y: Position along y, m.
        z: Position along z, m.

    Returns:
        Pose (4, 4), m.
    """
    a, b, c, d, e, f, g, h, i = rows
    return np.array([[a, b, c, x], [d, e, f, y], [g, h, i, z], [0.0, 0.0, 0.0, 1.0]])


def invert_pose(T: Array) -> Array:
    """Invert a rigid transform.

    Args:
        T: Transform (4, 4), m.

    Returns:
        Inverse (4, 4), m.
    """
    out = np.eye(4)
    out[:3, :3] = T[:3, :3].T
    out[:3, 3] = -T[:3, :3].T @ T[:3, 3]
    return out


def interpolate_rotations(R0: Array, R1: Array, share: Array) -> Array:
    """Interpolate rotations on the shortest rotation from R0 to R1.

    Args:
        R0: Start rotation (3, 3).
        R1: End rotation (3, 3).
        share: Shares (N,) of the angle, 0 to 1.

    Returns:
        Rotations (N, 3, 3).
    """
    turn = R0.T @ R1
    v = np.array([turn[2, 1] - turn[1, 2], turn[0, 2] - turn[2, 0], turn[1, 0] - turn[0, 1]])
    angle = math.atan2(float(np.linalg.norm(v)), float(np.trace(turn)) - 1.0)
    if angle < 1e-9:
        return np.repeat(R0[None], len(share), axis=0)
    if math.pi - angle < 1e-6:  # half a turn: the axis from the symmetric part
        axis = np.sqrt(np.maximum((np.diag(turn) + 1.0) / 2.0, 0.0))
        k = int(np.argmax(axis))
        axis = turn[:, k] + np.eye(3)[k]
    else:
        axis = v
    axis = axis / np.linalg.norm(axis)
    half = share * angle / 2.0
    s = np.sin(half)[:, None] * axis
    out = [convert_quaternion(float(c), *row) for c, row in zip(np.cos(half), s.tolist(), strict=True)]
    return np.asarray(R0 @ np.array(out, float).reshape(-1, 3, 3))


def compute_halfway_pose(a: Array, b: Array, c: Array) -> Array:
    """Compute a pose on the circle through three positions, half-way from the second to the third.

    Args:
        a: First pose (4, 4), m.
        b: Second pose (4, 4), m.
        c: Third pose (4, 4), m.

    Returns:
        Pose (4, 4), m.
    """
    p, q, r = (T[:3, 3] for T in (a, b, c))
    n = np.cross(q - p, r - q)
    rows = np.array([q - p, r - p, n])
    if abs(np.linalg.det(rows)) < FLAT:
        return b  # on a line: the arc through it says so
    centre = np.linalg.solve(rows, [(q @ q - p @ p) / 2.0, (r @ r - p @ p) / 2.0, n @ p])
    u, w = q - centre, r - centre
    v = np.cross(n / np.linalg.norm(n), u)
    half = (math.atan2(float(w @ v), float(w @ u)) % (2.0 * math.pi)) / 2.0
    out = b.copy()
    out[:3, 3] = centre + math.cos(half) * u + math.sin(half) * v
    return out
