"""Time of retiming and share of time at the programmed feed: ``python benchmarks/retiming_time.py``.

A KR500-like arm, jerk limits of 2,000–6,000 °/s³, 1,500 mm/min. Times are the second of two runs (compiled code is
loaded by the first).
"""

from __future__ import annotations

import sys
from pathlib import Path
from time import perf_counter

import numpy as np

sys.path.insert(0, str(Path(__file__).resolve().parents[1] / "tests"))
from test_retiming import make, zigzag

from machopt.planning.retiming.run_retiming import RunTrajectory, retime_run


def loop(n: int, step: float):  # type: ignore[no-untyped-def]
    t = np.arange(n) * step / 0.12
    position = np.column_stack([0.12 * np.sin(t), 0.1 * (1 - np.cos(t)), 0.02 * np.sin(2 * t)])
    return position, np.column_stack([0.25 * np.sin(t), 0.2 * np.cos(t) - 0.2, np.ones(n)])


def polygon(n: int):  # type: ignore[no-untyped-def]
    t = np.arange(n) * np.pi / 6
    return np.column_stack([0.01 * np.cos(t), 0.01 * np.sin(t), 0 * t])


def main() -> None:
    noise = np.random.default_rng(0).uniform(-2e-6, 2e-6, (5000, 3))
    position, axis = loop(5000, 0.0003)
    runs = {
        "1,000 points, 2 mm apart": make(*loop(1000, 0.002)),
        "10,000 points, 2 mm apart": make(*loop(10_000, 0.002)),
        "10,000 points, 0.2 mm apart": make(*loop(10_000, 0.0002)),
        "5,000 points, 0.3 mm, ±2 µm": make(position + noise, axis),
        "zigzag, 90° corners": make(zigzag()),
        "polygon, 30° corners, 5 mm": make(polygon(100)),
    }
    print(f"{'run':<30}{'points':>8}{'motion s':>10}{'samples':>9}{'time s':>8}{'feed held':>11}{'dips':>6}")
    for name, run in runs.items():
        for _ in range(2):
            start = perf_counter()
            out = retime_run(run)
            took = perf_counter() - start
        if not isinstance(out, RunTrajectory):
            raise SystemExit(f"{name}: {out}")
        print(
            f"{name:<30}{len(run.position):>8}{out.duration:>10.1f}{len(out.q):>9}{took:>8.2f}{out.held_share:>11.1%}"
            f"{len(out.dips):>6}"
        )


if __name__ == "__main__":
    main()
