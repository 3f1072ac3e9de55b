"""KR240-2 drilling of a curved panel, after dumas2011."""

from __future__ import annotations

import numpy as np
import trimesh

from making.arms import industrial_arm
from making.cellfiles import CellFiles, block, four
from making.controllers import KUKA
from making.spindles import inline_spindle

PROCESS = """\
machopt_process: 1
quantile: 0.95
materials:
  al7075:   # VDI 3323 group 22; thrust from tables is uncertain by a factor of two, so that the spread is wide
    drilling: {kc1: 800, mc: 0.25, chisel_N_mm2: 300, thrust_spread_percent: 30, torque_spread_percent: 25,
      source: "VDI 3323 group 22; chisel edge and spread assumed"}
operations:
  default:
    kind: drilling   # the spindle speed is that of the CAM file
    layers: [{material: al7075, thickness_mm: 4}]
    depth_mm: 7
    tolerance: {position_mm: 0.3, axis_deg: 0.5, reference: relative}
"""
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
  cutter: {diameter_mm: 6, length_mm: 70, teeth: 2, point_deg: 135, web_mm: 0.9}""",
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
        accuracy="{absolute_mm: 0.1, repeatability_mm: 0.033, source: assumed}",
        spread="spread_percent: 10\nsource: dumas2011 states 2 to 9 %; 10 % assumed\n",
        stiffness=(
            "Dumas et al. (2011) as cited by Góra and Trela; see README.md",
            "[1.41e6, 4.01e5, 9.35e5, 3.60e5, 3.70e5, 3.80e5]",
        ),
        extra={
            "process.yaml": PROCESS,
            "stiffness_table2.yaml": """\
# dumas2011, Table 2 of the text in hand; see README.md
machopt_stiffness: 1
joints_Nm_per_rad: [3.8e6, 6.6e6, 3.9e6, 5.6e5, 6.6e5, 4.7e5]
""",
        },
    )


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
