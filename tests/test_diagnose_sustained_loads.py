"""Sustained loads that are read repeatedly: drift of the force is no gain, creep is no noise."""

from __future__ import annotations

from dataclasses import fields, replace
from typing import Any

import numpy as np
from simulated_hidden_effects import CELLS, HiddenEffects, NoiseLevels, arm, load_tests, plan_load_tests

from machopt.cell.cell_reader import load_cell
from machopt.data_types.measurements.recording import Recording
from machopt.kinematics.urdf_loading import load_robot
from machopt.measurement.diagnosis.data_types.diagnosis_problem import DiagnosisProblem
from machopt.measurement.diagnosis.static import load_test_channel
from machopt.measurement.diagnosis.statistics import replicate_noise
from machopt.measurement.estimation.load_test_equations import build_load_test_experiment

CELL = "kr240_drilling"
TIMES, WHITE, FORCE = 3, 15e-6, 4.0  # readings per load; m and N, 1 sigma


def simulate_sustained_loads(crept: float) -> Recording:
    """Simulate each load read three times at one-minute intervals, with ``crept`` m more displacement along the load
    deflection each time."""
    rng = np.random.default_rng(11)
    a = arm(CELL)
    plan = plan_load_tests(a, rng, poses=14, loads=1, sessions=2)
    r = load_tests(a, HiddenEffects(a.nominal), plan, rng, NoiseLevels(white=0.0, cycle=0.0, visit=0.0, outliers=0.0))
    rows = np.repeat(np.arange(len(r)), TIMES)
    whole: dict[str, Any] = {}
    for f in fields(r):
        value = getattr(r, f.name)
        if isinstance(value, np.ndarray) and len(value) == len(r):
            whole[f.name] = value[rows]
    turn = np.tile(np.arange(TIMES), len(r))
    d = whole["displacement"].copy()
    along = d / np.linalg.norm(d[:, :3], axis=1, keepdims=True)
    d += crept * turn[:, None] * along + WHITE * rng.standard_normal(d.shape)
    w = whole["wrench"].copy()
    w[:, :3] += FORCE * rng.standard_normal((len(w), 3))
    whole |= {"displacement": d, "wrench": w, "time": whole["time"] + 60.0 * turn, "line": np.arange(2, len(w) + 2)}
    return replace(r, **whole)


def split(r: Recording) -> tuple[replicate_noise.ReplicateNoise, DiagnosisProblem]:
    cell = load_cell(CELLS / CELL)
    robot, T = load_robot(cell), cell.tool.T_flange_tcp
    problem, _, _ = load_test_channel.build_load_test_problem(
        r, build_load_test_experiment(r, robot, T), robot, T, None
    )
    A, y = problem.base.reshape(-1, problem.base.shape[2]), problem.y.reshape(-1)
    left = (y - A @ np.linalg.lstsq(A, y, rcond=None)[0]).reshape(problem.y.shape)
    return replicate_noise.estimate_replicate_noise(problem, left, np.ones(len(problem), bool)), problem


def test_constant_load_shows_no_gain_error() -> None:
    found, problem = split(simulate_sustained_loads(0.0))
    moved = float(np.abs(problem.y).max())
    assert found.replicated
    assert found.gain < 0.05
    assert found.total(0) < 3.0 * WHITE
    assert moved > 20.0 * WHITE  # a gain error of one would be far larger than this noise


def test_creep_at_constant_load_is_no_noise() -> None:
    still, _ = split(simulate_sustained_loads(0.0))
    crept, problem = split(simulate_sustained_loads(6.0 * WHITE))
    assert crept.reading[0] < 1.5 * still.reading[0]
    # only readings of the same order within a load are replicates
    turn = np.tile(np.arange(TIMES), len(problem) // TIMES)
    for label in np.unique(problem.replicate[problem.replicate >= 0]):
        assert len(np.unique(turn[problem.replicate == label])) == 1
