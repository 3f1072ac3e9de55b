"""Writes the five example cells: URDF, meshes, cell.yaml, stiffness.yaml and README of each.

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


def cylinder(axis: str, low: float, high: float, radius: float, centre: tuple[float, float] = (0, 0), n: int = 24) -> trimesh.Trimesh:  # fmt: skip
    return loft(axis, [(low, *centre, radius, radius), (high, *centre, radius, radius)], n=n)


def box(low: Sequence[float], high: Sequence[float]) -> trimesh.Trimesh:
    mesh = trimesh.creation.box(bounds=[low, high])
    return trimesh.Trimesh(mesh.vertices, mesh.faces, process=False)


def moved(mesh: trimesh.Trimesh, xyz: Sequence[float] = (0, 0, 0), rpy_deg: Sequence[float] = (0, 0, 0)) -> trimesh.Trimesh:  # fmt: skip
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


def industrial_arm(  # noqa: PLR0913  (the dimensions of a data sheet, each by its own name)
    *, a1: float, d1: float, a2: float, offset: float, d4: float, d6: float,
    upright_zero: bool, axis_sign: tuple[int, ...], limits_deg: Sequence[tuple[float, float]],
    velocity_deg_s: Sequence[float], masses: tuple[float, ...], size: float,
) -> Arm:  # fmt: skip
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
        loft("z", [(0.13 * s, 0, 0, 0.33 * s, 0.30 * s), (max(h - 0.1 * s, 0.2 * s), 0.75 * a1, y * s, 0.22 * s, 0.05 * s)], 4)
        for y in (-0.205, 0.205)
    ]  # fmt: skip
    link1 = joined(cylinder("z", 0.0, 0.15 * s, 0.38 * s), *column, *cheek)
    beam = joined(
        cylinder("y", -0.14 * s, 0.14 * s, 0.22 * s),
        loft("x", [(0, 0, 0, 0.13 * s, 0.20 * s), (0.25 * a2, 0, 0, 0.12 * s, 0.19 * s), (a2, 0, 0, 0.11 * s, 0.14 * s)], 4),
        cylinder("y", -0.12 * s, 0.12 * s, 0.17 * s, (0, a2)),
    )  # fmt: skip
    link2 = moved(beam, rpy_deg=(0, -90, 0)) if upright_zero else beam
    link3 = joined(
        *(cylinder("y", lo * s, hi * s, 0.18 * s) for lo, hi in ((-0.22, -0.13), (0.13, 0.22))),
        loft("x", [(-0.30 * s, 0, offset, 0.18 * s, 0.13 * s), (-0.1 * s, 0, offset, 0.22 * s, 0.19 * s),
                   (0.15 * s, 0, offset, 0.21 * s, 0.20 * s), (x4 - 0.01, 0, offset, 0.17 * s, 0.17 * s)], 4),
    )  # fmt: skip
    end = d4 - x4
    link4 = joined(
        loft("x", [(0, 0, 0, 0.16 * s, 0.16 * s), (0.6 * end, 0, 0, 0.14 * s, 0.13 * s),
                   (end - 0.55 * d6, 0, 0, 0.15 * s, 0.09 * s)], 3),
        *(
            joined(
                loft("x", [(end - 0.6 * d6, y * s, 0, 0.025 * s, 0.085 * s), (end, y * s, 0, 0.025 * s, 0.085 * s)], 6),
                cylinder("y", (y - 0.025) * s, (y + 0.025) * s, 0.09 * s, (0, end)),
            )
            for y in (-0.13, 0.13)
        ),
    )  # fmt: skip
    link5 = joined(
        cylinder("y", -0.10 * s, 0.10 * s, 0.085 * s),
        loft("x", [(0, 0, 0, 0.085 * s, 0.085 * s), (x6 - 0.005, 0, 0, 0.10 * s, 0.10 * s)]),
    )
    link6 = cylinder("x", 0.0, 0.06, 0.12 * s)
    return Arm(joints, (0.06, 0, 0), ("0", "1.5707963267948966", "0"),
               (link0, link1, link2, link3, link4, link5, link6), masses)  # fmt: skip


def cobot_arm(
    *, d1: float, a2: float, a3: float, d4: float, d5: float, d6: float,
    limits_deg: Sequence[tuple[float, float]], velocity_deg_s: Sequence[float], masses: tuple[float, ...],
) -> Arm:  # fmt: skip
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
    return Arm(joints, (0, -d6, 0), ("1.5707963267948966", "0", "0"),
               (link0, link1, link2, link3, link4, link5, link6), masses)  # fmt: skip


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
    readme: str
    extra: dict[str, str] = field(default_factory=dict)


def kr500_milling() -> CellFiles:
    arm = industrial_arm(
        a1=0.500, d1=1.045, a2=1.300, offset=0.055, d4=1.025, d6=0.290,
        upright_zero=False, axis_sign=(-1, 1, 1, -1, 1, -1),
        limits_deg=[(-185, 185), (-130, 20), (-94, 150), (-350, 350), (-118, 118), (-350, 350)],
        velocity_deg_s=[84, 79, 75, 81, 79, 124], masses=(650, 690, 430, 330, 140, 85, 25), size=1.0,
    )  # fmt: skip
    top = KR500_TOP_MM  # underside of the head is 130 mm lower
    x, y, z = top[0] / 1e3, top[1] / 1e3, top[2] / 1e3
    return CellFiles(
        folder="kr500_milling", title="KR500 milling of a cylinder head (jiao2022)", arm=arm,
        base_mm=(0, 0, 300), home_deg=(0, -90, 100, 0, 80, 90),
        tool=f"""\
  # paper's tool x is our TCP z; TCP y lies along axis 6, so gamma is the paper's theta_x on a +y pass
  tcp: {{xyz_mm: [{-KR500_TIP_MM:.1f}, 0.0, {KR500_REACH_MM:.2f}], rpy_deg: [90, 0, -90]}}
  mass_kg: 95
  com_mm: [-30, 0, 215]
  cutter: {{diameter_mm: 17, length_mm: 80}}""",
        tool_mesh=square_spindle(KR500_REACH_MM / 1e3, KR500_TIP_MM / 1e3, 0.080, radius=0.092, body=(-0.22, 0.20)),
        workpiece_mm=top, workpiece_rpy=(0, 0, 90), workpiece_mesh=cylinder_head(),
        obstacles=(
            "{name: pedestal, box_mm: [1100, 1100, 294], xyz_mm: [0, 0, 147]}",
            f"{{name: table, box_mm: [1000, 1400, 60], xyz_mm: [{top[0]:.1f}, {top[1]:.1f}, {top[2] - 160:.1f}]}}",
            f"{{name: table_stand, box_mm: [700, 1000, {top[2] - 190:.1f}], xyz_mm: [{top[0]:.1f}, {top[1]:.1f}, {(top[2] - 190) / 2:.2f}]}}",
            *(
                f"{{name: clamp_{i}, box_mm: [70, 50, 75], xyz_mm: [{top[0] + sx * 150:.1f}, {top[1] + sy * 150:.1f}, {top[2] - 92.5:.1f}]}}"
                for i, (sx, sy) in enumerate([(-1, -1), (-1, 1), (1, -1), (1, 1)], 1)
            ),
        ),
        stiffness=("jiao2022, eq. 38 (one set for the whole space), N·mm/rad there", "[1.58e7, 6.12e6, 5.28e6, 4.66e5, 2.19e5, 3.49e5]"),
        readme=KR500_README,
        extra={"stiffness_two_grid.yaml": f"""\
# jiao2022, eqs. 39 and 40: the 1200 × 600 × 600 mm calibration space (long side along y) in two cubes of 600 mm.
# The paper gives neither the space's origin nor which side is grid 1. Ours is centred on the head's top face,
# y split at the base's x axis plane; grid 1 (eq. 39) is the −y cube.
machopt_stiffness: 1
joints_Nm_per_rad: [1.58e7, 6.12e6, 5.28e6, 4.66e5, 2.19e5, 3.49e5]   # outside the grid: eq. 38
grid:
  origin_mm: [{1000 * x - 300:.1f}, -600.0, {1000 * z - 300 - 300:.1f}]   # in base_link, which stands 300 mm above world
  cell_mm: 600
  shape: [1, 2, 1]
  joints_Nm_per_rad:
    - [1.48e7, 5.57e6, 6.80e6, 3.38e5, 1.20e5, 2.17e5]   # eq. 39
    - [1.50e7, 6.29e6, 4.56e6, 2.79e5, 3.28e5, 1.61e5]   # eq. 40
"""},
    )  # fmt: skip


# Solved from Table 2 of jiao2022 (tests/test_cells.py does it again): the TCP lies 569.15 mm from the wrist
# centre along axis 6 and on it sideways; along the tool axis the table says nothing, 400 mm is our choice.
KR500_REACH_MM = 569.15 - 290.0
KR500_TIP_MM = 400.0
KR500_TOP_MM = (2140.7, -23.5, 300.0 + 884.3 - KR500_TIP_MM)  # middle of the two tags, in world


def square_spindle(reach: float, tip: float, cutter: float, *, radius: float, body: tuple[float, float]) -> trimesh.Trimesh:
    """A spindle square to the flange: axis parallel to flange −x, ``reach`` in front of the flange face.

    The holder ends 1 mm above the cutter. Flange frame.
    """
    r = radius
    back, front = -body[1], -body[0]  # along the tool axis (= −x), front towards the tip
    nose = tip - cutter - 0.001
    holder = [(front, reach, 0, 0.6 * r, 0.6 * r), (0.5 * (front + nose), reach, 0, 0.42 * r, 0.42 * r), (nose, reach, 0, 0.20 * r, 0.20 * r)]
    along = joined(
        cylinder("x", back, front, r, (0, reach)),
        loft("x", [(p, 0, cu, hu, hv) for p, cu, _, hu, hv in holder]),
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
        loft("z", [(0.025, 0.5 * offset, 0, 0.5 * offset + r, 1.1 * r), (0.065, 0.5 * offset, 0, 0.5 * offset + r, 1.1 * r)], 5),
        cylinder("z", 0.065, nose - 0.11, r, (offset, 0)),
        loft("z", [(nose - 0.11, offset, 0, 0.62 * r, 0.62 * r), (nose - 0.05, offset, 0, 0.42 * r, 0.42 * r), (nose, offset, 0, 0.2 * r, 0.2 * r)]),
    )  # fmt: skip


def cylinder_head() -> trimesh.Trimesh:
    """460 × 190 × 130 mm; deck (z = 0) with four open chambers 40 mm deep, ports and a foot flange. CAM frame."""
    lx, ly, depth = 0.230, 0.095, 0.040
    ribs = [(-lx, -lx + 0.028)] + [(c - 0.011, c + 0.011) for c in (-0.1035, 0.0, 0.1035)] + [(lx - 0.028, lx)]
    parts = [box((-lx, -ly, -0.110), (lx, ly, -depth)), box((-lx - 0.02, -ly - 0.02, -0.130), (lx + 0.02, ly + 0.02, -0.110))]
    parts += [box((-lx, y, -depth), (lx, y + 0.028, 0.0)) for y in (-ly, ly - 0.028)]
    parts += [box((a, -ly + 0.028, -depth), (b, ly - 0.028, 0.0)) for a, b in ribs]
    parts += [cylinder("y", sy * ly - 0.001 * sy, sy * (ly + 0.014), 0.021, (-0.072, c)) if sy > 0 else
              cylinder("y", -ly - 0.014, -ly + 0.001, 0.024, (-0.070, c))
              for sy in (-1, 1) for c in (-0.155, -0.052, 0.052, 0.155)]  # fmt: skip
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
        quads = [(o0(k), o0(k + 1), o1(k + 1), o1(k)), (i0(k), i1(k), i1(k + 1), i0(k + 1)),
                 (o0(k), i0(k), i0(k + 1), o0(k + 1)), (o1(k), o1(k + 1), i1(k + 1), i1(k))]  # fmt: skip
        faces += [[q[a], q[b], q[c]] for q in quads for a, b, c in ((0, 1, 2), (0, 2, 3))]
    for k, flip in ((0, False), (n, True)):
        q = (o0(k), o1(k), i1(k), i0(k))
        q = q[::-1] if flip else q
        faces += [[q[0], q[1], q[2]], [q[0], q[2], q[3]]]
    return trimesh.Trimesh(vertices, faces, process=False)


PANEL_RADIUS, PANEL_HALF = 1.500, (0.340, 0.520)  # m; toolpaths/make_toolpaths.py drills this very surface


def kr240_drilling() -> CellFiles:
    arm = industrial_arm(
        a1=0.350, d1=0.750, a2=1.250, offset=-0.055, d4=1.100, d6=0.230,
        upright_zero=False, axis_sign=(-1, 1, 1, -1, 1, -1),
        limits_deg=[(-185, 185), (-140, 0), (-120, 155), (-350, 350), (-125, 125), (-350, 350)],
        velocity_deg_s=[105, 101, 107, 136, 129, 206], masses=(310, 320, 230, 215, 95, 60, 20), size=0.8,
    )  # fmt: skip
    cx, z = 1700.0, 850.0
    hx, hy, sag = 340.0, 520.0, 1500.0 - float(np.sqrt(1500.0**2 - 340.0**2))
    beam_z = z - sag - 4 - 50
    return CellFiles(
        folder="kr240_drilling", title="KR240-2 drilling of a curved panel (dumas2011)", arm=arm,
        base_mm=(0, 0, 200), home_deg=(0, -100, 110, 0, 80, 0),
        tool="""\
  tcp: {xyz_mm: [180, 0, 430], rpy_deg: [0, 0, 0]}
  mass_kg: 48
  com_mm: [110, 0, 165]
  cutter: {diameter_mm: 6, length_mm: 70}""",
        tool_mesh=inline_spindle(0.180, 0.430, 0.070, radius=0.070),
        workpiece_mm=(cx, 0, z), workpiece_rpy=(0, 0, 0), workpiece_mesh=panel(*PANEL_HALF, PANEL_RADIUS, 0.004),
        obstacles=(
            "{name: pedestal, box_mm: [900, 900, 194], xyz_mm: [0, 0, 97]}",
            *(f"{{name: frame_{n}, box_mm: [60, {2 * hy + 120:.0f}, 100], xyz_mm: [{cx + s * (hx - 20):.1f}, 0, {beam_z:.1f}]}}"
              for n, s in (("near", -1), ("far", 1))),
            *(f"{{name: frame_{n}, box_mm: [{2 * hx:.0f}, 60, 80], xyz_mm: [{cx:.1f}, {s * (hy + 30):.1f}, {beam_z - 10:.1f}]}}"
              for n, s in (("right", -1), ("left", 1))),
            *(f"{{name: leg_{i}, box_mm: [80, 80, {beam_z - 50:.1f}], xyz_mm: [{cx + sx * 310:.1f}, {sy * 530:.1f}, {(beam_z - 50) / 2:.2f}]}}"
              for i, (sx, sy) in enumerate([(-1, -1), (-1, 1), (1, -1), (1, 1)], 1)),
            *(f"{{name: clamp_{i}, box_mm: [40, 60, 90], xyz_mm: [{cx + sx * 365:.1f}, {sy * 420:.1f}, {z - sag:.1f}]}}"
              for i, (sx, sy) in enumerate([(-1, -1), (-1, 1), (1, -1), (1, 1)], 1)),
        ),
        stiffness=("Dumas et al. (2011) as cited by Góra and Trela (there misprinted as kN·m/rad); see README.md", "[1.41e6, 4.01e5, 9.35e5, 3.60e5, 3.70e5, 3.80e5]"),
        readme=KR240_README,
        extra={"stiffness_table2.yaml": """\
# dumas2011, Table 2 of the text in hand; see README.md
machopt_stiffness: 1
joints_Nm_per_rad: [3.8e6, 6.6e6, 3.9e6, 5.6e5, 6.6e5, 4.7e5]
"""},
    )  # fmt: skip


def irb6700_drilling() -> CellFiles:
    arm = industrial_arm(
        a1=0.320, d1=0.780, a2=1.125, offset=0.200, d4=1.3925, d6=0.200,
        upright_zero=True, axis_sign=(1, 1, 1, 1, 1, 1),
        limits_deg=[(-170, 170), (-65, 85), (-180, 70), (-300, 300), (-130, 130), (-360, 360)],
        velocity_deg_s=[100, 90, 90, 170, 120, 190], masses=(370, 330, 210, 190, 90, 45, 12), size=0.72,
    )  # fmt: skip
    cx, z, knee, length = 1650.0, 800.0, 0.130, 0.330  # m: spindle axis meets axis 6 at knee; knee to tip
    c = float(np.sqrt(0.5))
    spindle = joined(
        loft("z", [(0.0, 0, 0, 0.085, 0.085), (0.03, 0, 0, 0.085, 0.085)]),
        loft("z", [(0.03, 0, 0, 0.075, 0.075), (knee, 0.02, 0, 0.062, 0.062)]),
        moved(
            joined(
                cylinder("z", -0.05, length - 0.171, 0.052),
                loft("z", [(length - 0.171, 0, 0, 0.036, 0.036), (length - 0.10, 0, 0, 0.024, 0.024), (length - 0.071, 0, 0, 0.012, 0.012)]),
            ),
            (0, 0, knee), (0, 45, 0),
        ),
    )  # fmt: skip
    return CellFiles(
        folder="irb6700_drilling", title="IRB 6700 drilling of a plate (zhang2025)", arm=arm,
        base_mm=(0, 0, 200), home_deg=(0, -10, 20, 0, 35, 0),
        tool=f"""\
  tcp: {{xyz_mm: [{1000 * length * c:.4f}, 0, {1000 * (knee + length * c):.4f}], rpy_deg: [0, 45, 0]}}
  mass_kg: 24
  com_mm: [60, 0, 130]
  cutter: {{diameter_mm: 8, length_mm: 70}}""",
        tool_mesh=spindle,
        workpiece_mm=(cx, 0, z), workpiece_rpy=(0, 0, 0),
        workpiece_mesh=joined(box((-0.25, -0.20, -0.03), (0.25, 0.20, 0.0)), box((-0.25, -0.20, -0.08), (-0.21, 0.20, -0.03)),
                              box((0.21, -0.20, -0.08), (0.25, 0.20, -0.03))),
        obstacles=(
            "{name: pedestal, box_mm: [900, 900, 194], xyz_mm: [0, 0, 97]}",
            f"{{name: workbench, box_mm: [800, 1200, 50], xyz_mm: [{cx:.0f}, 0, {z - 105:.0f}]}}",
            *(f"{{name: leg_{i}, box_mm: [80, 80, {z - 130:.0f}], xyz_mm: [{cx + sx * 340:.0f}, {sy * 540}, {(z - 130) / 2:.0f}]}}"
              for i, (sx, sy) in enumerate([(-1, -1), (-1, 1), (1, -1), (1, 1)], 1)),
            *(f"{{name: clamp_{i}, box_mm: [60, 40, 70], xyz_mm: [{cx + sx * 230:.0f}, {sy * 222}, {z - 45:.0f}]}}"
              for i, (sx, sy) in enumerate([(-1, -1), (-1, 1), (1, -1), (1, 1)], 1)),
        ),
        stiffness=("zhang2025, section 3 (Table 2 poses), N·m/rad", "[2.61e6, 9.37e5, 6.58e5, 9.20e5, 4.43e4, 2.74e4]"),
        readme=IRB6700_README,
    )  # fmt: skip


def s420f_handling() -> CellFiles:
    arm = industrial_arm(
        a1=0.270, d1=0.900, a2=0.900, offset=0.270, d4=1.300, d6=0.260,
        upright_zero=True, axis_sign=(1, -1, -1, 1, -1, 1),
        limits_deg=[(-150, 150), (-57.5, 57.5), (-72.5, 72.5), (-360, 360), (-125, 125), (-360, 360)],
        velocity_deg_s=[85, 85, 85, 120, 120, 190], masses=(420, 380, 240, 260, 110, 60, 15), size=0.8,
    )  # fmt: skip
    cx, z = 1600.0, 700.0
    gripper = joined(
        loft("z", [(0.0, 0, 0, 0.095, 0.095), (0.05, 0, 0, 0.095, 0.095)]),
        loft("z", [(0.05, 0.06, 0, 0.15, 0.08), (0.16, 0.06, 0, 0.15, 0.08)], 5),
        *(loft("z", [(0.16, 0.15 + d, 0, 0.012, 0.045), (0.30, 0.15 + d, 0, 0.010, 0.030)], 6) for d in (-0.045, 0.045)),
    )
    pallet = joined(*(cylinder("z", -0.06, 0.0, 0.045, (x, y), 16) for x in (-0.3, 0.0, 0.3) for y in (-0.3, 0.0, 0.3)))
    return CellFiles(
        folder="s420f_handling", title="FANUC S-420F handling of castings (gora-trela)", arm=arm,
        base_mm=(0, 0, 100), home_deg=(0, 0, 0, 0, -60, 0),
        tool="""\
  tcp: {xyz_mm: [150, 0, 320], rpy_deg: [0, 0, 0]}   # between the fingers, which stop 20 mm short of it
  mass_kg: 38
  com_mm: [60, 0, 120]
""",
        tool_mesh=gripper,
        workpiece_mm=(cx, 0, z), workpiece_rpy=(0, 0, 0), workpiece_mesh=pallet,
        obstacles=(
            "{name: pedestal, box_mm: [1000, 1000, 94], xyz_mm: [0, 0, 47]}",
            f"{{name: pallet, box_mm: [900, 900, 40], xyz_mm: [{cx:.0f}, 0, {z - 80:.0f}]}}",
            f"{{name: conveyor, box_mm: [700, 800, {z - 100:.0f}], xyz_mm: [{cx:.0f}, 0, {(z - 100) / 2:.0f}]}}",
            "{name: fence_post, cylinder_mm: [60, 2200], xyz_mm: [1300, 1500, 1100]}",
        ),
        stiffness=(
            "Joints 1 to 3: PUMA 560 ratios (66.23 : 66.50 : 11.61) as in gora-trela, scaled so that the vertical",
            "compliance at its pose is the measured 0.0059 mm/N; joints 4 to 6: those of the KR240-2 (dumas2011),",
            "our assumption. The paper's own sentence on the scale contradicts its measurement: see README.md.",
            "[2.52e6, 2.53e6, 4.42e5, 3.60e5, 3.70e5, 3.80e5]",
        ),
        readme=S420F_README,
    )  # fmt: skip


def cutting_cobot() -> CellFiles:
    arm = cobot_arm(
        d1=0.096, a2=0.418, a3=0.398, d4=0.114, d5=0.098, d6=0.089,
        limits_deg=[(-360, 360), (-265, 85), (-160, 160), (-360, 360), (-360, 360), (-360, 360)],
        velocity_deg_s=[150, 150, 150, 180, 180, 180], masses=(3.5, 4.8, 6.2, 3.6, 1.6, 1.6, 0.5),
    )  # fmt: skip
    cx, cy, z = 470.0, 110.0, 900.0
    femur = joined(
        loft("x", [(-0.16, 0, -0.016, 0.014, 0.014), (-0.05, 0, -0.015, 0.015, 0.015), (0.0, 0, -0.018, 0.023, 0.018),
                   (0.035, 0, -0.022, 0.036, 0.022)], n=32),
        *(loft("x", [(0.015, y, -0.026, 0.010, 0.010), (0.035, y, -0.028, 0.020, 0.024), (0.055, y, -0.030, 0.017, 0.022),
                     (0.066, y, -0.032, 0.008, 0.010)], n=24) for y in (-0.019, 0.019)),
    )  # fmt: skip
    return CellFiles(
        folder="cutting_cobot", title="Cobot cutting bone (tian2025)", arm=arm,
        base_mm=(0, 0, 750), home_deg=(0, -110, 105, 13, -90, 90),
        tool="""\
  tcp: {xyz_mm: [-130, 0, 85], rpy_deg: [90, 0, -90]}
  mass_kg: 1.2
  com_mm: [-20, 0, 55]
  cutter: {diameter_mm: 4, length_mm: 60}""",
        tool_mesh=joined(cylinder("z", 0.0, 0.032, 0.036), square_spindle(0.085, 0.130, 0.060, radius=0.018, body=(-0.035, 0.075))),
        workpiece_mm=(cx, cy, z), workpiece_rpy=(0, 0, 90), workpiece_mesh=femur,
        obstacles=(
            "{name: trolley, box_mm: [500, 600, 744], xyz_mm: [-60, 0, 372]}",
            f"{{name: bench, box_mm: [400, 700, 40], xyz_mm: [{cx + 80:.0f}, {cy:.0f}, {z - 160:.0f}]}}",
            f"{{name: vice, box_mm: [60, 50, 95], xyz_mm: [{cx:.0f}, {cy - 125:.0f}, {z - 92.5:.1f}]}}",
        ),
        stiffness=("tian2025, Table 3, N·m/rad", "[4.68e5, 5.56e5, 4.57e5, 2.75e5, 9.55e5, 8.36e4]"),
        readme=COBOT_README,
    )  # fmt: skip


ASSUMED = """
Assumptions of ours, not published data: every mesh (envelopes drawn around the published axes, not the maker's
CAD), link masses and inertias (split of the arm's data-sheet mass), tool, workpiece, fixture, accelerations
(velocity limit reached in 0.35 s) and jerks (full acceleration reached in 0.14 s). Joint ranges and velocities are
from the maker's data sheet as we remember it, not looked up: replace them by your robot's before cutting metal.

Made by `python cells/make_cells.py`; change that script, not these files.
"""

KR500_README = """\
# KR500 milling

The robot and stiffness of Jiao et al., "Variable Stiffness Identification and Configuration Optimization of
Industrial Robots for Machining Tasks" (2022), milling the deck of a cylinder head.

| number | source |
|---|---|
| 500, 1045, 1300, 1025, 290 mm | KUKA KR 500-2 data sheet (reach class R2830), from memory, and confirmed by Table 2 below |
| axis 4 lies 55 mm **above** the elbow axis while the forearm points forward | Table 2: −55 leaves 50 mm, +55 leaves 0.04 mm |
| TCP 569.15 mm from the wrist centre along axis 6, 0 sideways; tool axis square to axis 6 | solved from Table 2 |
| joint stiffness | eq. 38 (N·mm/rad there); `stiffness_two_grid.yaml`: eqs. 39, 40 |
| cutter 17 mm, 2 teeth | Table 3 of the paper |

Table 2 gives each of two tags in two configurations. With the geometry above each pair is one TCP to 0.06 mm
and turned about the tool axis by 110.003° and 70.000° (stated: 110° and 70°); `tests/test_cells.py` checks it.
The tags come out at (2140.9, −191.2) and (2140.5, 144.2) mm in base_link, tool pointing straight down.
The TCP frame is turned so that gamma equals the paper's θx on a pass from Tag 1 to Tag 2.

Table 2 says nothing of how far the tip stands out along the tool axis, and the axial stiffness of the paper does not
depend on it either: 400 mm from axis 6 is our choice. It puts the tags on the head's deck (CAM z = 0), on its
centre line. The grid's origin is ours too: two 600 mm cubes about the deck's centre, split at y = 0 of base_link,
eq. 39 on the −y side. With the paper's axial index (its eqs. 15–23) and eq. 38 this geometry gives 1791, 4819,
1989 and 4819 N/mm where Table 2 has 1717, 4061, 1761 and 4047 from an unpublished finer grid.
""" + ASSUMED

KR240_README = """\
# KR240-2 drilling

The robot of Dumas et al., "Joint stiffness identification of industrial serial robots" (2011), drilling a skin panel
(radius 1500 mm, 680 × 1040 mm, 4 mm thick). The spindle is parallel to axis 6 and 180 mm beside it.

| number | source |
|---|---|
| 350, 750, 1250, 1100, 230 mm; axis 4 lies 55 mm below the elbow axis (forearm forward) | KUKA KR 240-2 data sheet, from memory; the paper leaves d2, d3, d4, RL4, RL6 as symbols and gives a reach of 2700 mm = 350 + 1250 + 1100 |
| 1.41e6, 4.01e5, 9.35e5, 3.60e5, 3.70e5, 3.80e5 N·m/rad | Dumas et al. (2011), as cited by Góra and Trela (who print kN·m for MN·m) |

The text of the paper that we have prints other values (its Table 2: 3.8e6, 6.6e6, 3.9e6, 5.6e5, 6.6e5, 4.7e5 N·m/rad,
errors of 2 to 9 %), which `stiffness_table2.yaml` holds; the values above are the ones other papers cite under its name.
""" + ASSUMED

IRB6700_README = """\
# IRB 6700 drilling

The robot of Zhang et al., "Global stiffness modeling of robot drilling system …" (Machines 2025, 13, 837), with a
spindle at 45° to axis 6, drilling a plate on a workbench.

| number | source |
|---|---|
| 780, 320, 1125, 200, 1393, 200 mm | Table 1 (modified DH); 1392.5 instead of the rounded 1393 |
| signs of the twists (±90°) | lost in the text; taken from the arm's shape: forearm axis 200 mm above the elbow |
| joint zero and signs | ABB's: upper arm upright and forearm forward at zero |
| joint stiffness | section 3 of the paper |

The paper's link 4 flexibility and spindle beam are not in this cell. Its loads are printed as N·m with magnitudes
(1e5) that can only be N·mm.
""" + ASSUMED

S420F_README = """\
# FANUC S-420F handling

The robot of Góra and Trela, "Stiffness matrix of manipulator FANUC S-420F", with a gripper over a pallet of
castings. No cutter: the cell shows handling and mapping.

| number | source |
|---|---|
| 270, 900, 270, 1300, 260 mm; joint ranges | Table 1 (λ1 = 0: the table starts at axis 2; 900 mm from the floor to axis 2 is our assumption) |
| q2 = θ2 − 90°, so that the ranges ±57.5° and ±72.5° are about the upright arm | our reading of Table 1 |
| joint stiffness 1 to 3 | measured vertical compliance 0.0059 mm/N and the ratios of the PUMA 560 |
| joint stiffness 4 to 6 | KR240-2, our assumption |

Where the paper contradicts itself:
- It concludes that the S-420F is about three times **stiffer** than the PUMA 560, but its measured stiffness
  (169.5 N/mm) is three times **less** than the one it computes with PUMA values (546.6 N/mm).
- That computed value does not follow from its inputs: with 66.5 and 11.61 kN·m/rad and levers of 1.8 and 1.4 m the
  vertical compliance is 0.22 mm/N, not 0.00183 mm/N. We scale joints 1 to 3 to the measurement (× 38).
- The KR240-2 values are cited in kN·m/rad (1.410); they are MN·m/rad.
- The stated tool position (279.85, 2751.95, 145.14) is 2766 mm from axis 1; its own joint angles with Table 1 give
  2026 to 2078 mm, on the other side (y < 0).
""" + ASSUMED

COBOT_README = """\
# Cobot cutting bone

The arm of Tian et al., "Comprehensive stiffness modeling and evaluation of an orthopedic surgical robot …"
(Biomimetics 2025, 10, 383): three parallel axes, offset wrist, **no spherical wrist**. A bur square to the flange
mills a femur-like piece in a vice.

| number | source |
|---|---|
| d 96, 0, 0, 114, 98, 89 mm; a 0, 418, 398, 0, 0, 0 mm | Table 5 (the text runs index and value together: row "1960" is i = 1, d = 96, a = 0); 418, 398, 114, 98, 89 stand in the text as well |
| twists −90, 0, 0, −90, −90, 0 degrees with a > 0 | signs are lost in the text; equal signs as printed are the choice that raises the arm and points the tool down at all five poses of Table 1 |
| joint stiffness | Table 3 |
| joint ranges and velocities | typical of the class, our assumption |

Where the paper contradicts itself: the displacements of its Tables 2 and 4 (0.2 to 1 mm under 10 to 35 N) are some
thirty times what the stiffness of Table 3 gives (about 1000 N/mm, as its Tables 7 and 8 measure); the workspace radius
of 650 mm is less than 418 + 398; the dexterity of Table 1 follows from no choice of signs we tried.
""" + ASSUMED

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
            "      <inertia " + " ".join(f'{k}="{inertia[a, b]:.5g}"' for k, a, b in
                                         (("ixx", 0, 0), ("ixy", 0, 1), ("ixz", 0, 2), ("iyy", 1, 1), ("iyz", 1, 2), ("izz", 2, 2)))
            + "/></inertial>",
            f"    <visual>{geometry}</visual>",
            f"    <collision>{geometry}</collision>",
            "  </link>",
        ]  # fmt: skip
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
        f'    <parent link="link_6"/><child link="flange"/><origin xyz="{" ".join(f"{v:g}" for v in arm.flange_xyz)}" rpy="{" ".join(arm.flange_rpy)}"/>',
        "  </joint>", "</robot>", "",
    ]  # fmt: skip
    (folder / "robot.urdf").write_text("\n".join(lines), encoding="utf-8")


def write_cell(cell: CellFiles) -> None:
    folder = HERE / cell.folder
    (folder / "meshes").mkdir(parents=True, exist_ok=True)
    named = {f"link{i}": m for i, m in enumerate(cell.arm.meshes)}
    for name, mesh in {**named, "tool": cell.tool_mesh, "workpiece": cell.workpiece_mesh}.items():
        (folder / "meshes" / f"{name}.stl").write_bytes(trimesh.exchange.stl.export_stl(mesh))
    write_urdf(folder, cell.arm, cell.folder)
    speed = np.array([j.velocity_deg_s for j in cell.arm.joints])
    rows = {"velocity_deg_s": speed, "acceleration_deg_s2": speed / ACCELERATION_TIME,
            "jerk_deg_s3": speed / ACCELERATION_TIME / JERK_TIME}  # fmt: skip
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
"""
    (folder / "cell.yaml").write_text(text, encoding="utf-8")
    *source, values = cell.stiffness
    head = "".join(f"# {line}\n" for line in source)
    (folder / "stiffness.yaml").write_text(f"{head}machopt_stiffness: 1\njoints_Nm_per_rad: {values}\n", encoding="utf-8")
    (folder / "README.md").write_text(cell.readme, encoding="utf-8")
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
