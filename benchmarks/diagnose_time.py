"""Load tests of an arm that conceals nothing, diagnosed whole: search, limits and proof, without files and page.

Run: ``python benchmarks/diagnose_time.py``. Prints seconds and peak memory for 1,000 and 10,000 readings, of 3 and 6
coordinates, and what was named (nothing is concealed).
"""

from __future__ import annotations

import resource
import sys
import time
from pathlib import Path

import numpy as np

ROOT = Path(__file__).resolve().parents[1]
sys.path[:0] = [str(ROOT), str(ROOT / "tests")]

from simulated_arm import TrueArm, random_loads, record, scattered_poses  # noqa: E402

from machopt.cell.cell_reader import load_cell  # noqa: E402
from machopt.kinematics.urdf_loading import load_masses, load_robot  # noqa: E402
from machopt.measurement.diagnosis.model_selection import selection_pipeline  # noqa: E402
from machopt.measurement.diagnosis.static import load_test_channel  # noqa: E402
from machopt.measurement.estimation.load_test_equations import build_load_test_experiment  # noqa: E402

CELL = ROOT / "cells" / "kr240_drilling"
TRUE_K = np.array([3.8e6, 6.6e6, 3.9e6, 5.6e5, 6.6e5, 4.7e5])  # N·m/rad
LOADS, CYCLES = 10, 5


def main() -> None:
    cell = load_cell(CELL)
    robot, T, masses = load_robot(cell), cell.tool.T_flange_tcp, load_masses(cell)
    for count in (20, 200):
        for rotations in (False, True):
            rng = np.random.default_rng(0)
            poses = scattered_poses(
                robot, rng, count, np.radians([0, -80, 100, 30, 60, 30]), np.radians([40, 30, 30, 60, 40, 90])
            )
            loads = random_loads(rng, count, LOADS, 1500.0, 150.0)
            made = record(TrueArm(robot, T, 1.0 / TRUE_K), poses, loads, rng, repeats=CYCLES, rotations=rotations)
            start = time.perf_counter()
            tests = build_load_test_experiment(made.recording, robot, T)
            problem, catalogue, _ = load_test_channel.build_load_test_problem(made.recording, tests, robot, T, masses)
            found = selection_pipeline.diagnose_problem(
                problem, catalogue, selection_pipeline.DiagnosisOptions(predicted="load tests"), rng
            )
            seconds = time.perf_counter() - start
            peak = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / 1024
            named = [(f.effect, f.location) for f in found.findings]
            print(
                f"{len(problem)} readings of {problem.dimensions} coordinates, {found.tried} laws × shapes: "
                f"{seconds:.1f} s, peak so far {peak:.0f} MB, {found.verdict}, named {named}"
            )


if __name__ == "__main__":
    main()
