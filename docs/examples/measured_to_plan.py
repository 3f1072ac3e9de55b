"""From measured load tests to a new plan: identify the stiffness, put it into the cell, plan again.

``python docs/examples/measured_to_plan.py OUT``
"""

import sys
from pathlib import Path

import numpy as np

import machopt

ROOT = Path(__file__).resolve().parents[2]


def main(out: Path) -> None:
    folder = ROOT / "cells" / "irb6700_drilling"
    before = machopt.Cell.load(folder)
    found = machopt.identify(before, folder / "recordings" / "zhang2025_table2", studies=False)
    print(found, np.round(found.joint_stiffness).tolist(), "N·m/rad")
    after = before.with_stiffness(found.save(out / "identified"))

    toolpath = out / "hole.csv"
    rows = ["0,0,20,0,0,1,approach,2000", "0,0,-5,0,0,1,cut,200", "0,0,20,0,0,1,retract,2000"]
    toolpath.write_text("x_mm,y_mm,z_mm,i,j,k,move,feed_mm_min\n" + "\n".join(rows) + "\n")
    for name, cell in (("before", before), ("after", after)):
        plan = machopt.optimize(cell, toolpath, rotation_step_deg=15)
        print(f"{name}: {plan.verdict}, worst deflection {np.nanmax(plan.deflection):.3f} mm")
        plan.save(out / name)


if __name__ == "__main__":
    main(Path(sys.argv[1]))
