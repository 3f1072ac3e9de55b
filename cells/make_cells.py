"""Writes the five example cells: URDF, meshes, cell.yaml and stiffness.yaml of each; the READMEs are by hand.

Run ``python cells/make_cells.py [cell …]``. The output is deterministic and committed; edit here, never there.
Link shapes are our own envelopes, drawn from published kinematic dimensions. Lengths in m unless a name says mm.
"""

from __future__ import annotations

import sys
from collections.abc import Callable, Sequence
from dataclasses import dataclass, field
from pathlib import Path

import numpy as np
import trimesh

Array = np.ndarray
Section = tuple[float, float, float, float, float]  # position, centre u, centre v, half-size u, half-size v
HERE = Path(__file__).resolve().parent
ACCELERATION_TIME = 0.35  # s from standstill to the velocity limit; our assumption for all joints
JERK_TIME = 0.14  # s from zero to full acceleration; our assumption


# --- shapes ------------------------------------------------------------------------------------------------


def loft(axis: str, sections: Sequence[Section], power: float = 2.0, n: int = 24) -> trimesh.Trimesh:
    """A closed body through superellipse sections (2: ellipse, 4 and more: box with rounded edges).

    ``u, v`` are the two axes that follow ``axis`` in the cycle x → y → z → x.
    """
    angle = 2 * np.pi * (np.arange(n) + 0.5) / n
    c, s = np.cos(angle), np.sin(angle)
    u, v = np.sign(c) * np.abs(c) ** (2 / power), np.sign(s) * np.abs(s) ** (2 / power)
    rings, caps = [], []
    for position, cu, cv, hu, hv in sections:
        rings.append(np.column_stack([np.full(n, position), cu + hu * u, cv + hv * v]))
    for position, cu, cv, _, _ in (sections[0], sections[-1]):
        caps.append([position, cu, cv])
    vertices = np.vstack([*rings, caps])
    vertices = np.roll(vertices, {"x": 0, "y": 1, "z": 2}[axis], axis=1)
    faces = []
    k = len(sections)
    for r in range(k - 1):
        for i in range(n):
            j = (i + 1) % n
            a, b, c0, d = r * n + i, r * n + j, (r + 1) * n + i, (r + 1) * n + j
            faces += [[a, b, d], [a, d, c0]]
    for i in range(n):
        j = (i + 1) % n
        faces += [[k * n, j, i], [k * n + 1, (k - 1) * n + i, (k - 1) * n + j]]
    return trimesh.Trimesh(vertices, faces, process=False)


def cylinder(
    axis: str, low: float, high: float, radius: float, centre: tuple[float, float] = (0, 0), n: int = 24
) -> trimesh.Trimesh:
    return loft(axis, [(low, *centre, radius, radius), (high, *centre, radius, radius)], n=n)


def box(low: Sequence[float], high: Sequence[float]) -> trimesh.Trimesh:
    mesh = trimesh.creation.box(bounds=[low, high])
    return trimesh.Trimesh(mesh.vertices, mesh.faces, process=False)


def moved(
    mesh: trimesh.Trimesh, xyz: Sequence[float] = (0, 0, 0), rpy_deg: Sequence[float] = (0, 0, 0)
) -> trimesh.Trimesh:
    return trimesh.Trimesh(mesh.vertices @ rpy(rpy_deg).T + np.asarray(xyz), mesh.faces, process=False)


def joined(*parts: trimesh.Trimesh) -> trimesh.Trimesh:
    return trimesh.util.concatenate(list(parts))


def rpy(rpy_deg: Sequence[float]) -> Array:
    r, p, y = np.radians(rpy_deg)
    rx = np.array([[1, 0, 0], [0, np.cos(r), -np.sin(r)], [0, np.sin(r), np.cos(r)]])
    ry = np.array([[np.cos(p), 0, np.sin(p)], [0, 1, 0], [-np.sin(p), 0, np.cos(p)]])
    rz = np.array([[np.cos(y), -np.sin(y), 0], [np.sin(y), np.cos(y), 0], [0, 0, 1]])
    return rz @ ry @ rx


# --- arms --------------------------------------------------------------------------------------------------


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


# --- controllers: what a program must know of them ------------------------------------------------------------

SAME_AXES = """\
  joint_map: {sign: [1, 1, 1, 1, 1, 1], offset_deg: [0, 0, 0, 0, 0, 0]}   # the URDF counts as the controller
  root: {xyz_mm: [0, 0, 0], rpy_deg: [0, 0, 0]}
  flange: {xyz_mm: [0, 0, 0], rpy_deg: [0, 0, 0]}"""
KUKA = f"""\
  post: krl   # tool and base stand in the program itself: no numbers
{SAME_AXES}"""
ABB = f"""\
  post: rapid
{SAME_AXES}"""
UR = f"""\
  post: urscript   # an assumption: README.md
{SAME_AXES}"""
FANUC = """\
  post: fanuc
  joint_map:   # J2 forwards, J3 from the horizontal whatever J2 does, J4 and J6 turn the other way: README.md
    sign: [1, -1, 1, -1, 1, -1]
    offset_deg: [0, 0, 0, 0, 0, 0]
    coupling: {j3: {j2: -1}}
  root: {xyz_mm: [0, 0, 900], rpy_deg: [0, 0, 0]}   # on axis 1 at the height of axis 2
  flange: {xyz_mm: [0, 0, 0], rpy_deg: [0, 0, 180]}
  tool_number: 1
  base_number: 1
  nonflip_j5: negative"""


# --- cells -------------------------------------------------------------------------------------------------


@dataclass(frozen=True)
class CellFiles:
    folder: str
    title: str
    arm: Arm
    base_mm: tuple[float, float, float]
    home_deg: tuple[float, ...]
    tool: str  # YAML of the tool block without geometry
    tool_mesh: trimesh.Trimesh  # in the flange frame
    workpiece_mm: tuple[float, float, float]
    workpiece_rpy: tuple[float, float, float]
    workpiece_mesh: trimesh.Trimesh  # in the CAM frame
    obstacles: tuple[str, ...]
    stiffness: tuple[str, ...]  # comment lines, then the six values as a YAML list
    controller: str  # YAML of the controller
    extra: dict[str, str] = field(default_factory=dict)
    force: str = ""  # YAML of the process force, in path axes


def block(name: str, size_mm: Sequence[float], centre_mm: Sequence[float]) -> str:
    """A box among the obstacles, in world."""
    return f"{{name: {name}, box_mm: {as_list(size_mm)}, xyz_mm: {as_list(centre_mm)}}}"


def four(name: str, size_mm: Sequence[float], centre_mm: Sequence[float], away_mm: tuple[float, float]) -> list[str]:
    """Four boxes about a centre, at ± ``away_mm`` along x and y."""
    signs = [(-1, -1), (-1, 1), (1, -1), (1, 1)]
    cx, cy, cz = centre_mm
    return [
        block(f"{name}_{i}", size_mm, (cx + sx * away_mm[0], cy + sy * away_mm[1], cz))
        for i, (sx, sy) in enumerate(signs, 1)
    ]


def kr500_milling() -> CellFiles:
    arm = industrial_arm(
        a1=0.500,
        d1=1.045,
        a2=1.300,
        offset=0.055,
        d4=1.025,
        d6=0.290,
        upright_zero=False,
        axis_sign=(-1, 1, 1, -1, 1, -1),
        limits_deg=[(-185, 185), (-130, 20), (-94, 150), (-350, 350), (-118, 118), (-350, 350)],
        velocity_deg_s=[84, 79, 75, 81, 79, 124],
        masses=(650, 690, 430, 330, 140, 85, 25),
        size=1.0,
    )
    x, y, z = KR500_TOP_MM  # the head stands on the table 130 mm lower
    return CellFiles(
        folder="kr500_milling",
        title="KR500 milling of a cylinder head (jiao2022)",
        force="{travel: 120, normal: 250, axial: 80}",
        arm=arm,
        base_mm=(0, 0, 300),
        home_deg=(0, -75, 115, 0, -40, 180),
        tool=f"""\
  # paper's tool x is our TCP z; TCP y lies along axis 6, so gamma is the paper's theta_x on a +y pass
  tcp: {{xyz_mm: [{-KR500_TIP_MM:.1f}, 0.0, {KR500_REACH_MM:.2f}], rpy_deg: [90, 0, -90]}}
  mass_kg: 95
  com_mm: [-30, 0, 215]
  cutter: {{diameter_mm: 17, length_mm: 80}}""",
        tool_mesh=square_spindle(KR500_REACH_MM / 1e3, KR500_TIP_MM / 1e3, 0.080, radius=0.092, body=(-0.22, 0.20)),
        workpiece_mm=(x, y, z),
        workpiece_rpy=(0, 0, 90),
        workpiece_mesh=cylinder_head(),
        obstacles=(
            block("pedestal", (1100, 1100, 294), (0, 0, 147)),
            block("table", (1000, 1400, 60), (x, y, z - 160)),
            block("table_stand", (700, 1000, z - 190), (x, y, (z - 190) / 2)),
            *four("clamp", (70, 50, 75), (x, y, z - 92.5), (150, 150)),
        ),
        controller=KUKA,
        stiffness=(
            "jiao2022, eq. 38 (one set for the whole space), N·mm/rad there",
            "[1.58e7, 6.12e6, 5.28e6, 4.66e5, 2.19e5, 3.49e5]",
        ),
        extra={
            "stiffness_two_grid.yaml": f"""\
# jiao2022, eqs. 39 and 40: the 1200 × 600 × 600 mm calibration space (long side along y) in two cubes of 600 mm.
# The paper gives neither the space's origin nor which side is grid 1. Ours is centred on the head's top face,
# y split at the base's x axis plane; grid 1 (eq. 39) is the −y cube.
machopt_stiffness: 1
joints_Nm_per_rad: [1.58e7, 6.12e6, 5.28e6, 4.66e5, 2.19e5, 3.49e5]   # outside the grid: eq. 38
grid:
  origin_mm: [{x - 300:.1f}, -600.0, {z - 300 - 300:.1f}]   # in base_link, 300 mm above world
  cell_mm: 600
  shape: [1, 2, 1]
  joints_Nm_per_rad:
    - [1.48e7, 5.57e6, 6.80e6, 3.38e5, 1.20e5, 2.17e5]   # eq. 39
    - [1.50e7, 6.29e6, 4.56e6, 2.79e5, 3.28e5, 1.61e5]   # eq. 40
"""
        },
    )


# Solved from Table 2 of jiao2022 (tests/test_cells.py does it again): the TCP lies 569.15 mm from the wrist
# centre along axis 6 and on it sideways; along the tool axis the table says nothing, 400 mm is our choice.
KR500_REACH_MM = 569.15 - 290.0
KR500_TIP_MM = 400.0
KR500_TOP_MM = (2140.7, -23.5, 300.0 + 884.3 - KR500_TIP_MM)  # middle of the two tags, in world


def square_spindle(
    reach: float, tip: float, cutter: float, *, radius: float, body: tuple[float, float]
) -> trimesh.Trimesh:
    """A spindle square to the flange: axis parallel to flange −x, ``reach`` in front of the flange face.

    The holder ends 1 mm above the cutter. Flange frame.
    """
    r = radius
    back, front = -body[1], -body[0]  # along the tool axis (= −x), front towards the tip
    nose = tip - cutter - 0.001
    holder = [(front, 0.6 * r), (0.5 * (front + nose), 0.42 * r), (nose, 0.20 * r)]  # position, radius
    along = joined(
        cylinder("x", back, front, r, (0, reach)),
        loft("x", [(p, 0, reach, rr, rr) for p, rr in holder]),
        cylinder("x", back - 0.06, back, 0.55 * r, (0, reach)),
        loft("z", [(0.0, 0, 0, 1.15 * r, 1.15 * r), (0.03, 0, 0, 1.15 * r, 1.15 * r)]),
        loft("z", [(0.03, 0, 0, 0.9 * r, 0.9 * r), (reach - 0.8 * r, 0, 0, 1.2 * r, 0.95 * r)], 5),
    )
    return trimesh.Trimesh(along.vertices * [-1, 1, 1], along.faces[:, ::-1], process=False)


def inline_spindle(offset: float, tip: float, cutter: float, *, radius: float) -> trimesh.Trimesh:
    """A drilling unit whose axis is parallel to axis 6, ``offset`` along flange +x. Flange frame, tip on +z."""
    r, nose = radius, tip - cutter - 0.001
    return joined(
        loft("z", [(0.0, 0, 0, 0.10, 0.10), (0.025, 0, 0, 0.10, 0.10)]),
        loft(
            "z",
            [(0.025, 0.5 * offset, 0, 0.5 * offset + r, 1.1 * r), (0.065, 0.5 * offset, 0, 0.5 * offset + r, 1.1 * r)],
            5,
        ),
        cylinder("z", 0.065, nose - 0.11, r, (offset, 0)),
        loft(
            "z",
            [
                (nose - 0.11, offset, 0, 0.62 * r, 0.62 * r),
                (nose - 0.05, offset, 0, 0.42 * r, 0.42 * r),
                (nose, offset, 0, 0.2 * r, 0.2 * r),
            ],
        ),
    )


def cylinder_head() -> trimesh.Trimesh:
    """460 × 190 × 130 mm; deck (z = 0) with four open chambers 40 mm deep, ports and a foot flange. CAM frame."""
    lx, ly, depth = 0.230, 0.095, 0.040
    ribs = [(-lx, -lx + 0.028)] + [(c - 0.011, c + 0.011) for c in (-0.1035, 0.0, 0.1035)] + [(lx - 0.028, lx)]
    parts = [
        box((-lx, -ly, -0.110), (lx, ly, -depth)),
        box((-lx - 0.02, -ly - 0.02, -0.130), (lx + 0.02, ly + 0.02, -0.110)),
    ]
    parts += [box((-lx, y, -depth), (lx, y + 0.028, 0.0)) for y in (-ly, ly - 0.028)]
    parts += [box((a, -ly + 0.028, -depth), (b, ly - 0.028, 0.0)) for a, b in ribs]
    parts += [
        cylinder("y", sy * ly - 0.001 * sy, sy * (ly + 0.014), 0.021, (-0.072, c))
        if sy > 0
        else cylinder("y", -ly - 0.014, -ly + 0.001, 0.024, (-0.070, c))
        for sy in (-1, 1)
        for c in (-0.155, -0.052, 0.052, 0.155)
    ]
    return joined(*parts)


def panel(half_x: float, half_y: float, radius: float, thickness: float, n: int = 24) -> trimesh.Trimesh:
    """A skin bent about an axis parallel to y; outer face through the CAM origin, which is its crown."""
    angle = np.arcsin(np.linspace(-half_x, half_x, n + 1) / radius)
    outer = np.column_stack([radius * np.sin(angle), radius * np.cos(angle) - radius])
    inner = np.column_stack([(radius - thickness) * np.sin(angle), (radius - thickness) * np.cos(angle) - radius])
    m = n + 1
    vertices = np.array([[p[0], y, p[1]] for y in (-half_y, half_y) for ring in (outer, inner) for p in ring])
    o0, i0, o1, i1 = (lambda k: k), (lambda k: m + k), (lambda k: 2 * m + k), (lambda k: 3 * m + k)
    faces: list[list[int]] = []
    for k in range(n):
        quads = [
            (o0(k), o0(k + 1), o1(k + 1), o1(k)),
            (i0(k), i1(k), i1(k + 1), i0(k + 1)),
            (o0(k), i0(k), i0(k + 1), o0(k + 1)),
            (o1(k), o1(k + 1), i1(k + 1), i1(k)),
        ]
        faces += [[q[a], q[b], q[c]] for q in quads for a, b, c in ((0, 1, 2), (0, 2, 3))]
    for k, flip in ((0, False), (n, True)):
        q = (o0(k), o1(k), i1(k), i0(k))
        q = q[::-1] if flip else q
        faces += [[q[0], q[1], q[2]], [q[0], q[2], q[3]]]
    return trimesh.Trimesh(vertices, faces, process=False)


PANEL_RADIUS, PANEL_HALF = 1.500, (0.340, 0.520)  # m; toolpaths/make_toolpaths.py drills this very surface


def kr240_drilling() -> CellFiles:
    arm = industrial_arm(
        a1=0.350,
        d1=0.750,
        a2=1.250,
        offset=-0.055,
        d4=1.100,
        d6=0.230,
        upright_zero=False,
        axis_sign=(-1, 1, 1, -1, 1, -1),
        limits_deg=[(-185, 185), (-140, 0), (-120, 155), (-350, 350), (-125, 125), (-350, 350)],
        velocity_deg_s=[105, 101, 107, 136, 129, 206],
        masses=(310, 320, 230, 215, 95, 60, 20),
        size=0.8,
    )
    x, z, hx, hy = 1700.0, 850.0, 1e3 * PANEL_HALF[0], 1e3 * PANEL_HALF[1]
    sag = round(1e3 * (PANEL_RADIUS - float(np.sqrt(PANEL_RADIUS**2 - PANEL_HALF[0] ** 2))), 1)
    beam = z - sag - 4 - 50  # centre of the frame's beams, under the skin's edges
    return CellFiles(
        folder="kr240_drilling",
        title="KR240-2 drilling of a curved panel (dumas2011)",
        force="{axial: 250}",
        arm=arm,
        base_mm=(0, 0, 200),
        home_deg=(0, -100, 110, 0, 80, 0),
        tool="""\
  tcp: {xyz_mm: [180, 0, 430], rpy_deg: [0, 0, 0]}
  mass_kg: 48
  com_mm: [110, 0, 165]
  cutter: {diameter_mm: 6, length_mm: 70}""",
        tool_mesh=inline_spindle(0.180, 0.430, 0.070, radius=0.070),
        workpiece_mm=(x, 0, z),
        workpiece_rpy=(0, 0, 0),
        workpiece_mesh=panel(*PANEL_HALF, PANEL_RADIUS, 0.004),
        obstacles=(
            block("pedestal", (900, 900, 194), (0, 0, 97)),
            block("frame_near", (60, 2 * hy + 120, 100), (x - hx + 20, 0, beam)),
            block("frame_far", (60, 2 * hy + 120, 100), (x + hx - 20, 0, beam)),
            block("frame_right", (2 * hx, 60, 80), (x, -hy - 30, beam - 10)),
            block("frame_left", (2 * hx, 60, 80), (x, hy + 30, beam - 10)),
            *four("leg", (80, 80, beam - 50), (x, 0, (beam - 50) / 2), (310, 530)),
            *four("clamp", (40, 60, 90), (x, 0, z - sag), (365, 420)),
        ),
        controller=KUKA,
        stiffness=(
            "Dumas et al. (2011) as cited by Góra and Trela; see README.md",
            "[1.41e6, 4.01e5, 9.35e5, 3.60e5, 3.70e5, 3.80e5]",
        ),
        extra={
            "stiffness_table2.yaml": """\
# dumas2011, Table 2 of the text in hand; see README.md
machopt_stiffness: 1
joints_Nm_per_rad: [3.8e6, 6.6e6, 3.9e6, 5.6e5, 6.6e5, 4.7e5]
"""
        },
    )


def irb6700_drilling() -> CellFiles:
    arm = industrial_arm(
        a1=0.320,
        d1=0.780,
        a2=1.125,
        offset=0.200,
        d4=1.3925,
        d6=0.200,
        upright_zero=True,
        axis_sign=(1, 1, 1, 1, 1, 1),
        limits_deg=[(-170, 170), (-65, 85), (-180, 70), (-300, 300), (-130, 130), (-360, 360)],
        velocity_deg_s=[100, 90, 90, 170, 120, 190],
        masses=(370, 330, 210, 190, 90, 45, 12),
        size=0.72,
    )
    x, z, knee, length = 1650.0, 800.0, 0.130, 0.330  # m: spindle axis meets axis 6 at knee; knee to tip
    c = float(np.sqrt(0.5))
    spindle = joined(
        loft("z", [(0.0, 0, 0, 0.085, 0.085), (0.03, 0, 0, 0.085, 0.085)]),
        loft("z", [(0.03, 0, 0, 0.075, 0.075), (knee, 0.02, 0, 0.062, 0.062)]),
        moved(
            joined(
                cylinder("z", -0.05, length - 0.171, 0.052),
                loft(
                    "z",
                    [
                        (length - 0.171, 0, 0, 0.036, 0.036),
                        (length - 0.10, 0, 0, 0.024, 0.024),
                        (length - 0.071, 0, 0, 0.012, 0.012),
                    ],
                ),
            ),
            (0, 0, knee),
            (0, 45, 0),
        ),
    )
    return CellFiles(
        folder="irb6700_drilling",
        title="IRB 6700 drilling of a plate (zhang2025)",
        force="{axial: 400}",
        arm=arm,
        base_mm=(0, 0, 200),
        home_deg=(0, -10, 20, 0, 35, 0),
        tool=f"""\
  tcp: {{xyz_mm: [{1000 * length * c:.4f}, 0, {1000 * (knee + length * c):.4f}], rpy_deg: [0, 45, 0]}}
  mass_kg: 24
  com_mm: [60, 0, 130]
  cutter: {{diameter_mm: 8, length_mm: 70}}""",
        tool_mesh=spindle,
        workpiece_mm=(x, 0, z),
        workpiece_rpy=(0, 0, 0),
        workpiece_mesh=joined(
            box((-0.25, -0.20, -0.03), (0.25, 0.20, 0.0)),
            box((-0.25, -0.20, -0.08), (-0.21, 0.20, -0.03)),
            box((0.21, -0.20, -0.08), (0.25, 0.20, -0.03)),
        ),
        obstacles=(
            block("pedestal", (900, 900, 194), (0, 0, 97)),
            block("workbench", (800, 1200, 50), (x, 0, z - 105)),
            *four("leg", (80, 80, z - 130), (x, 0, (z - 130) / 2), (340, 540)),
            *four("clamp", (60, 40, 70), (x, 0, z - 45), (230, 222)),
        ),
        controller=ABB,
        stiffness=("zhang2025, section 3 (Table 2 poses), N·m/rad", "[2.61e6, 9.37e5, 6.58e5, 9.20e5, 4.43e4, 2.74e4]"),
    )


def s420f_handling() -> CellFiles:
    arm = industrial_arm(
        a1=0.270,
        d1=0.900,
        a2=0.900,
        offset=0.270,
        d4=1.300,
        d6=0.260,
        upright_zero=True,
        axis_sign=(1, -1, -1, 1, -1, 1),
        limits_deg=[(-150, 150), (-57.5, 57.5), (-72.5, 72.5), (-360, 360), (-125, 125), (-360, 360)],
        velocity_deg_s=[85, 85, 85, 120, 120, 190],
        masses=(420, 380, 240, 260, 110, 60, 15),
        size=0.8,
    )
    x, z = 1600.0, 700.0
    gripper = joined(
        loft("z", [(0.0, 0, 0, 0.095, 0.095), (0.05, 0, 0, 0.095, 0.095)]),
        loft("z", [(0.05, 0.06, 0, 0.15, 0.08), (0.16, 0.06, 0, 0.15, 0.08)], 5),
        *(
            loft("z", [(0.16, 0.15 + d, 0, 0.012, 0.045), (0.30, 0.15 + d, 0, 0.010, 0.030)], 6)
            for d in (-0.045, 0.045)
        ),
    )
    pallet = joined(*(cylinder("z", -0.06, 0.0, 0.045, (u, v), 16) for u in (-0.3, 0.0, 0.3) for v in (-0.3, 0.0, 0.3)))
    return CellFiles(
        folder="s420f_handling",
        title="FANUC S-420F handling of castings (gora-trela)",
        arm=arm,
        base_mm=(0, 0, 100),
        home_deg=(0, 0, 0, 0, -60, 0),
        tool="""\
  tcp: {xyz_mm: [150, 0, 320], rpy_deg: [0, 0, 0]}   # between the fingers, which stop 20 mm short of it
  mass_kg: 38
  com_mm: [60, 0, 120]
""",
        tool_mesh=gripper,
        workpiece_mm=(x, 0, z),
        workpiece_rpy=(0, 0, 0),
        workpiece_mesh=pallet,
        obstacles=(
            block("pedestal", (1000, 1000, 94), (0, 0, 47)),
            block("pallet", (900, 900, 40), (x, 0, z - 80)),
            block("conveyor", (700, 800, z - 100), (x, 0, (z - 100) / 2)),
            "{name: fence_post, cylinder_mm: [60, 2200], xyz_mm: [1300, 1500, 1100]}",
        ),
        controller=FANUC,
        stiffness=(
            "Joints 1 to 3: PUMA 560 ratios (66.23 : 66.50 : 11.61) as in gora-trela, scaled so that the vertical",
            "compliance at its pose is the measured 0.0059 mm/N; joints 4 to 6: those of the KR240-2 (dumas2011),",
            "our assumption. The paper's own sentence on the scale contradicts its measurement: see README.md.",
            "[2.52e6, 2.53e6, 4.42e5, 3.60e5, 3.70e5, 3.80e5]",
        ),
    )


def cutting_cobot() -> CellFiles:
    arm = cobot_arm(
        d1=0.096,
        a2=0.418,
        a3=0.398,
        d4=0.114,
        d5=0.098,
        d6=0.089,
        limits_deg=[(-360, 360), (-265, 85), (-160, 160), (-360, 360), (-360, 360), (-360, 360)],
        velocity_deg_s=[150, 150, 150, 180, 180, 180],
        masses=(3.5, 4.8, 6.2, 3.6, 1.6, 1.6, 0.5),
    )
    x, y, z = 470.0, 110.0, 900.0
    femur = joined(
        loft(
            "x",
            [
                (-0.16, 0, -0.016, 0.014, 0.014),
                (-0.05, 0, -0.015, 0.015, 0.015),
                (0.0, 0, -0.018, 0.023, 0.018),
                (0.035, 0, -0.022, 0.036, 0.022),
            ],
            n=32,
        ),
        *(
            loft(
                "x",
                [
                    (0.015, c, -0.026, 0.010, 0.010),
                    (0.035, c, -0.028, 0.020, 0.024),
                    (0.055, c, -0.030, 0.017, 0.022),
                    (0.066, c, -0.032, 0.008, 0.010),
                ],
                n=24,
            )
            for c in (-0.019, 0.019)
        ),
    )
    return CellFiles(
        folder="cutting_cobot",
        title="Cobot cutting bone (tian2025)",
        arm=arm,
        base_mm=(0, 0, 750),
        home_deg=(0, -110, 105, 13, -90, 90),
        tool="""\
  tcp: {xyz_mm: [-130, 0, 85], rpy_deg: [90, 0, -90]}
  mass_kg: 1.2
  com_mm: [-20, 0, 55]
  cutter: {diameter_mm: 4, length_mm: 60}""",
        tool_mesh=joined(
            cylinder("z", 0.0, 0.032, 0.036), square_spindle(0.085, 0.130, 0.060, radius=0.018, body=(-0.035, 0.075))
        ),
        workpiece_mm=(x, y, z),
        workpiece_rpy=(0, 0, 90),
        workpiece_mesh=femur,
        obstacles=(
            block("trolley", (500, 600, 744), (-60, 0, 372)),
            block("bench", (400, 700, 40), (x + 80, y, z - 160)),
            block("vice", (60, 50, 95), (x, y - 125, z - 92.5)),
        ),
        controller=UR,
        stiffness=("tian2025, Table 3, N·m/rad", "[4.68e5, 5.56e5, 4.57e5, 2.75e5, 9.55e4, 8.36e4]"),
    )


# --- writing -----------------------------------------------------------------------------------------------

LINKS = ("base_link", "link_1", "link_2", "link_3", "link_4", "link_5", "link_6")


def write_urdf(folder: Path, arm: Arm, name: str) -> None:
    lines = ['<?xml version="1.0"?>', f'<robot name="{name}">', "  <!-- made by cells/make_cells.py -->"]
    for i, (link, mesh, mass) in enumerate(zip(LINKS, arm.meshes, arm.masses, strict=True)):
        uniform = mesh.copy()
        uniform.density = mass / uniform.volume
        com, inertia = uniform.center_mass, uniform.moment_inertia
        geometry = f'<geometry><mesh filename="meshes/link{i}.stl"/></geometry>'
        lines += [
            f'  <link name="{link}">',
            f'    <inertial><origin xyz="{com[0]:.4f} {com[1]:.4f} {com[2]:.4f}" rpy="0 0 0"/><mass value="{mass:g}"/>',
            "      <inertia "
            + " ".join(
                f'{k}="{inertia[a, b]:.5g}"'
                for k, a, b in (
                    ("ixx", 0, 0),
                    ("ixy", 0, 1),
                    ("ixz", 0, 2),
                    ("iyy", 1, 1),
                    ("iyz", 1, 2),
                    ("izz", 2, 2),
                )
            )
            + "/></inertial>",
            f"    <visual>{geometry}</visual>",
            f"    <collision>{geometry}</collision>",
            "  </link>",
        ]
    lines += ['  <link name="flange"/>']
    for i, j in enumerate(arm.joints):
        low, high, speed = (f"{np.radians(v):.10f}" for v in (*j.limits_deg, j.velocity_deg_s))
        lines += [
            f'  <joint name="a{i + 1}" type="revolute">',
            f'    <parent link="{LINKS[i]}"/><child link="{LINKS[i + 1]}"/>',
            f'    <origin xyz="{" ".join(f"{v:.6g}" for v in j.origin)}" rpy="0 0 0"/>',
            f'    <axis xyz="{" ".join(str(v) for v in j.axis)}"/>',
            f'    <limit lower="{low}" upper="{high}" velocity="{speed}" effort="0"/>',
            "  </joint>",
        ]
    lines += [
        '  <joint name="flange_fixed" type="fixed">',
        '    <parent link="link_6"/><child link="flange"/>',
        f'    <origin xyz="{" ".join(f"{v:g}" for v in arm.flange_xyz)}" rpy="{" ".join(arm.flange_rpy)}"/>',
        "  </joint>",
        "</robot>",
        "",
    ]
    (folder / "robot.urdf").write_text("\n".join(lines), encoding="utf-8")


def write_cell(cell: CellFiles) -> None:
    folder = HERE / cell.folder
    (folder / "meshes").mkdir(parents=True, exist_ok=True)
    named = {f"link{i}": m for i, m in enumerate(cell.arm.meshes)}
    for name, mesh in {**named, "tool": cell.tool_mesh, "workpiece": cell.workpiece_mesh}.items():
        (folder / "meshes" / f"{name}.stl").write_bytes(trimesh.exchange.stl.export_stl(mesh))
    write_urdf(folder, cell.arm, cell.folder)
    speed = np.array([j.velocity_deg_s for j in cell.arm.joints])
    rows = {
        "velocity_deg_s": speed,
        "acceleration_deg_s2": speed / ACCELERATION_TIME,
        "jerk_deg_s3": speed / ACCELERATION_TIME / JERK_TIME,
    }
    limits = "\n".join(f"    {k}: [{', '.join(f'{v:.4g}' for v in row)}]" for k, row in rows.items())
    tool_head, _, tool_rest = cell.tool.partition("  cutter:")
    obstacles = "\n".join(f"  - {o}" for o in cell.obstacles)
    text = f"""\
# made by cells/make_cells.py; sources of the numbers: README.md
machopt_cell: 1
name: {cell.title}
robot:
  urdf: robot.urdf
  base_link: base_link
  flange_link: flange
  pose: {{xyz_mm: {as_list(cell.base_mm)}, rpy_deg: [0, 0, 0]}}
  arm_joints: [a1, a2, a3, a4, a5, a6]
  external_joints: []
  home_deg: {as_list(cell.home_deg)}
  limits:
{limits}
tool:
{tool_head.rstrip()}
  geometry: [{{name: tool, mesh: meshes/tool.stl}}]
{"  cutter:" + tool_rest if tool_rest else "  # no cutter"}
workpiece:
  link: world
  pose: {{xyz_mm: {as_list(cell.workpiece_mm)}, rpy_deg: {as_list(cell.workpiece_rpy)}}}
  geometry: [{{name: workpiece, mesh: meshes/workpiece.stl}}]
obstacles:
{obstacles}
stiffness: stiffness.yaml
controller:
{cell.controller}
"""
    if cell.force:
        text += f"plan:\n  force_N: {cell.force}  # an assumption: README.md\n"
    (folder / "cell.yaml").write_text(text, encoding="utf-8")
    *source, values = cell.stiffness
    head = "".join(f"# {line}\n" for line in source)
    (folder / "stiffness.yaml").write_text(
        f"{head}machopt_stiffness: 1\njoints_Nm_per_rad: {values}\n", encoding="utf-8"
    )
    for name, content in cell.extra.items():
        (folder / name).write_text(content, encoding="utf-8")


def as_list(values: Sequence[float]) -> str:
    return "[" + ", ".join(f"{v:.6g}" for v in values) + "]"


CELLS: dict[str, Callable[[], CellFiles]] = {
    "kr500_milling": kr500_milling,
    "kr240_drilling": kr240_drilling,
    "irb6700_drilling": irb6700_drilling,
    "s420f_handling": s420f_handling,
    "cutting_cobot": cutting_cobot,
}

if __name__ == "__main__":
    for wanted in sys.argv[1:] or CELLS:
        write_cell(CELLS[wanted]())
        print(HERE / wanted)
