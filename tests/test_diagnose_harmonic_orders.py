"""Shapes of effects in motions: fractional wave orders, smooth friction, column sums of one joint."""

from __future__ import annotations

import re
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from test_diagnose_motion import arm, build_fourier_motion, build_motion_recording, diagnose_recording, shaken

from machopt.data_types.cell import Cell, JointLimits
from machopt.data_types.kinematic_corrections import KinematicCorrection, KinematicCorrections
from machopt.data_types.measurements.recording import Recording
from machopt.dynamics.rigid_body import load_dynamics
from machopt.errors import InputError
from machopt.measurement.diagnosis.data_types.diagnosis_result import Finding
from machopt.measurement.diagnosis.dynamic import link_mass_uncertainty, motion_channels, next_motion
from machopt.measurement.diagnosis.model_selection import selection_pipeline
from machopt.measurement.diagnosis.model_selection.evaluation import repeatable_mismatch
from machopt.measurement.diagnosis.model_selection.screening.hypothesis_screening import (
    compute_chance_probability,
    score_hypotheses,
)
from machopt.measurement.diagnosis.model_selection.search.shape_refinement import build_ratio_refinement
from machopt.measurement.diagnosis.motion_data.motion_signals import build_motion_signals
from machopt.measurement.diagnosis.statistics import replicate_noise
from machopt.measurement.diagnosis.statistics.normal_equations_by_fold import build_base_model
from machopt.measurement.diagnosis.statistics.whitened_hypothesis import whiten_hypotheses
from machopt.measurement.diagnosis.statistics.whitening import build_whitening
from machopt.numerics.array_types import Array

SECOND = np.pi / 648000.0  # rad


def far_side(folder: Path, order: float, arcsec: float, sigma: float, size: float) -> tuple[Cell, Recording]:
    """Simulate the link-side encoder of one joint with a transmission error; the joint range is ``size`` times 1.9
    rad."""
    rng = np.random.default_rng(5)
    t, q, v, a = build_fourier_motion(1, rng)
    q, v, a = size * q, size * v, size * a
    cell = arm(folder, 1)
    wave = arcsec * SECOND * np.sin(order * q + 0.4)
    bent = q - load_dynamics(cell).compute_torque(q, v, a) / 2e6
    return cell, build_motion_recording(t, q, v, q_secondary=bent + wave + sigma * rng.normal(size=q.shape))


def wave_of(found: selection_pipeline.DiagnosisResult) -> Finding:
    assert [(f.effect, f.location) for f in found.findings] == [("transmission_error", "joint:1")]
    return found.findings[0]


@pytest.mark.parametrize(("order", "size"), [(7.0, 0.4), (10.4, 1.0)])
def test_order_is_determined_from_one_period_and_for_fractional_orders(
    tmp_path: Path, order: float, size: float
) -> None:
    """Order 7 with 0.8 periods in the recorded range, and a non-integer order."""
    cell, recording = far_side(tmp_path, order, 60.0, 2e-5, size)
    found = wave_of(diagnose_recording(recording, cell, "link")[0]).parameters["order"]
    assert found.value == pytest.approx(order, rel=0.02)
    assert found.ci95[0] <= order <= found.ci95[1]
    assert found.ci95[1] > found.ci95[0]


def test_undetermined_order_is_stated_as_a_range(tmp_path: Path) -> None:
    """Order 7 with an amplitude of 20 arcsec (0.1 mrad) in noise of 0.15 mrad."""
    cell, recording = far_side(tmp_path, 7.0, 20.0, 1.5e-4, 0.4)
    found = wave_of(diagnose_recording(recording, cell, "link")[0])
    low, high = found.parameters["order"].ci95
    assert low <= 7.0 <= high
    assert high - low > 1.0
    assert "order not resolved (between" in found.note


@pytest.mark.parametrize("over", [0.055])
def test_smooth_friction_reversal_is_no_low_speed_peak(tmp_path: Path, over: float) -> None:
    """The friction reversal is smooth with a width between two grid values; noise 0.25 N·m, friction 6 N·m."""
    rng, cell, t, q, v, tau = shaken(tmp_path, 2, 6)
    tau += 6.0 * (np.tanh(v / over) - np.sign(v))
    found, _, _ = diagnose_recording(
        build_motion_recording(t, q, v, tau + 0.25 * rng.normal(size=q.shape)), cell, "torque"
    )
    assert not found.findings


def test_next_motion_respects_limits_and_separates_rivals(tmp_path: Path) -> None:
    """A wave that might be backlash: of the motions of this joint, the one with the largest predicted difference is
    suggested; poses are not."""
    cell, recording = far_side(tmp_path, 7.0, 60.0, 2e-5, 1.0)
    found = diagnose_recording(recording, cell, "link")[0]
    f = wave_of(found)
    cell = replace(
        cell, limits=JointLimits(np.array([-0.6]), np.array([0.9]), *(np.array([v]) for v in (0.8, 2.0, 9.0)))
    )
    tried_motions = list(next_motion.generate_candidate_motions(cell, 0))
    assert len(tried_motions) == 7
    for one in tried_motions:
        assert one.q.min() > -0.6
        assert one.q.max() < 0.9
        assert np.abs(one.v).max() < 0.8
        assert np.abs(one.a).max() < 2.0 * (1.0 + 1e-9)
        np.testing.assert_allclose(np.gradient(one.q[:, 0], one.time)[2:-2], one.v[2:-2, 0], atol=5e-3)
    assert f.rivals
    doubtful = replace(f, one_of=(("transmission_error", "joint:1"), ("joint_hysteresis", "joint:1")))
    result = next_motion.suggest_next_motion(cell, "link", replace(found, findings=(doubtful,)))
    assert result.startswith("To tell transmission error of joint 1 from hysteresis of joint 1: drive ")
    assert "standard deviations" in result
    for other in (replace(found, findings=()), replace(found, findings=(), verdict="unexplained"), found):
        assert "plan-poses" not in next_motion.suggest_next_motion(cell, "link", other)


def test_unknown_payload_is_no_time_delay(tmp_path: Path) -> None:
    """Payload of 10 kg at the flange of a two-link arm; torques are synchronous."""
    rng, cell, t, q, v, tau = shaken(tmp_path, 2, 5)
    heavy = arm(tmp_path, 2, tool=10.0)
    a = np.gradient(v, t, axis=0)
    more = load_dynamics(heavy).compute_torque(q, v, a) - load_dynamics(arm(tmp_path, 2)).compute_torque(q, v, a)
    found, _, _ = diagnose_recording(
        build_motion_recording(t, q, v, tau + more + rng.normal(size=q.shape)), cell, "torque"
    )
    assert [f.effect for f in found.findings] == ["payload"]


def test_columns_of_one_joint_give_the_sums_of_all_rows(tmp_path: Path) -> None:
    """Rows of other joints are left out: the sums, gains and probabilities are the same."""
    rng, cell, t, q, v, tau = shaken(tmp_path, 2, 5)
    tau[:, 1] += 3.0 * np.sign(v[:, 1]) * np.exp(-np.abs(v[:, 1]) / 0.1)
    recording = build_motion_recording(t, q, v, tau + rng.normal(size=q.shape))
    problem, catalogue, _, _ = motion_channels.build_motion_problem(recording, cell, "torque", np.random.default_rng(0))
    used = np.ones(len(problem), bool)
    w = build_whitening(problem, replicate_noise.estimate_replicate_noise(problem, problem.y, used), used)
    full = replace(w, is_independent=False)
    assert w.is_independent
    each = []
    for one in (w, full):
        base, _ = build_base_model(problem, one, np.random.default_rng(1))
        laws = whiten_hypotheses(base, [h for h in catalogue.hypotheses if h.effect in ("joint_friction", "payload")])
        scored = score_hypotheses(base, laws)
        chance = compute_chance_probability(base, scored, base.residual, np.random.default_rng(2))
        each.append((laws, scored, chance))
    (few, of_few, p_few), (whole, of_whole, p_whole) = each
    assert {t.rows is None for t in few if t.hypothesis.effect == "joint_friction"} == {False}
    assert all(t.rows is None for t in whole)
    for a, b in zip(few, whole, strict=True):
        np.testing.assert_allclose(a.columns_at(0), b.columns_at(0), rtol=1e-9, atol=1e-12)
        np.testing.assert_allclose(a.XX, b.XX, rtol=1e-9, atol=1e-9)
    np.testing.assert_allclose([s.total for s in of_few], [s.total for s in of_whole], rtol=1e-6, atol=1e-6)
    np.testing.assert_array_equal(p_few, p_whole)


def test_probability_from_replicates_equals_that_of_their_products() -> None:
    """Reference: the signs of all visits are flipped, and the products are summed pair by pair."""
    rng = np.random.default_rng(3)
    pairs = np.array([(a, b) for a in range(9) for b in range(a + 1, 9)], float).T
    products: Array = rng.normal(size=pairs.shape[1]) + 0.4
    signs = np.random.default_rng(4).choice([-1.0, 1.0], (repeatable_mismatch.MISMATCH_FLIPS, 9))
    drawn = (signs[:, pairs[0].astype(int)] * signs[:, pairs[1].astype(int)]) @ products / 5.0
    expected = (1 + np.sum(drawn >= products.sum() / 5.0)) / (repeatable_mismatch.MISMATCH_FLIPS + 1)
    assert (
        repeatable_mismatch._compute_sign_flip_chance(pairs, products, 5.0, np.random.default_rng(4)).p_value
        == expected
    )


def test_shapes_are_refined_between_grid_values() -> None:
    finer = build_ratio_refinement([(1.0,), (2.0,), (4.0,)])
    assert finer is not None
    wide, narrow = ([s[0] for s in finer.shapes_around((2.0,), share)] for share in (1.0, 0.5))
    assert (min(wide), max(wide)) == pytest.approx((1.0, 4.0))
    assert (min(narrow), max(narrow)) == pytest.approx((2.0**0.5, 2.0**1.5))
    assert build_ratio_refinement([()]) is None
    assert build_ratio_refinement([(1.0, 2.0), (2.0, 3.0)]) is None


def test_several_orders_of_one_gear_are_one_finding(tmp_path: Path) -> None:
    """Orders 5 and 36: a single wave would have an order in between, or an additional double order that does not
    exist."""
    cell, recording = far_side(tmp_path, 5.0, 30.0, 1.5e-5, 1.0)
    assert recording.q_secondary is not None
    second = 20.0 * SECOND * np.sin(36.0 * recording.q + 1.1)
    found = wave_of(diagnose_recording(replace(recording, q_secondary=recording.q_secondary + second), cell, "link")[0])
    assert found.law == "2 waves"
    for word, order, size in (("", 5.0, 30.0), ("second_", 36.0, 20.0)):
        assert found.parameters[f"{word}order"].value == pytest.approx(order, abs=0.05)
        assert found.parameters[f"{word}amplitude"].value == pytest.approx(size, rel=0.05)
    assert isinstance(found.correction, KinematicCorrection)
    fixed = found.correction.parameters
    assert sorted(fixed["per_turn"]) == pytest.approx([5.0, 36.0], abs=0.05)
    # the written correction equals the finding: with it in the cell no finding remains
    again = diagnose_recording(
        replace(recording, q_secondary=recording.q_secondary + second),
        replace(cell, kinematics=KinematicCorrections((found.correction,))),
        "link",
    )[0]
    assert not again.findings


def test_single_missing_samples_do_not_distort_time(tmp_path: Path) -> None:
    """One sample in a hundred is missing in a recording without velocities: no false acceleration and no false delay
    result."""
    rng, cell, t, q, _, tau = shaken(tmp_path, 2, 6)
    retained = np.sort(rng.permutation(len(t))[: int(0.99 * len(t))])
    record = build_motion_recording(t[retained], q[retained], None, (tau + 0.25 * rng.normal(size=q.shape))[retained])
    found, _, _ = diagnose_recording(record, cell, "torque")
    assert not found.findings
    assert found.heldout_before < 0.4


def test_fractional_delay_keeps_the_noise_level() -> None:
    """Linear interpolation between samples would remove a third of the noise, so that any delay would seem better
    than none."""
    t = np.arange(4000) / 100.0
    one = build_motion_recording(t, np.sin(t)[:, None] + 0.01 * np.sin(2.0 * np.pi * 10.0 * t)[:, None], None)
    motion_ = build_motion_signals(one, 1)
    late = motion_.delay_cubic(motion_.q, 0.005)[500:-500, 0]
    true = np.sin(t - 0.005) + 0.01 * np.sin(2.0 * np.pi * 10.0 * (t - 0.005))
    # amplitude 0.007 rms; linear interpolation would remove 4.8 % of it, 3.4e-4
    assert np.std(late - true[500:-500]) < 2e-4


@pytest.mark.parametrize("sign", [1.0, -1.0])
def test_overcompensating_balancer_is_no_wrong_sign(tmp_path: Path, sign: float) -> None:
    """The gravity torque of the links is inverted; the sign of the friction shows whether the channel is inverted."""
    rng, cell, t, q, v, tau = shaken(tmp_path, 2, 6)
    still = load_dynamics(cell).compute_torque(q, np.zeros_like(q), np.zeros_like(q))
    tau[:, 1] -= 3.0 * still[:, 1]
    record = build_motion_recording(t, q, v, sign * (tau + 0.25 * rng.normal(size=q.shape)))
    if sign > 0:
        motion_channels.build_motion_problem(record, cell, "torque", rng)
    else:
        with pytest.raises(InputError, match="runs against"):
            motion_channels.build_motion_problem(record, cell, "torque", rng)


def test_implausible_link_masses_do_not_replace_a_payload(tmp_path: Path) -> None:
    """Readings so many that a link-mass prior has no effect: an additional 12 kg at the flange with links of 20 kg."""
    rng, cell, t, q, v, tau = shaken(tmp_path, 2, 6)
    assert cell.tool is not None
    heavier = replace(cell, tool=replace(cell.tool, mass=cell.tool.mass + 12.0))
    tau = tau + load_dynamics(heavier).compute_torque(q, v, q * 0.0) - load_dynamics(cell).compute_torque(q, v, q * 0.0)
    found, _, _ = diagnose_recording(
        build_motion_recording(t, q, v, tau + 0.25 * rng.normal(size=q.shape)), cell, "torque"
    )
    assert ("payload", "tool") in {(f.effect, f.location) for f in found.findings}


@pytest.mark.parametrize(("off", "unsure"), [(0.2, False), (0.08, True)])
def test_implausible_last_link_mass_is_a_payload_where_equally_good(off: float, unsure: bool) -> None:
    """A lighter last link and a payload give the same torque; the plausible mass deviation of a maker decides which
    is named."""
    rng = np.random.default_rng(4)
    base, links, rest = (rng.normal(size=(600, 2, p)) for p in (3, 2, 3))
    load = np.concatenate([links[:, :, 1:], rest], axis=2)
    y = off * links[:, :, 1] + 0.02 * rng.normal(size=(600, 2))
    doubt, _ = link_mass_uncertainty.estimate_link_mass_sigma(y, base, load, load, links, np.repeat(np.arange(12), 50))
    assert (doubt > 0.0) == unsure


def test_orders_closer_than_the_resolution_are_one_wave(tmp_path: Path) -> None:
    """The amplitude of a wave grows with the angle: two close orders with large, cancelling amplitudes would fit it
    better."""
    cell, recording = far_side(tmp_path, 36.0, 0.0, 1.5e-5, 1.0)
    q, other = recording.q, recording.q_secondary
    assert other is not None
    swelling = 30.0 * SECOND * (1.0 + 1.5 * q / np.ptp(q)) * np.sin(36.0 * q)
    found = wave_of(diagnose_recording(replace(recording, q_secondary=other + swelling), cell, "link")[0])
    orders = sorted(v.value for k, v in found.parameters.items() if k.endswith("order"))
    assert any(abs(n - 36.0) < 1.0 for n in orders)
    assert np.all(np.diff(orders) >= np.pi / np.ptp(q))
    assert max(v.value for k, v in found.parameters.items() if k.endswith("amplitude")) < 60.0


def test_massless_last_link_is_carried_as_payload(tmp_path: Path) -> None:
    """The flange link has no mass in the URDF: the diagnosis does not fail and reports its weight as payload."""
    rng, cell, t, q, v, tau = shaken(tmp_path, 2, 6)
    text = cell.urdf.read_text(encoding="utf-8")
    at = text.rindex("<mass")
    bare = re.sub(r'(value|ixx|iyy|izz)="[^"]*"', r'\1="0"', text[at : text.index("</inertial>", at)])
    cell.urdf.write_text(text[:at] + bare + text[text.index("</inertial>", at) :], encoding="utf-8")
    found, _, _ = diagnose_recording(
        build_motion_recording(t, q, v, tau + 0.25 * rng.normal(size=q.shape)), cell, "torque"
    )
    assert [(f.effect, f.location) for f in found.findings] == [("payload", "tool")]
