"""What a plan loses by choosing at stations and not at every planning point.

Run: ``python benchmarks/station_density.py [shipped|spiral|raster] [--points N] [--times own,1,inf] [--passes N]
[--even N]``.
Plans the same path with the stations of the planner (own), as dense as it has them on a shorter path (1: without the
limit of their number), and twice and four times as dense, and prints the objective of each finished plan, its parts,
and how far it is from the densest one. ``raster --passes 400 --points 10000 --times own,1`` is a path of 65 m. All are
priced by one scale, that of the densest: the median index differs a little with the stations, and J would differ with
it. No files are written.
"""

from __future__ import annotations

import argparse
import resource
import time
from dataclasses import dataclass
from pathlib import Path as File

import numpy as np

from machopt.cell.cell_reader import load_cell
from machopt.data_types.plan_options import PlanOptions
from machopt.data_types.toolpath import Toolpath
from machopt.options.plan_option_reader import load_options
from machopt.planning.cost.objective import AssignmentCosts, compute_objective
from machopt.planning.pipeline.path_planner import plan_path
from machopt.planning.pipeline.plan_data_types import Plan
from machopt.planning.stations import path_station_selection
from machopt.toolpath.toolpath_reader import read_toolpath

ROOT = File(__file__).resolve().parents[1]
CELL = ROOT / "cells" / "kr500_milling"


def spiral(points: int, folder: File) -> File:
    """A spiral over a bent face with a wavy tool axis: 5 turns from the middle outwards."""
    t = np.linspace(0.0, 1.0, points)
    angle = 10.0 * np.pi * np.sqrt(t)
    r = 0.02 + 0.13 * np.sqrt(t)
    x, y = 1e3 * 1.2 * r * np.cos(angle), 1e3 * 0.55 * r * np.sin(angle)
    z = 8.0 + 6.0 * np.cos(x / 60.0)
    axis = np.c_[0.15 * np.sin(x / 60.0), 0.1 * np.sin(y / 40.0), np.ones(points)]
    return written(np.c_[x, y, z], axis, folder / "spiral.csv")


def written(position: np.ndarray, axis: np.ndarray, file: File) -> File:
    """A table of one cut, come to from 60 mm above."""
    axis = axis / np.linalg.norm(axis, axis=1, keepdims=True)
    rows = ["x_mm,y_mm,z_mm,i,j,k,move,feed_mm_min"]
    rows.append(",".join(f"{v:.6f}" for v in (*(position[0] + 60.0 * axis[0]), *axis[0])) + ",rapid,")
    rows += [",".join(f"{v:.6f}" for v in (*p, *a)) + ",cut,1500" for p, a in zip(position, axis, strict=True)]
    file.write_text("\n".join(rows) + "\n", encoding="utf-8")
    return file


def raster(points: int, folder: File, passes: int = 60) -> File:
    """Passes of 160 mm to and fro on a bent face of 90 mm: the force turns over with every pass."""
    per = points // passes
    along = np.linspace(-80.0, 80.0, per)
    x = np.concatenate([along if k % 2 == 0 else along[::-1] for k in range(passes)])
    y = np.repeat(90.0 / passes * np.arange(passes) - 45.0, per)
    z = 8.0 + 6.0 * np.cos(x / 60.0)
    axis = np.c_[0.15 * np.sin(x / 60.0), 0.1 * np.sin(y / 40.0), np.ones(len(x))]
    return written(np.c_[x, y, z], axis, folder / "raster.csv")


@dataclass(frozen=True)
class Density:
    """How the stations are chosen."""

    name: str
    fine: float = 1.0  # times as dense as the planner has it; inf: every planning point; 0: the planner's own
    even: int = 0  # so many at equal distances instead

    def planned(self, toolpath: Toolpath, options: PlanOptions) -> Plan:
        detail, even = path_station_selection._accumulate_detail, self.even
        limits = path_station_selection.ALL_STATIONS, path_station_selection.MAX_STATIONS

        def by_length(position: np.ndarray, axis: np.ndarray, runs: tuple[tuple[int, int], ...]) -> np.ndarray:
            step = np.r_[0.0, np.linalg.norm(np.diff(position, axis=0), axis=1)]
            step[[first for first, _ in runs]] = 0.0
            return np.asarray(np.cumsum(step) / step.sum() * even)

        def finer(position: np.ndarray, axis: np.ndarray, runs: tuple[tuple[int, int], ...]) -> np.ndarray:
            return self.fine * detail(position, axis, runs)

        if self.fine or even:
            path_station_selection.ALL_STATIONS = 10**9 if self.fine == np.inf else 0
            path_station_selection.MAX_STATIONS = 10**9
            path_station_selection._accumulate_detail = by_length if even else finer
        try:
            return plan_path(load_cell(CELL), toolpath, options)
        finally:
            path_station_selection._accumulate_detail = detail
            path_station_selection.ALL_STATIONS, path_station_selection.MAX_STATIONS = limits


def main() -> None:
    import tempfile

    words = argparse.ArgumentParser(description=__doc__)
    words.add_argument("job", choices=("shipped", "spiral", "raster"), nargs="?", default="spiral")
    words.add_argument("--points", type=int, default=10_000)
    words.add_argument(
        "--times", default="1,2,4", help="times as many stations as the planner takes; inf: every point; own"
    )
    words.add_argument("--passes", type=int, default=60, help="of the raster")
    words.add_argument("--even", type=int, default=0, help="also with so many stations at equal distances")
    args = words.parse_args()
    with tempfile.TemporaryDirectory() as folder:
        shipped = ROOT / "toolpaths" / "cylinder_head_face.cls"
        made_by = {
            "shipped": lambda *_: shipped,
            "spiral": spiral,
            "raster": lambda points, folder: raster(points, folder, args.passes),
        }
        file = made_by[args.job](args.points, File(folder))
        toolpath = read_toolpath(file)
    options = load_options(load_cell(CELL).plan, None, [])
    times = sorted(0.0 if t == "own" else float(t) for t in args.times.split(","))
    ways = [Density(f"{t:g} ×" if t else "own", t) for t in times]
    if args.even:
        ways.insert(0, Density(f"{args.even} even", even=args.even))
    rows = []
    for way in ways:
        start = time.perf_counter()
        made = way.planned(toolpath, options)
        rows.append((way.name, made))
        peak = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / 1024
        print(
            f"{way.name}: {len(made.path.stations)} stations of {len(made.path.index)} points, "
            f"{time.perf_counter() - start:.1f} s, up to {peak:.0f} MiB, {made.chosen_from}",
            flush=True,
        )
    scale, best = rows[-1][1].scores.scale, np.nan
    for name, made in reversed(rows):
        a, velocity = made.chosen.assignment, made.setup.cell.limits.velocity[:6]
        costs = AssignmentCosts(cost=made.chosen.cost, q=a.q, phi=a.phi)
        j = compute_objective(made.path, costs, scale, velocity, options)
        best = j.total if np.isnan(best) else best
        print(
            f"{name}, on one scale: J {j.total:.5f} ({100 * (j.total / best - 1):+.2f} %), mean {j.mean:.4f}, "
            f"worst {j.worst:.4f}, travel {j.travel:.4f}, rotation {j.rotation:.4f}, feed {j.feed:.5f}"
        )


if __name__ == "__main__":
    main()
