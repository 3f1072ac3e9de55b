"""How near the default choice of external axes is to the best of several runs with other options.

    python benchmarks/external_axis_gap.py [--job CELL TOOLPATH] … [--save FILE]

Each job is planned by default and with ten variants: lighter and heavier travel of the external joints, one value for
each operation, and joints locked at places of their ranges. Every J is that of the default's weights, with the index in
the default's unit. The table states by how much the best variant is below the default, in percent of its J; the goal is
1 %, and negative where the default is the best.
"""

from __future__ import annotations

import argparse
import json
import resource
import subprocess
import sys
import tempfile
from pathlib import Path

import numpy as np

from machopt.cell.cell_reader import load_cell

ROOT = Path(__file__).resolve().parents[1]
JOBS = (
    (ROOT / "cells/kr500_rail", ROOT / "toolpaths/beam_passes.csv"),
    (ROOT / "cells/kr240_turntable", ROOT / "toolpaths/drum_holes.csv"),
)
WEIGHTS = (0.0, 0.1, 0.3, 0.6, 2.0)
LOCKED = (0.1, 0.35, 0.65, 0.9)  # place in the range of the first joint


def list_variants(cell_folder: Path) -> dict[str, list[str]]:
    """Return the options of each variant by its name."""
    cell = load_cell(cell_folder)
    out = {f"weight {w:g}": [f"external.{name}.weight={w:g}" for name in cell.external_joints] for w in WEIGHTS}
    out["one value each"] = [f"external.{name}.mode=operation" for name in cell.external_joints]
    name, slides = cell.external_joints[0], cell.external_prismatic[0]
    low, high = float(cell.limits.lower[6]), float(cell.limits.upper[6])
    for share in LOCKED:
        value = low + share * (high - low)
        at = f"at_mm={1e3 * value:.3f}" if slides else f"at_deg={np.degrees(value):.3f}"
        out[f"{name} locked at {share:g}"] = [f"external.{name}.mode=locked", f"external.{name}.{at}"]
    return out


def plan(cell: Path, toolpath: Path, options: list[str], folder: Path) -> tuple[dict[str, object] | None, float]:
    """Return result.json, None where there is no plan, and the CPU time in s."""
    before = resource.getrusage(resource.RUSAGE_CHILDREN).ru_utime
    words = [sys.executable, "-m", "machopt.cli", "optimize", str(cell), str(toolpath), "-o", str(folder / "out")]
    words += ["--quiet", "--force", *(w for o in options for w in ("--set", o))]
    done = subprocess.run(words, cwd=ROOT, check=False, capture_output=True)
    cpu = resource.getrusage(resource.RUSAGE_CHILDREN).ru_utime - before
    if done.returncode:
        return None, cpu
    return json.loads((folder / "out" / "result.json").read_text(encoding="utf-8")), cpu


def compute_value(result: dict[str, object], unit: float) -> float:
    """Return J with the index in another unit than the run's own."""
    own, w = result["objective"]["chosen"], result["options"]["weights"]  # type: ignore[index]
    ratio = float(result["index_scale"]) / unit  # type: ignore[arg-type]
    index = w["mean"] * own["mean"] + w["worst"] * own["worst"]
    return float(own["total"] + (ratio - 1.0) * index)


def main() -> None:
    """Plan every job with all variants and print the table."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--job", nargs=2, type=Path, action="append", default=[])
    parser.add_argument("--save", type=Path)
    args = parser.parse_args()
    rows = []
    print("| job | J | best variant | its J | below the default (%) | CPU (s) |\n|---|---|---|---|---|---|")
    for cell, toolpath in args.job or JOBS:
        with tempfile.TemporaryDirectory() as name:
            own, cpu = plan(cell, toolpath, [], Path(name))
            if own is None:
                print(f"| {cell.name} | no plan |")
                continue
            unit = float(own["index_scale"])  # type: ignore[arg-type]
            values = {}
            for variant, options in list_variants(cell).items():
                result, _ = plan(cell, toolpath, options, Path(name))
                if result is not None:
                    values[variant] = compute_value(result, unit)
        mine = compute_value(own, unit)
        best = min(values, key=lambda v: values[v])
        gap = 100.0 * (1.0 - values[best] / mine)
        rows.append({"job": cell.name, "J": mine, "variants": values, "gap_percent": gap, "cpu_s": cpu})
        print(f"| {cell.name} | {mine:.4f} | {best} | {values[best]:.4f} | {gap:.2f} | {cpu:.1f} |", flush=True)
    if args.save:
        args.save.write_text(json.dumps(rows, indent=1) + "\n", encoding="utf-8")


if __name__ == "__main__":
    main()
