"""A cell of your own from a robot's URDF: write it, look at it, plan in it.

``python docs/examples/own_cell.py OUT``
"""

import sys
from pathlib import Path

import machopt

ROOT = Path(__file__).resolve().parents[2]
HOLES = [(x, y) for x in (0, 60, 120) for y in (0, 80)]  # mm


def main(out: Path) -> None:
    toolpath = out / "holes.csv"
    out.mkdir(parents=True, exist_ok=True)
    rows = ["x_mm,y_mm,z_mm,i,j,k,move,feed_mm_min"]
    for x, y in HOLES:
        rows += [f"{x},{y},20,0,0,1,rapid,", f"{x},{y},-8,0,0,1,cut,200", f"{x},{y},20,0,0,1,retract,2000"]
    toolpath.write_text("\n".join(rows) + "\n")

    robot = ROOT / "cells" / "kr240_drilling" / "robot.urdf"  # yours here
    cell = machopt.Cell.new(robot, out / "cell", toolpath=toolpath, tool_length_mm=320, tool_mass_kg=40, post="krl")
    print(cell, "home", cell.home)
    for finding in cell.validate(picture=out / "cell.svg"):  # errors first
        print(f"{finding.level}: {finding.where} {finding.text}")

    plan = machopt.optimize(cell, toolpath, rotation_step_deg=15)
    print(f"{plan.verdict}; cycle {plan.cycle_time_s:.1f} s; verified: {plan.verify().ok}")
    print("softest point:", plan.points["k_axial_N_mm"].min(), "N/mm along the tool")
    plan.figures.map().save(out / "map.svg")
    plan.save(out / "plan")


if __name__ == "__main__":
    main(Path(sys.argv[1]))
