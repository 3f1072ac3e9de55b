"""A cobot without a spherical wrist: a long cut along a shaft, where the first choice collides nearly everywhere.

Run: ``python benchmarks/cobot_shaft_job.py [--points N] [--keep FOLDER]``. Makes the path (three waves round the top of
the shaft in the shipped cell ``cutting_cobot``, the tool leaning with them), and prints wall time, peak memory and
stages of ``machopt optimize`` as a process, three times: the first run may still compile. The stiffest postures fold
the arm into the trolley, the bench and itself.
"""

from __future__ import annotations

import argparse
import tempfile
from pathlib import Path

import numpy as np
from obstacle_job import timed

CELL = Path(__file__).resolve().parents[1] / "cells" / "cutting_cobot"
POINTS, RUNS = 1000, 3
HALF_LENGTH, HALF_WIDTH, DEPTH = 28.0, 2.0, 0.3  # mm, of the cut on the shaft
LEAN = np.radians(8.0)  # of the tool, to either side
WAVES = 3
CLEAR, NEAR = 22.0, 3.0  # mm above the shaft, of the rapid moves and where they end


def make_path(folder: Path, points: int = POINTS) -> Path:
    """The toolpath, as a CSV in the workpiece's frame."""
    s = np.linspace(0.0, 1.0, points)
    wave = np.sin(2.0 * np.pi * WAVES * s)
    at = np.c_[HALF_LENGTH * (2.0 * s - 1.0), HALF_WIDTH * wave, np.full(points, -DEPTH)]
    axis = np.c_[np.zeros(points), np.sin(LEAN * wave), np.cos(LEAN * wave)]

    def row(k: int, above: float, move: str, feed: str) -> str:
        return ",".join(f"{x:.6f}" for x in (*(at[k] + above * axis[k]), *axis[k])) + f",{move},{feed}"

    rows = [row(0, CLEAR, "rapid", ""), row(0, NEAR, "approach", "300")]
    rows += [row(k, 0.0, "cut", "60") for k in range(points)]
    rows += [row(-1, NEAR, "retract", "300"), row(-1, CLEAR, "rapid", "")]
    out = folder / "along_the_shaft.csv"
    out.write_text("\n".join(["x_mm,y_mm,z_mm,i,j,k,move,feed_mm_min", *rows]) + "\n", encoding="utf-8")
    return out


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--points", type=int, default=POINTS)
    parser.add_argument("--keep", type=Path, help="make the path here and leave it there")
    args = parser.parse_args()
    with tempfile.TemporaryDirectory() as name:
        folder = args.keep or Path(name)
        folder.mkdir(parents=True, exist_ok=True)
        path = make_path(folder, args.points)
        for n in range(RUNS):
            timed(CELL, path, Path(name) / f"out{n}")


if __name__ == "__main__":
    main()
