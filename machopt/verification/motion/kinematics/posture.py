"""Branch, distance from singularities and distance from joint limits of points.csv, from the lines of the six axes.

With z_i and o_i the direction and origin of axis i, w the point where axes 4, 5 and 6 meet (spherical wrist):

* (z₁ × (w − o₁))·z₂ says how fast joint 1 moves w along axis 2. Its size is the distance of w from the
  shoulder singularity in m.
* a = o₃ − o₂, b = w − o₃: joint 3 turns b about z₃; how far it is from folding or stretching the arm is
  atan2(|a·(z₃ × b)|, a·b − (a·z₃)(b·z₃)), counted from 0 or 180°, the nearer.
* the same of z₄ and z₆ about z₅ for the wrist.

``branch`` is 4·[(z₁ × (w − o₁))·z₂ < 0] + 2·[(w − o₂)·(z₃ × b) > 0] + [z₄·(z₅ × z₆) > 0]. ``singularity`` is the least
of wrist, elbow and the shoulder's distance seen as an angle over 1 m, in deg.

Arms with three parallel axes 2, 3 and 4: wrist = angle between the lines of axes 4 and 6; elbow = angle of the two
links, flat on the common direction, from one line; shoulder = distance of o₅ from the plane of z₁ and z₂ through o₁.
``branch`` is 4·[(z₁ × (w − o₁))·z₂ < 0] + 2·[z₂·(z₅ × z₆) > 0] + [(o₄ − o₂)·(z₃ × (o₄ − o₃)) > 0], w where axes 5 and
6 meet. Other arms: the least singular value of the flange's Jacobian with lengths over 0.5 m. Their branches are
numbered by a solver, not by the arm's shape, so that the column cannot be recomputed.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Literal

import numpy as np
from numpy.typing import NDArray

from machopt.numerics.array_types import Array
from machopt.verification.motion.kinematics.arm_configuration import ArmConfiguration

PARALLEL_TOLERANCE_RAD = 1e-6  # rad; axes of a URDF with printed decimals
INTERSECTION_TOLERANCE_M = 2e-6  # m
CHARACTERISTIC_LENGTH_M = 0.5  # m, what linear rows of a Jacobian are divided by
WristKind = Literal["spherical", "three_parallel", "general"]


@dataclass(frozen=True)
class ArmPosture:
    """Branch and singularity distances of N configurations."""

    kind: WristKind
    branch: NDArray[np.int64] | None  # (N,); None: numbered by a solver
    singularity: Array  # (N,) rad
    ambiguity: Array  # (N,) rad, of singularity: axes that meet or are parallel only within MEETING and PARALLEL


def compute_posture(stance: ArmConfiguration) -> ArmPosture:
    """Return branch and singularity distance of N ≥ 1 configurations.

    Args:
        stance: The arm at N configurations, base_link axes.
    """
    z, o = stance.axis, stance.origin
    parallel = bool(np.linalg.norm(np.cross(z[0, 1], z[0, 2])) < PARALLEL_TOLERANCE_RAD)
    w, off = _find_meeting_point(z[:, 3:], o[:, 3:])
    skewed = all(np.linalg.norm(np.cross(z[0, i], z[0, j])) > 0.1 for i, j in ((0, 1), (3, 4), (4, 5)))
    if parallel and skewed and float(off.max()) < INTERSECTION_TOLERANCE_M:
        return _compute_spherical_posture(z, o, w, off)
    if parallel and np.linalg.norm(np.cross(z[0, 1], z[0, 3])) < PARALLEL_TOLERANCE_RAD:
        return _compute_three_parallel_posture(z, o)
    J = np.swapaxes(np.concatenate([np.cross(z, stance.flange[:, None, :3, 3] - o), z], axis=-1), 1, 2)
    J[:, :3] /= CHARACTERISTIC_LENGTH_M
    _, sigma, Vt = np.linalg.svd(J)
    moved = (
        Vt[:, -1] ** 2
    )  # the group that moves most gives the singularity its name; the shoulder's counts as a length
    shoulder = (moved[:, 0] >= moved[:, 1] + moved[:, 2]) & (moved[:, 0] >= moved[:, 3:].sum(axis=1))
    least = sigma[:, -1]
    return ArmPosture(
        "general", None, np.where(shoulder, np.arctan(least * CHARACTERISTIC_LENGTH_M), least), np.zeros(len(z))
    )


def compute_limit_margin(q: Array, lower: Array, upper: Array) -> Array:
    """Return the (N,) distance to the nearest joint limit, rad by encoder, negative beyond it.

    Args:
        q: (N, 6) joint positions by encoder, rad.
        lower: (6,) lower limits, rad.
        upper: (6,) upper limits, rad.
    """
    return np.asarray(np.minimum(q - lower, upper - q).min(axis=1))


def _compute_spherical_posture(z: Array, o: Array, w: Array, off: Array) -> ArmPosture:
    """Posture by wrist centres w (N, 3) that the three wrist axes pass at up to ``off`` (N,) m.

    Where they do not meet exactly, every point within about twice that distance is as good a wrist centre.
    """
    shoulder = _dot_product(np.cross(z[:, 0], w - o[:, 0]), z[:, 1])
    a, b = o[:, 2] - o[:, 1], w - o[:, 2]
    bent = _dot_product(w - o[:, 1], np.cross(z[:, 2], b))
    flipped = _dot_product(z[:, 3], np.cross(z[:, 4], z[:, 5]))
    elbow = _compute_line_angle(
        _dot_product(a, np.cross(z[:, 2], b)), _dot_product(a, b) - _dot_product(a, z[:, 2]) * _dot_product(b, z[:, 2])
    )
    wrist = _compute_line_angle(
        flipped, _dot_product(z[:, 3], z[:, 5]) - _dot_product(z[:, 3], z[:, 4]) * _dot_product(z[:, 4], z[:, 5])
    )
    branch = 4 * (shoulder < 0) + 2 * (bent > 0) + (flipped > 0)
    ambiguity = 2.0 * off * np.maximum(1.0, 1.0 / np.linalg.norm(b, axis=1))
    return ArmPosture("spherical", branch, np.minimum(np.minimum(wrist, elbow), np.arctan(np.abs(shoulder))), ambiguity)


def _compute_three_parallel_posture(z: Array, o: Array) -> ArmPosture:
    def flat(v: Array) -> Array:
        return np.asarray(v - _dot_product(v, z[:, 1])[:, None] * z[:, 1])

    wrist, elbow = (
        _compute_angle_between_lines(z[:, 3], z[:, 5]),
        _compute_angle_between_lines(flat(o[:, 2] - o[:, 1]), flat(o[:, 3] - o[:, 2])),
    )
    normal = np.cross(z[:, 0], z[:, 1])
    shoulder = np.abs(_dot_product(o[:, 4] - o[:, 0], normal)) / np.linalg.norm(normal, axis=1)
    w = _find_meeting_point(z[:, 4:], o[:, 4:])[0]
    back = _dot_product(np.cross(z[:, 0], w - o[:, 0]), z[:, 1]) < 0
    bent = _dot_product(o[:, 3] - o[:, 1], np.cross(z[:, 2], o[:, 3] - o[:, 2])) > 0
    branch = 4 * back + 2 * (_dot_product(z[:, 1], np.cross(z[:, 4], z[:, 5])) > 0) + bent
    skew = np.maximum(*(np.linalg.norm(np.cross(z[:, 1], z[:, k]), axis=1) for k in (2, 3)))
    return ArmPosture("three_parallel", branch, np.minimum(np.minimum(wrist, elbow), np.arctan(shoulder)), skew)


def _find_meeting_point(z: Array, o: Array) -> tuple[Array, Array]:
    """The point (N, 3) nearest to three lines, and how far (N,) the farthest of them passes."""
    P = np.eye(3) - np.einsum("nki,nkj->nkij", z, z)
    w = np.linalg.solve(P.sum(axis=1) + 1e-15 * np.eye(3), np.einsum("nkij,nkj->ni", P, o)[..., None])[..., 0]
    return w, np.linalg.norm(np.einsum("nkij,nkj->nki", P, w[:, None] - o), axis=2).max(axis=1)


def _compute_line_angle(sine: Array, cosine: Array) -> Array:
    angle = np.arctan2(np.abs(sine), cosine)
    return np.asarray(np.minimum(angle, np.pi - angle))


def _compute_angle_between_lines(a: Array, b: Array) -> Array:
    return np.asarray(np.arctan2(np.linalg.norm(np.cross(a, b), axis=1), np.abs(_dot_product(a, b))))


def _dot_product(a: Array, b: Array) -> Array:
    return np.asarray(np.einsum("ij,ij->i", a, b))
