"""Random small jobs end with exit 0 in every post."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from property_example_count import NIGHTLY
from random_small_jobs import CELLS, POSTS, ROOT, UP, Row, choose_place_above_cut, random_job, write_job

from machopt.commands.optimize.request import OptimizeRequest
from machopt.commands.optimize.run import run_optimize

OF_RAILS = ("krl", "rapid", "jbi", "csv")  # posts that support external axes


def run(cell: str, toolpath: Path, out: Path, rng: np.random.Generator) -> int:
    """Plan with two posts and a random sample time and tolerance; return the exit code."""
    posts = rng.choice(OF_RAILS if CELLS[cell] in ("beam_passes.csv", "drum_holes.csv") else POSTS, 2, replace=False)
    options = ["force_N={normal: 100, axial: 50}"] if rng.random() < 0.5 else []
    options.append(f"sample_ms={rng.choice([4, 8, 12, 24, 50, 90])}")
    return run_optimize(
        OptimizeRequest(
            cell=ROOT / "cells" / cell,
            toolpath=toolpath,
            out=out,
            posts=tuple(posts.tolist()),
            overrides=tuple(options),
            program_tolerance_mm=float(rng.choice([0.02, 0.05, 0.1, 0.3])),
        )
    ).exit_code


def random_small_job(seed: int, folder: Path) -> int:
    rng = np.random.default_rng(seed)
    cell = list(CELLS)[seed % len(CELLS)]
    origin, axis = choose_place_above_cut(ROOT / "toolpaths" / CELLS[cell], rng)
    file = write_job(folder / f"job_{seed}.csv", random_job(rng), origin, axis)
    return run(cell, file, folder / f"out_{seed}", rng)


@pytest.mark.slow
# each cell with an arm alone; rail: see below; turntable: see the proofs
@pytest.mark.parametrize("seed", [0, 1, 2, 3, 32])
def test_random_small_job_is_verified(seed: int, tmp_path: Path) -> None:
    assert random_small_job(seed, tmp_path) == 0


@pytest.mark.proof
@pytest.mark.parametrize(
    "seed", [27, *range(100, 104), 105, 106, *(range(107, 200) if NIGHTLY else ())]
)  # each cell once; 27 is on the turntable, where a job takes long
def test_random_small_jobs_are_verified(seed: int, tmp_path: Path) -> None:
    assert random_small_job(seed, tmp_path) == 0


def run_cuts_along_rail(seed: int, folder: Path) -> int:
    """Plan two to five short cuts anywhere along the rail of the shipped cell; return the exit code."""
    rng = np.random.default_rng(seed)
    rows: list[Row] = []
    for _ in range(rng.integers(2, 6)):
        place = np.array([rng.uniform(-120, 120), rng.uniform(-900, 900), 0.0])
        length, angle = rng.uniform(30, 150), rng.uniform(0, 2 * np.pi)
        end = place + length * np.array([np.cos(angle), np.sin(angle), 0.0])
        rows += [Row(place + 80 * UP, UP, "rapid", None), Row(place + 6 * UP, UP, "rapid", None)]
        rows += [Row(place - UP, UP, "cut", 1000.0), Row(end - UP, UP, "cut", 3000.0)]
        rows.append(Row(end + 80 * UP, UP, "rapid", None))
    file = write_job(folder / "cuts.csv", rows, np.zeros(3), UP)
    request = OptimizeRequest(cell=ROOT / "cells" / "kr500_rail", toolpath=file, out=folder / "out", posts=("krl",))
    return run_optimize(request).exit_code


@pytest.mark.slow
def test_distant_cuts_on_a_rail_are_verified(tmp_path: Path) -> None:
    assert run_cuts_along_rail(13, tmp_path) == 0  # the index of the refined plan is 18 % below that of any grid plan


@pytest.mark.proof
@pytest.mark.parametrize("seed", range(40, 120 if NIGHTLY else 43))
def test_random_cuts_on_a_rail_are_verified(seed: int, tmp_path: Path) -> None:
    assert run_cuts_along_rail(seed, tmp_path) == 0
