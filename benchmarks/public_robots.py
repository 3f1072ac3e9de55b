"""From a robot's URDF to a verified plan, arm by arm, without editing.

    python benchmarks/public_robots.py FOLDER -o OUT [--angle 0 --angle 45] [--only NAME …]

FOLDER holds packages of robots, an ``index.csv`` (robot, package, axes) and ``small_job.csv``. For each arm of six axes
``machopt init --toolpath small_job.csv`` makes a cell with a spindle at each angle to the flange axis, and ``machopt
optimize`` plans the job in it and verifies the plan. One line an arm and angle goes to OUT/robots.csv: exit codes of
both, whether the plan was verified, seconds, and the first line of what was refused. A run goes on where an earlier one
stopped.
"""

from __future__ import annotations

import argparse
import csv
import json
import subprocess
import sys
import time
from collections import Counter
from pathlib import Path

COLUMNS = ("robot", "angle_deg", "init", "optimize", "verified", "seconds", "said")
LONGEST = 900  # s of one plan


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("folder", type=Path)
    parser.add_argument("-o", "--out", type=Path, required=True)
    parser.add_argument("--angle", type=float, action="append", choices=(0.0, 45.0, 90.0))
    parser.add_argument("--only", nargs="*", help="names of robots")
    args = parser.parse_args()
    args.out.mkdir(parents=True, exist_ok=True)
    table = args.out / "robots.csv"
    known = read_rows(table)
    with (args.folder / "index.csv").open(encoding="utf-8") as file:
        arms = [row for row in csv.DictReader(file) if row["axes"] == "6"]
    for angle in args.angle or (0.0, 45.0):
        for arm in arms:
            name = arm["robot"]
            done = any((r["robot"], float(r["angle_deg"])) == (name, angle) for r in known)
            if done or (args.only and name not in args.only):
                continue
            row = run_arm(args.folder, arm, angle, args.out)
            known.append(row)
            write_rows(table, known)
            print(*(row[c] for c in COLUMNS[:6]), row["said"][:160], flush=True)
    for angle in sorted({r["angle_deg"] for r in known}, key=float):
        codes = Counter((r["init"], r["optimize"]) for r in known if r["angle_deg"] == angle)
        print(f"{angle} deg: " + ", ".join(f"init {i} optimize {o or '-'}: {n}" for (i, o), n in sorted(codes.items())))


def run_arm(folder: Path, arm: dict[str, str], angle: float, out: Path) -> dict[str, str]:
    """One arm with a tool at one angle, as one row of the table."""
    robot = next((folder / arm["package"]).rglob(f"{arm['robot']}.urdf"))
    cell, plan = out / f"{arm['robot']}-{angle:g}-cell", out / f"{arm['robot']}-{angle:g}-plan"
    job = folder / "small_job.csv"
    began = time.monotonic()
    row = dict.fromkeys(COLUMNS, "") | {"robot": arm["robot"], "angle_deg": f"{angle:g}"}
    made = command("init", robot, "-o", cell, "--toolpath", job, "--tool-angle-deg", f"{angle:g}")
    row |= {"init": str(made.returncode), "said": first_line(made.stderr)}
    if made.returncode == 0:
        done = command("optimize", cell, job, "-o", plan, "--json")
        row |= {"optimize": str(done.returncode), "said": first_line(done.stderr)}
        result = json.loads(done.stdout) if done.stdout.startswith("{") else {}
        row["verified"] = str((result.get("verification") or {}).get("passed", ""))
    row["seconds"] = f"{time.monotonic() - began:.0f}"
    return row


def command(*words: object) -> subprocess.CompletedProcess[str]:
    line = [sys.executable, "-m", "machopt", *map(str, words)]
    try:
        return subprocess.run(line, capture_output=True, text=True, timeout=LONGEST, check=False)
    except subprocess.TimeoutExpired:
        return subprocess.CompletedProcess(line, -1, "", f"ended after {LONGEST} s")


def first_line(text: str) -> str:
    lines = [line for line in text.splitlines() if line.startswith("machopt: ")] or text.splitlines()[-1:]
    return lines[0].removeprefix("machopt: ") if lines else ""


def read_rows(table: Path) -> list[dict[str, str]]:
    if not table.exists():
        return []
    with table.open(encoding="utf-8", newline="") as file:
        return list(csv.DictReader(file))


def write_rows(table: Path, rows: list[dict[str, str]]) -> None:
    with table.open("w", encoding="utf-8", newline="") as file:
        writer = csv.DictWriter(file, COLUMNS)
        writer.writeheader()
        writer.writerows(rows)


if __name__ == "__main__":
    main()
