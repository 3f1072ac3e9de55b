"""FANUC S-420F handling of castings, after gora-trela."""

from __future__ import annotations

from making.arms import industrial_arm
from making.cellfiles import CellFiles, block
from making.controllers import FANUC
from making.shapes import cylinder, joined, loft


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
        accuracy="{absolute_mm: 0.5, repeatability_mm: 0.1, source: assumed}",
        spread="spread_percent: 20\nsource: assumed\n",
        stiffness=(
            "Joints 1 to 3: PUMA 560 ratios (66.23 : 66.50 : 11.61) as in gora-trela, scaled so that the vertical",
            "compliance at its pose is the measured 0.0059 mm/N; joints 4 to 6: those of the KR240-2 (dumas2011),",
            "our assumption. The paper's own sentence on the scale contradicts its measurement: see README.md.",
            "[2.52e6, 2.53e6, 4.42e5, 3.60e5, 3.70e5, 3.80e5]",
        ),
    )
