"""What a better place of the workpiece is worth: ``machopt place`` on the shipped jobs.

    python benchmarks/placement_gain.py [--places N] [--reach MM] [--only CELL]

A line a job: worst index where the cell has the part, at the best place found (a whole verified plan), the gain,
whether it is proven over the places looked at, processor and wall time, and peak memory of the command as a process.
Goal: 200 places of a 300-point job in 3 minutes on two cores of an ordinary machine.
"""

from __future__ import annotations

import argparse
import json
import resource
import subprocess
import sys
import tempfile
import time
from pathlib import Path

ROOT = Path(__file__).resolve().parents[1]
JOBS = (
    ("kr500_milling", "plain.csv"),
    ("kr240_drilling", "panel_holes.csv"),
    ("irb6700_drilling", "plate_holes.csv"),
    ("s420f_handling", "castings.csv"),
    ("cutting_cobot", "bone_tracks.csv"),
)
COBOT_REACH = 0.3  # of the others', as the arm is


def main() -> int:
    """Print the table; 1 where a job ends in an error."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--places", type=int, default=200)
    parser.add_argument("--reach", type=float, default=300.0, help="mm either way, along x and y")
    parser.add_argument("--only", help="one cell")
    args = parser.parse_args()
    print(
        f"{'job':38} {'shipped':>9} {'best':>9} {'unit':>6} {'gain %':>7} {'proven':>7} {'planned':>8} {'CPU s':>7} "
        f"{'wall s':>7} MiB"
    )
    failed = False
    for cell, toolpath in JOBS:
        if args.only in (None, cell):
            failed |= not _told(cell, toolpath, args.places, args.reach)
    return int(failed)


def _told(cell: str, toolpath: str, places: int, reach: float) -> bool:
    reach *= COBOT_REACH if cell == "cutting_cobot" else 1.0
    with tempfile.TemporaryDirectory() as name:
        asked = [
            sys.executable,
            "-m",
            "machopt.cli",
            "place",
            str(ROOT / "cells" / cell),
            str(ROOT / "toolpaths" / toolpath),
        ]
        asked += ["-o", f"{name}/out", "--json", "--places", str(places), "--best", "1"]
        asked += ["--x-mm", str(-reach), str(reach), "--y-mm", str(-reach), str(reach), "--minutes", "30"]
        before, begun = resource.getrusage(resource.RUSAGE_CHILDREN), time.perf_counter()
        done = subprocess.run(asked, capture_output=True, text=True, check=False)
        wall, after = time.perf_counter() - begun, resource.getrusage(resource.RUSAGE_CHILDREN)
    if done.returncode not in (0, 3, 4):
        print(f"{cell} {toolpath}: {done.stderr.strip()}")
        return False
    found = json.loads(done.stdout)
    here, best = found["as_it_stands"], (found["best"] or [{}])[0]
    cpu = after.ru_utime + after.ru_stime - before.ru_utime - before.ru_stime

    def number(value: float | None) -> str:
        return "–" if value is None else f"{value:.4g}"

    print(
        f"{cell + ' ' + toolpath:38} {number(here['worst']):>9} {number(best.get('worst')):>9} {found['unit']:>6} "
        f"{number(found['gain_percent']):>7} {found['proven']!s:>7} {found['planned']:>8} {cpu:7.0f} {wall:7.0f} "
        f"{after.ru_maxrss / 1024:.0f}\n    {found['verdict']}",
        flush=True,
    )
    return True


if __name__ == "__main__":
    sys.exit(main())
