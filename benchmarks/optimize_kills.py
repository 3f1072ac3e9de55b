"""Kill whole commands at random moments: the output folder must be the old one or the new one, never missing or mixed.

    python benchmarks/optimize_kills.py [--kills 100] [--cell cells/kr500_milling] [--seed 20]

Each round starts ``machopt optimize`` into the same folder and kills it (SIGKILL) at a moment drawn from the time a
whole run takes, every third one from its last tenth, where the swap is. After every kill the folder is held against
its own manifest. At the end one undisturbed run must succeed and leave nothing beside the folder.
"""

from __future__ import annotations

import argparse
import random
import subprocess
import sys
import tempfile
import time
from pathlib import Path

from machopt.output import read_manifest
from machopt.output.manifest_file import find_differences

ROOT = Path(__file__).resolve().parents[1]
TABLE = "x_mm,y_mm,z_mm,i,j,k,move,feed_mm_min\n" + "".join(
    f"{x},0,{z},0,0,1,{move},{feed}\n"
    for x, z, move, feed in (
        (-100, 60, "rapid", ""),
        (-100, 5, "approach", 1000),
        (-100, -0.5, "cut", 1500),
        (-90, -0.5, "cut", 1500),
        (-90, 5, "retract", 1000),
        (-90, 60, "rapid", ""),
    )
)


def main() -> int:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0] if __doc__ else None)
    parser.add_argument("--kills", type=int, default=100)
    parser.add_argument("--cell", type=Path, default=ROOT / "cells" / "kr500_milling")
    parser.add_argument("--seed", type=int, default=20)
    parser.add_argument(
        "--most-s", type=float, default=3600.0, help="stop after that many seconds, and say how many it was"
    )
    args = parser.parse_args()
    rng = random.Random(args.seed)
    with tempfile.TemporaryDirectory() as place:
        toolpath, out = Path(place) / "cut.csv", Path(place) / "out"
        toolpath.write_text(TABLE, encoding="utf-8")
        command = [
            sys.executable,
            "-m",
            "machopt.cli",
            "optimize",
            str(args.cell),
            str(toolpath),
            "-o",
            str(out),
            "--quiet",
            "--set",
            "rotation_step_deg=30",
        ]
        subprocess.run(command, check=True)  # the first one may compile
        begun = time.monotonic()
        subprocess.run(command, check=True)
        whole = time.monotonic() - begun
        killed = replaced = 0
        last = read_manifest(out)[0]
        done = 0
        for number in range(args.kills):
            if time.monotonic() - begun > args.most_s:
                break
            done += 1
            moment = rng.uniform(0.9, 1.05) if number % 3 == 0 else rng.uniform(0.0, 1.0)
            with subprocess.Popen(command) as run:
                try:
                    run.wait(moment * whole)
                except subprocess.TimeoutExpired:
                    run.kill()
                    killed += 1
            found, sealed = read_manifest(out)  # missing or half-written: this raises
            wrong = find_differences(out, found)
            if wrong or not sealed:
                print(f"kill {number} at {moment:.3f} of a run: {wrong}")
                return 1
            replaced += found != last
            last = found
        subprocess.run(command, check=True)
        beside = sorted(p.name for p in out.parent.iterdir() if p not in (out, toolpath))
        print(
            f"{killed} of {done} runs killed within {whole:.1f} s each, {replaced} replaced the folder; "
            f"never missing, never mixed; left beside it: {', '.join(beside) or 'nothing'}"
        )
        return 1 if beside else 0


if __name__ == "__main__":
    sys.exit(main())
