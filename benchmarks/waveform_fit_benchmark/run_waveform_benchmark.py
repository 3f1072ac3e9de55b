"""Coverage of the intervals of waveform fits on cuts that other code has simulated.

``python benchmarks/waveform_fit_benchmark/run_waveform_benchmark.py [--cases 200] [--seed 1] [--jobs 1]`` draws
cutters,
coefficients, run-out, offsets and spindle speeds anew for each case, simulates cuts at three feeds with
``milling_simulator`` (exact trochoids, no import of machopt), adds coloured noise, writes a recording and fits it by
``machopt.fit_cutting_coefficients``. Printed, per group: the share of 90 % intervals with the truth inside (expected
0.85 to 0.95), the median half width relative to the truth, and the median error in half widths.

Noise: 2 % of the largest force, an autoregression of first order with coefficient 0.6. The stated spindle speed is off
by up to 0.3 %. Every second case has an encoder (column angle_deg).
"""

from __future__ import annotations

import argparse
import math
import multiprocessing
import shutil
import sys
import tempfile
import time
from pathlib import Path

import numpy as np

sys.path.insert(0, str(Path(__file__).resolve().parent))
from milling_simulator import SimulatedCut, simulate_forces

import machopt

ROOT = Path(__file__).resolve().parents[2]
CELL = ROOT / "cells" / "kr500_milling"
FEEDS = (0.04e-3, 0.07e-3, 0.11e-3)  # m per tooth
REVOLUTIONS, PER_REVOLUTION = 12, 48
NOISE, COLOUR = 0.02, 0.6
NAMES = ("Ktc", "Krc", "Kac", "Kte", "Kre", "Kae")


def draw_cuts(rng: np.random.Generator) -> tuple[list[SimulatedCut], float]:
    """The cuts of one case, one a feed, and the stated spindle speed in rev/s."""
    teeth = int(rng.integers(2, 5))
    diameter = rng.uniform(8e-3, 20e-3)
    side = str(rng.choice(["up", "down", "slot"]))
    common = {
        "teeth": teeth,
        "diameter": diameter,
        "helix": math.radians(rng.uniform(25.0, 45.0)),
        "ae": diameter if side == "slot" else rng.uniform(0.2, 0.7) * diameter,
        "ap": rng.uniform(2e-3, 5e-3),
        "side": side,
        "runout": rng.uniform(0.0, 15e-6),
        "runout_angle": rng.uniform(-1.0, 1.0) * math.pi / teeth,
        "coefficients": rng.uniform([500, 100, 80, 8, 8, 1], [1200, 350, 250, 30, 30, 6]),
    }
    stated = rng.uniform(50.0, 150.0)
    cuts = [
        SimulatedCut(
            feed_per_tooth=feed,
            speed=stated * (1.0 + rng.uniform(-0.003, 0.003)),
            offset=rng.uniform(0.0, 2.0 * math.pi),
            **common,
        )
        for feed in FEEDS
    ]
    return cuts, stated


def write_recording(folder: Path, cuts: list[SimulatedCut], stated: float, encoder: bool, rng) -> float:
    """Write the recording of a case; returns the offset of its encoder in rad (0 without)."""
    one = cuts[0]
    (folder / "recording.yaml").write_text(
        "machopt_recording: 1\nkind: cutting\ndata: data.csv\nwrench_frame: feed\nforce_on: tool\n"
        f"cut: {one.side}\ncutter: {{diameter_mm: {1e3 * one.diameter!r}, length_mm: 40, teeth: {one.teeth}, "
        f"helix_deg: {math.degrees(one.helix)!r}}}\n",
        encoding="utf-8",
    )
    zero = rng.uniform(-math.pi, math.pi)
    lines = [f"cut_number,{'angle_deg' if encoder else 'time_s'},spindle_rpm,feed_mm_min,ae_mm,ap_mm,fx_N,fy_N,fz_N"]
    for number, cut in enumerate(cuts, 1):
        rate = stated * PER_REVOLUTION * rng.uniform(0.9, 1.1)
        t = np.arange(int(REVOLUTIONS * rate / stated)) / rate
        force = simulate_forces(cut, t)
        noise = rng.normal(size=force.shape) * NOISE * np.abs(force).max()
        for n in range(1, len(noise)):
            noise[n] += COLOUR * noise[n - 1]
        force = force + noise
        angle = np.degrees(2.0 * math.pi * cut.speed * t + cut.offset - zero)
        first = angle if encoder else t
        feed = cut.feed_per_tooth * cut.teeth * stated * 6e4
        for n in range(len(t)):
            values = ",".join(
                f"{v:.9g}" for v in (first[n], 60.0 * stated, feed, 1e3 * cut.ae, 1e3 * cut.ap, *force[n])
            )
            lines.append(f"{number},{values}")
    (folder / "data.csv").write_text("\n".join(lines) + "\n", encoding="utf-8")
    return zero


def evaluate_case(seed: tuple[int, int]) -> dict[str, list[tuple[bool, float, float]]] | str:
    """Per group: inside, half width relative to the truth, error in half widths. A text where the fit refuses."""
    rng = np.random.default_rng(seed)
    cuts, stated = draw_cuts(rng)
    encoder = seed[1] % 2 == 1
    folder = Path(tempfile.mkdtemp())
    try:
        zero = write_recording(folder, cuts, stated, encoder, rng)
        result = machopt.fit_cutting_coefficients(CELL, folder, material="m").result
    except machopt.InputError as problem:
        return f"case {seed[1]}: {problem}"
    finally:
        shutil.rmtree(folder)
    out: dict[str, list[tuple[bool, float, float]]] = {}
    truth, pitch = cuts[0].coefficients, 2.0 * math.pi / cuts[0].teeth

    def add(group: str, low: float, high: float, value: float, scale: float) -> None:
        half = 0.5 * (high - low)
        out.setdefault(group, []).append((low <= value <= high, half / scale, abs(0.5 * (low + high) - value) / half))

    for n, entry in enumerate(result.coefficients):
        if not entry.fixed:
            add(entry.name, *entry.interval, truth[n], truth[n])
    runout = result.waveform.runout
    add("run-out", *(v * 1e-3 for v in runout.interval_mm), cuts[0].runout, 1e-5)
    if runout.angle_deg is not None:
        low, high = runout.angle_interval_deg
        turned = (math.degrees(cuts[0].runout_angle) - 0.5 * (low + high)) % math.degrees(pitch)
        turned = min(turned, math.degrees(pitch) - turned)
        add("run-out angle", -0.5 * (high - low), 0.5 * (high - low), turned, 10.0)
    for cut, entry in zip(cuts, result.waveform.cuts, strict=True):
        true = math.degrees(cut.offset if not encoder else zero)
        off = (true - entry.offset_deg) % math.degrees(pitch)
        off = min(off, math.degrees(pitch) - off)
        half = 1.6449 * entry.offset_sigma_deg
        if not encoder or cut is cuts[0]:
            add("offset", -half, half, off, 1.0)
    out["misfit"] = [(not result.waveform.misfit_significant, result.waveform.misfit_ratio, 0.0)]
    return out


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--cases", type=int, default=200)
    parser.add_argument("--seed", type=int, default=1)
    parser.add_argument("--jobs", type=int, default=1)
    args = parser.parse_args()
    started, found, refused = time.perf_counter(), {}, []
    seeds = [(args.seed, n) for n in range(args.cases)]
    with multiprocessing.get_context("spawn").Pool(args.jobs) as pool:
        for result in pool.imap(evaluate_case, seeds):
            if isinstance(result, str):
                refused.append(result)
                continue
            for group, rows in result.items():
                found.setdefault(group, []).extend(rows)
    print(f"{args.cases} cases, seed {args.seed}, {time.perf_counter() - started:.0f} s, refused {len(refused)}")
    print("group           intervals  inside  half width  error/half width (medians)")
    for group, rows in found.items():
        inside, half, error = (np.array(column, float) for column in zip(*rows, strict=True))
        print(f"{group:15} {len(rows):9d} {inside.mean():7.3f} {np.median(half):11.4f} {np.median(error):11.3f}")
    print("half width: relative to the truth; run-out per 0.01 mm, run-out angle per 10°, offset in degrees")
    for text in refused:
        print(text)


if __name__ == "__main__":
    main()
