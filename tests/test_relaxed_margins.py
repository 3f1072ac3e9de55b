"""Relaxing a margin, a weight or a lock never makes a feasible job infeasible."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from random_small_jobs import CELLS, ROOT, choose_place_above_cut, random_job, write_job

from machopt.commands.optimize.request import OptimizeRequest
from machopt.commands.optimize.run import run_optimize

STRICT = (
    "singularity_wrist_deg=6",
    "singularity_elbow_deg=4",
    "singularity_shoulder_mm=60",
    "limit_margin_deg=2",
    "clearance_mm=4",
)
RELAXED = (
    "singularity_wrist_deg=3",
    "singularity_elbow_deg=1",
    "singularity_shoulder_mm=10",
    "limit_margin_deg=0",
    "clearance_mm=0.02",
    "weights.travel=0",
    "weights.rotation=0",
    "weights.feed=0",
    "weights.worst=0",
    "rotation_step_deg=2.5",
)


def exit_code(cell: str, job: Path, out: Path, options: tuple[str, ...]) -> int:
    return run_optimize(OptimizeRequest(cell=ROOT / "cells" / cell, toolpath=job, out=out, overrides=options)).exit_code


def find_lost_options(seed: int, folder: Path, cells: list[str]) -> list[str]:
    """Return the options with which a job is infeasible although it is feasible with stricter ones."""
    rng = np.random.default_rng(seed)
    cell = cells[seed % len(cells)]
    origin, axis = choose_place_above_cut(ROOT / "toolpaths" / CELLS[cell], rng)
    job = write_job(folder / "job.csv", random_job(rng, ("line", "arc", "pivot", "zigzag")), origin, axis)
    if exit_code(cell, job, folder / "strict", STRICT) != 0:
        return []
    codes = {o: exit_code(cell, job, folder / f"relaxed_{n}", (*STRICT, o)) for n, o in enumerate(RELAXED)}
    return [option for option, code in codes.items() if code != 0]


@pytest.mark.slow
def test_relaxed_options_keep_a_job_feasible(tmp_path: Path) -> None:
    assert find_lost_options(2, tmp_path, ["kr500_milling"]) == []


@pytest.mark.proof
@pytest.mark.parametrize("seed", [10, 12])
def test_relaxed_options_keep_jobs_feasible(seed: int, tmp_path: Path) -> None:
    assert (
        find_lost_options(seed, tmp_path, ["kr500_milling", "irb6700_drilling", "cutting_cobot", "kr240_drilling"])
        == []
    )
