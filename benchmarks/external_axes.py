"""What joints that move along are worth, and what they cost: the shipped cells ``kr500_rail`` and ``kr240_turntable``.

    python benchmarks/external_axes.py [--points N] [--only gain|time|near] [--axes 1|2]

gain: the shipped passes, half as long so that one place of the rail reaches all of them, with one value for each
operation and with the rail moving; both planned in full, rotations every 15°. Goal: the worst deflection 15 % less.
time: ``machopt optimize`` as a process over N cutting points (1,000), rotations every 5°, with one moving joint (the
same passes, the rail) and with two (a groove that winds one and a half times round the drum, tilt and turn of the
table): wall and processor time, peak memory, stages, and in the same run how long a plain pinocchio loop takes for
the Jacobian and stiffness of every point × rotation × branch where the external joints stand at one place: the ratio
holds on any machine. Goals on two cores of an ordinary machine: 8 s with one, 25 s with two, 1.5 GiB.
near (only where it is asked for: some minutes): what ``AS_GOOD`` of
:mod:`machopt.planning.external_axis_optimization.coarse_to_fine_search` and ``UNSURE`` of
:mod:`machopt.planning.external_axis_optimization.refinement_starts` are worth. The shipped jobs of both cells and a
short groove, rotations every 15°, with either number set so that nothing but the best is tried, as it stands, and so
that everything is: J and processor time.
"""

from __future__ import annotations

import argparse
import json
import os
import subprocess
import sys
import tempfile
import time
from pathlib import Path

import numpy as np
from optimize_time import textbook

from machopt.cell.cell_reader import load_cell
from machopt.options.plan_option_reader import load_options
from machopt.planning.external_axis_optimization import coarse_to_fine_search, refinement_starts
from machopt.toolpath.toolpath_reader import read_toolpath

ROOT = Path(__file__).resolve().parents[1]
TOOLPATHS = ROOT / "toolpaths"
CELL, TABLE = ROOT / "cells" / "kr500_rail", ROOT / "cells" / "kr240_turntable"
RADIUS, ROUNDS = 300.0, 1.5  # mm, of the drum; times the groove goes round it
ROTATIONS, BRANCHES = 72, 8
GROOVE = 120  # points of the groove that the thresholds are tried on
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


def make_groove(folder: Path, points: int) -> Path:
    """A groove 1 mm deep that winds round the drum, the tool radial, as a CSV in the workpiece's frame."""
    rows = ["x_mm,y_mm,z_mm,i,j,k,move,feed_mm_min,operation"]

    def row(u: float, out: float, move: str, feed: str) -> str:
        angle, z = np.pi * ROUNDS * (2.0 * u - 1.0), 80.0 + 240.0 * u
        c, s = float(np.cos(angle)), float(np.sin(angle))
        return f"{(RADIUS + out) * c:.4f},{(RADIUS + out) * s:.4f},{z:.4f},{c:.9f},{s:.9f},0,{move},{feed},groove"

    rows += [row(0.0, 60.0, "rapid", ""), row(0.0, 5.0, "approach", "2000")]
    rows += [row(float(u), -1.0, "cut", "2000") for u in np.linspace(0.0, 1.0, points)]
    rows += [row(1.0, 60.0, "retract", "3000")]
    out = folder / "groove.csv"
    out.write_text("\n".join(rows) + "\n", encoding="utf-8")
    return out


def timed(cell: Path, path: Path, out: Path, points: int) -> None:
    """Run ``machopt optimize`` as a process; print time, memory, stages and objective, and the plain loop's time."""
    command = [sys.executable, "-m", "machopt.cli", "optimize", str(cell), str(path), "--quiet", "-o", str(out)]
    start = time.perf_counter()
    done = subprocess.Popen(command, env={**os.environ, "PYTHONPATH": str(ROOT)})
    _, status, used = os.wait4(done.pid, 0)  # its own peak: that of all children would be the greatest so far
    wall = time.perf_counter() - start
    cpu = used.ru_utime + used.ru_stime
    done.returncode = os.waitstatus_to_exitcode(status)
    print(f"exit {done.returncode}, {wall:.2f} s wall, {cpu:.2f} s CPU, peak {used.ru_maxrss / 1024:.0f} MiB")
    result = json.loads((out / "result.json").read_text(encoding="utf-8"))
    print("stages:", ", ".join(f"{k} {v:.2f} s" for k, v in result["timings_s"].items()))
    print(f"objective {result['objective']['chosen']['total']:.5f}; {result['objective']['search']}")
    print(f"cycle time {result['cycle_time_s']:.1f} s; verdict {result['verdict']}")
    plain = textbook(CELL.parent / "kr500_milling") * points * ROTATIONS * BRANCHES
    print(f"a plain pinocchio loop, the joints at one place: {plain:.1f} s; the command takes {cpu / plain:.2f} of it")


def gain() -> None:
    """Print mean and worst deflection of either mode."""
    cell = load_cell(CELL)
    with tempfile.TemporaryDirectory() as name:
        path = read_toolpath(make_path(Path(name), 290, HALF))
        found = {}
        for mode in ("operation", "moving"):
            options = load_options(cell.plan, None, ["rotation_step_deg=15", f"external.e1.mode={mode}"])
            plan = coarse_to_fine_search.find_best_external_axis_plan(cell, path, options)
            o, unit = plan.chosen.objective, 1e3 * plan.scores.scale
            found[mode] = (unit * o.mean, unit * o.worst)
            lost = len(plan.missing)
            print(f"{mode:10} J {o.total:.4f}, mean {unit * o.mean:.4f} mm, worst {unit * o.worst:.4f} mm, {lost} lost")
    less = [100.0 * (1.0 - b / a) for a, b in zip(found["operation"], found["moving"], strict=True)]
    print(f"moving: mean {less[0]:.1f} % less, worst {less[1]:.1f} % less")


def near() -> None:
    """Print J and processor time of three jobs by the two numbers that say what is planned beside the best estimate."""
    good, unsure = coarse_to_fine_search.AS_GOOD, refinement_starts.UNSURE
    trials = [(good, unsure), (1.0, unsure), (np.inf, unsure), (good, 0.0), (good, 1.0)]
    with tempfile.TemporaryDirectory() as name:
        groove = make_groove(Path(name), GROOVE)
        jobs = [(CELL, TOOLPATHS / "beam_passes.csv"), (TABLE, TOOLPATHS / "drum_holes.csv"), (TABLE, groove)]
        for folder, path in jobs:
            cell, toolpath = load_cell(folder), read_toolpath(path)
            options = load_options(cell.plan, None, ["rotation_step_deg=15"])
            for trial in trials:
                coarse_to_fine_search.AS_GOOD, refinement_starts.UNSURE = trial
                start = time.process_time()
                plan = coarse_to_fine_search.find_best_external_axis_plan(cell, toolpath, options)
                spent, lost = time.process_time() - start, len(plan.missing) + len(plan.breaks)
                said = f"AS_GOOD {trial[0]:g}, UNSURE {trial[1]:g}"
                total = plan.chosen.objective.total
                print(f"{path.stem:12} {said}: J {total:.5f}, {lost} lost, {spent:.1f} s CPU", flush=True)
    coarse_to_fine_search.AS_GOOD, refinement_starts.UNSURE = good, unsure


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--points", type=int, default=1000)
    parser.add_argument("--only", choices=("gain", "time", "near"))
    parser.add_argument("--axes", type=int, choices=(1, 2), help="time: with so many moving joints; both by default")
    args = parser.parse_args()
    if args.only == "near":
        near()
    if args.only in (None, "gain"):
        gain()
    if args.only in (None, "time"):
        with tempfile.TemporaryDirectory() as name:
            if args.axes != 2:
                print(f"one moving joint, {args.points} points")
                timed(CELL, make_path(Path(name), args.points, LONG), Path(name) / "out1", args.points)
            if args.axes != 1:
                print(f"two moving joints, {args.points} points")
                timed(TABLE, make_groove(Path(name), args.points), Path(name) / "out2", args.points)


if __name__ == "__main__":
    main()
