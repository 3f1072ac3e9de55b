"""10,000 load tests of 6 coordinates identified whole: check, fit, uncertainty, unseen poses, influence, studies.

Run: ``python benchmarks/identify_time.py``. Prints seconds and peak memory, and the seconds of the fit with its
uncertainty alone.
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
from machopt.data_types.stiffness import ArmStiffness  # noqa: E402
from machopt.kinematics.urdf_loading import load_robot  # noqa: E402
from machopt.measurement.estimation.load_test_equations import build_load_test_experiment  # noqa: E402
from machopt.measurement.identification.assessment.coefficient_uncertainty import compute_coefficient_uncertainty  # noqa: E402
from machopt.measurement.identification.fitting.weighted_fit import fit_stiffness  # noqa: E402
from machopt.measurement.identification.identification_pipeline import identify_stiffness  # noqa: E402
from machopt.measurement.identification.options import IdentifyOptions  # noqa: E402

CELL = ROOT / "cells" / "kr240_drilling"
TRUE_K = np.array([3.8e6, 6.6e6, 3.9e6, 5.6e5, 6.6e5, 4.7e5])  # N·m/rad
POSES, LOADS, CYCLES = 200, 10, 5
RUNS = 3


def main() -> None:
    cell = load_cell(CELL)
    robot, T = load_robot(cell), cell.tool.T_flange_tcp
    rng = np.random.default_rng(0)
    poses = scattered_poses(
        robot, rng, POSES, np.radians([0, -80, 100, 30, 60, 30]), np.radians([40, 30, 30, 60, 40, 90])
    )
    arm = TrueArm(robot, T, 1.0 / TRUE_K)
    made = record(arm, poses, random_loads(rng, POSES, LOADS, 1500.0, 150.0), rng, repeats=CYCLES, rotations=True)
    before = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / 1024
    print(f"{len(made.recording)} readings of 6 coordinates: {POSES} poses × {LOADS} loads × {CYCLES} cycles")
    for run in range(RUNS):
        start = time.perf_counter()
        e = build_load_test_experiment(made.recording, robot, T)
        alone = time.perf_counter()
        sure = compute_coefficient_uncertainty(fit_stiffness(e))
        fitted = time.perf_counter()
        found = identify_stiffness(
            e, robot, T, ArmStiffness(joints=TRUE_K), IdentifyOptions(), np.random.default_rng(0)
        )
        end = time.perf_counter()
        print(
            f"run {run + 1}: experiment and whole identification {end - fitted + alone - start:.2f} s; "
            f"fit with uncertainty alone {fitted - alone:.2f} s"
        )
    peak = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / 1024
    print(f"peak memory {peak:.0f} MB, {peak - before:.0f} MB more than before the first run")
    wrong = np.array([j.k for j in found.joints]) / TRUE_K - 1
    error = sure.sigma[:6] * TRUE_K
    print(
        "joint: error, standard error in %: "
        + ", ".join(
            f"{j + 1}: {100 * w:+.2f}, {100 * s:.2f}" for j, (w, s) in enumerate(zip(wrong, error, strict=True))
        )
    )


if __name__ == "__main__":
    main()
