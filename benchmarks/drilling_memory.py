"""Peak memory and CPU seconds of ``optimize`` for many short drilling strokes, by the number of holes and the feed.

Run: ``python benchmarks/drilling_memory.py [HOLES[@FEED_MM_MIN] …]`` (default 300 1000 3000 100@5). The holes lie in
rows on the plate of the shipped IRB 6700 cell; each has a rapid move, an approach, a cut of 7 mm and a retract. Each
job runs as a process of its own, after a small one that compiles what is not stored yet.
"""

from __future__ import annotations

import json
import os
import subprocess
import sys
import tempfile
from pathlib import Path

ROOT = Path(__file__).resolve().parent.parent
CELL = ROOT / "cells" / "irb6700_drilling"
COLUMNS = 60  # holes in a row
FEED = 500.0  # mm/min
RUN = """
import json, resource, sys
from machopt.cli import main
code = main()
used = resource.getrusage(resource.RUSAGE_SELF)
lines = open("/proc/self/status").read().splitlines()  # ru_maxrss begins with that of the parent process
peak = next(int(line.split()[1]) for line in lines if line.startswith("VmHWM"))
print(json.dumps([code or 0, peak / 1024, used.ru_utime + used.ru_stime]), file=sys.stderr)
"""


def write_holes(file: Path, holes: int, feed_mm_min: float = FEED) -> None:
    """Write the table of a job of some holes."""
    rows = ["x_mm,y_mm,z_mm,i,j,k,move,feed_mm_min"]
    lines = max((holes - 1) // COLUMNS, 1)
    for hole in range(holes):
        row, column = divmod(hole, COLUMNS)
        column = COLUMNS - 1 - column if row % 2 else column
        place = f"{-180 + 360 * column / (COLUMNS - 1):.4f},{-130 + 260 * row / lines:.4f}"
        moves = ((25, "rapid,"), (2, "approach,1000"), (-5, f"cut,{feed_mm_min:g}"), (25, "retract,3000"))
        rows += [f"{place},{z},0,0,1,{move}" for z, move in moves]
    file.write_text("\n".join(rows) + "\n", encoding="utf-8")


def measure(holes: int, feed_mm_min: float, folder: Path) -> tuple[int, float, float, dict[str, float]]:
    """Exit code, peak memory (MiB), CPU seconds and seconds by stage of one run in a process of its own."""
    table, out = folder / f"holes_{holes}.csv", folder / f"out_{holes}_{feed_mm_min:g}"
    write_holes(table, holes, feed_mm_min)
    command = [sys.executable, "-c", RUN, "optimize", str(CELL), str(table), "--quiet", "-o", str(out)]
    done = subprocess.run(
        command, env={**os.environ, "PYTHONPATH": str(ROOT)}, capture_output=True, text=True, check=False
    )
    code, peak, cpu = json.loads(done.stderr.strip().splitlines()[-1])
    stages = json.loads((out / "result.json").read_text(encoding="utf-8"))["timings_s"]
    return int(code), float(peak), float(cpu), stages


def main() -> None:
    jobs = [word.partition("@") for word in sys.argv[1:] or ["300", "1000", "3000", "100@5"]]
    with tempfile.TemporaryDirectory() as name:
        measure(4, FEED, Path(name))
        for holes, _, feed in jobs:
            code, peak, cpu, stages = measure(int(holes), float(feed or FEED), Path(name))
            print(f"{holes} holes at {feed or f'{FEED:g}'} mm/min: exit {code}, {peak:.0f} MiB, {cpu:.1f} s CPU")
            print("   " + ", ".join(f"{stage} {seconds:.1f}" for stage, seconds in stages.items()), flush=True)


if __name__ == "__main__":
    main()
