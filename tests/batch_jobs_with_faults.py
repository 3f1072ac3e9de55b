"""Real jobs for batch tests: some crash or hang, others wait until a file appears."""

from __future__ import annotations

import ctypes
import os
import time
from collections.abc import Mapping
from pathlib import Path
from typing import Any

from machopt.batch import job_process

ROOT = Path(__file__).resolve().parents[1]
JOBS, GATED = 15, 8  # each cell with each method; the jobs from the ninth on wait for the gate file
CELLS = {  # cell: (toolpath, number of its rows in a small job)
    "s420f_handling": ("castings", 4),
    "cutting_cobot": ("bone_tracks", 4),
    "irb6700_drilling": ("plate_holes", 4),
    "kr240_drilling": ("panel_holes", 4),
    "kr500_milling": ("plain", 9),
}
METHODS = ("global", "default", "jiao2022")


def run(job: Mapping[str, Any], out: Path) -> dict[str, object]:
    """Record that the job ran, then crash, hang or run the real job; ``seed`` is its number."""
    path, number = Path(job["request"]["toolpath"]), job["request"]["direct"]["seed"]
    place = path.parents[1]
    with (place / "ran" / f"{number:02d}").open("a", encoding="ascii") as file:
        file.write(f"{os.getpid()}\n")
    while number >= GATED and not (place / "gate").exists():
        time.sleep(0.02)
    if path.stem == "boom":
        ctypes.string_at(0)
    while path.stem == "deaf":
        time.sleep(1000)
    return job_process.run(job, out)


warm = job_process.warm


def small_jobs(place: Path) -> Path:
    """Write a list of fifteen jobs with small toolpaths in four cells, with various options, one crash and one hang."""
    (place / "parts").mkdir()
    (place / "ran").mkdir()
    lines = ["machopt_batch: 1", "post: krl", "jobs:"]
    for number in range(JOBS):
        cell, (name, rows) = list(CELLS.items())[number % len(CELLS)]
        name, limit = {3: ("boom", ""), 7: ("deaf", ", time_limit_s: 1.5")}.get(number, (name, ""))
        source = CELLS[cell][0]
        text = (ROOT / "toolpaths" / f"{source}.csv").read_text(encoding="utf-8").splitlines(keepends=True)
        table = [line for line in text if not line.startswith("#")]
        (place / "parts" / f"{name}.csv").write_text("".join(table[: rows + 1]), encoding="utf-8")
        options = f"seed: {number}, method: {METHODS[number % 3]}, rotation_step_deg: 30, sample_ms: 50"
        # collision checking takes most of the time of a small job
        options += "" if number % 3 == 0 else ", collision: false"
        lines.append(
            f"  - {{cell: {ROOT / 'cells' / cell}, toolpath: parts/{name}.csv, options: {{{options}}}{limit}}}"
        )
    (place / "list.yaml").write_text("\n".join(lines) + "\n", encoding="utf-8")
    return place / "list.yaml"
