"""The same job with and without process.yaml: seconds and processor seconds of the whole command, and their ratio.

Run: ``python benchmarks/process_time.py``. Each pair runs one after the other, so the ratio holds on any machine; the
first pair also fills the caches and does not count.
"""

from __future__ import annotations

import os
import resource
import subprocess
import sys
import tempfile
import time
from pathlib import Path

ROOT = Path(__file__).resolve().parents[1]
PAIRS = 3
JOBS = {
    "120 holes": ("kr240_drilling", "panel_holes.aptsource"),
    "2,400 milled points": ("kr500_milling", "contour_5axis.nc"),
}


def measure(cell: str, toolpath: str, out: Path, *options: str) -> tuple[float, float]:
    """Return wall seconds and processor seconds of one run."""
    command = [
        sys.executable,
        "-m",
        "machopt",
        "optimize",
        str(ROOT / "cells" / cell),
        str(ROOT / "toolpaths" / toolpath),
    ]
    before, start = resource.getrusage(resource.RUSAGE_CHILDREN), time.perf_counter()
    subprocess.run(
        [*command, "-o", str(out), "--quiet", "--force", *options],
        check=True,
        env={**os.environ, "PYTHONPATH": str(ROOT)},
    )
    wall, after = time.perf_counter() - start, resource.getrusage(resource.RUSAGE_CHILDREN)
    return wall, after.ru_utime + after.ru_stime - before.ru_utime - before.ru_stime


def main() -> None:
    with tempfile.TemporaryDirectory() as name:
        for label, (cell, toolpath) in JOBS.items():
            process = ("--process", str(ROOT / "cells" / cell / "process.yaml"))
            pairs = [
                (measure(cell, toolpath, Path(name) / "plain"), measure(cell, toolpath, Path(name) / "with", *process))
                for _ in range(PAIRS + 1)
            ][1:]
            for word, k in (("wall", 0), ("processor", 1)):
                plain, full = (sorted(pair[n][k] for pair in pairs)[PAIRS // 2] for n in (0, 1))
                print(f"{label}: {word} {plain:.1f} s without, {full:.1f} s with the process: {full / plain:.2f}")


if __name__ == "__main__":
    main()
