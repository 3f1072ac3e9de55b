"""A folder of jobs: what a job costs beside its own work, and what a second worker brings.

Run: ``python benchmarks/batch_overhead.py [number of real jobs]``. Prints, for one and for two workers on this machine:
the time until the first job starts (workers, and the warm-up of their process servers, which compiles on the first
run), jobs a minute of jobs that do nothing (the overhead of a job), and of the smallest shipped job with different
seeds, beside the same as single commands one after the other. Resuming a finished batch is timed too.
"""

from __future__ import annotations

import os
import subprocess
import sys
import tempfile
import time
from collections.abc import Mapping
from pathlib import Path
from typing import Any

from machopt.batch.request import BatchProgress, BatchRequest, BatchResult
from machopt.batch.run import run_batch

ROOT = Path(__file__).resolve().parents[1]
CELL, TOOLPATH = ROOT / "cells" / "s420f_handling", ROOT / "toolpaths" / "castings.csv"
NOTHING = 200
SINGLE = 2


def run(job: Mapping[str, Any], out: Path) -> dict[str, object]:
    """A job that does nothing; this file is its own entry."""
    out.mkdir()
    return {"exit_code": 0, "verdict": "done", "reason": "", "toolpath": Path(job["request"]["toolpath"]).name}


def timed(request: BatchRequest) -> tuple[BatchResult, float, float, float]:
    """The outcome, seconds in all, seconds until the first job was done, jobs a second after that."""
    start = time.perf_counter()
    done: list[float] = []

    def told(progress: BatchProgress) -> None:
        if progress.done:
            done.append(time.perf_counter())

    outcome = run_batch(request, told)
    end = time.perf_counter()
    rate = (len(done) - 1) / (done[-1] - done[0]) if len(done) > 1 else float("nan")
    return outcome, end - start, done[0] - start if done else float("nan"), rate


def main() -> None:
    real = int(sys.argv[1]) if len(sys.argv) > 1 else 12
    with tempfile.TemporaryDirectory() as name:
        place = Path(name)
        empty = place / "empty"
        empty.mkdir()
        for n in range(NOTHING):
            (empty / f"{n:04d}.nc").write_text(f"{n}\n", encoding="utf-8")
        seeds = "".join(f"  s{n}: {{seed: {n}}}\n" for n in range(real))
        listed = place / "seeds.yaml"
        listed.write_text(
            f"machopt_batch: 1\ncells: [{CELL}]\ntoolpaths: [{TOOLPATH}]\noptions:\n{seeds}", encoding="utf-8"
        )
        for workers in (1, 2):
            out = place / f"nothing{workers}"
            request = BatchRequest(
                jobs=(str(empty),), out=out, cell=CELL, entry=Path(__file__).stem, workers=workers, version="1"
            )
            _, total, first, rate = timed(request)
            print(
                f"{NOTHING} jobs that do nothing, {workers} worker(s): first after {first:.1f} s, then "
                f"{1e3 / rate:.0f} ms a job, {1e3 * workers / rate:.0f} ms of a worker; {total:.1f} s in all"
            )
        start = time.perf_counter()
        outcome = run_batch(request)
        print(f"resumed when all are done: {time.perf_counter() - start:.1f} s, {outcome.done} done again")
        for workers in (1, 2):
            request = BatchRequest(jobs=(str(listed),), out=place / f"real{workers}", workers=workers, version="1")
            outcome, total, first, rate = timed(request)
            print(
                f"{real} real jobs, {workers} worker(s): exit {outcome.exit_code}, first after {first:.1f} s, then "
                f"{60 * rate:.1f} a minute; {total:.1f} s in all"
            )
        start = time.perf_counter()
        for n in range(SINGLE):
            subprocess.run(
                [
                    sys.executable,
                    "-m",
                    "machopt.cli",
                    "optimize",
                    str(CELL),
                    str(TOOLPATH),
                    "--quiet",
                    "--set",
                    f"seed={n}",
                    "-o",
                    str(place / f"single{n}"),
                ],
                check=True,
                env={**os.environ, "PYTHONPATH": str(ROOT)},
            )
        print(f"the same as single commands: {60 * SINGLE / (time.perf_counter() - start):.1f} a minute")
        print(f"load of the machine meanwhile: {os.getloadavg()[1]:.1f} on {os.cpu_count()} cores")


if __name__ == "__main__":
    main()
