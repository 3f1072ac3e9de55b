"""Coverage of the intervals of stiffness and damping from frequency responses that other code has simulated.

``python benchmarks/frequency_response_benchmark/run_frequency_response_benchmark.py [--cases 200] [--seed 1]
[--mass-percent 0] [--jobs 1]`` draws springs (1 σ of the logarithm 0.3 about the cell's), viscous damping, three poses
and noise anew for each case, simulates responses with ``arm_simulator`` (pinocchio and a direct solution, no import of
machopt), writes a recording and runs ``machopt identify``. With ``--mass-percent 5`` the masses of the true arm scatter
by 5 % (1 σ, each link), and the recording states it. Printed per group: the share of 90 % intervals with the truth
inside (expected 0.85 to 0.95), the medians of half width and error, and for joints that are not identified the share
whose one-sided bound holds.

Responses: forces and sensors along x, y, z of the base, 4 to 79 Hz in steps of 1.5 Hz, receptance with white noise of
10 % of its median and a coherence that follows from it, averaged over ten blows.
"""

from __future__ import annotations

import argparse
import io
import json
import math
import multiprocessing
import shutil
import sys
import tempfile
import time
from contextlib import redirect_stderr
from pathlib import Path

import numpy as np

sys.path.insert(0, str(Path(__file__).resolve().parent))
from arm_simulator import build_arm, simulate_responses

from machopt.cli import main as run_machopt

ROOT = Path(__file__).resolve().parents[2]
CELL = ROOT / "cells" / "kr500_milling"
SPRINGS = np.array([1.58e7, 6.12e6, 5.28e6, 4.66e5, 2.19e5, 3.49e5])  # N·m/rad, of the cell's stiffness.yaml
SCATTER = 0.3  # of log k and log d
FREQUENCY = np.arange(4.0, 80.1, 1.5)
PAIRS = ((0, 0), (1, 1), (2, 2), (0, 2))  # force, sensor
POSES, NOISE, BLOWS = 3, 0.1, 10
HOME, RANGE = np.radians([0, -90, 90, 0, 45, 0]), np.radians([60, 25, 25, 90, 40, 90])


def average_blows(H: np.ndarray, noise: float, rng: np.random.Generator) -> tuple[np.ndarray, np.ndarray]:
    """The mean of ten noisy receptances whose mean has the given noise, and the coherence that they make."""
    shape = (BLOWS, len(H))
    blows = H + noise * np.sqrt(BLOWS) * (rng.normal(size=shape) + 1j * rng.normal(size=shape))
    mean = blows.mean(axis=0)
    coherence = np.abs(mean) ** 2 / np.mean(np.abs(blows) ** 2, axis=0)
    return mean, np.minimum(coherence, 1.0)


def write_recording(folder: Path, rng: np.random.Generator, mass_percent: float) -> tuple[np.ndarray, np.ndarray]:
    """Write the recording of a case; returns stiffness and viscous damping of the joints."""
    sigma = mass_percent / 100.0
    arm = build_arm(CELL, 1.0 + sigma * rng.normal(size=6))
    k = SPRINGS * np.exp(SCATTER * rng.normal(size=6))
    d = 0.05 * k / (2.0 * np.pi * 30.0) * np.exp(SCATTER * rng.normal(size=6))
    (folder / "recording.yaml").write_text(
        "machopt_recording: 1\nkind: frf\ndata: data.csv\ndirection_frame: base\n"
        f"standard_uncertainty: {{mass_percent: {mass_percent}}}\n",
        encoding="utf-8",
    )
    joints = ",".join(f"q{n}_deg" for n in range(1, 7))
    axes = ",".join(f"{what}_{axis}" for what in ("excitation", "response") for axis in "xyz")
    lines = [f"pose,frequency_Hz,re_m_per_N,im_m_per_N,coherence,{joints},{axes}"]
    for pose in range(POSES):
        q = HOME + rng.uniform(-1.0, 1.0, 6) * RANGE
        for force, sensor in PAIRS:
            pair = np.eye(3)[force], np.eye(3)[sensor]
            H = simulate_responses(arm, q, pair, 2.0 * np.pi * FREQUENCY, k, d)
            mean, coherence = average_blows(H, NOISE * np.median(np.abs(H)), rng)
            for n, f in enumerate(FREQUENCY):
                numbers = [f, mean[n].real, mean[n].imag, coherence[n], *np.degrees(q), *pair[0], *pair[1]]
                lines.append(f"{pose + 1}," + ",".join(f"{v:.9g}" for v in numbers))
    (folder / "data.csv").write_text("\n".join(lines) + "\n", encoding="utf-8")
    return k, d


def evaluate_case(given: tuple[int, int, float]) -> dict[str, list[tuple[bool, float, float]]] | str:
    """Per group: inside, half width and error of the logarithm. A text where identify refuses."""
    seed, number, mass_percent = given
    rng = np.random.default_rng((seed, number))
    folder = Path(tempfile.mkdtemp())
    try:
        recording, out = folder / "recording", folder / "out"
        recording.mkdir()
        k, d = write_recording(recording, rng, mass_percent)
        errors = io.StringIO()
        with redirect_stderr(errors):
            code = run_machopt(["identify", str(CELL), str(recording), "-o", str(out), "--quiet"])
        if code:
            return f"case {number}: exit {code}: {errors.getvalue().strip()}"
        found = json.loads((out / "frequency_response.json").read_text(encoding="utf-8"))
    finally:
        shutil.rmtree(folder)
    rows: dict[str, list[tuple[bool, float, float]]] = {}
    for n, joint in enumerate(found["joints"]):
        low, high = joint["interval"]
        if joint["identified"]:
            half = 0.5 * np.log(high / low)
            error = abs(np.log(joint["k_Nm_per_rad"] / k[n]))
            rows.setdefault(f"stiffness {n + 1}", []).append((low <= k[n] <= high, half, error))
        else:
            rows.setdefault(f"bound {n + 1}", []).append((k[n] >= low, np.log(k[n] / low), 0.0))
        low, high = joint["damping_interval"]
        if low is not None and found["damping_law"] == "viscous":
            inside = low <= d[n] <= high
            rows.setdefault(f"damping {n + 1}", []).append(
                (inside, 0.5 * np.log(high / low), abs(np.log(joint["damping"] / d[n])))
            )
    rows["viscous law"] = [(found["damping_law"] == "viscous", found["variance_inflation"], 0.0)]
    return rows


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--cases", type=int, default=200)
    parser.add_argument("--seed", type=int, default=1)
    parser.add_argument("--mass-percent", type=float, default=0.0)
    parser.add_argument("--minutes", type=float, default=math.inf, help="stop after this time, with the cases done")
    parser.add_argument("--jobs", type=int, default=1)
    args = parser.parse_args()
    started, found, refused = time.perf_counter(), {}, []
    cases = [(args.seed, n, args.mass_percent) for n in range(args.cases)]
    done = 0
    with multiprocessing.get_context("spawn").Pool(args.jobs) as pool:
        for result in pool.imap(evaluate_case, cases):
            done += 1
            if isinstance(result, str):
                refused.append(result)
            else:
                for group, rows in result.items():
                    found.setdefault(group, []).extend(rows)
            if time.perf_counter() - started > 60.0 * args.minutes:
                break
    seconds = time.perf_counter() - started
    print(f"{done} cases, seed {args.seed}, masses {args.mass_percent:g} %, {seconds:.0f} s, refused {len(refused)}")
    print("group          intervals  inside  half width of the log  error (medians)")
    for group, rows in sorted(found.items()):
        inside, half, error = (np.array(column, float) for column in zip(*rows, strict=True))
        print(f"{group:14} {len(rows):9d} {inside.mean():7.3f} {np.median(half):22.4f} {np.median(error):16.4f}")
    for text in refused:
        print(text)


if __name__ == "__main__":
    main()
