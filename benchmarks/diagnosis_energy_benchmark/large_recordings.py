"""Records of the stranger's lab at the size of a night's measurement.

    python benchmarks/diagnosis_energy_benchmark/large_recordings.py [--only poses|motion] [--share S]

12,000 readings of poses (6,000 poses on two days) and 100,000 samples of a motion, each with one effect concealed,
diagnosed by the command line, page and files included. Prints wall and processor time, peak memory, and what was named
beside what is concealed. Goals: 60 s and 2 GiB for the poses, 30 s for the motion, on two cores of an ordinary machine.
"""

from __future__ import annotations

import argparse
import json
import os
import resource
import subprocess
import sys
import tempfile
from dataclasses import replace
from pathlib import Path
from time import perf_counter

sys.path.insert(0, str(Path(__file__).resolve().parent))
import channel_dispatch
import make_cases
import numpy as np
import recording_tables
import robot_models
from motion_recording import MOTION_LABS, STEP, Motion
from pose_recording import POSE_LABS, PoseSet

POSES, SAMPLES = 6000, 100_000
SEED = 7


def write(name: str, folder: Path, share: float) -> list[str]:
    """A cell and a recording with one effect concealed; says which."""
    rng = np.random.default_rng(SEED)
    nominal = (
        robot_models.draw("kr210", rng)
        if "kr210" in robot_models.CATALOGUE
        else robot_models.draw(next(iter(robot_models.CATALOGUE)), rng)
    )
    built = robot_models.as_built(nominal, rng)
    scene: PoseSet | Motion
    if name == "poses":
        scene = PoseSet(nominal, built, replace(POSE_LABS["fit"], poses=round(POSES * share)), rng)
        wanted = "transmission_error"
    else:
        lab = MOTION_LABS["torque"]
        scene = Motion(nominal, built, replace(lab, cycles=round(SAMPLES * share * STEP / lab.period)), rng)
        wanted = "payload"
    quiet = scene.clean([])
    effect = make_cases.pick(scene, (wanted, 1.5), quiet, set(), rng)
    robot_models.write_cell(nominal, folder / "cell")
    table = channel_dispatch.table(scene, scene.clean([effect]), rng)
    recording_tables.write(table, folder / "recording")
    rows = len(next(iter(table.columns.values())))
    return [f"{rows} rows", f"concealed {effect.effect} {effect.location} {effect.size():.3g} {effect.unit}"]


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--only", choices=("poses", "motion"))
    parser.add_argument("--share", type=float, default=1.0, help="of the size")
    options = parser.parse_args()
    for name in [options.only] if options.only else ["poses", "motion"]:
        with tempfile.TemporaryDirectory() as room:
            said = write(name, Path(room), options.share)
            print(f"{name}: {', '.join(said)}", flush=True)
            command = [sys.executable, "-m", "machopt.cli", "diagnose", "cell", "recording", "-o", "out", "--quiet"]
            before = resource.getrusage(resource.RUSAGE_CHILDREN)
            start = perf_counter()
            path = os.pathsep.join([str(Path(__file__).resolve().parents[2]), os.environ.get("PYTHONPATH", "")])
            code = subprocess.run(command, cwd=room, check=False, env={**os.environ, "PYTHONPATH": path}).returncode
            after = resource.getrusage(resource.RUSAGE_CHILDREN)
            used = after.ru_utime + after.ru_stime - before.ru_utime - before.ru_stime
            wall, memory = perf_counter() - start, after.ru_maxrss / 2**20
            print(f"  exit {code}, {wall:.1f} s, processor {used:.1f} s, {memory:.2f} GiB", flush=True)
            if code == 0:
                found = json.loads((Path(room) / "out" / "diagnosis.json").read_text(encoding="utf-8"))
                named = [f"{f['effect']} {f['location']} {f['parameters']}" for f in found["findings"]]
                print(f"  {found['verdict']}, {found['baseline']} -> {found['final']}: {named}")


if __name__ == "__main__":
    main()
