"""A cobot cutting bone, after tian2025."""

from __future__ import annotations

from making.arms import cobot_arm
from making.cellfiles import CellFiles, block
from making.controllers import UR
from making.shapes import cylinder, joined, loft
from making.spindles import square_spindle


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
  cutter: {diameter_mm: 4, length_mm: 60, teeth: 2, helix_deg: 30}""",
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
        accuracy="{absolute_mm: 0.2, repeatability_mm: 0.014, source: assumed}",
        spread="spread_percent: 20\nsource: assumed\n",
        stiffness=("tian2025, Table 3, N·m/rad", "[4.68e5, 5.56e5, 4.57e5, 2.75e5, 9.55e4, 8.36e4]"),
    )
