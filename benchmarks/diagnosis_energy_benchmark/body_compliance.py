"""Bodies that bend: 6 x 6 compliances (translation m, rotation rad per N, N·m) of beams, pedestals and tools.

A beam's end moves by the integral of the strain energy's derivative along a section that gets thinner (Castigliano),
shear included (Timoshenko); a pedestal stands on three feet and takes the position of least energy on them.
"""

from __future__ import annotations

import numpy as np
from dual_quaternions import Array


def _across(along: Array) -> Array:
    """(3, 3) columns: the beam's axis and two across it."""
    x = along / np.linalg.norm(along)
    help_ = np.eye(3)[int(np.argmin(np.abs(x)))]
    y = np.cross(help_, x)
    y /= np.linalg.norm(y)
    return np.stack([x, y, np.cross(x, y)], axis=1)


def beam(span: Array, bending: float, taper: float, flat: float = 1.0, twist: float = 0.8) -> Array:
    """End compliance in the axes of the frame it is clamped in.

    Args: ``span`` (3,) m from clamp to end; ``bending`` EI at the clamp, N·m²; the section is a thin tube whose
    radius falls linearly to ``taper`` of the clamp's, so EI with its cube; ``flat`` EI of the second plane over that of
    the first; ``twist`` GJ over EI.
    """
    length = float(np.linalg.norm(span))
    n = 200
    s = (np.arange(n) + 0.5) / n  # share of the length
    ds = length / n
    radius = 1.0 - (1.0 - taper) * s
    EI = bending * radius**3
    # shear stiffness of a thin tube k G A with A = 2 I / r², r 0.12 of the length at the clamp; axial likewise
    EA = 2.0 * bending / (0.12 * length) ** 2 * radius
    kGA = 0.5 * EA / 2.6
    C = np.zeros((6, 6))
    for EI_, lateral, turn, sign in ((EI, 1, 5, 1.0), (EI * flat, 2, 4, -1.0)):
        arm = length * (1.0 - s)  # lever of an end force
        C[lateral, lateral] += np.sum(arm**2 / EI_ + 1.0 / kGA) * ds
        C[lateral, turn] += sign * np.sum(arm / EI_) * ds
        C[turn, lateral] = C[lateral, turn]
        C[turn, turn] += np.sum(1.0 / EI_) * ds
    C[0, 0] = np.sum(1.0 / EA) * ds
    C[3, 3] = np.sum(1.0 / (twist * EI)) * ds
    B = np.kron(np.eye(2), _across(np.asarray(span, dtype=float)))
    return np.asarray(B @ C @ B.T)


def stepped(length: float, along: Array, bending: float) -> Array:
    """A tool of two cylinders, the second half as thick in EI as a fifth of the first, seen at its tip."""
    first = beam(along / np.linalg.norm(along) * 0.55 * length, bending, 1.0)
    second = beam(along / np.linalg.norm(along) * 0.45 * length, 0.2 * bending, 0.9)
    return shifted(first, along / np.linalg.norm(along) * 0.45 * length) + second


def shifted(C: Array, to: Array) -> Array:
    """Compliance of the same body at a point rigidly ``to`` (3,) farther: motion G C Gᵀ, G the rigid lever."""
    x, y, z = to
    lever = np.array([[0, -z, y], [z, 0, -x], [-y, x, 0]])
    G = np.eye(6)
    G[:3, 3:] = -lever
    return np.asarray(G @ C @ G.T)


def feet(radius: float, axial: float, lateral: float, uneven: tuple[float, float, float]) -> tuple[Array, Array]:
    """Three feet: places (3, 3) m and springs (3, 3) N/m for x, y, z of each."""
    angles = np.radians([20.0, 140.0, 260.0])
    at = radius * np.stack([np.cos(angles), np.sin(angles), np.zeros(3)], axis=1)
    k = np.array([[lateral * u, lateral * u, axial * u] for u in uneven])
    return at, k


def plate(at: Array, k: Array) -> Array:
    """(6, 6) stiffness of a plate on feet that hold always."""
    K = np.zeros((6, 6))
    for p, springs in zip(at, k, strict=True):
        x, y, z = p
        S = np.hstack([np.eye(3), -np.array([[0, -z, y], [z, 0, -x], [-y, x, 0]])])
        K += S.T @ np.diag(springs) @ S
    return K


def loose(at: Array, k: Array, wrench: Array, foot: int, gap: float) -> Array:
    """(N, 6) motion of a plate whose one foot lifts off freely by ``gap`` metres before its bolt pulls.

    Least energy by Newton with the foot's force smoothed over a tenth of the gap, from rest under ``wrench`` (N, 6).
    """
    rest = k.copy()
    rest[foot, 2] = 0.0
    K = plate(at, rest)
    row = np.array([0, 0, 1.0, at[foot, 1], -at[foot, 0], 0])  # lift of that foot
    stiff, soft = k[foot, 2], 0.1 * gap
    x = np.linalg.solve(plate(at, k), wrench.T).T
    for _ in range(60):
        lift = x @ row
        down = -soft * np.logaddexp(0.0, -lift / soft)  # pressed
        up = soft * np.logaddexp(0.0, (lift - gap) / soft)  # bolt taut
        slope = 1 / (1 + np.exp(np.clip(lift / soft, -50, 50))) + 1 / (
            1 + np.exp(np.clip((gap - lift) / soft, -50, 50))
        )
        force = x @ K.T + (stiff * (down + up))[:, None] * row - wrench
        H = K[None] + (stiff * np.maximum(slope, 1e-3))[:, None, None] * np.outer(row, row)
        step = np.linalg.solve(H, force[..., None])[..., 0]
        x = x - step
        if float(np.max(np.abs(step[:, :3]))) < 1e-11:
            break
    return x
