"""Table of what a robot programmer looks at first in a plan, for every shipped cell with its toolpaths.

    python benchmarks/plan_quality.py [--job NAME …] [--inputs FOLDER] [--set KEY=VALUE …] [--save FILE]
                                      [--against FILE]

``--inputs`` names a folder whose sub-folders each hold a cell and its ``job.csv``; these jobs are planned too.
``--save`` keeps the figures as JSON, ``--against`` prints the change of each figure against such a file. Columns:

changes        changes of the branch over rapid moves (no meaning where branches have no lasting numbers)
turns          whole turns by which joints unwind from one toolpath point to the next, summed over the joints
clearance      median clearance of the cut points, mm
cycle, rapid   duration of the motion and of its rapid moves, s
mean, worst    mean and worst deflection of the cut points, mm
J              objective; its weights may differ between two versions
CPU            user time of the command, s
"""

from __future__ import annotations

import argparse
import csv
import itertools
import json
import resource
import statistics
import subprocess
import sys
import tempfile
from pathlib import Path

ROOT = Path(__file__).resolve().parents[1]
JOBS: dict[str, tuple[str, str]] = {
    "deck": ("cells/kr500_milling", "toolpaths/cylinder_head_face.cls"),
    "contour": ("cells/kr500_milling", "toolpaths/contour_5axis.nc"),
    "plain": ("cells/kr500_milling", "toolpaths/plain.csv"),
    "panel": ("cells/kr240_drilling", "toolpaths/panel_holes.aptsource"),
    "plate": ("cells/irb6700_drilling", "toolpaths/plate_holes.csv"),
    "castings": ("cells/s420f_handling", "toolpaths/castings.csv"),
    "bone": ("cells/cutting_cobot", "toolpaths/bone_tracks.csv"),
    "beam": ("cells/kr500_rail", "toolpaths/beam_passes.csv"),
    "drum": ("cells/kr240_turntable", "toolpaths/drum_holes.csv"),
    "setups": ("cells/kr240_setups", "toolpaths/two_plates.nc"),
}
COLUMNS = ("changes", "turns", "held", "clearance", "cycle", "rapid", "mean", "worst", "J", "CPU")
Figures = dict[str, float]


def find_input_jobs(folder: Path) -> dict[str, tuple[str, str]]:
    """Return the jobs of a folder: sub-folders with a cell.yaml and a job.csv."""
    found = sorted(p for p in folder.iterdir() if (p / "cell.yaml").is_file() and (p / "job.csv").is_file())
    return {p.name: (str(p), str(p / "job.csv")) for p in found}


def measure_plan(out: Path) -> Figures:
    """Return the figures of an output folder, without the CPU time."""
    result = json.loads((out / "result.json").read_text(encoding="utf-8"))
    with (out / "points.csv").open(encoding="utf-8") as stream:
        points = [row for row in csv.DictReader(stream) if row["status"] == "ok"]
    joints = [[float(row[f"q{n}_deg"]) for n in range(1, 7)] for row in points]
    flown = [(a, b) for a, b in itertools.pairwise(points) if b["move"] == "rapid"]
    turns = sum(round(abs(b - a) / 360.0) for p, q in itertools.pairwise(joints) for a, b in zip(p, q, strict=True))
    cuts = [row for row in points if row["move"] == "cut"]
    deflection = [float(row["deflection_mm"]) for row in cuts if row["deflection_mm"]]
    with (out / "trajectory.csv").open(encoding="utf-8") as stream:
        moves = [row["move"] for row in csv.DictReader(stream)]
    step = result["cycle_time_s"] / max(len(moves) - 1, 1)
    dips = [dip["lowest_ratio"] for dip in result["feed_dips"]]
    return {
        "changes": sum(a["branch"] != b["branch"] for a, b in flown),
        "turns": turns,
        "held": 100.0 * min(dips, default=1.0),
        "clearance": statistics.median([float(r["clearance_mm"]) for r in cuts if r["clearance_mm"]] or [float("nan")]),
        "cycle": result["cycle_time_s"],
        "rapid": step * moves.count("rapid"),
        "mean": statistics.fmean(deflection or [float("nan")]),
        "worst": max(deflection, default=float("nan")),
        "J": result["objective"]["chosen"]["total"],
    }


def plan_job(cell: str, toolpath: str, options: list[str], folder: Path) -> Figures | str:
    """Plan one job and return its figures, or why there are none."""
    out = folder / "out"
    before = resource.getrusage(resource.RUSAGE_CHILDREN)
    command = [sys.executable, "-m", "machopt.cli", "optimize", cell, toolpath, "-o", str(out), "--quiet", "--force"]
    done = subprocess.run(
        [*command, *(w for o in options for w in ("--set", o))], cwd=ROOT, check=False, capture_output=True, text=True
    )
    cpu = resource.getrusage(resource.RUSAGE_CHILDREN).ru_utime - before.ru_utime
    if done.returncode:
        return f"exit {done.returncode}: " + (done.stderr.strip().splitlines() or [""])[-1][:150]
    return measure_plan(out) | {"CPU": cpu}


def format_row(name: str, figures: Figures | str, old: Figures | str | None) -> str:
    """Return one row of the table, with the change in percent behind each figure where an old one is known."""
    if isinstance(figures, str):
        return f"| {name} | {figures} |"
    cells = []
    for column in COLUMNS:
        text = f"{figures[column]:.4g}"
        if isinstance(old, dict) and column in old and old[column] != figures[column]:
            base = old[column]
            text += f" ({100 * (figures[column] / base - 1):+.1f} %)" if base else f" (was {base:g})"
        cells.append(text)
    return f"| {name} | " + " | ".join(cells) + " |"


def main() -> None:
    """Plan the jobs and print the table."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--job", action="append", default=[])
    parser.add_argument("--inputs", type=Path)
    parser.add_argument("--set", action="append", default=[])
    parser.add_argument("--save", type=Path)
    parser.add_argument("--against", type=Path)
    parser.add_argument("--keep", type=Path, help="folder for the output folders")
    args = parser.parse_args()
    jobs = JOBS | (find_input_jobs(args.inputs) if args.inputs else {})
    old = json.loads(args.against.read_text(encoding="utf-8")) if args.against else {}
    results: dict[str, Figures | str] = {}
    print("| job | " + " | ".join(COLUMNS) + " |\n|---" + "|---" * len(COLUMNS) + "|")
    for name, (cell, toolpath) in jobs.items():
        if args.job and name not in args.job:
            continue
        with tempfile.TemporaryDirectory() as temporary:
            folder = Path(temporary) if args.keep is None else args.keep / name
            folder.mkdir(parents=True, exist_ok=True)
            results[name] = plan_job(cell, toolpath, args.set, folder)
        print(format_row(name, results[name], old.get(name)), flush=True)
        if args.save:
            known = json.loads(args.save.read_text(encoding="utf-8")) if args.save.exists() else {}
            args.save.write_text(json.dumps(known | results, indent=1) + "\n", encoding="utf-8")


if __name__ == "__main__":
    main()
