"""What a rail that moves along is worth, and what it costs: the shipped cell ``kr500_rail``.

    python benchmarks/external.py [--points N] [--only gain|time]

gain: the shipped passes, half as long so that one place of the rail reaches all of them, with one value for each
operation and with the rail moving; both planned in full, rotations every 15°. Goal: the worst deflection 15 % less.
time: ``machopt optimize`` as a process over N cutting points (1,000) of the same passes, rotations every 5°: wall and
processor time, peak memory, stages. Goal: 8 s and 1.5 GiB on two cores of an ordinary machine.
"""

from __future__ import annotations

import argparse
import tempfile
from pathlib import Path

import numpy as np
from crowded import timed

from machopt.formats.cell import load_cell
from machopt.formats.options import load_options
from machopt.formats.toolpath import read_toolpath
from machopt.plan.external import best_plan

CELL = Path(__file__).resolve().parents[1] / "cells" / "kr500_rail"
HALF = 1450.0  # mm, of each pass; the shipped ones are twice as long
LONG = 2900.0


def make_path(folder: Path, points: int, half: float) -> Path:
    """Two weaving passes along the beam, there and back, as a CSV in the workpiece's frame."""
    rows = ["x_mm,y_mm,z_mm,i,j,k,move,feed_mm_min,operation"]
    for name, side in (("pass 1", -1.0), ("pass 2", 1.0)):
        y = np.linspace(-half, half, points // 2)
        tips = [(80.0 * side + 30.0 * float(np.sin(v / 300.0)), -side * float(v)) for v in y]
        ends = ((tips[0], 60.0, "rapid", ""), (tips[0], 5.0, "approach", "2000"))
        rows += [f"{x:.4f},{v:.4f},{z - 1.0:.1f},0,0,1,{move},{feed},{name}" for (x, v), z, move, feed in ends]
        rows += [f"{x:.4f},{v:.4f},-1,0,0,1,cut,3000,{name}" for x, v in tips]
        rows += [f"{tips[-1][0]:.4f},{tips[-1][1]:.4f},59,0,0,1,retract,3000,{name}"]
    out = folder / "passes.csv"
    out.write_text("\n".join(rows) + "\n", encoding="utf-8")
    return out


def gain() -> None:
    """Print mean and worst deflection of either mode."""
    cell = load_cell(CELL)
    with tempfile.TemporaryDirectory() as name:
        path = read_toolpath(make_path(Path(name), 290, HALF))
        found = {}
        for mode in ("operation", "moving"):
            options = load_options(cell.plan, None, ["rotation_step_deg=15", f"external.e1.mode={mode}"])
            plan = best_plan(cell, path, options)
            o, unit = plan.chosen.objective, 1e3 * plan.scores.scale
            found[mode] = (unit * o.mean, unit * o.worst)
            lost = len(plan.missing)
            print(f"{mode:10} J {o.total:.4f}, mean {unit * o.mean:.4f} mm, worst {unit * o.worst:.4f} mm, {lost} lost")
    less = [100.0 * (1.0 - b / a) for a, b in zip(found["operation"], found["moving"], strict=True)]
    print(f"moving: mean {less[0]:.1f} % less, worst {less[1]:.1f} % less")


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--points", type=int, default=1000)
    parser.add_argument("--only", choices=("gain", "time"))
    args = parser.parse_args()
    if args.only != "time":
        gain()
    if args.only != "gain":
        with tempfile.TemporaryDirectory() as name:
            timed(CELL, make_path(Path(name), args.points, LONG), Path(name) / "out")


if __name__ == "__main__":
    main()
