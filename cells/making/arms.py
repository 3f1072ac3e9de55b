"""Arms of six joints: kinematics, masses and our own envelopes as link meshes. Lengths in m."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import trimesh

from making.shapes import cylinder, joined, loft, moved


@dataclass(frozen=True)
class Joint:
    """Origin in the parent's frame and axis; at zero all link frames are parallel to base_link."""

    origin: tuple[float, float, float]
    axis: tuple[int, int, int]
    limits_deg: tuple[float, float]
    velocity_deg_s: float


@dataclass(frozen=True)
class Arm:
    joints: tuple[Joint, ...]
    flange_xyz: tuple[float, float, float]
    flange_rpy: tuple[str, str, str]
    meshes: tuple[trimesh.Trimesh, ...]  # links 0 … 6, each in its own link frame
    masses: tuple[float, ...]


def industrial_arm(
    *,
    a1: float,
    d1: float,
    a2: float,
    offset: float,
    d4: float,
    d6: float,
    upright_zero: bool,
    axis_sign: tuple[int, ...],
    limits_deg: Sequence[tuple[float, float]],
    velocity_deg_s: Sequence[float],
    masses: tuple[float, ...],
    size: float,
) -> Arm:
    """A 6R arm with spherical wrist. x forward, z up.

    Args:
        a1, d1: axis 2 from axis 1, and above the mounting plane.
        a2: upper arm. offset: axis 4 above the elbow axis while the forearm points along +x.
        d4: elbow to wrist centre along the forearm. d6: wrist centre to flange.
        upright_zero: the upper arm points up at zero (ABB, FANUC); else forward (KUKA).
        axis_sign: of axes 1 … 6 about +z, +y, +y, +x, +y, +x.
        size: 1 for a link cross-section of the 500 kg class.
    """
    z1 = 0.4 * d1  # between base and turret
    x4, s = 0.36 * d4, size
    x6 = d6 - 0.06
    up = (0.0, 0.0, a2) if upright_zero else (a2, 0.0, 0.0)
    origins = [(0, 0, z1), (a1, 0, d1 - z1), up, (x4, 0, offset), (d4 - x4, 0, 0), (x6, 0, 0)]
    directions = [(0, 0, 1), (0, 1, 0), (0, 1, 0), (1, 0, 0), (0, 1, 0), (1, 0, 0)]
    joints = tuple(
        Joint(tuple(float(v) for v in o), tuple(g * c for c in d), lim, vel)  # type: ignore[arg-type]
        for o, d, g, lim, vel in zip(origins, directions, axis_sign, limits_deg, velocity_deg_s, strict=True)
    )
    h = d1 - z1
    link0 = joined(
        loft("z", [(0.0, 0, 0, 0.46 * s, 0.46 * s), (0.05, 0, 0, 0.46 * s, 0.46 * s)], 8),
        loft("z", [(0.05, 0, 0, 0.40 * s, 0.40 * s), (z1 - 0.01, 0, 0, 0.34 * s, 0.34 * s)], 3),
    )
    cheek = [cylinder("y", lo * s, hi * s, 0.22 * s, (h, a1)) for lo, hi in ((-0.26, -0.15), (0.15, 0.26))]
    column = [
        loft(
            "z",
            [
                (0.13 * s, 0, 0.1 * y * s, 0.33 * s, 0.28 * s),
                (max(h - 0.1 * s, 0.2 * s), 0.75 * a1, y * s, 0.22 * s, 0.05 * s),
            ],
            4,
        )
        for y in (-0.205, 0.205)
    ]
    link1 = joined(cylinder("z", 0.0, 0.15 * s, 0.38 * s), *column, *cheek)
    beam = joined(
        cylinder("y", -0.14 * s, 0.14 * s, 0.22 * s),
        loft(
            "x",
            [(0, 0, 0, 0.13 * s, 0.20 * s), (0.25 * a2, 0, 0, 0.12 * s, 0.19 * s), (a2, 0, 0, 0.11 * s, 0.14 * s)],
            4,
        ),
        cylinder("y", -0.12 * s, 0.12 * s, 0.17 * s, (0, a2)),
    )
    link2 = moved(beam, rpy_deg=(0, -90, 0)) if upright_zero else beam
    link3 = joined(
        *(cylinder("y", lo * s, hi * s, 0.18 * s) for lo, hi in ((-0.22, -0.13), (0.13, 0.22))),
        loft(
            "x",
            [
                (-0.30 * s, 0, offset, 0.18 * s, 0.13 * s),
                (-0.1 * s, 0, offset, 0.22 * s, 0.19 * s),
                (0.15 * s, 0, offset, 0.21 * s, 0.20 * s),
                (x4 - 0.01, 0, offset, 0.17 * s, 0.17 * s),
            ],
            4,
        ),
    )
    end = d4 - x4
    link4 = joined(
        loft(
            "x",
            [
                (0, 0, 0, 0.16 * s, 0.16 * s),
                (0.6 * end, 0, 0, 0.14 * s, 0.13 * s),
                (end - 0.55 * d6, 0, 0, 0.15 * s, 0.09 * s),
            ],
            3,
        ),
        *(
            joined(
                loft("x", [(end - 0.6 * d6, y * s, 0, 0.025 * s, 0.085 * s), (end, y * s, 0, 0.025 * s, 0.085 * s)], 6),
                cylinder("y", (y - 0.025) * s, (y + 0.025) * s, 0.09 * s, (0, end)),
            )
            for y in (-0.13, 0.13)
        ),
    )
    link5 = joined(
        cylinder("y", -0.10 * s, 0.10 * s, 0.085 * s),
        loft("x", [(0, 0, 0, 0.085 * s, 0.085 * s), (x6 - 0.005, 0, 0, 0.10 * s, 0.10 * s)]),
    )
    link6 = cylinder("x", 0.0, 0.06, 0.12 * s)
    return Arm(
        joints,
        (0.06, 0, 0),
        ("0", "1.5707963267948966", "0"),
        (link0, link1, link2, link3, link4, link5, link6),
        masses,
    )


def cobot_arm(
    *,
    d1: float,
    a2: float,
    a3: float,
    d4: float,
    d5: float,
    d6: float,
    limits_deg: Sequence[tuple[float, float]],
    velocity_deg_s: Sequence[float],
    masses: tuple[float, ...],
) -> Arm:
    """A 6R arm with three parallel axes and offset wrist, stretched along +x at its DH zero.

    Standard DH with a > 0 and every twist of axes 1, 4 and 5 −90°.
    """
    origins = [(0, 0, 0), (0, 0, d1), (a2, 0, 0), (a3, 0, 0), (0, d4, 0), (0, 0, -d5)]
    axes = [(0, 0, 1), (0, 1, 0), (0, 1, 0), (0, 1, 0), (0, 0, -1), (0, -1, 0)]
    joints = tuple(
        Joint(tuple(float(v) for v in o), x, lim, vel)  # type: ignore[arg-type]
        for o, x, lim, vel in zip(origins, axes, limits_deg, velocity_deg_s, strict=True)
    )
    r, upper, fore = 0.050, 0.125, 0.030  # shoulder radius; y of the upper arm's and the forearm's tube
    link0 = joined(cylinder("z", 0.0, 0.015, 0.085), cylinder("z", 0.015, 0.034, 0.065))
    link1 = joined(cylinder("z", 0.036, d1, r), cylinder("y", -r, 0.068, r, (d1, 0)))
    link2 = joined(
        cylinder("y", 0.072, upper + r, r),
        cylinder("x", 0.0, a2, 0.044, (upper, 0)),
        cylinder("y", 0.080, upper + 0.045, 0.050, (0, a2)),
    )
    link3 = joined(
        cylinder("y", fore - 0.045, 0.077, 0.050),
        cylinder("x", 0.0, a3, 0.036, (fore, 0)),
        cylinder("y", fore - 0.040, fore + 0.036, 0.043, (0, a3)),
    )
    link4 = joined(cylinder("y", fore + 0.039, d4 + 0.042, 0.042), cylinder("z", -0.047, 0.045, 0.040, (0, d4)))
    link5 = joined(cylinder("z", -d5 - 0.042, -0.049, 0.040), cylinder("y", -d6 + 0.028, 0.042, 0.040, (-d5, 0)))
    link6 = cylinder("y", -d6, -d6 + 0.026, 0.036)
    return Arm(
        joints, (0, -d6, 0), ("1.5707963267948966", "0", "0"), (link0, link1, link2, link3, link4, link5, link6), masses
    )
