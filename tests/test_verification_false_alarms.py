"""Correct plans verify: one small job per former false positive; all: benchmarks/verification_false_alarms.py."""

from __future__ import annotations

import sys
from pathlib import Path

import pytest

sys.path.insert(0, str(Path(__file__).resolve().parents[1] / "benchmarks"))

from verification_false_alarms import fixed_jobs, run

JOBS = {job.name: job for job in fixed_jobs()}


@pytest.mark.parametrize(
    "name",
    [
        "bare",  # retracts from the cut along the line of the following rapid move
        "one point between rapids",  # and along the line of the plunge
        "one point",  # no feed move at all
        # the direction of travel where the axis rotates; bits of an axis near zero; dwelling at corners
        "tilts default",
        "doubled points",  # repeated moves in the file
        "compensate plunge",  # a target between two samples of a fast move
        "compensate circle",  # the gain of a shifted path
        "zero offsets",  # the tool axis by nominal kinematics
    ],
)
def test_intact_plan_verifies(name: str, tmp_path: Path) -> None:
    found = run(JOBS[name], tmp_path, None, None)
    assert found is not None
    assert (found.optimize, found.verify, found.failing) == (0, 0, ()), found.said
