"""A job where half of the free choice collides: 1,500 cutting points between tall posts close to the part.

Run: ``python benchmarks/obstacle_job.py [--points N] [--keep FOLDER]``. Makes the job (the shipped KR500 cell with four
tall posts round its workpiece, and a five-axis contour over it: what is free wanders along it, and no rotation is free
all along), counts on an even sample which share of the configurations within reach, limits and margins collides, and
prints wall time, peak memory and stages of ``machopt optimize`` as a process.
"""

from __future__ import annotations

import argparse
import json
import os
import resource
import shutil
import subprocess
import sys
import tempfile
import time
from pathlib import Path

import numpy as np

ROOT = Path(__file__).resolve().parents[1]
POINTS = 1500
SAMPLE = 4000  # configurations checked for the share that collides
WAVES = 7  # of the contour's height and lean
CENTRE = (2140.7, -23.5)  # mm, of the workpiece in world

POSTS = (40.0, 130.0, 220.0, 310.0)  # deg round the workpiece, from world x
ROUND = 340.0  # mm, of the posts from its centre
SIZE = (50.0, 50.0, 560.0)  # mm, of a post
TABLE = 654.3  # mm, its top in world


def make_job(folder: Path, points: int = POINTS) -> tuple[Path, Path]:
    """Cell and toolpath."""
    from ruamel.yaml import YAML

    cell = folder / "cell"
    shutil.copytree(ROOT / "cells" / "kr500_milling", cell)
    yaml = YAML()
    data = yaml.load(cell / "cell.yaml")
    for n, angle in enumerate(np.radians(POSTS)):
        centre = [CENTRE[0] + ROUND * np.cos(angle), CENTRE[1] + ROUND * np.sin(angle), TABLE + SIZE[2] / 2]
        post = {"name": f"post_{n}", "box_mm": list(SIZE), "xyz_mm": [round(float(v), 1) for v in centre]}
        data["obstacles"].append(post)
    yaml.dump(data, cell / "cell.yaml")
    angle = np.linspace(0, 2 * np.pi, points)
    position = np.c_[120 * np.cos(angle), 60 * np.sin(angle), 6 + 4 * np.sin(WAVES * angle)]
    lean = 0.15 + 0.06 * np.sin(WAVES * angle)
    axis = np.c_[lean * np.cos(angle), lean * np.sin(angle), np.ones(points)]
    axis /= np.linalg.norm(axis, axis=1, keepdims=True)
    rows = ["x_mm,y_mm,z_mm,i,j,k,move,feed_mm_min"]
    rows.append(",".join(f"{v:.6f}" for v in (*(position[0] + 60 * axis[0]), *axis[0])) + ",rapid,")
    rows += [",".join(f"{v:.6f}" for v in (*p, *a)) + ",cut,1500" for p, a in zip(position, axis, strict=True)]
    path = folder / "contour.csv"
    path.write_text("\n".join(rows) + "\n", encoding="utf-8")
    return cell, path


def share_colliding(cell_folder: Path, toolpath: Path) -> float:
    """Share of the configurations within reach, limits and margins that collide, on an even sample."""
    from machopt.cell.cell_reader import load_cell
    from machopt.options.plan_option_reader import load_options
    from machopt.planning.pipeline.planning_setup import prepare_planning
    from machopt.planning.sampling.candidate_enumeration import enumerate_candidates
    from machopt.planning.stations.planning_path import build_planning_path
    from machopt.toolpath.toolpath_reader import read_toolpath

    cell = load_cell(cell_folder)
    options = load_options(cell.plan, None, [])
    setup = prepare_planning(cell, options)
    path = build_planning_path(read_toolpath(toolpath))
    c = enumerate_candidates(path, setup.arm, options)
    found = np.argwhere(c.feasible.any(axis=3))
    some = found[np.linspace(0, len(found) - 1, min(SAMPLE, len(found))).astype(int)]
    assert setup.collision is not None
    hit = setup.collision.check_configurations(c.q[tuple(some.T)], path.may_touch[path.stations[some[:, 0]]]).hit
    return float(hit.mean())


def timed(cell: Path, path: Path, out: Path) -> None:
    """Run ``machopt optimize`` as a process, and print its time, memory, stages and objective."""
    command = [sys.executable, "-m", "machopt.cli", "optimize", str(cell), str(path), "--quiet", "-o", str(out)]
    environment = {**os.environ, "PYTHONPATH": str(ROOT)}
    environment.pop("PYTHONDONTWRITEBYTECODE", None)  # an installation has its code compiled, and so has a second run
    before = resource.getrusage(resource.RUSAGE_CHILDREN)
    start = time.perf_counter()
    done = subprocess.run(command, env=environment, check=False)
    wall = time.perf_counter() - start
    used = resource.getrusage(resource.RUSAGE_CHILDREN)
    cpu = used.ru_utime + used.ru_stime - before.ru_utime - before.ru_stime
    print(f"exit {done.returncode}, {wall:.2f} s wall, {cpu:.2f} s CPU, peak {used.ru_maxrss / 1024:.0f} MiB")
    result = json.loads((out / "result.json").read_text(encoding="utf-8"))
    print("stages:", ", ".join(f"{k} {v:.2f} s" for k, v in result["timings_s"].items()))
    print(f"objective {result['objective']['chosen']['total']:.5f}; {result['objective']['search']}")


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--points", type=int, default=POINTS)
    parser.add_argument("--keep", type=Path, help="make the job here and leave it there")
    args = parser.parse_args()
    with tempfile.TemporaryDirectory() as name:
        folder = args.keep or Path(name)
        folder.mkdir(parents=True, exist_ok=True)
        cell, path = make_job(folder, args.points)
        print(f"{args.points} cutting points; {100 * share_colliding(cell, path):.0f} % of the free choice collides")
        timed(cell, path, Path(name) / "out")


if __name__ == "__main__":
    main()
