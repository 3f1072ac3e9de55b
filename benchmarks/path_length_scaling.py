"""The whole command at any length: seconds of every stage and peak memory by the number of points.

Run: ``python benchmarks/path_length_scaling.py [POINTS …]`` (default 1000 10000 100000). The path is a spiral over the
shipped KR500 part, five axes, in one cut; up to 10,000 points they lie 2.3 mm apart, beyond that the same path is
divided finer. Each length runs as a process of its own, twice (the first of all also compiles), and the second counts.
Beside the seconds stands how long a plain pinocchio loop would take for the Jacobians and stiffness of as many
configurations as the path has points × 72 rotations × 8 branches, in the same run, so that ratios hold on any machine.
"""

from __future__ import annotations

import json
import os
import resource
import subprocess
import sys
import tempfile
import time
from pathlib import Path

import numpy as np
from optimize_time import ROOT, textbook

LAPS, FINE = 40, 10_000  # laps of the spiral; points above which only their spacing shrinks
CONFIGURATIONS = 72 * 8


def write_path(path: Path, points: int) -> None:
    """A spiral inwards, the axis swaying by 9 degrees."""
    laps = LAPS * min(points, FINE) / FINE
    angle = np.linspace(0.0, laps * 2.0 * np.pi, points)
    inward = 1.0 - 0.6 * angle / angle[-1]
    position = np.c_[180 * inward * np.cos(angle), 70 * inward * np.sin(angle), 6 + 4 * np.sin(3 * angle)]
    axis = np.c_[0.15 * np.cos(angle), 0.15 * np.sin(angle), np.ones(points)]
    axis /= np.linalg.norm(axis, axis=1, keepdims=True)
    rows = ["x_mm,y_mm,z_mm,i,j,k,move,feed_mm_min"]
    for n, move in ((0, "rapid,"), *((n, "cut,1500") for n in range(points)), (points - 1, "rapid,")):
        place = position[n] + 60 * axis[n] if move == "rapid," else position[n]
        rows.append(",".join(f"{v:.6f}" for v in (*place, *axis[n])) + f",{move}")
    path.write_text("\n".join(rows) + "\n", encoding="utf-8")


def main() -> None:
    cell = ROOT / "cells" / "kr500_milling"
    plain = textbook(cell)
    lengths = [int(word) for word in sys.argv[1:]] or [1000, 10_000, 100_000]
    print(f"plain pinocchio loop: {1e6 * plain:.1f} µs a configuration")
    with tempfile.TemporaryDirectory() as name:
        for points in lengths:
            table, out = Path(name) / f"{points}.csv", Path(name) / f"out{points}"
            write_path(table, points)
            command = [
                sys.executable,
                "-m",
                "machopt.cli",
                "optimize",
                str(cell),
                str(table),
                "--quiet",
                "-o",
                str(out),
            ]
            for _ in range(2):
                before = resource.getrusage(resource.RUSAGE_CHILDREN)
                start = time.perf_counter()
                code = subprocess.run(command, env={**os.environ, "PYTHONPATH": str(ROOT)}, check=False).returncode
                wall = time.perf_counter() - start
                after = resource.getrusage(resource.RUSAGE_CHILDREN)
                cpu = after.ru_utime + after.ru_stime - before.ru_utime - before.ru_stime
            stages = json.loads((out / "result.json").read_text(encoding="utf-8"))["timings_s"]
            loop = plain * points * CONFIGURATIONS
            print(
                f"{points} points: exit {code}, {wall:.1f} s wall ({wall / loop:.2f} of the loop), {cpu:.1f} s CPU, "
                f"peak of all so far {after.ru_maxrss / 1024:.0f} MiB"
            )
            print("   " + ", ".join(f"{stage} {seconds:.1f}" for stage, seconds in stages.items()), flush=True)


if __name__ == "__main__":
    main()
