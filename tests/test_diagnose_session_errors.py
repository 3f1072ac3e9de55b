"""Errors of a single session or pose are corrected with the other sessions; a majority of a session is no outlier."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from functools import cache
from typing import Any

import numpy as np
import pytest
from simulated_hidden_effects import (
    ARCMIN,
    CELLS,
    HiddenEffects,
    NoiseLevels,
    arm,
    build_rough_backlash,
    load_tests,
    plan_load_tests,
)
from test_diagnose_tcp_poses import arm as measured_arm
from test_diagnose_tcp_poses import measure

from machopt.cell.cell_reader import load_cell
from machopt.data_types.measurements.recording import Recording, StandardUncertainty
from machopt.effects.compliance_matrices.body_compliance_laws import project_to_semidefinite
from machopt.kinematics.urdf_loading import load_robot
from machopt.measurement.diagnosis.data_quality import session_corrections, swapped_columns
from machopt.measurement.diagnosis.data_types import load_resolution
from machopt.measurement.diagnosis.data_types.diagnosis_problem import CoordinateFamily, DiagnosisProblem
from machopt.measurement.diagnosis.data_types.diagnosis_result import Finding
from machopt.measurement.diagnosis.diagnosis_pipeline import diagnose_static_recording
from machopt.measurement.diagnosis.model_selection import selection_pipeline
from machopt.measurement.diagnosis.statistics import instrument_uncertainty_check, outlier_rejection
from machopt.measurement.diagnosis.statistics.replicate_noise import ReplicateNoise

CELL = "kr240_drilling"


@cache
def simulate_correct_sessions(
    sessions: int = 2, frame: str = "base", moment: float = 0.0, concealed: bool = True
) -> Recording:
    """Simulate forces of 1.5 kN at 10 poses; a backlash of 0.5 arcmin that the springs cannot explain."""
    rng = np.random.default_rng(5)
    a = arm(CELL)
    truth = HiddenEffects(
        a.nominal * rng.uniform(0.75, 1.3, 6), {2: build_rough_backlash(0.5 * ARCMIN, 80.0)} if concealed else {}
    )
    plan = plan_load_tests(a, rng, poses=10, loads=3, sessions=sessions, moment=moment)
    return load_tests(a, truth, plan, rng, NoiseLevels(outliers=0.01), frame=frame)


def correct_sessions(r: Recording, accept: tuple[str, ...] = ()) -> tuple[Recording, list[Finding]]:
    cell = load_cell(CELLS / CELL)
    assert cell.stiffness is not None
    return session_corrections.correct_sessions_and_poses(
        r, load_robot(cell), cell.tool.T_flange_tcp, cell.stiffness.joints, accept
    )


def spoilt(r: Recording, name: str, change: Callable[[np.ndarray], np.ndarray], rows: np.ndarray) -> Recording:
    values = getattr(r, name).copy()
    values[rows] = change(values[rows])
    changes: dict[str, Any] = {name: values}
    return replace(r, **changes)


def forces(v: np.ndarray, factor: float) -> np.ndarray:
    return np.hstack([v[:, :3] * factor, v[:, 3:]])


FAULTS: dict[str, tuple[str, Callable[[np.ndarray], np.ndarray], str, str]] = {
    "inches": ("displacement", lambda v: v / 25.4, "units", "dx_mm"),
    "centimetres": ("displacement", lambda v: v / 10.0, "units", "dx_mm"),
    "micrometres": ("displacement", lambda v: v * 1e3, "units", "dx_mm"),
    "kilograms": ("wrench", lambda v: forces(v, 1 / 9.80665), "units", "fx_N"),
    "pounds": ("wrench", lambda v: forces(v, 1 / 4.44822), "units", "fx_N"),
    "kilonewtons": ("wrench", lambda v: forces(v, 1e-3), "units", "fx_N"),
    "y and z": ("displacement", lambda v: v[:, [0, 2, 1]], "columns", "dx_mm"),
    "turned round": ("displacement", lambda v: v[:, [1, 2, 0]], "columns", "dx_mm"),
    "−z": ("displacement", lambda v: v * [1, 1, -1], "columns", "dx_mm"),
    "−fx": ("wrench", lambda v: v * [-1, 1, 1, 1, 1, 1], "columns", "fx_N"),
    "one row low": ("displacement", lambda v: np.roll(v, 1, axis=0), "columns", "dx_mm"),
    "one row high": ("displacement", lambda v: np.roll(v, -1, axis=0), "columns", "dx_mm"),
    "−q5": ("q", lambda v: v * [1, 1, 1, 1, -1, 1], "columns", "q5_deg"),
}


@pytest.mark.parametrize("name", FAULTS)
def test_session_in_another_convention_is_corrected(name: str) -> None:
    column, change, effect, where = FAULTS[name]
    for frame in ("base", "tool") if effect == "columns" else ("base",):
        r = simulate_correct_sessions(frame=frame)
        bad = spoilt(r, column, change, r.session == 1)
        out, findings = correct_sessions(bad)
        assert [(f.effect, f.location) for f in findings] == [(effect, f"column:{where}")]
        assert np.allclose(getattr(out, column), getattr(r, column), rtol=1e-9, atol=1e-12)
        assert findings[0].record
        assert findings[0].parameters["session"].value == 1.0
        assert findings[0].after < 0.3 * findings[0].before


@pytest.mark.parametrize(("length", "force"), [(25.4, 4.44822), (10.0, 4.44822)])
def test_session_in_other_length_and_force_units_is_corrected(length: float, force: float) -> None:
    """A session in inches and pounds: neither correction alone makes the session agree with the others."""
    r = simulate_correct_sessions(concealed=False)
    rows = r.session == 1
    bad = spoilt(spoilt(r, "displacement", lambda v: v / length, rows), "wrench", lambda v: forces(v, 1 / force), rows)
    out, findings = correct_sessions(bad)
    assert [(f.effect, f.location) for f in findings] == [("units", "column:dx_mm"), ("units", "column:fx_N")]
    assert [f.parameters["factor"].value for f in findings] == pytest.approx([1 / length, 1 / force])
    for name in ("displacement", "wrench"):
        assert np.allclose(getattr(out, name), getattr(r, name), rtol=1e-9, atol=1e-12)


@pytest.mark.parametrize(("share", "said"), [(1.0, False), (1.02, False), (1.12, True), (0.9, True)])
def test_session_with_a_force_gain_is_reported_with_its_size(share: float, said: bool) -> None:
    """A gain error of 12 % was treated as scatter of the force without a message: "consistent", "explained"."""
    cell = load_cell(CELLS / CELL)
    r = simulate_correct_sessions(concealed=False)
    bad = spoilt(r, "wrench", lambda v: forces(v, share), r.session == r.session.max())
    d = diagnose_static_recording(cell, bad, selection_pipeline.DiagnosisOptions(), [], accept=(), seed=0).diagnosis
    found = [f for f in d.findings if f.effect == "force_sensor_gain"]
    assert bool(found) is said
    if said:
        assert (found[0].location, found[0].record) == ("sensor:force", True)
        assert found[0].parameters["gain"].value == pytest.approx(100.0 * (share - 1.0), abs=1.0)
        assert found[0].parameters["session"].value == r.session.max()
        assert "gain of the force sensor" in d.sentence


@pytest.mark.parametrize("frame", ["base", "tool"])
@pytest.mark.parametrize("concealed", [False, True])
def test_correct_sessions_remain_unchanged(frame: str, concealed: bool) -> None:
    for r in (
        simulate_correct_sessions(frame=frame, concealed=concealed),
        simulate_correct_sessions(3, concealed=concealed),
    ):
        out, findings = correct_sessions(r)
        assert findings == []
        assert out is r


def test_fault_in_the_whole_recording_is_not_a_session_fault() -> None:
    r = simulate_correct_sessions()
    assert r.displacement is not None
    _, findings = correct_sessions(replace(r, displacement=r.displacement / 25.4))
    assert findings == []


def test_two_of_three_sessions_are_corrected_and_accepted_ones_are_not() -> None:
    r = simulate_correct_sessions(3)
    bad = spoilt(r, "displacement", lambda v: v / 25.4, r.session == 2)
    bad = spoilt(bad, "wrench", lambda v: v * [1, 1, -1, 1, 1, -1], r.session == 0)
    out, findings = correct_sessions(bad)
    assert {(f.effect, f.parameters["session"].value) for f in findings} == {("units", 2.0), ("columns", 0.0)}
    assert np.allclose(out.displacement, r.displacement)  # type: ignore[arg-type]
    assert {f.effect for f in correct_sessions(bad, ("units",))[1]} <= {"columns"}


def test_single_pose_in_inches_is_corrected() -> None:
    r = simulate_correct_sessions()
    out, findings = correct_sessions(spoilt(r, "displacement", lambda v: v / 25.4, r.pose == 3))
    assert [(f.effect, f.location) for f in findings] == [("units", "column:dx_mm")]
    assert findings[0].parameters["pose"].value == 3.0
    assert np.allclose(out.displacement, r.displacement)  # type: ignore[arg-type]


@pytest.mark.parametrize("registration", ["fit", "fixed"])
@pytest.mark.parametrize(
    ("change", "effect"),
    [
        (lambda v: v / 25.4, "units"),
        (lambda v: v * [1, -1, 1], "columns"),
        (lambda v: v[:, [2, 1, 0]], "columns"),
        (lambda v: np.roll(v, 1, axis=0), "columns"),
    ],
)
def test_session_of_poses_in_another_convention_is_corrected(
    registration: str, change: Callable[[np.ndarray], np.ndarray], effect: str
) -> None:
    cell, robot, _ = measured_arm()
    r = measure(noise=25e-6, registration=registration)
    r = replace(r, session=np.repeat(np.arange(3), len(r) // 3))
    T = cell.tool.T_flange_tcp
    assert session_corrections.correct_sessions_and_poses(r, robot, T, None)[0] is r
    out, findings = session_corrections.correct_sessions_and_poses(
        spoilt(r, "position", change, r.session == 2), robot, T, None
    )
    assert [(f.effect, f.location) for f in findings] == [(effect, "column:x_mm")]
    assert np.allclose(out.position, r.position)  # type: ignore[arg-type]


THROUGHOUT: dict[str, tuple[str, Callable[[np.ndarray], np.ndarray], str]] = {
    "x and y": ("displacement", lambda v: v[:, [1, 0, 2]], "dx_mm"),
    "fx and fz": ("wrench", lambda v: v[:, [2, 1, 0, 3, 4, 5]], "fx_N"),
    "−q5": ("q", lambda v: v * [1, 1, 1, 1, -1, 1], "q5_deg"),
    "q2 and q3": ("q", lambda v: v[:, [0, 2, 1, 3, 4, 5]], "q2_deg"),
    "one row low": ("displacement", lambda v: np.roll(v, 1, axis=0), "dx_mm"),
}


@pytest.mark.parametrize("name", THROUGHOUT)
def test_columns_exchanged_in_the_whole_recording_are_corrected(name: str) -> None:
    column, change, where = THROUGHOUT[name]
    cell, r = load_cell(CELLS / CELL), simulate_correct_sessions()
    robot, T = load_robot(cell), cell.tool.T_flange_tcp
    assert swapped_columns.correct_swapped_columns(r, robot, T) == (r, [])
    bad = spoilt(r, column, change, np.ones(len(r), bool))
    out, findings = swapped_columns.correct_swapped_columns(bad, robot, T)
    assert [(f.effect, f.location) for f in findings] == [("columns", f"column:{where}")]
    assert np.allclose(getattr(out, column), getattr(r, column))
    assert swapped_columns.correct_swapped_columns(bad, robot, T, ("columns",)) == (bad, [])


def test_far_rotated_tracker_is_a_frame_and_a_mirrored_one_is_not() -> None:
    cell, robot, _ = measured_arm()
    T = cell.tool.T_flange_tcp
    r = measure(noise=25e-6)
    assert r.position is not None
    turned = replace(r, position=r.position[:, [2, 0, 1]] * [1, -1, -1] + 0.5)
    assert swapped_columns.correct_swapped_columns(turned, robot, T) == (turned, [])
    assert turned.position is not None
    mirrored = replace(turned, position=turned.position * np.array([1.0, 1.0, -1.0]))
    _, findings = swapped_columns.correct_swapped_columns(mirrored, robot, T)
    assert [(f.effect, f.location) for f in findings] == [("columns", "column:x_mm")]
    out, findings = swapped_columns.correct_swapped_columns(replace(turned, q=turned.q * [1, 1, 1, -1, 1, 1]), robot, T)
    assert [(f.effect, f.location) for f in findings] == [("columns", "column:q4_deg")]
    assert np.array_equal(out.q, turned.q)


# outliers ------------------------------------------------------------------------------------------------------


def build_small_problem(N: int = 24, stated: float | None = 1e-5, scale: float | None = None) -> DiagnosisProblem:
    """Build six poses, each measured twice in each of two sessions; every reading has replicates."""
    pose = np.tile(np.repeat(np.arange(N // 4), 2), 2)
    session = np.repeat([0, 1], N // 2)
    visit = session * 100 + pose
    return DiagnosisProblem(
        channel="deflection",
        y=np.zeros((N, 3)),
        base=np.zeros((N, 3, 1)),
        unknowns=(),
        families=(
            CoordinateFamily(name="translation", columns=(0, 1, 2), unit="mm", factor=1e3, stated_uncertainty=stated),
        ),
        group=pose,
        visit=visit,
        cycle=visit,
        session=session,
        replicate=pose,
        line=np.arange(N),
        row=np.arange(1, N + 1),
        scale=None if scale is None else np.full((N, 3), scale),
    )


def test_few_rows_are_outliers_but_repeated_deviations_are_not() -> None:
    p, rng = build_small_problem(), np.random.default_rng(0)
    e = 1e-5 * rng.standard_normal((24, 3))
    assert outlier_rejection.find_inlier_readings(p, e).all()
    one = e.copy()
    one[5] += 1e-3
    assert np.flatnonzero(~outlier_rejection.find_inlier_readings(p, one)).tolist() == [5]
    modelled = np.zeros((24, 3))
    modelled[5] = 6e-3  # displacement by a law, which is not exact
    assert outlier_rejection.find_inlier_readings(p, one, modelled).all()
    one[5] += 5e-3
    assert np.flatnonzero(~outlier_rejection.find_inlier_readings(p, one, modelled)).tolist() == [5]
    other = e.copy()
    other[5, 1] += 1e-3
    modelled[5] = [6e-3, 0.0, 0.0]  # the law moves this reading along x only
    assert np.flatnonzero(~outlier_rejection.find_inlier_readings(p, other, modelled)).tolist() == [5]
    session = e.copy()
    session[12:20] += rng.choice([-1, 1], (8, 1)) * 1e-3  # eight of the twelve readings, in random directions
    assert outlier_rejection.find_inlier_readings(p, session).all()
    again = e.copy()
    again[[4, 16]] += 1e-3  # the same pose in both sessions
    assert outlier_rejection.find_inlier_readings(p, again).all()
    lean = e.copy()
    # five readings of the second session in one direction: for example a yielding floor
    lean[[12, 14, 15, 17, 20]] += np.array([0.0, 0.0, -1e-3])
    assert outlier_rejection.find_inlier_readings(p, lean).all()


# loads ---------------------------------------------------------------------------------------------------------


def test_load_columns_of_noise_count_as_zero() -> None:
    rng = np.random.default_rng(1)
    r = simulate_correct_sessions(moment=200.0)
    assert r.wrench is not None
    stated = replace(r, uncertainty=StandardUncertainty(displacement=15e-6, rotation=None, force=5.0, moment=2.0))
    assert load_resolution.discard_noise_components(stated) == (stated, [])
    w = r.wrench.copy()
    w[:, 3:] = 2.0 * rng.standard_normal((len(r), 3))
    noisy = replace(stated, wrench=w)
    received, output = load_resolution.discard_noise_components(noisy)
    assert received.wrench is not None
    assert not received.wrench[:, 3:].any()
    assert np.array_equal(received.wrench[:, :3], w[:, :3])
    assert len(output) == 1
    w = w.copy()
    w[r.pose == 2, 3] += 40.0  # a real moment in a tenth of the readings
    received, _ = load_resolution.discard_noise_components(replace(stated, wrench=w))
    assert received.wrench is not None
    assert received.wrench[:, 3].any()
    unstated = replace(noisy, uncertainty=StandardUncertainty())
    # the replicates show the uncertainty that is not stated
    received, _ = load_resolution.discard_noise_components(unstated)
    assert received.wrench is not None
    assert not received.wrench[:, 3:].any()
    once = replace(unstated, pose=np.arange(len(unstated)))
    assert load_resolution.discard_noise_components(once)[0] is once
    loaded = replace(r, uncertainty=StandardUncertainty())
    assert load_resolution.discard_noise_components(loaded)[0] is loaded


def test_sideways_noise_of_a_hanging_weight_is_no_load() -> None:
    """Without a stated uncertainty, the replicates of a pose show that a column contains only noise."""
    rng = np.random.default_rng(2)
    r = simulate_correct_sessions()
    assert r.wrench is not None
    w = np.zeros_like(r.wrench)
    w[:, 2] = -np.abs(r.wrench[:, 2]).max() * (0.5 + 0.5 * (np.arange(len(r)) % 2))
    w[:, :2] = 1e-3 * w[:, 2].min() * rng.standard_normal((len(r), 2))
    hung = replace(r, wrench=w, uncertainty=StandardUncertainty())
    received, _ = load_resolution.discard_noise_components(hung)
    assert received.wrench is not None
    assert not received.wrench[:, :2].any()
    assert received.wrench[:, 2].all()


def test_loads_within_sensor_noise_are_equal() -> None:
    apart = load_resolution.compute_load_tolerance(
        np.array([1000.0, 3.0]), 0.08, StandardUncertainty(displacement=None, rotation=None, force=5.0, moment=2.0)
    )
    assert apart[:3] == pytest.approx([80.0] * 3)
    assert (apart[3:] > 8.0).all()
    assert (load_resolution.compute_load_tolerance(np.zeros(2), 0.08, StandardUncertainty()) > 0).all()


# messages ------------------------------------------------------------------------------------------------------


def test_impossible_instrument_readings_are_reported() -> None:
    p, used = build_small_problem(), np.ones(24, bool)
    noise = ReplicateNoise(np.array([1e-5]), np.zeros(1), np.zeros(1), 0.0, True)
    fine, poor = np.full((24, 3), 3e-5), np.full((24, 3), 5e-4)
    assert instrument_uncertainty_check.check_stated_uncertainty(p, fine, noise, used) is None
    left = instrument_uncertainty_check.check_stated_uncertainty(p, poor, noise, used)
    assert left is not None
    assert [
        instrument_uncertainty_check.weaken_verdict(v) for v in ("consistent", "explained", "partly_explained")
    ] == [
        "unexplained",
        "partly_explained",
        "partly_explained",
    ]
    assert "50 times" in left
    loud = replace(noise, reading=np.array([1e-3]))
    assert instrument_uncertainty_check.check_stated_uncertainty(p, fine, loud, used) is not None
    assert (
        instrument_uncertainty_check.check_stated_uncertainty(build_small_problem(stated=None), poor, loud, used)
        is None
    )
    assert (
        instrument_uncertainty_check.check_stated_uncertainty(build_small_problem(scale=0.05), poor, noise, used)
        is None
    )  # a compliant arm: 1 % of 50 mm


def test_negative_matrix_entry_does_not_make_a_body_infinitely_soft() -> None:
    C = np.diag([1e-8, 2e-8, 1e-8, 1e-7, 1e-7, -1e-9])
    C[1, 5] = C[5, 1] = 3e-8
    out = project_to_semidefinite(C)
    assert np.linalg.eigvalsh(out).min() >= -1e-20
    assert np.abs(out).max() <= 1e-7
    assert np.allclose(out, np.diag([1e-8, 2e-8, 1e-8, 1e-7, 1e-7, 0.0]))
