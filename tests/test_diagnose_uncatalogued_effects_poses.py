"""Effects outside the catalogue in measured poses: reported with their location; catalogue effects are still named."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
from test_diagnose_tcp_poses import ARCSEC, Array, arm, build, measure, only, poses, unit, wave

from machopt.data_types.measurements.recording import Recording
from machopt.measurement.diagnosis.data_types.diagnosis_problem import HypothesisCatalogue
from machopt.measurement.diagnosis.data_types.diagnosis_result import DiagnosisResult
from machopt.measurement.diagnosis.model_selection import selection_pipeline
from machopt.measurement.diagnosis.model_selection.attribution import naming_stages, uncatalogued_form_guard
from machopt.measurement.diagnosis.model_selection.screening.hypothesis_screening import score_hypotheses
from machopt.measurement.diagnosis.model_selection.search import search_iterations, selected_effect
from machopt.measurement.diagnosis.static import unmodelled_pose_errors

NOISE = 2e-5  # m
TRACKER = np.array([-2.5, 2.0, 0.5])  # m in base_link


def diagnose_recording(recording: Recording) -> DiagnosisResult:
    problem, catalogue = build(recording)
    return selection_pipeline.diagnose_problem(
        problem, catalogue, selection_pipeline.DiagnosisOptions(), np.random.default_rng(0)
    )


def shift_points(by: Array, registration: str = "fixed") -> Recording:
    """Return a recording with the measured points shifted by (N, 3) m."""
    observed = measure(noise=NOISE, registration=registration)
    assert observed.position is not None
    return replace(observed, position=observed.position + by)


def sagging() -> Array:
    """Return the vertical error (N, 3) in m of a laser beam refracted by warm air: proportional to the cube of its
    length."""
    observed = measure().position
    assert observed is not None
    far = np.linalg.norm(observed - TRACKER, axis=1) / 3.0
    return np.asarray(-1.2e-4 * far[:, None] ** 3 * unit(3)[:3])


def test_beam_bent_by_warm_air_is_no_displaced_frame() -> None:
    """Most of the error equals a rigid frame, which was named; the remainder does not."""
    found = diagnose_recording(shift_points(sagging()))
    assert not found.findings
    assert found.verdict == "unexplained"
    assert [n for n in found.notes if "sensor:displacement" in n and "rigid frame" in n]
    assert next(s.axis for s in found.mismatch if s.kind == "machine") == "sensor:displacement"


def test_displaced_frame_keeps_its_name() -> None:
    observed = measure().position
    assert observed is not None
    turn = np.radians(0.006) * np.array([0.6, 0.0, 0.8])
    found = diagnose_recording(shift_points(np.cross(turn, observed) + np.array([1e-4, 0.0, -5e-5])))
    assert [f.effect for f in found.findings] == ["displacement_frame"]
    assert found.verdict == "explained"


def nodding(q: Array) -> Array:
    """Return the angle errors of joints 2 and 3 that represent a wobble of axis 1 twice per revolution."""
    twice = 2.0 * q[:, :1]
    return np.asarray(40 * ARCSEC * (np.sin(twice) * unit(2) - 0.6 * np.cos(twice) * unit(3)))


def test_tilting_axis_is_neither_geometry_nor_a_wave() -> None:
    found = diagnose_recording(measure(delta=nodding, noise=NOISE))
    assert not found.findings
    assert found.verdict == "unexplained"
    assert [n for n in found.notes if "something at joint:1" in n]


def test_wave_is_named_beside_a_tilting_axis() -> None:
    gear = wave(4, 5.0, 90.0, 0.0)
    found = diagnose_recording(measure(delta=lambda q: nodding(q) + gear(q), noise=NOISE))
    assert [(f.effect, f.location) for f in found.findings] == [("transmission_error", "joint:4")]
    assert found.verdict == "partly_explained"


def test_hose_is_not_named_as_a_payload() -> None:
    """A position-dependent pull at the end of link 4: 600 N upwards in the middle, spring of 200 N/m."""
    problem, catalogue = build(measure(noise=NOISE))
    hose = next(h for h in catalogue.uncatalogued_hypotheses if h.name[1] == "link:4")
    problem = replace(problem, y=problem.y + hose.columns(()) @ np.array([0.0, 0.0, 600.0, -200.0]))

    def answered(offered: HypothesisCatalogue) -> DiagnosisResult:
        return selection_pipeline.diagnose_problem(
            problem, offered, selection_pipeline.DiagnosisOptions(), np.random.default_rng(0)
        )

    assert [f.effect for f in answered(replace(catalogue, uncatalogued_hypotheses=())).findings] == ["payload"]
    found = answered(catalogue)
    assert not found.findings
    assert [n for n in found.notes if "something at link:4" in n]


def test_taut_hose_is_not_named_as_payload_and_frame() -> None:
    """A spring between the end of link 4 and a fixed point in the hall: axial stiffness, and lateral stiffness by
    its tension."""
    problem, catalogue = build(measure(noise=NOISE))
    _, robot, _ = arm()
    forms = {h.law: h for h in catalogue.uncatalogued_hypotheses if h.location == "link:4"}
    state = robot.compute_state(poses(), arm()[0].tool.T_flange_tcp, bodies=True)
    assert state.R_bodies is not None
    assert state.p_bodies is not None
    line = np.array([2.0, 1.5, 4.0]) - (state.R_bodies[:, 4] @ robot.point[4] + state.p_bodies[:, 4])
    length = np.linalg.norm(line, axis=1)[:, None]
    force = line / length * (400.0 + 500.0 * (length - length.mean()))
    columns = {
        name: forms[name].columns(())
        for name in (unmodelled_pose_errors.POINT_PULL_LAW, unmodelled_pose_errors.LINE_PULL_LAW)
    }
    force = np.tile(force, (len(problem) // len(force), 1))
    moved = np.einsum("ndk,nk->nd", columns[unmodelled_pose_errors.POINT_PULL_LAW][:, :, :3], force)
    left = {}
    for name, c in columns.items():
        A = np.concatenate([problem.base, c], axis=2).reshape(moved.size, -1)
        A = A / np.maximum(np.linalg.norm(A, axis=0), 1e-300)
        rest = moved.reshape(-1) - A @ np.linalg.lstsq(A, moved.reshape(-1), rcond=1e-10)[0]
        left[name] = float(np.linalg.norm(rest))
    assert left[unmodelled_pose_errors.LINE_PULL_LAW] < 0.5 * left[unmodelled_pose_errors.POINT_PULL_LAW]
    problem = replace(problem, y=problem.y + moved)

    found = selection_pipeline.diagnose_problem(
        problem, catalogue, selection_pipeline.DiagnosisOptions(), np.random.default_rng(0)
    )
    assert (found.findings, found.verdict) == ((), "unexplained")
    assert [n for n in found.notes if "something at link:4" in n]


def test_frame_has_no_name_where_a_form_of_equal_size_fits_better() -> None:
    """An axis that wobbles twice per revolution was named a displaced frame, because the residual was within the
    limit of the noise."""
    problem, catalogue = build(measure(noise=NOISE))
    nods = next(
        h
        for h in catalogue.uncatalogued_hypotheses
        if h.name[1] == "joint:6" and h.law == unmodelled_pose_errors.NEIGHBOUR_JOINT_LAW
    )
    frame = only(catalogue, "geometry", "joint:5")
    count = nods.columns((2.0,)).shape[2]
    for true in (nods.columns((2.0,)), frame.columns(())):
        moved = true @ np.cos(np.arange(true.shape[2]))  # arbitrary coefficients
        spoilt = replace(problem, y=problem.y + 1e-4 * moved / np.abs(moved).max())
        state = search_iterations.search_iteratively(spoilt, replace(catalogue, uncatalogued_hypotheses=()), 1, 0)
        law = next(t for t in state.whitened_hypotheses if t.hypothesis.name == frame.name)
        chosen = (selected_effect.SelectedEffect(score_hypotheses(state.base, [law])[0], 0.002),)
        state = replace(state, chosen=chosen, catalogue=catalogue)
        (effect,) = naming_stages.apply_naming_stages(state, np.random.default_rng(0)).chosen
        assert effect.whitened.hypothesis.is_in_catalogue is (true.shape[2] > count)
        has_reason = uncatalogued_form_guard.UNCATALOGUED_REASON in effect.whitened.hypothesis.note
        assert has_reason is (true.shape[2] == count)


def simulate_bowed_arm(course: Array) -> Recording:
    """Rotate the arm after joint 2 about the axis of the upper arm by 60 µrad times a time course (N,)."""
    observed = measure(noise=NOISE)
    assert observed.position is not None
    a, b = observed.q[:, 0], observed.q[:, 1]
    axis = np.stack([np.cos(a) * np.cos(b), np.sin(a) * np.cos(b), -np.sin(b)], axis=1)
    by = 6e-5 * course[:, None] * np.cross(axis, observed.position - np.array([0.0, 0.0, 0.8]))
    return replace(observed, position=observed.position + by)


def test_bow_by_one_hour_of_sun_is_no_displaced_frame() -> None:
    """Half of the effect is its mean, which equals a displaced frame; the same effect without change over time is
    still named."""
    time = measure().time
    assert time is not None
    comes = diagnose_recording(simulate_bowed_arm(0.5 + 0.5 * np.sin(2.0 * np.pi * (time % 1e5) / 3600.0)))
    assert not comes.findings
    assert [n for n in comes.notes if "geometry" in n and "comes and goes with the hours" in n]
    stays = diagnose_recording(simulate_bowed_arm(np.ones(len(time))))
    assert {f.effect for f in stays.findings} == {"geometry"}
    assert stays.verdict == "explained"


def test_warming_hall_is_one_drift_of_tracker_and_arm() -> None:
    """One drift of both: with a drift law of either alone, the residual was named payload."""
    time = measure().time
    assert time is not None
    warm = 1.0 - np.exp(-(time % 1e5) / 2500.0)
    observed = measure(noise=NOISE, grow=6e-5 * warm[:, None] * np.ones(3))
    assert observed.position is not None
    found = diagnose_recording(
        replace(observed, position=observed.position + warm[:, None] * np.array([8e-5, -5e-5, 1.2e-4]))
    )
    assert [f.effect for f in found.findings] == ["thermal_drift"]
    assert found.verdict == "explained"


def test_external_pull_acts_through_the_joints_before_it() -> None:
    """Reference by finite differences: the work of a force at the end of a link over the rotation of the preceding
    joints."""
    cell, robot, _ = arm()
    catalogue = build(measure())[1]
    q, T, step = poses()[:4], cell.tool.T_flange_tcp, 1e-6

    def end(angles: Array) -> Array:
        state = robot.compute_state(angles, T, bodies=True)
        assert state.R_bodies is not None
        assert state.p_bodies is not None
        return np.asarray(state.R_bodies[:, 4] @ robot.point[4] + state.p_bodies[:, 4])

    slope = np.stack([(end(q + step * unit(j)) - end(q - step * unit(j))) / (2 * step) for j in range(1, 7)], axis=2)
    assert np.abs(slope[:, :, 4:]).max() < 1e-9  # the following joints carry no load
    hose = next(h for h in catalogue.uncatalogued_hypotheses if h.name[1] == "link:4")
    J = robot.compute_state(q, T).J[:, :3]
    for k in range(3):
        given = hose.columns(())[:4, :, k]
        # (N, 3, 3), one column per joint compliance; link 4 ends on the axis of joint 4
        parts = (J * slope[:, k][:, None, :])[:, :, :3]
        c = np.linalg.lstsq(parts.reshape(-1, 3), given.reshape(-1), rcond=None)[0]
        # the deflected arm differs from its encoder angles by a milliradian
        np.testing.assert_allclose(parts @ c, given, rtol=0.0, atol=0.02 * np.abs(given).max())
        assert (c[1:] > 0.0).all()  # the spring of joint 1 is not determined, because weight applies no torque to it


def test_unnamed_forms_do_not_replace_named_effects() -> None:
    """Two waves and an offset are compared with every unnamed form, and are still named."""
    parts = (wave(3, 4.0, 30.0, 10.0), wave(5, 3.0, 40.0, 0.0))
    found = diagnose_recording(
        measure(delta=lambda q: sum((p(q) for p in parts), np.radians(0.01) * unit(2) + 0 * q), noise=NOISE)
    )
    assert {(f.effect, f.location) for f in found.findings} == {
        ("transmission_error", "joint:3"),
        ("transmission_error", "joint:5"),
        ("joint_zero_offset", "joint:2"),
    }


def test_every_form_is_offered_where_its_joint_moves() -> None:
    catalogue = build(measure())[1]
    offered = {(h.location, h.law) for h in catalogue.uncatalogued_hypotheses}
    assert {(f"joint:{j}", unmodelled_pose_errors.AXIS_WOBBLE_LAW) for j in range(1, 7)} <= offered
    assert not any(h.is_in_catalogue for h in catalogue.uncatalogued_hypotheses)
    assert only(catalogue, "transmission_error", "joint:3", "one").is_in_catalogue
