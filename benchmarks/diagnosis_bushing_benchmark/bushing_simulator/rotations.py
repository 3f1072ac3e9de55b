"""Batched rotations: exponential, logarithm and the inverse left Jacobian of SO(3)."""

from __future__ import annotations

import numpy as np


def build_skew(v: np.ndarray) -> np.ndarray:
    """Return the cross-product matrices (…, 3, 3) of vectors (…, 3)."""
    out = np.zeros((*v.shape, 3))
    out[..., 0, 1], out[..., 0, 2], out[..., 1, 2] = -v[..., 2], v[..., 1], -v[..., 0]
    out[..., 1, 0], out[..., 2, 0], out[..., 2, 1] = v[..., 2], -v[..., 1], v[..., 0]
    return out


def compute_rotation(v: np.ndarray) -> np.ndarray:
    """Return the rotations (…, 3, 3) of rotation vectors (…, 3) in rad (Rodrigues)."""
    angle = np.linalg.norm(v, axis=-1)[..., None, None]
    K = build_skew(v)
    small = angle < 1e-6
    safe = np.where(small, 1.0, angle)
    a = np.where(small, 1.0 - angle**2 / 6.0, np.sin(safe) / safe)
    b = np.where(small, 0.5 - angle**2 / 24.0, (1.0 - np.cos(safe)) / safe**2)
    return np.eye(3) + a * K + b * (K @ K)


def compute_rotation_vector(R: np.ndarray) -> np.ndarray:
    """Return the rotation vectors (…, 3) in rad of rotations below 90° (bushing strains are below 0.1 rad)."""
    axial = 0.5 * np.stack(
        [R[..., 2, 1] - R[..., 1, 2], R[..., 0, 2] - R[..., 2, 0], R[..., 1, 0] - R[..., 0, 1]], axis=-1
    )
    sine = np.linalg.norm(axial, axis=-1)
    cosine = 0.5 * (np.trace(R, axis1=-2, axis2=-1) - 1.0)
    angle = np.arctan2(sine, cosine)
    factor = np.where(sine < 1e-7, 1.0 + sine**2 / 6.0, angle / np.where(sine < 1e-7, 1.0, sine))
    return factor[..., None] * axial


def compute_inverse_left_jacobian(v: np.ndarray) -> np.ndarray:
    """Return Jl⁻¹ (…, 3, 3) with δlog(R) = Jl⁻¹ δθ for R ← exp(δθ) R."""
    angle = np.linalg.norm(v, axis=-1)[..., None, None]
    K = build_skew(v)
    small = angle < 1e-3
    safe = np.where(small, 1.0, angle)
    exact = (1.0 - 0.5 * safe / np.tan(0.5 * safe)) / safe**2
    series = 1.0 / 12.0 + angle**2 / 720.0
    return np.eye(3) - 0.5 * K + np.where(small, series, exact) * (K @ K)


def compute_axis_rotation(axis: np.ndarray, angle: np.ndarray) -> np.ndarray:
    """Return rotations (N, 3, 3) about one unit axis (3,) by angles (N,) in rad."""
    return compute_rotation(angle[..., None] * axis)


def compute_rpy_rotation(rpy: np.ndarray) -> np.ndarray:
    """Return the rotation (3, 3) of roll, pitch, yaw in rad about fixed x, y, z."""
    roll, pitch, yaw = (compute_rotation(np.asarray(e, float) * a) for e, a in zip(np.eye(3), rpy, strict=True))
    return yaw @ pitch @ roll
