"""Gain by one and two re-entries in closed contours: deflection, cycle time and planning time.

Run: ``python benchmarks/reentry_gain.py``.

Each job is planned on the shipped milling cell without re-entry, with one and with two (``max_reentries``), with the
default weights and with a tenth of the weights of travel, rotation and feed, where stiffness counts more. Changes are
those against the plan without re-entry of the same weights. Every plan is verified. The jobs are the shipped
``contour_5axis.csv``, a ring and a helix of three turns over the cylinder head, and a rounded square.
"""

from __future__ import annotations

import math
import tempfile
import time
from pathlib import Path

from machopt.commands.optimize.request import OptimizeRequest
from machopt.commands.optimize.run import run_optimize
from machopt.data_types.documents.optimize_document import OptimizeDocument

ROOT = Path(__file__).resolve().parents[1]
CELL = ROOT / "cells" / "kr500_milling"
HEADER = "x_mm,y_mm,z_mm,i,j,k,move,feed_mm_min"
RADIUS_MM, SIDE_MM, FEED_MM_MIN = 80.0, 140.0, 1500
MOST = 2  # re-entries
WEIGHTS = {"default": "", "stiffness": "weights={travel: 0.003, rotation: 0.01, feed: 0.2}"}

Place = tuple[float, float, float]  # mm


def build_ring(turns: int, points: int, pitch_mm: float) -> list[Place]:
    """Points of a circle, or of a helix downwards."""
    angles = [2.0 * math.pi * turns * n / (points - 1) for n in range(points)]
    return [(RADIUS_MM * math.cos(a), RADIUS_MM * math.sin(a), -0.5 - pitch_mm * a / (2.0 * math.pi)) for a in angles]


def build_rounded_square(points: int = 160, power: float = 6.0) -> list[Place]:
    """Points of a superellipse."""
    out = []
    for n in range(points + 1):
        a = 2.0 * math.pi * n / points
        c, s = math.cos(a), math.sin(a)
        r = SIDE_MM / 2.0 / (abs(c) ** power + abs(s) ** power) ** (1.0 / power)
        out.append((r * c, r * s, -0.5))
    return out


def write_job(file: Path, places: list[Place]) -> None:
    """A cut through the places with approach and retract."""
    (x0, y0, _), (x1, y1, _) = places[0], places[-1]
    rows = [
        f"{x0},{y0},60,0,0,1,rapid,",
        f"{x0},{y0},5,0,0,1,approach,1000",
        *(f"{x:.4f},{y:.4f},{z:.4f},0,0,1,cut,{FEED_MM_MIN}" for x, y, z in places),
        f"{x1},{y1},5,0,0,1,retract,1000",
        f"{x1},{y1},60,0,0,1,rapid,",
    ]
    file.write_text("\n".join([HEADER, *rows]) + "\n", encoding="utf-8")


def plan(toolpath: Path, folder: Path, count: int, weights: str) -> tuple[OptimizeDocument, float]:
    """Return the verified plan with at most ``count`` re-entries and its processor time in s."""
    began = time.process_time()
    overrides = (f"max_reentries={count}", *([weights] if weights else []))
    outcome = run_optimize(
        OptimizeRequest(cell=CELL, toolpath=toolpath, out=folder, overrides=overrides, overwrite=True)
    )
    if outcome.exit_code:
        raise SystemExit(f"{toolpath.name} with {count} re-entries: {outcome.result.verdict}")
    return outcome.result, time.process_time() - began


def main() -> None:
    """Print the table."""
    with tempfile.TemporaryDirectory() as text:
        folder = Path(text)
        jobs = {"contour_5axis": ROOT / "toolpaths" / "contour_5axis.csv"}
        for name, places in {
            "ring": build_ring(1, 121, 0.0),
            "helix": build_ring(3, 361, 1.0),
            "rounded_square": build_rounded_square(),
        }.items():
            jobs[name] = folder / f"{name}.csv"
            write_job(jobs[name], places)
        print(
            f"{'job':15s} {'weights':>9s} {'lifts':>5s} {'mean':>8s} {'worst':>8s} {'J':>8s} {'cycle s':>8s} "
            f"{'CPU s':>6s}  points"
        )
        for name, toolpath in jobs.items():
            for word, weights in WEIGHTS.items():
                for count in range(MOST + 1):
                    result, cpu = plan(toolpath, folder / "out", count, weights)
                    entry = result.reentry[0] if result.reentry else None
                    points = list(entry.points) if entry else []
                    mean, worst = (entry.mean_percent, entry.worst_percent) if entry else (0.0, 0.0)
                    print(
                        f"{name:15s} {word:>9s} {len(points):5d} {mean or 0.0:+7.1f}% {worst or 0.0:+7.1f}% "
                        f"{result.objective.chosen.total:8.4f} {result.cycle_time_s:8.1f} {cpu:6.1f}  {points}",
                        flush=True,
                    )


if __name__ == "__main__":
    main()
