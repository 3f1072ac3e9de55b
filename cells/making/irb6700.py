"""IRB 6700 drilling of a plate, after zhang2025."""

from __future__ import annotations

import numpy as np

from making.arms import industrial_arm
from making.cellfiles import CellFiles, block, four
from making.controllers import ABB
from making.shapes import box, cylinder, joined, loft, moved


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
  cutter: {{diameter_mm: 8, length_mm: 70, teeth: 2, point_deg: 135, web_mm: 1.2}}""",
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
        accuracy="{absolute_mm: 0.1, repeatability_mm: 0.014, source: assumed}",
        spread="spread_percent: 20\nsource: assumed\n",
        stiffness=("zhang2025, section 3 (Table 2 poses), N·m/rad", "[2.61e6, 9.37e5, 6.58e5, 9.20e5, 4.43e4, 2.74e4]"),
    )
