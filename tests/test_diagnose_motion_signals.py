"""Recorded motion signals: refusals, periods, requirements of the channels."""

from __future__ import annotations

import re
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from test_diagnose_motion import arm, build_fourier_motion, build_motion_recording

from machopt.cell.cell_reader import load_cell
from machopt.data_types.cell import Cell
from machopt.data_types.measurements.recording import Recording
from machopt.dynamics.rigid_body import load_dynamics
from machopt.effects import registry
from machopt.errors import InputError
from machopt.kinematics.urdf_loading import load_robot
from machopt.measurement.diagnosis import diagnosis_pipeline
from machopt.measurement.diagnosis.dynamic import (
    exchanged_torque_columns,
    friction,
    link_mass_uncertainty,
    motion_channels,
)
from machopt.measurement.diagnosis.dynamic.motion_record_checks import correct_torque_side, fit_slope
from machopt.measurement.diagnosis.dynamic.servo_lag import find_servo_lag
from machopt.measurement.diagnosis.model_selection.selection_pipeline import DiagnosisOptions
from machopt.measurement.diagnosis.motion_data.motion_signals import build_motion_signals

CELLS = Path(__file__).resolve().parent.parent / "cells"


def simulate_joint_motion(joints: int = 1, seed: int = 3, **more) -> Recording:
    t, q, v, _ = build_fourier_motion(joints, np.random.default_rng(seed), **more)
    return build_motion_recording(t, q, v)


def test_recording_without_a_running_clock_is_refused() -> None:
    r = simulate_joint_motion(periods=2)
    assert r.time is not None
    still, lone = r.time.copy(), np.arange(len(r.time))
    still[700] = still[699]
    for wrong, output in (
        (replace(r, time=None), "a motion needs the column time_s"),
        (replace(r, session=lone), "one sample a session"),
        (replace(r, time=still), "time does not advance at .*every sample needs its own time_s"),
        (replace(r, time=r.time + 5.0 * (lone // 20)), "no stretch without a gap lasts"),
    ):
        with pytest.raises(InputError, match=output):
            build_motion_signals(wrong, 1)


def test_short_segments_are_left_out_and_positions_differentiated() -> None:
    """The last half second after a gap is too short for a segment; q̇ differentiated from the encoders equals that
    of the motion."""
    t, q, v, _ = build_fourier_motion(1, np.random.default_rng(4), periods=2)
    late = t + 3.0 * (np.arange(len(t)) >= len(t) - 20)
    m = build_motion_signals(replace(build_motion_recording(late, q, v), velocity=None), 1)
    assert len(m.q) == len(t) - 20
    assert any("20 samples in stretches shorter than" in n for n in m.notes)
    assert any("velocity differentiated" in n for n in m.notes)
    np.testing.assert_allclose(m.v[100:-100, 0], v[100 : len(m.q) - 100, 0], atol=0.01 * np.ptp(v))


@pytest.mark.parametrize("by", [0.0, 0.03, -0.017, 0.2, -0.2, 1e3, -1e3])
def test_delays_shift_by_fractional_samples_with_constant_ends(by: float) -> None:
    r = simulate_joint_motion(2, periods=2)
    m = build_motion_signals(r, 2)
    x = np.stack([np.sin(0.7 * m.time), np.cos(0.4 * m.time)], axis=1)
    late = m.delay_cubic(x, by)
    t = np.clip(m.time - by, m.time[0], m.time[-1])
    away = (m.time - by > m.time[2]) & (m.time - by < m.time[-3])
    np.testing.assert_allclose(late[away], np.stack([np.sin(0.7 * t), np.cos(0.4 * t)], axis=1)[away], atol=1e-6)
    beyond = (m.time - by < m.time[0] - 0.1) | (m.time - by > m.time[-1] + 0.1)
    fixed = x[0] if by > 0 else x[-1]
    np.testing.assert_allclose(late[beyond], np.broadcast_to(fixed, late[beyond].shape), atol=1e-12)


def test_periods_follow_repeating_labels() -> None:
    """Labels define the periods; labels that do not repeat or have unequal lengths are ignored, and the signal shape
    defines them."""
    r, each = simulate_joint_motion(periods=4), 600
    label = np.arange(len(r)) // each
    named = build_motion_signals(replace(r, cycle=label, stated_labels=frozenset({"cycle"})), 1)
    assert named.length == pytest.approx(6.0)
    np.testing.assert_array_equal(named.period, label[named.index])
    for wrong in (np.arange(len(r)) // 450, np.minimum(np.arange(len(r)) // 300, 2)):
        shaped = build_motion_signals(replace(r, cycle=wrong, stated_labels=frozenset({"cycle"})), 1)
        assert shaped.length == pytest.approx(6.0, abs=0.02)
    drifting = replace(r, q=np.linspace(0.0, 2.0, len(r))[:, None] + 0.01 * r.q)
    assert build_motion_signals(drifting, 1).length == 0.0
    assert build_motion_signals(r, 1, repeats=False).length == 0.0


def test_missing_channel_is_refused_with_its_requirements(tmp_path: Path) -> None:
    cell, r = arm(tmp_path, 2), simulate_joint_motion(2)
    rng = np.random.default_rng(0)
    with pytest.raises(InputError, match=r"qse1_deg … are needed for the channel link"):
        motion_channels.build_motion_problem(r, cell, "link", rng)
    with pytest.raises(InputError, match=r"needs an arm of six joints or more; the cell has 2"):
        motion_channels.build_motion_problem(replace(r, position=np.zeros((len(r), 3))), cell, "tip", rng)
    with pytest.raises(InputError, match=r"needs tau1_Nm … and a URDF with inertias"):
        motion_channels.build_motion_problem(r, cell, "torque", rng)
    with pytest.raises(InputError, match=r"a toolpath needs an arm of six revolute joints"):
        diagnosis_pipeline.diagnose_motion_recording(
            cell, r, DiagnosisOptions(), requested_channel="auto", seed=0, toolpath=True
        )
    with pytest.raises(InputError, match=r"current1_A, current2_A never change: .*currents of all joints"):
        diagnosis_pipeline.diagnose_motion_recording(
            cell,
            replace(r, current=np.ones_like(r.q)),
            DiagnosisOptions(),
            requested_channel="auto",
            seed=0,
            toolpath=False,
        )
    assert r.time is not None
    tau = load_dynamics(cell).compute_torque(r.q, r.velocity, np.gradient(r.velocity, r.time, axis=0))
    with pytest.raises(InputError, match=r"found link; this recording allows torque"):
        diagnosis_pipeline.diagnose_motion_recording(
            cell, replace(r, torque=tau), DiagnosisOptions(), requested_channel="link", seed=0, toolpath=False
        )
    assert exchanged_torque_columns.correct_exchanged_torques(r, build_motion_signals(r, 2), tau) == (r, [])
    assert correct_torque_side(r, build_motion_signals(r, 2), tau) == (r, [])


def test_line_through_a_constant_has_no_slope() -> None:
    assert fit_slope(np.ones(9), np.arange(9.0)) == (0.0, 0.0)
    assert fit_slope(np.arange(9.0), 3.0 * np.arange(9.0)) == pytest.approx((3.0, 1.0))


def massless(folder: Path) -> Cell:
    """Return a two-joint arm whose URDF has no inertias."""
    cell = arm(folder, 2)
    cell.urdf.write_text(re.sub("<inertial>.*?</inertial>", "", cell.urdf.read_text()))
    return cell


def test_link_side_encoders_without_inertias_use_the_recorded_torque(tmp_path: Path) -> None:
    """Springs of 1e-6 and 2e-6 rad/(N·m) are estimated from the recorded torque, whose friction has its own columns."""
    t, q, v, a = build_fourier_motion(2, np.random.default_rng(6))
    tau = load_dynamics(arm(tmp_path, 2)).compute_torque(q, v, a)
    cell = massless(tmp_path)
    r = replace(build_motion_recording(t, q, v, tau), q_secondary=q - tau * [1e-6, 2e-6] + 1e-9)
    problem, catalogue, notes, _ = motion_channels.build_motion_problem(r, cell, "link", np.random.default_rng(0))
    names = [u.name for u in problem.unknowns]
    assert any("recorded torque, smoothed" in n for n in notes)
    assert names[4:] == [f"friction in the torque {j}, {k}" for j in (1, 2) for k in ("Coulomb", "viscous")]
    A = problem.base.reshape(-1, problem.base.shape[2])
    size = np.linalg.norm(A, axis=0)
    x = np.linalg.lstsq(A / size, problem.y.reshape(-1), rcond=1e-12)[0] / size
    assert x[names.index("compliance 1")] == pytest.approx(1e-6, rel=0.02)
    assert x[names.index("compliance 2")] == pytest.approx(2e-6, rel=0.02)
    bare, left, _, _ = motion_channels.build_motion_problem(
        replace(r, torque=None), cell, "link", np.random.default_rng(0)
    )
    assert [u.name for u in bare.unknowns] == ["offset 1", "offset 2"]
    why = "neither torques are recorded nor does the URDF have inertias"
    assert {u.effect for u in left.untestable if u.reason == why} >= {"joint_hysteresis", "joint_nonlinear_stiffness"}
    angles = {e.name for e in registry.EFFECTS.values() if e.port == "angle"}  # these effects do not depend on a load
    assert {"transmission_error", "time_skew"} <= {h.effect for h in left.hypotheses} <= {"time_skew", *angles}
    assert "joint_hysteresis" in {h.effect for h in catalogue.hypotheses}


def test_lost_or_constant_second_encoder_is_ignored(tmp_path: Path) -> None:
    cell, r = massless(tmp_path), simulate_joint_motion(2)
    lost = np.column_stack([r.q[:, 0], np.full(len(r), np.nan)])
    problem, *_ = motion_channels.build_motion_problem(
        replace(r, q_secondary=lost), cell, "link", np.random.default_rng(0)
    )
    assert problem.dimensions == 1
    still = replace(r, q=r.q * [1.0, 0.0], q_secondary=r.q)
    problem, *_ = motion_channels.build_motion_problem(still, cell, "link", np.random.default_rng(0))
    assert problem.dimensions == 1
    assert motion_channels.list_testable_channels(replace(r, q_secondary=0.0 * r.q), cell) == ()


def test_tracked_tcp_without_known_loads_has_no_base_compliance(tmp_path: Path) -> None:
    """Without inertias and torques, the base has no compliances and the catalogue no joint torque laws; both are
    reported."""
    path = CELLS / "kr240_drilling"
    cell = load_cell(path)
    urdf = tmp_path / "bare.urdf"
    urdf.write_text(re.sub("(?s)<inertial>.*?</inertial>", "", cell.urdf.read_text()))
    cell, robot = replace(cell, urdf=urdf), load_robot(cell)
    t, q, v, _ = build_fourier_motion(6, np.random.default_rng(9), periods=2, rate=50.0)
    q = 0.5 * q + cell.home[:6]
    r = replace(build_motion_recording(t, q, 0.5 * v), position=robot.compute_fk(q, cell.tool.T_flange_tcp)[:, :3, 3])
    problem, catalogue, *_ = motion_channels.build_motion_problem(r, cell, "tip", np.random.default_rng(0))
    assert not any("compliance" in u.name for u in problem.unknowns)
    assert {"joint_backlash", "servo_lag"} <= {u.effect for u in catalogue.untestable}
    assert not {h.effect for h in catalogue.hypotheses} & {e.name for e in registry.select_joint_torque_effects()}
    assert np.abs(problem.y).max() < 1e-9  # the measured TCP equals the nominal TCP


def test_warming_follows_the_recorded_temperature_or_time(tmp_path: Path) -> None:
    cell, r = massless(tmp_path), simulate_joint_motion(2)
    m = build_motion_signals(r, 2)
    warm_one = np.linspace(20.0, 30.0, len(r))
    for temperature, shapes in ((None, ((15.0,),)), (np.full(len(r), 20.5), ((15.0,),)), (warm_one, ((0.0,),))):
        scene = motion_channels._build_motion_model(replace(r, temperature=temperature), cell, m, None, None)
        assert friction.list_warming_shapes(scene) == shapes
    np.testing.assert_allclose(friction.compute_joint_warmth(scene, 0.0), (warm_one[m.index] - 20.0) / 10.0, atol=0.01)
    risen = friction.compute_joint_warmth(motion_channels._build_motion_model(r, cell, m, None, None), 10.0)
    np.testing.assert_allclose(risen, 1.0 - np.exp(-(m.time - m.time[0]) / 10.0), rtol=1e-12)
    still = replace(m, q=0.0 * m.q)
    assert (
        friction.build_friction_hypotheses(
            motion_channels._build_motion_model(r, cell, still, None, None), 0, friction.FrictionReversal
        )
        == []
    )  # type: ignore[arg-type]


def test_constant_command_has_no_lag(tmp_path: Path) -> None:
    """One joint lags by 20 ms and is reported; a joint with a constant command is not."""
    t, q, v, _ = build_fourier_motion(2, np.random.default_rng(7))
    commanded = np.column_stack([q[:, 0] + 0.02 * v[:, 0], np.zeros(len(t))])
    r = build_motion_recording(t, q * [1.0, 0.0], v * [1.0, 0.0])
    assert find_servo_lag(r, build_motion_signals(r, 2)) == []
    (found,) = find_servo_lag(replace(r, q_command=commanded), build_motion_signals(r, 2))
    assert found.effect == "servo_lag"
    assert next(iter(found.parameters.values())).value == pytest.approx(20.0, rel=0.05)


def test_stated_masses_are_preferred_where_compensator_and_gains_explain_as_much() -> None:
    """The residual of the payload was attributed to the links, although it required a change of 15 % in three link
    masses."""
    rng = np.random.default_rng(8)
    n, joints = 720, 3
    group = np.arange(n) * 12 // n
    load, links = rng.normal(size=(n, joints, 4)), 100.0 * rng.normal(size=(n, joints, 3))
    balancer = links @ np.array([0.15, -0.15, 0.15])
    rivals = np.concatenate([load, balancer[:, :, None]], axis=2)
    base = np.zeros((n, joints, joints))
    base[:, np.arange(joints), np.arange(joints)] = 1.0
    noise = 20.0 * rng.normal(size=(n, joints))
    assert link_mass_uncertainty.estimate_link_mass_sigma(noise + balancer, base, load, rivals, links, group) == (
        0.0,
        [],
    )
    off = links @ np.array([0.04, 0.03, -0.05])  # typical deviations from makers' data that no other column can explain
    assert link_mass_uncertainty.estimate_link_mass_sigma(noise + off, base, load, rivals, links, group)[0] > 0.0
    assert link_mass_uncertainty.estimate_link_mass_sigma(noise, base, load, rivals, links, group)[0] > 0.0
