"""Stub jobs for batch tests: the toolpath file states what the job does."""

from __future__ import annotations

import ctypes
import os
import time
from collections.abc import Mapping
from dataclasses import replace
from pathlib import Path
from typing import Any

from machopt.batch.request import BatchRequest

OF_THE_CLOCK = {"timing.json", "timings.csv", "timings.js", "log.txt", ".lock", "manifest.json"}
"""Files with times, places of interruption and hashes of such files; all other files are the same in every run."""

CELL = Path(__file__).resolve().parents[1] / "cells" / "s420f_handling"


def run(job: Mapping[str, Any], out: Path) -> dict[str, object]:
    """Record that the job ran, do what the comment in the file states, and write a result that depends on the file
    only."""
    path = Path(job["request"]["toolpath"])
    words = path.read_text().splitlines()[0].removeprefix("#").split()
    count = path.parents[1] / "ran"
    if count.is_dir():
        with (count / path.name).open("a") as file:
            file.write(f"{os.getpid()}\n")
    what, *more = words
    if what == "gate":
        while not (path.parents[1] / more[0]).exists():
            time.sleep(0.01)
    elif what == "sleep":
        time.sleep(float(more[0]))
    elif what == "segfault":
        ctypes.string_at(0)
    elif what == "exit":
        os._exit(0)
    elif what == "raise":
        raise RuntimeError("the arm fell off")
    elif what == "hang":
        while True:  # ignores all signals except SIGKILL and has a child process
            if os.fork() == 0:
                time.sleep(1000)
            time.sleep(1000)
    elif what == "eat":
        hoard = [bytearray(os.urandom(1)) * (16 * 2**20) for _ in range(int(more[0]) // 16)]
        time.sleep(1000 + len(hoard))
    gain = float(len(path.read_text())) % 37
    if what in ("infeasible", "unverified"):
        return {"exit_code": {"infeasible": 3, "unverified": 4}[what], "verdict": what, "reason": "as told"}
    out.mkdir()
    (out / "points.csv").write_text("gamma_deg,move,branch\n" + f"{gain},cut,1\n" * 3)
    (out / "report.html").write_text(f"<p>{path.name}</p>")
    return {
        "exit_code": 0,
        "verdict": "done",
        "reason": "",
        "gain_percent": gain,
        "unit": "mm",
        "mean": 1.0 / (1 + gain),
        "warnings": [],
    }


def folder_of(place: Path, **words: str) -> Path:
    """Write a folder of toolpaths for batch_stub_jobs, and a folder in which the jobs record that they ran."""
    jobs = place / "jobs"
    jobs.mkdir(parents=True)
    (place / "ran").mkdir()
    for name, text in words.items():
        (jobs / f"{name}.nc").write_text(f"#{text}\n{name * 5}")
    return jobs


def request_for(jobs: Path | str, out: Path, **changes: object) -> BatchRequest:
    base = BatchRequest(jobs=(str(jobs),), out=out, cell=CELL, entry="batch_stub_jobs", version="test", time_limit=60.0)
    return replace(base, **changes)  # type: ignore[arg-type]


def times_run(place: Path) -> dict[str, int]:
    return {f.stem: len(f.read_text().splitlines()) for f in (place / "ran").iterdir()}


def contents(out: Path) -> dict[str, bytes]:
    """Return every file that is the same in every run; the batch manifest contains hashes of the others, too."""
    files = [f for f in out.rglob("*") if f.is_file() and f.name not in OF_THE_CLOCK and f != out / "manifest.json"]
    return {str(f.relative_to(out)): f.read_bytes() for f in files}
