"""Identification of an arm with further compliances: the misfit is reported first, and intervals cover."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from simulated_hidden_effects import (
    ARCMIN,
    CELLS,
    HiddenEffects,
    arm,
    build_rough_backlash,
    load_tests,
    plan_load_tests,
    sine_knee,
)

from machopt.cli import main
from machopt.measurement.recording import write_recording
from machopt.numerics.array_types import Array

CELL = CELLS / "kr240_drilling"
TURN = np.ones(3)


def truths(k: Array) -> dict[str, dict[str, Any]]:
    """Return the additional compliances, by name; their deflection is a tenth to a third of that of the springs."""
    return {
        "nothing": {},
        "base, tilt": {"hinges": {0: 3e-8 * np.diag([1.0, 1.0, 0.0])}},
        "base, tilt and torsion": {"hinges": {0: 3e-8 * np.diag(TURN)}},
        "link 2": {"hinges": {2: 8e-8 * np.diag(TURN)}},
        "link 3": {"hinges": {3: 2e-7 * np.diag(TURN)}},
        "tool": {"hinges": {7: 1e-6 * np.diag(TURN)}},
        "gear": {"twist": {2: sine_knee(0.5 / k[2], 600.0)}},
        "play": {"twist": {1: build_rough_backlash(0.6 * ARCMIN, 0.2 * ARCMIN)}},
    }


def identify(folder: Path, seed: int, name: str, capsys: pytest.CaptureFixture[str] | None = None) -> Any:
    rng = np.random.default_rng(seed)
    a = arm(CELL.name)
    k = a.nominal * rng.uniform(0.8, 1.25, 6)
    own = np.random.default_rng(seed + 100)
    plan = plan_load_tests(a, own, poses=18, sessions=2, loads=3, directions=3, force=1500.0)
    write_recording(folder / "recording", load_tests(a, HiddenEffects(k, **truths(k)[name]), plan, own))
    quiet = [] if capsys else ["--quiet"]
    command = ["identify", str(CELL), str(folder / "recording"), "-o", str(folder / "out"), "--no-studies", "--force"]
    assert main([*command, *quiet]) == 0
    return k, json.loads((folder / "out" / "identification.json").read_text(encoding="utf-8"))


@pytest.mark.proof
def test_intervals_cover_the_as_built_joints(tmp_path: Path) -> None:
    """The 90 % intervals contain 85 % of the springs over all causes, two thirds per cause, and are narrow."""
    rates, width = [], []
    for name in truths(np.ones(6)):
        fixed = []
        for seed in (51, 52, 53):
            k, document = identify(tmp_path, seed, name)
            for joint in document["joints"]:
                low, high = joint["ci90"]
                true = k[joint["joint"] - 1]
                fixed.append(low <= true and (high is None or true <= high))
                width.append(np.inf if high is None else true / low - true / high)
            assert document["misfit"]["significant"] or name in ("nothing", "play", "gear")
            assert bool(document["misfit"]["next"]) == document["misfit"]["significant"]
        rates.append(np.mean(fixed))
    assert np.mean(rates) >= 0.85
    assert min(rates) >= 2 / 3
    assert np.median(width) < 0.1


def test_misfit_is_reported_first(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    k, document = identify(tmp_path, 51, "base, tilt and torsion", capsys)
    assert document["warnings"][0].startswith("joint springs alone do not explain the readings")
    assert capsys.readouterr().out.startswith("joint springs alone do not explain the readings")
    assert "machopt diagnose" in document["misfit"]["next"]
    assert document["misfit"]["noise_mm"] < document["misfit"]["left_mm"]
    base = next(s for s in document["inseparable"] if s["body"] == "base")
    low, high = base["sum_ci90_rad_per_Nm"]
    assert low <= 1.0 / k[0] + 3e-8 <= high
    assert base["joint_at_least_Nm_per_rad"] <= k[0]
    assert base["body_at_most_rad_per_Nm"] >= 3e-8
