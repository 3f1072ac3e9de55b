"""Thresholds of diagnose, tested from both sides."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from simulated_hidden_effects import HiddenEffects, load_tests, plan_load_tests
from simulated_hidden_effects import arm as loaded_arm
from test_diagnose_model_selection import build_synthetic_problem, law
from test_diagnose_motion import arm as moved_arm
from test_diagnose_motion import build_fourier_motion, build_motion_recording
from test_diagnose_tcp_poses import arm as posed_arm
from test_diagnose_tcp_poses import measure

from machopt.cell.cell_reader import load_cell
from machopt.data_types.measurements.recording import Recording
from machopt.dynamics.rigid_body import load_dynamics
from machopt.errors import InputError
from machopt.kinematics.urdf_loading import load_robot
from machopt.measurement.diagnosis.data_quality.inconsistent_loads import correct_inconsistent_loads
from machopt.measurement.diagnosis.data_types.diagnosis_problem import HypothesisCatalogue
from machopt.measurement.diagnosis.dynamic import motion_record_checks
from machopt.measurement.diagnosis.dynamic.motion_record_checks import correct_torque_side
from machopt.measurement.diagnosis.model_selection import selection_pipeline
from machopt.measurement.diagnosis.motion_data.motion_signals import build_motion_signals
from machopt.measurement.diagnosis.static.measured_pose_model import NominalPoseModel
from machopt.measurement.diagnosis.statistics import holdout_residuals

CELLS = Path(__file__).resolve().parents[1] / "cells"


@pytest.mark.parametrize(("like", "frame", "body"), [(0.95, True, True), (0.72, True, False), (0.5, False, False)])
def test_frame_with_law_error_may_leave_more_than_a_body(like: float, frame: bool, body: bool) -> None:
    """An effect that explains less than the residual is not named; a frame may leave a larger residual than another
    effect."""
    named = []
    for effect in ("geometry", "wind"):
        rng = np.random.default_rng(5)
        problem, column = build_synthetic_problem(400, extra=40e-6)
        other = rng.standard_normal((len(column) // 2, *column.shape[1:]))
        near = like * column + np.sqrt(1.0 - like**2) * np.concatenate([other, other])
        found = selection_pipeline.diagnose_problem(
            problem, HypothesisCatalogue((law(near, effect),)), selection_pipeline.DiagnosisOptions(), rng
        )
        named.append(effect in {f.effect for f in found.findings})
    assert named == [frame, body]


@pytest.mark.parametrize(("left", "better"), [(0.6, True), (0.8, False)])
def test_few_groups_suffice_where_the_error_falls_by_half(left: float, better: bool) -> None:
    """Three groups with different results are no evidence, unless the error falls to half the power."""
    problem, _ = build_synthetic_problem(1)
    used = problem.group < 3
    rng = np.random.default_rng(2)
    before = rng.standard_normal(problem.y.shape)
    uneven = np.array([0.02, 1.05, 1.0])[np.minimum(problem.group, 2)][:, None]
    after = before * uneven
    after *= left / (holdout_residuals.compute_rms(after[used]) / holdout_residuals.compute_rms(before[used]))
    assert bool(holdout_residuals._is_family_better(problem, before, after, used, problem.families[0])) is better


def simulate_weights_recorded_upwards(share: float) -> Recording:
    """Simulate weights recorded as pulling upwards; at a share of the poses the arm really moved upwards."""
    a = loaded_arm("kr240_drilling")
    rng = np.random.default_rng(3)
    plan = plan_load_tests(a, rng, poses=10, directions=1)
    down = -np.linalg.norm(plan.wrench[:, :3], axis=1)
    plan = replace(plan, wrench=np.stack([0 * down, 0 * down, down, 0 * down, 0 * down, 0 * down], axis=1))
    r = load_tests(a, HiddenEffects(a.nominal), plan, rng)
    assert r.wrench is not None
    return replace(r, wrench=np.where((r.pose < share * 10)[:, None], -r.wrench, r.wrench))


@pytest.mark.parametrize(("share", "said"), [(1.0, True), (0.8, False)])
def test_displacement_against_the_load_is_reported_for_a_large_majority(share: float, said: bool) -> None:
    """Most readings oppose their load, with either sign of the load."""
    cell = load_cell(CELLS / "kr240_drilling")
    _, found = correct_inconsistent_loads(
        simulate_weights_recorded_upwards(share), load_robot(cell), cell.tool.T_flange_tcp
    )
    assert [f.effect for f in found] == ["load_geometry"]
    assert ("move against their load" in found[0].note) is said


@pytest.mark.parametrize(("rubs", "accepted"), [(40.0, True), (0.02, False)])
def test_balancer_may_exceed_the_masses_where_friction_has_the_correct_sign(
    tmp_path: Path, rubs: float, accepted: bool
) -> None:
    """Without friction, torque that opposes the masses has the wrong sign."""
    cell = moved_arm(tmp_path, 1)
    rng = np.random.default_rng(6)
    t, q, v, a = build_fourier_motion(1, rng, period=60.0, rate=20.0)
    dynamics = load_dynamics(cell)
    needed, weight = dynamics.compute_torque(q, v, a), dynamics.compute_torque(q, 0.0 * v, 0.0 * a)
    r = build_motion_recording(t, q, v, needed - 2.0 * weight + rubs * np.sign(v) + 0.5 * rng.standard_normal(q.shape))
    motion = build_motion_signals(r, 1)
    if accepted:
        assert correct_torque_side(r, motion, needed[motion.index])[1] == []
    else:
        with pytest.raises(InputError, match="runs against what the arm needs"):
            correct_torque_side(r, motion, needed[motion.index])


@pytest.mark.parametrize(("size", "column"), [(1e-3, "q"), (1.0, "velocity")])
def test_prismatic_values_within_a_few_millimetres_were_metres(size: float, column: str) -> None:
    """Of two columns with a ratio of 1000, the one within a few millimetres has the wrong unit."""
    t, q, v, a = build_fourier_motion(1, np.random.default_rng(1))
    scale = size / np.abs(q).max()
    r = replace(build_motion_recording(t, scale * q, 1e3 * scale * v, a), prismatic=(True,))
    found = motion_record_checks.correct_motion_units(r, 1)[1]
    assert [f.location for f in found] == [f"column:{motion_record_checks.format_column_name(r, column, 0)}"]


def test_generic_springs_are_assumed_where_no_cell_states_them() -> None:
    """The assumed values are ``unit_checks.GENERIC_STIFFNESS`` and ``ratios.implausible``."""
    cell, robot, masses = posed_arm()
    bare = replace(cell, stiffness=None)
    model = NominalPoseModel(measure(noise=10e-6), bare, robot, masses, frozenset())
    assert (model.nominal == 1e-6).all()
    first = model.fit_base()
    state = model.predict(first)[0]
    observed = model.build_readings(state, first, np.array([1e-9, 1e-7, 1e-6, 1e-4, 1e-2, 0.0])).compliance
    np.testing.assert_allclose(observed, [1e-7, 1e-7, 1e-6, 1e-4, 1e-2, 1e-7])
