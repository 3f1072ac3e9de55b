"""Finish of a conical wall with a tool axis that turns: contact, volume, plan and verification.

Run: ``python benchmarks/tilted_wall.py [--keep FOLDER]``. The exact values are closed forms.
"""

from __future__ import annotations

import argparse
import csv
import json
import tempfile
import time
from pathlib import Path

import numpy as np
from tilted_wall_job import TiltedWall

from machopt.cli import main as run_machopt


def measure(folder: Path, job: TiltedWall) -> None:
    """Plan, verify and print one job.

    Args:
        folder: Receives cell, toolpath and output.
        job: The job.
    """
    job.write_cell(folder / "cell")
    job.write_toolpath(folder / "wall.csv")
    start = time.process_time()
    planned = run_machopt(["optimize", str(folder / "cell"), str(folder / "wall.csv"), "-o", str(folder / "out")])
    seconds = time.process_time() - start
    verified = run_machopt(["verify", str(folder / "cell"), str(folder / "wall.csv"), str(folder / "out")])
    print(f"optimize {planned} ({seconds:.1f} CPU s), verify {verified}")
    with (folder / "out" / "points.csv").open() as table:
        rows = [row for row in csv.DictReader(table) if row["ae_mm"]][5:-5]
    for name, (least, most) in job.find_contact().items():
        found = np.array([float(row[name]) for row in rows])
        print(f"{name:12} {found.min():.3f} … {found.max():.3f}, exact {least:.3f} … {most:.3f} over the height")
    found = np.array([float(row["ap_mm"]) for row in rows])
    print(f"ap_mm        {found.min():.3f} … {found.max():.3f}, wall {1e3 * job.height / np.cos(job.lean):.3f}")
    stock = json.loads((folder / "out" / "result.json").read_text())["process"]["stock"]
    print(f"removed {stock['removed_mm3']:.2f} mm³, sector alone {1e9 * job.find_removed_volume():.2f} mm³")
    print({name: stock["finished"][name] for name in ("gouge_depth_mm", "gouge_volume_mm3")})


def main() -> None:
    """Print all figures."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--keep", type=Path, help="folder for cell, toolpath and output")
    keep = parser.parse_args().keep
    with tempfile.TemporaryDirectory() as folder:
        measure(keep or Path(folder), TiltedWall())


if __name__ == "__main__":
    main()
