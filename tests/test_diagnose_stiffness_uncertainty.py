"""Uncertainty of a diagnosed stiffness for a plan that has no load history."""

from __future__ import annotations

from dataclasses import replace
from types import SimpleNamespace
from typing import cast

import numpy as np
import simulated_load_tests as made

from machopt.data_types.stiffness import ArmStiffness, StiffnessTerm
from machopt.measurement.diagnosis.diagnosis_pipeline import DiagnosedRecording, read_load_test_masses
from machopt.measurement.diagnosis.effect_columns import joint_torque
from machopt.measurement.diagnosis.outputs.model_uncertainty import add_model_uncertainty
from machopt.measurement.diagnosis.static import load_test_channel
from machopt.measurement.estimation.load_test_equations import build_load_test_experiment
from machopt.planning.error_probability.model_discrepancy import DiscrepancyModel
from machopt.stiffness.arm_stiffness import ArmElasticity

PLAY = StiffnessTerm(
    "joint_hysteresis",
    "joint:1",
    {"law": "used_up", "half_clearance_arcmin": 2.0, "threshold_Nm": 900.0, "reach_Nm": 600.0, "memory": "session"},
)


def test_plan_uncertainty_includes_loads_explained_by_history() -> None:
    """A history-dependent law fitted the recording; a plan has no history, so its uncertainty was too small and the
    prediction 25 % off."""
    cell, robot, T = made.cell()
    masses, rng = read_load_test_masses(cell), np.random.default_rng(8)
    pull = rng.normal(size=(16, 1, 6)) * np.array([1.0, 1.0, 1.0, 0.0, 0.0, 0.0])
    pull = 1500.0 * pull / np.linalg.norm(pull, axis=2, keepdims=True) * np.array([0.4, 1.0])[:, None]
    recording = made.add_measurement_errors(made.plan_load_tests(rng, poses=16, wrench=pull), rng, outliers=0.0)
    tests = build_load_test_experiment(recording, robot, T)
    r = load_test_channel.build_load_test_readings(recording, tests, robot, T, masses, 1.0 / made.TRUE_K)
    lived, _ = joint_torque.compute_memory_term_displacement(r, (PLAY,))
    springs = ArmElasticity(robot, T, ArmStiffness(joints=made.TRUE_K)).evaluate(tests.state.q)
    moved = (springs.compute_twist(tests.wrench) + lived)[:, :3]
    recording = replace(recording, displacement=moved + rng.normal(0.0, made.WHITE, moved.shape))
    diagnosis = SimpleNamespace(used=np.ones(len(tests), bool), coefficients=())
    found = cast(DiagnosedRecording, SimpleNamespace(recording=recording, diagnosis=diagnosis))

    model_uncertainty = add_model_uncertainty(cell, found, ArmStiffness(joints=made.TRUE_K, terms=(PLAY,)))

    assert model_uncertainty is not None
    arm = ArmElasticity(robot, T, model_uncertainty, masses=masses, counted=True)
    doubt, q, w = DiscrepancyModel.build(arm), tests.state.q, tests.wrench
    assert doubt is not None
    off = arm.evaluate(q).compute_twist(w)[:, :3] - moved
    state = robot.compute_state(q, T, bodies=True)
    ways = (doubt.suspects.compute_columns(state, np.tile(made.TRUE_K, (len(q), 1)), w) @ doubt.ways.T)[:, :3]
    sigma = np.sqrt(np.sum(ways**2, axis=2) + (doubt.local * np.linalg.norm(w[:, :3], axis=1)[:, None]) ** 2)
    alone = ArmElasticity(robot, T, replace(model_uncertainty, discrepancy=None), masses=masses)
    before = alone.evaluate(q).compute_twist(w)[:, :3] - moved
    assert np.sqrt(np.mean(before**2)) > 3.0 * made.WHITE  # three times the noise: the history matters
    assert np.mean(np.abs(off) < 1.645 * sigma + made.WHITE) > 0.8
