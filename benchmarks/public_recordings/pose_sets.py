"""Public pose sets of real robots: ``python benchmarks/public_recordings/pose_sets.py DATA [--only ur5 ipa_ur10_c
ipa_ur10_d]``.

DATA holds a folder a set with ``cell`` and ``recording`` (UR10 C and D: Landgraf, ipa-robot-accuracy, MIT licence;
UR5: serial_robots_datasets, MIT); nothing of them is stored in the project. For each set ``machopt diagnose`` runs as a
command; printed are its error on poses that no fit saw, before and after, beside what a refit by hand reached, the
places named, and processor time. Then the files it wrote (kinematics.yaml, stiffness.yaml) stand in the cell of another
series of the same robot, and the error there, frame and reflector refitted and nothing else, is printed without and
with them.
"""

from __future__ import annotations

import argparse
import json
import resource
import shutil
import subprocess
import sys
import tempfile
from pathlib import Path
from typing import Any

from ruamel.yaml import YAML

BY_HAND = {"ipa_ur10_c": "0.068", "ur5": "0.034 (geometry alone 0.061)"}  # mm, rms a coordinate, held out
OTHER = {"ipa_ur10_c": "ipa_ur10_d/recording", "ipa_ur10_d": "ipa_ur10_c/recording", "ur5": "ur5/recording_random20"}


def diagnosed(cell: Path, recording: Path, out: Path, *more: str) -> dict[str, Any]:
    """The answer of the command."""
    before = resource.getrusage(resource.RUSAGE_CHILDREN)
    command = [sys.executable, "-m", "machopt.cli", "diagnose", str(cell), str(recording), "-o", str(out), "--quiet"]
    subprocess.run([*command, *more], check=True)
    after = resource.getrusage(resource.RUSAGE_CHILDREN)
    found: dict[str, Any] = json.loads((out / "diagnosis.json").read_text(encoding="utf-8"))
    found["processor_s"] = after.ru_utime + after.ru_stime - before.ru_utime - before.ru_stime
    return found


def with_files(cell: Path, written: Path, out: Path) -> Path:
    """A copy of a cell in which the written files are in use."""
    shutil.copytree(cell, out)
    yaml = YAML()
    about = yaml.load((out / "cell.yaml").read_text(encoding="utf-8"))
    for name in ("kinematics", "stiffness"):
        if (written / f"{name}.yaml").is_file():
            shutil.copy(written / f"{name}.yaml", out / f"{name}.yaml")
            about[name] = f"{name}.yaml"
    with (out / "cell.yaml").open("w", encoding="utf-8") as file:
        yaml.dump(about, file)
    return out


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("data", type=Path)
    parser.add_argument("--only", nargs="*", default=list(OTHER), choices=list(OTHER))
    options = parser.parse_args()
    for name in options.only:
        folder = options.data / name
        with tempfile.TemporaryDirectory() as room:
            out = Path(room) / "out"
            found = diagnosed(folder / "cell", folder / "recording", out)
            error = f"{found['baseline']['heldout_rmse']:.3f} -> {found['final']['heldout_rmse']:.3f} mm"
            print(f"{name}: {found['verdict']}, {error}; by hand {BY_HAND.get(name, 'not known')}", end="")
            print(f"; {found['processor_s']:.0f} s of processor time", flush=True)
            print("  " + ", ".join(f"{f['effect']} {f['location']}" for f in found["findings"]))
            other = options.data / OTHER[name]
            before = diagnosed(folder / "cell", other, Path(room) / "before", "--max-findings", "1")
            cell = with_files(folder / "cell", out, Path(room) / "cell")
            after = diagnosed(cell, other, Path(room) / "after", "--max-findings", "1")
            a, b = (d["baseline"]["heldout_rmse"] for d in (before, after))
            print(f"  its files on {OTHER[name]}: {a:.3f} -> {b:.3f} mm")
            for note in after["notes"] + after["warnings"]:
                if "range" in note or "cover" in note:
                    print(f"    {note}")


if __name__ == "__main__":
    main()
