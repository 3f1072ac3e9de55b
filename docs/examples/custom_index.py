"""An effect of one's own in the stiffness, and an index of one's own over the plans.

The planner makes its own index small. A criterion that it has not got is put over several of its plans: here the
deflection across the feed, which is what a slot's walls show.

``python docs/examples/custom_index.py OUT``
"""

import sys
from pathlib import Path

import numpy as np

import machopt

ROOT = Path(__file__).resolve().parents[2]
HERE = Path(__file__).resolve().parent
STIFFNESS = """\
machopt_stiffness: 1
joints_Nm_per_rad: [1.41e6, 4.01e5, 9.35e5, 3.60e5, 3.70e5, 3.80e5]
terms:
  - {effect: joint_softening, location: "joint:2", parameters: {extra_rad_per_Nm: 1e-6, half_way_Nm: 800}}
"""


def across(plan: machopt.Plan) -> float:
    """The index: worst compliance across the tool, mm/N."""
    return float(np.nanmax(1.0 / plan.points["k_normal_N_mm"]))


def main(out: Path) -> None:
    out.mkdir(parents=True, exist_ok=True)
    (out / "stiffness.yaml").write_text(STIFFNESS)
    toolpath = out / "slot.csv"
    rows = [f"{x},0,{z},0,0,1,{move},600" for x, z, move in [(0, 30, "approach"), (0, -2, "cut"), (80, -2, "cut")]]
    toolpath.write_text("x_mm,y_mm,z_mm,i,j,k,move,feed_mm_min\n" + "\n".join(rows) + "\n")

    cell = machopt.Cell.load(
        ROOT / "cells" / "kr240_drilling", stiffness=out / "stiffness.yaml", effects=[HERE / "softening.py"]
    )
    plans = {}
    for low in (-180, -60, 60):  # a third of the turn each
        plan = machopt.optimize(cell, toolpath, rotation_range_deg=[low, low + 120], rotation_step_deg=15)
        if plan.feasible:
            plans[low] = plan
    for low, plan in plans.items():
        print(f"rotations from {low} deg: {1e6 * across(plan):.1f} mm/MN across, {plan.cycle_time_s:.1f} s")
    best = min(plans.values(), key=across)
    best.save(out / "best")


if __name__ == "__main__":
    main(Path(sys.argv[1]))
