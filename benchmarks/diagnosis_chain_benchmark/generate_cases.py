"""Generate cases with hidden effects.

Run: ``python benchmarks/diagnosis_chain_benchmark/generate_cases.py --set dev --out out/chain``.

Writes OUT/<case>/cell and OUT/<case>/recording, which is all that a diagnosis may see, and OUT/<case>.truth.json.
"""

from __future__ import annotations

import argparse
import fnmatch
import json
import sys
from concurrent.futures import ProcessPoolExecutor
from pathlib import Path
from time import perf_counter

sys.path.insert(0, str(Path(__file__).resolve().parent))
from case_list import FAST, SETS, numbered
from simulator.case_files import write_cell, write_recording
from simulator.case_simulation import Case, Scene
from simulator.ground_truth import build_truth

CELLS = Path(__file__).resolve().parents[2] / "cells"
Job = tuple[str, Case, tuple[int, ...], str, Path, bool]


def generate(job: Job) -> tuple[str, str, int, float]:
    """One case; returns its folder, its key, its number of readings and the time it took."""
    name, case, seed, which, out, fast = job
    start = perf_counter()
    scene = Scene(case, seed, CELLS, fast)
    scene.calibrate()
    table, world, _, simulated = scene.table()
    truth = build_truth(scene, name, which, table, simulated)
    write_cell(CELLS / scene.nominal.name, out / name / "cell")
    write_recording(out / name / "recording", case, world, table)
    truth["generated_s"] = round(perf_counter() - start, 2)
    (out / f"{name}.truth.json").write_text(json.dumps(truth, indent=1) + "\n", encoding="utf-8")
    return name, case.key, len(table.clean), perf_counter() - start


def chosen(
    which: str, only: list[str], fast: bool, rounds: int, draw: int = 0
) -> list[tuple[str, Case, tuple[int, ...]]]:
    """The cases of a set that match; ``only`` are patterns for keys or folder names, ``fast`` the small subset."""
    listed = numbered(which, rounds, draw)
    if fast:
        listed = [c for c in listed if any(fnmatch.fnmatch(c[1].key, p) for p in FAST)]
    if only:
        listed = [c for c in listed if any(fnmatch.fnmatch(c[1].key, p) or fnmatch.fnmatch(c[0], p) for p in only)]
    return listed


def main(arguments: list[str] | None = None) -> int:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--set", choices=sorted(SETS), default="dev")
    parser.add_argument("--out", type=Path, required=True)
    parser.add_argument("--only", nargs="*", default=[], metavar="PATTERN", help="keys or folders, e.g. 'null/*'")
    parser.add_argument("--fast", action="store_true", help="a small subset with fewer readings")
    parser.add_argument("--rounds", type=int, default=1, help="every case so many times, each with its own seed")
    parser.add_argument(
        "--seed", type=int, default=0, help="which draw of the set; one that nobody has answered judges"
    )
    parser.add_argument("--jobs", type=int, default=2)
    options = parser.parse_args(arguments)
    listed = chosen(options.set, options.only, options.fast, options.rounds, options.seed)
    if not listed:
        print("no case matches", file=sys.stderr)
        return 2
    options.out.mkdir(parents=True, exist_ok=True)
    jobs = [(*c, options.set, options.out, options.fast) for c in listed]
    start, total = perf_counter(), 0.0
    with ProcessPoolExecutor(options.jobs) as pool:
        for name, _, readings, seconds in pool.map(generate, jobs):
            total += seconds
            print(f"{name}  {readings:>6} readings  {seconds:5.2f} s")
    print(f"{len(jobs)} cases, {total / len(jobs):.2f} s each, {perf_counter() - start:.0f} s in all -> {options.out}")
    return 0


if __name__ == "__main__":
    sys.exit(main())
