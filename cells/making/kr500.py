"""KR500 milling of a cylinder head, after jiao2022."""

from __future__ import annotations

import trimesh

from making.arms import industrial_arm
from making.cellfiles import CellFiles, block, four
from making.controllers import KUKA
from making.shapes import box, cylinder, joined
from making.spindles import square_spindle

# Solved from Table 2 of jiao2022 (tests/test_shipped_cells.py does it again): the TCP lies 569.15 mm from the wrist
# centre along axis 6 and on it sideways; along the tool axis the table says nothing, 400 mm is our choice.
KR500_REACH_MM = 569.15 - 290.0
KR500_TIP_MM = 400.0
KR500_TOP_MM = (2140.7, -23.5, 300.0 + 884.3 - KR500_TIP_MM)  # middle of the two tags, in world


PROCESS = """\
machopt_process: 1
materials:
  al7075:
    milling: {Ktc: 767, Krc: 169, Kac: 222, Kte: 27.7, Kre: 26.6, Kae: 0.7, spread_percent: 25, h_mm: [0.02, 0.12],
      source: "Chin. J. Mech. Eng. 34 (2021), 10.1186/s10033-021-00536-9, table 5, 7075-T6"}
operations:   # a finishing pass along a wall
  default: {kind: milling, material: al7075, spindle_rpm: 12000, ae_mm: 1, ap_mm: 6, cut: down, surface: side,
    tolerance: {surface_mm: 0.1, reference: relative}}
modes: {damping_percent: 3, source: assumed}
"""


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
  cutter: {{diameter_mm: 17, length_mm: 80, teeth: 2, helix_deg: 30}}""",
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
        accuracy="{absolute_mm: 0.1, repeatability_mm: 0.025, source: assumed}",
        spread="spread_percent: 15\nsource: assumed\n",
        stiffness=(
            "jiao2022, eq. 38 (one set for the whole space), N·mm/rad there",
            "[1.58e7, 6.12e6, 5.28e6, 4.66e5, 2.19e5, 3.49e5]",
        ),
        extra={
            "process.yaml": PROCESS,
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
""",
        },
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
