"""Every correction of a recording has a sign and an axis, and reduces the error when its own equation is applied.

The formulas follow ``equation`` and ``parameters`` of diagnosis.json, and share no code with the laws.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from diagnosis_in_memory import diagnose_in_memory
from simulated_hidden_effects import CELLS, HiddenEffects, arm, load_tests, plan_load_tests

from machopt.cell.cell_reader import load_cell
from machopt.data_types.measurements.recording import Recording
from machopt.kinematics.urdf_loading import load_robot
from machopt.measurement.estimation.load_test_equations import build_load_test_experiment
from machopt.numerics.array_types import Array
from machopt.numerics.rigid_transforms import convert_vector_to_rotation

CELL = CELLS / "kr240_drilling"
Change = Callable[[Array], Array]


def simulate_changed_record(change: Callable[[Recording], Recording], *, six: bool = False) -> Recording:
    """Return load tests of an arm with other springs, modified by the change."""
    rng = np.random.default_rng(8)
    a = arm(CELL.name)
    plan = plan_load_tests(a, rng, poses=16, sessions=2, loads=3, directions=3, force=1500.0)
    return change(load_tests(a, HiddenEffects(a.nominal * rng.uniform(0.8, 1.25, 6)), plan, rng))


def misfit(recording: Recording) -> float:
    """Return the rms residual (m) after a fit of the springs."""
    cell = load_cell(CELL)
    tests = build_load_test_experiment(recording, load_robot(cell), cell.tool.T_flange_tcp)
    A, y = tests.response()[:, :3].reshape(-1, 6), tests.measured[:, :3].reshape(-1)
    return float(np.sqrt(np.mean((y - A @ np.linalg.lstsq(A, y, rcond=None)[0]) ** 2)))


def with_force(recording: Recording, of: Change) -> Recording:
    assert recording.wrench is not None
    wrench = recording.wrench.copy()
    wrench[:, :3] = of(wrench[:, :3])
    return replace(recording, wrench=wrench)


def axis_gain(axis: int, gain: float) -> Callable[[Recording], Recording]:
    return lambda r: with_force(r, lambda f: f * np.where(np.arange(3) == axis, 1.0 + gain, 1.0))


def offset(b: tuple[float, float, float]) -> Callable[[Recording], Recording]:
    return lambda r: with_force(r, lambda f: f + np.array(b))


def force_axes(about: tuple[float, float, float]) -> Callable[[Recording], Recording]:
    R = convert_vector_to_rotation(np.radians(about))
    return lambda r: with_force(r, lambda f: f @ R.T)


def displacement_axes(about: tuple[float, float, float]) -> Callable[[Recording], Recording]:
    R = convert_vector_to_rotation(np.radians(about))

    def turned(r: Recording) -> Recording:
        assert r.displacement is not None
        parts = [r.displacement[:, k : k + 3] @ R.T for k in range(0, r.displacement.shape[1], 3)]
        return replace(r, displacement=np.concatenate(parts, axis=1))

    return turned


def put_right(recording: Recording, finding: dict[str, Any]) -> Recording:
    """Apply the parameters of a finding by its equation."""
    p = {name: e["value"] for name, e in finding["parameters"].items()}
    effect = finding["effect"]
    if effect == "force_sensor_gain":
        return axis_gain(int(p["axis"]) - 1, 1.0 / (1.0 + p["gain"] / 100.0) - 1.0)(recording)
    if effect == "force_sensor_offset":
        return offset((-p["offset_x"], -p["offset_y"], -p["offset_z"]))(recording)
    turn = (-p["about_x"], -p["about_y"], -p["about_z"])
    return (force_axes if effect == "force_sensor_frame" else displacement_axes)(turn)(recording)


CASES = {  # gains of either sign; components of either sign in offsets and angles
    "gain +": ("force_sensor_gain", axis_gain(1, 0.08)),
    "gain of z -": ("force_sensor_gain", axis_gain(2, -0.06)),
    "offset": ("force_sensor_offset", offset((60.0, -40.0, 25.0))),
    "axes": ("force_sensor_frame", force_axes((2.0, -1.0, 1.5))),
    "displacement -": ("displacement_frame", displacement_axes((-1.5, 1.0, -2.0))),
}


@pytest.mark.parametrize("name", CASES)
def test_written_correction_lowers_the_error(name: str, tmp_path: Path) -> None:
    effect, change = CASES[name]
    recording, clean = simulate_changed_record(change), simulate_changed_record(lambda r: r)
    document = diagnose_in_memory(CELL, recording, tmp_path / "recording").result.to_json_types()
    found = [f for f in document["findings"] if f["effect"] == effect]
    assert found, [(f["effect"], f["location"]) for f in document["findings"]]
    before, after, least = misfit(recording), misfit(put_right(recording, found[0])), misfit(clean)
    assert after < before
    assert after - least < 0.35 * (before - least)  # most of the error that the fault had added
