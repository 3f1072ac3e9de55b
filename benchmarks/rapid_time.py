"""Rapid time of the shipped jobs: stops, straight moves, lifts, and what rounding and shortcuts save.

Run: ``python benchmarks/rapid_time.py [--only NAME …]``.

Each shipped job is planned twice in one run, with ``rapid_blend_mm=0`` (an exact stop at every way point) and with the
default. A chain is an unbroken row of rapid moves between two moves at a feed, or from or to home. For each plan:

* rapid time, its share of the cycle, and the cycle time,
* chains, moves (between two points of the file, or a point and home) and stops inside of chains,
* moves that are straight in joint space to 0.01°,
* the median rise of the TCP above the higher end of its chain, in the direction of the tool axis there,
* the share of the rapid time that one straight joint move for every chain would save, collisions aside: a bound for
  what shortcuts can give, because it also leaves out the points that the file asks for,
* processor time of the planning stages (load, write and verify excluded).

Both plans are verified.
"""

from __future__ import annotations

import argparse
import csv
import itertools
import tempfile
import time
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from machopt.cell.cell_reader import load_cell
from machopt.commands.optimize.request import OptimizeRequest
from machopt.commands.optimize.run import run_optimize
from machopt.data_types.cell import Cell
from machopt.data_types.documents.optimize_document import OptimizeDocument
from machopt.kinematics.machine import load_machine
from machopt.kinematics.robot import load_robot
from machopt.numerics.array_types import Array
from machopt.planning.cost.rapid_time import compute_rest_time

ROOT = Path(__file__).resolve().parents[1]
JOBS = {
    "panel_holes": ("kr240_drilling", "panel_holes.aptsource"),
    "cylinder_head_face": ("kr500_milling", "cylinder_head_face.cls"),
    "contour_5axis": ("kr500_milling", "contour_5axis.nc"),
    "plain": ("kr500_milling", "plain.csv"),
    "plate_holes": ("irb6700_drilling", "plate_holes.csv"),
    "castings": ("s420f_handling", "castings.csv"),
    "bone_tracks": ("cutting_cobot", "bone_tracks.csv"),
    "beam_passes": ("kr500_rail", "beam_passes.csv"),
    "drum_holes": ("kr240_turntable", "drum_holes.csv"),
    "two_plates": ("kr240_setups", "two_plates.nc"),
}
STILL = 1e-9  # rad or m between two samples
SLOW = 0.08  # step at a rest over the largest one near by: of a cubic start 2 / 37
STRAIGHT = np.radians(0.01)  # farthest joint from the straight line
SCALE = 0.8  # rapid_scale, the default
VARIANTS = {"stops": ("rapid_blend_mm=0",), "rounded": ()}


@dataclass(frozen=True)
class RapidFigures:
    """What one trajectory does in rapid moves."""

    time: float  # s
    cycle: float  # s
    chains: int
    moves: int
    stops: int  # inside of chains
    straight: int  # of the moves
    rise: float  # m, median over the chains
    direct: float  # s, one straight joint move for each chain

    def __str__(self) -> str:
        saved = 100.0 * (1.0 - self.direct / self.time) if self.time else 0.0
        return (
            f"{self.time:8.2f} {100 * self.time / self.cycle:6.1f} {self.cycle:8.1f} {self.chains:6d} {self.moves:5d} "
            f"{self.stops:5d} {self.straight:8d} {1e3 * self.rise:7.1f} {saved:7.1f}"
        )


def read_motion(folder: Path) -> tuple[Array, Array, list[str], Array]:
    """Return time (S,) s, joints (S, 6 + E) rad or m, moves and toolpath index (S,) of trajectory.csv."""
    with (folder / "trajectory.csv").open(encoding="utf-8") as file:
        rows = list(csv.DictReader(line for line in file if not line.startswith("#")))
    joints = [name for name in rows[0] if name[:1] in "qe" and name.split("_")[0][1:].isdigit()]
    scale = np.array([1e-3 if name.endswith("_mm") else np.pi / 180.0 for name in joints])
    x = np.array([[float(row[name]) for name in joints] for row in rows]) * scale
    return (
        np.array([float(row["time_s"]) for row in rows]),
        x,
        [row["move"] for row in rows],
        np.array([float(row["point"] or "nan") for row in rows]),
    )


def measure(folder: Path, cell: Cell) -> RapidFigures:
    """Return the figures of one output folder."""
    seconds, x, move, point = read_motion(folder)
    rapid = np.array([word == "rapid" for word in move])
    size = np.abs(np.diff(x, axis=0)).max(axis=1)
    moving = size > STILL
    tcp = load_machine(cell, load_robot(cell)).compute_fk(x, cell.tool.T_flange_tcp)
    limits, total, direct, rises = cell.limits, 0.0, 0.0, []
    chains = moves = stops = straight = 0
    inside = moving & rapid[1:]
    edges = np.flatnonzero(np.diff(np.r_[False, rapid[1:], False].astype(int))).reshape(-1, 2)
    for first, stop in edges.tolist():
        steps = np.flatnonzero(inside[first:stop]) + first
        if not len(steps):
            continue
        begin, end = int(steps[0]), int(steps[-1]) + 1
        total += float(inside[begin:end].sum()) * float(seconds[1] - seconds[0])
        chains += 1
        legs, inner = split_moves(point[begin : end + 1], size[begin:end])
        moves += len(legs)
        stops += inner
        straight += sum(is_straight(x[begin + a : begin + b + 1]) for a, b in legs)
        need = np.abs(x[end] - x[begin])
        with np.errstate(divide="ignore"):
            direct += compute_rest_time(
                *(
                    float((need / (SCALE * np.asarray(v))).max())
                    for v in (limits.velocity, limits.acceleration, limits.jerk)
                )
            )
        up = -tcp[begin, :3, 2]
        height = (tcp[begin : end + 1, :3, 3] - tcp[begin, :3, 3]) @ up
        rises.append(float(height.max() - max(height[0], height[-1])))
    return RapidFigures(
        total, float(seconds[-1]), chains, moves, stops, straight, float(np.median(rises)) if rises else 0.0, direct
    )


def split_moves(point: Array, size: Array) -> tuple[list[tuple[int, int]], int]:
    """Return first and last row of each move of a chain, and how many stops are inside.

    Args:
        point: (n,) toolpath index of the rows, NaN from and to home.
        size: (n - 1,) largest joint step between them.
    """
    n = len(point)
    whole = np.isfinite(point) & (np.abs(point - np.round(point)) < 1e-6)
    ends = [k for k in range(1, n - 1) if whole[k] and not (whole[k - 1] and point[k] == point[k - 1])]
    stops = sum(size[k - 1] + size[k] < SLOW * size[max(k - 4, 0) : k + 4].max() for k in ends)
    rows = [0, *ends, n - 1]
    return [*itertools.pairwise(rows)], stops


def is_straight(x: Array) -> bool:
    """Return whether rows (n, J) lie on one line."""
    way = x[-1] - x[0]
    length2 = float(way @ way)
    if length2 == 0.0:
        return True
    share = np.clip((x - x[0]) @ way / length2, 0.0, 1.0)
    return bool(np.abs(x - x[0] - share[:, None] * way).max() < STRAIGHT)


def plan(name: str, folder: Path, overrides: tuple[str, ...]) -> tuple[OptimizeDocument, float]:
    """Return the verified plan and its processor time in s."""
    cell, toolpath = JOBS[name]
    began = time.process_time()
    outcome = run_optimize(
        OptimizeRequest(
            cell=ROOT / "cells" / cell,
            toolpath=ROOT / "toolpaths" / toolpath,
            out=folder,
            overrides=overrides,
            overwrite=True,
        )
    )
    if outcome.exit_code:
        raise SystemExit(f"{name} {overrides}: exit code {outcome.exit_code}: {outcome.result.verdict}")
    return outcome.result, time.process_time() - began


def main() -> None:
    """Print the table."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--only", nargs="+", choices=JOBS, default=list(JOBS))
    parser.add_argument("--variants", nargs="+", choices=VARIANTS, default=list(VARIANTS))
    args = parser.parse_args()
    print(
        f"{'job':20s} {'variant':8s} {'rapid s':>8s} {'share%':>6s} {'cycle s':>8s} {'chains':>6s} {'moves':>5s} "
        f"{'stops':>5s} {'straight':>8s} {'rise mm':>7s} {'direct%':>7s} {'CPU s':>6s}"
    )
    with tempfile.TemporaryDirectory() as text:
        for name in args.only:
            cell = load_cell(ROOT / "cells" / JOBS[name][0])
            for word in args.variants:
                _, cpu = plan(name, Path(text) / "out", VARIANTS[word])
                print(f"{name:20s} {word:8s} {measure(Path(text) / 'out', cell)} {cpu:6.1f}", flush=True)


if __name__ == "__main__":
    main()
