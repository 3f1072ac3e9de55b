"""Two stiffness models of one arm: does the choice of rotation depend on which one is right?

``python docs/examples/compare_stiffness.py OUT``
"""

import sys
from pathlib import Path

import numpy as np

import machopt

ROOT = Path(__file__).resolve().parents[2]


def main(out: Path) -> None:
    folder = ROOT / "cells" / "kr240_drilling"
    first = machopt.Cell.load(folder)
    cells = {"stiffness.yaml": first, "stiffness_table2.yaml": first.with_stiffness(folder / "stiffness_table2.yaml")}
    toolpath = out / "slot.csv"
    out.mkdir(parents=True, exist_ok=True)
    rows = [f"{x},0,{z},0,0,1,{move},600" for x, z, move in [(0, 30, "approach"), (0, -2, "cut"), (80, -2, "cut")]]
    toolpath.write_text("x_mm,y_mm,z_mm,i,j,k,move,feed_mm_min\n" + "\n".join(rows) + "\n")

    force = {"axial": 300, "travel": -200}  # N, on the tool
    plans = {
        name: machopt.optimize(cell, toolpath, force_N=force, rotation_step_deg=15, index="deflection")
        for name, cell in cells.items()
    }
    for name, plan in plans.items():
        joints = np.round(cells[name].joint_stiffness).tolist()
        print(f"{name}: joints {joints} N·m/rad, worst deflection {np.nanmax(plan.deflection):.3f} mm")
        plan.save(out / Path(name).stem)
    a, b = (plan.joints for plan in plans.values())
    print(f"the two plans differ by {np.nanmax(np.abs(a - b)):.1f} deg in a joint")


if __name__ == "__main__":
    main(Path(sys.argv[1]))
