"""Rapid time of the shipped jobs: stops, straight moves, lifts, and what rounding and shortcuts save.

Run: ``python benchmarks/rapid_time.py [--only NAME …]``.

Each shipped job is planned twice in one run, with ``rapid_blend_mm=0`` (an exact stop at every way point) and with the
default. A chain is an unbroken row of rapid moves between two moves at a feed, or from or to home. For each plan:

* rapid time, its share of the cycle, and the cycle time,
* chains (none over a tool change), moves (between two points of the file, or a point and home), stops inside of chains,
* moves that are straight in joint space to 0.01°,
* the median rise of the TCP above the higher end of its chain, in the direction of the tool axis there,
* the time of one straight joint move between any two places where the machine has to stop: the ends of a chain, and
  points at which the file acts. Collisions and the points of the file are left out, so that it is a bound,
* what rounding and shortcuts save, and which share of what that bound would save,
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

from machopt.commands.optimize.request import OptimizeRequest, load_optimize_inputs
from machopt.commands.optimize.run import run_optimize
from machopt.data_types.cell import Cell
from machopt.data_types.documents.optimize_document import OptimizeDocument
from machopt.kinematics.machine import load_machine
from machopt.kinematics.urdf_loading import load_robot
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
LEAST_SAVING = 2.0  # % that the bound would save; below, a share of it means nothing
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
    direct: float  # s, one straight joint move between any two places where the machine has to stop

    def __str__(self) -> str:
        return (
            f"{self.time:8.2f} {100 * self.time / self.cycle:6.1f} {self.cycle:8.1f} {self.chains:6d} {self.moves:5d} "
            f"{self.stops:5d} {self.straight:8d} {1e3 * self.rise:7.1f} {self.direct:8.2f}"
        )

    def compare(self, before: RapidFigures) -> str:
        """Return what is saved of the time before, what the bound would save, and the share of it, %."""
        saved, most = (100.0 * (1.0 - time / before.time) for time in (self.time, before.direct))
        share = f"{100.0 * saved / most:.0f}" if most > LEAST_SAVING else "-"
        return f"saved {saved:.1f} %, bound {most:.1f} %, reached {share} %"


def read_motion(folder: Path) -> tuple[Array, Array, list[str], Array, list[str]]:
    """Return time (S,) s, joints (S, 6 + E) rad or m, moves, toolpath index and tool (S,) of trajectory.csv."""
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
        [row.get("tool", "") for row in rows],
    )


def measure(folder: Path, cell: Cell, acting: frozenset[int]) -> RapidFigures:
    """Return the figures of one output folder; the file acts at some points."""
    seconds, x, move, point, tool = read_motion(folder)
    rapid = np.array([word == "rapid" for word in move])
    changes = np.r_[False, [a != b for a, b in itertools.pairwise(tool)]]
    size = np.abs(np.diff(x, axis=0)).max(axis=1)
    moving = size > STILL
    tcp = load_machine(cell, load_robot(cell)).compute_fk(x, cell.tool.T_flange_tcp)
    limits, total, direct, rises = cell.limits, 0.0, 0.0, []
    chains = moves = stops = straight = 0
    inside = moving & rapid[1:]
    edges = np.flatnonzero(np.diff(np.r_[False, rapid[1:], False].astype(int))).reshape(-1, 2)
    pieces = [
        pair
        for first, stop in edges.tolist()
        for pair in itertools.pairwise([first, *(first + np.flatnonzero(changes[first + 1 : stop]) + 1).tolist(), stop])
    ]
    for first, stop in pieces:
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
        inside_stops = [begin + b for _, b in legs[:-1] if point[begin + b] in acting]
        for a, b in itertools.pairwise([begin, *inside_stops, end]):
            need = np.abs(x[b] - x[a])
            bounds = (limits.velocity, limits.acceleration, limits.jerk)
            direct += compute_rest_time(*(float((need / (SCALE * np.asarray(v))).max()) for v in bounds))
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


def build_request(name: str, folder: Path, overrides: tuple[str, ...]) -> OptimizeRequest:
    """Return the request of a job."""
    cell, toolpath = JOBS[name]
    return OptimizeRequest(
        cell=ROOT / "cells" / cell,
        toolpath=ROOT / "toolpaths" / toolpath,
        out=folder,
        overrides=overrides,
        overwrite=True,
    )


def plan(name: str, folder: Path, overrides: tuple[str, ...]) -> tuple[OptimizeDocument, float]:
    """Return the verified plan and its processor time in s."""
    began = time.process_time()
    outcome = run_optimize(build_request(name, folder, overrides))
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
        f"{'stops':>5s} {'straight':>8s} {'rise mm':>7s} {'bound s':>8s} {'CPU s':>6s}"
    )
    with tempfile.TemporaryDirectory() as text:
        for name in args.only:
            given = load_optimize_inputs(build_request(name, Path(text) / "out", ()))
            acting = frozenset(event.index - 1 for event in given.toolpath.events if event.kind != "comment")
            found: dict[str, RapidFigures] = {}
            for word in args.variants:
                _, cpu = plan(name, Path(text) / "out", VARIANTS[word])
                found[word] = measure(Path(text) / "out", given.cell, acting)
                print(f"{name:20s} {word:8s} {found[word]} {cpu:6.1f}", flush=True)
            if len(found) == len(VARIANTS):
                print(f"{name:20s} {found['rounded'].compare(found['stops'])}", flush=True)


if __name__ == "__main__":
    main()
