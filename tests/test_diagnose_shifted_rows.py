"""Shifted rows, and moments in another unit than forces, are corrected."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from simulated_hidden_effects import CELLS
from test_diagnose_session_errors import CELL, simulate_correct_sessions
from test_diagnose_tcp_poses import arm as measured_arm
from test_diagnose_tcp_poses import measure

from machopt.cell.cell_reader import load_cell
from machopt.data_types.measurements.recording import Recording, StandardUncertainty
from machopt.kinematics.urdf_loading import load_robot
from machopt.measurement.diagnosis.data_quality import shifted_rows, static_record_correction, swapped_columns
from machopt.measurement.diagnosis.data_types.diagnosis_result import Finding
from machopt.measurement.diagnosis.diagnosis_pipeline import diagnose_static_recording
from machopt.measurement.diagnosis.model_selection import selection_pipeline


def at_arm(
    r: Recording, mend=shifted_rows.correct_shifted_rows, accept: tuple[str, ...] = ()
) -> tuple[Recording, list[Finding]]:
    cell = load_cell(CELLS / CELL)
    return mend(r, load_robot(cell), cell.tool.T_flange_tcp, accept)


def shift_rows(r: Recording, first: int, last: int, by: int) -> Recording:
    """Give rows first … last − 1 the displacement of the row ``by`` rows before (after, if negative)."""
    values = r.displacement.copy()
    values[first:last] = r.displacement[first - by : last - by]
    return replace(r, displacement=values)


@pytest.mark.parametrize(("first", "last", "by"), [(70, 110, 1), (95, 115, -1), (4, 40, 1)])
def test_shifted_rows_are_corrected_and_listed(first: int, last: int, by: int) -> None:
    r = simulate_correct_sessions()
    out, (finding,) = at_arm(shift_rows(r, first, last, by))
    assert (finding.effect, finding.location) == ("columns", "column:dx_mm")
    at = [round(finding.parameters[name].value) for name in ("first row", "last row")]
    assert abs(at[0] - (first + 1)) <= 2
    assert abs(at[1] - last) <= 2
    inside = slice(first + 2, last - 2)
    assert np.array_equal(out.displacement[inside], r.displacement[inside])
    assert np.array_equal(
        np.delete(out.displacement, np.s_[first - 2 : last + 2], axis=0),
        np.delete(r.displacement, np.s_[first - 2 : last + 2], axis=0),
    )


@pytest.mark.parametrize("sessions", [1, 2])
@pytest.mark.parametrize("deleted", [5, 20, 60, 90])
def test_deleted_cell_shifts_all_following_rows(sessions: int, deleted: int) -> None:
    """Most rows are wrong then; only shifting the displacements makes them agree."""
    r = simulate_correct_sessions(sessions=sessions)
    values = r.displacement.copy()
    values[deleted:] = np.roll(r.displacement[deleted:], -1, axis=0)
    out, (finding,) = at_arm(replace(r, displacement=values))
    away = shifted_rows.find_lost_rows([finding], len(r))
    retained = ~away
    retained[-1] = False  # last row of the file, which contains the reading of another row
    assert away.sum() == 1
    assert away[max(deleted - 1, 0) : deleted + 2].any()
    wrong = np.linalg.norm(out.displacement - r.displacement, axis=1)[:, None][retained]
    noise = 4.0 * 15e-6
    assert (wrong > noise).sum() <= 1  # of two similar adjacent rows, either may be reported


def test_shift_over_two_sessions_is_reported_by_rows() -> None:
    r = simulate_correct_sessions()
    values = r.displacement.copy()
    values[120:] = np.roll(r.displacement[120:], -1, axis=0)
    cell = load_cell(CELLS / CELL)
    robot, T = load_robot(cell), cell.tool.T_flange_tcp
    _, found, _ = static_record_correction.correct_static_record(
        replace(r, displacement=values), robot, T, cell.stiffness.joints
    )
    (finding,) = (f for f in found if f.effect == "columns")
    assert abs(finding.parameters["first row"].value - 121) <= 2
    whole = r.displacement.copy()
    rows = r.session == r.session.max()
    whole[rows] = np.roll(r.displacement[rows], -1, axis=0)
    _, found, _ = static_record_correction.correct_static_record(
        replace(r, displacement=whole), robot, T, cell.stiffness.joints
    )
    (finding,) = (f for f in found if f.effect == "columns")
    assert "first row" not in finding.parameters
    assert finding.parameters["session"].value == r.session.max()


def test_deleted_cell_does_not_lead_to_a_named_effect() -> None:
    r = simulate_correct_sessions(sessions=1, concealed=False)
    values = r.displacement.copy()
    values[20:] = np.roll(r.displacement[20:], -1, axis=0)
    cell = load_cell(CELLS / CELL)
    d = diagnose_static_recording(
        cell, replace(r, displacement=values), selection_pipeline.DiagnosisOptions(), [], accept=(), seed=0
    ).diagnosis
    assert {f.effect for f in d.findings} <= {"columns", "geometric_stiffness", "outliers"}
    assert d.verdict in ("consistent", "explained", "insufficient")


def test_shifted_rows_of_measured_poses_are_corrected() -> None:
    cell, robot, _ = measured_arm()
    r = measure(noise=25e-6, registration="fit")
    values = r.position.copy()
    values[20:34] = r.position[19:33]
    out, (finding,) = shifted_rows.correct_shifted_rows(replace(r, position=values), robot, cell.tool.T_flange_tcp)
    assert (finding.effect, finding.location) == ("columns", "column:x_mm")
    assert np.array_equal(out.position[21:32], r.position[21:32])


def test_correct_records_with_backlash_and_accepted_ones_remain() -> None:
    r = simulate_correct_sessions()
    assert at_arm(r)[0] is r
    wrong = shift_rows(r, 70, 110, 1)
    assert at_arm(wrong, accept=("columns",))[0] is wrong
    cell, robot, _ = measured_arm()
    poses = measure(noise=25e-6, registration="fit")
    assert shifted_rows.correct_shifted_rows(poses, robot, cell.tool.T_flange_tcp)[0] is poses


def test_different_load_in_every_row_is_no_shift() -> None:
    r = simulate_correct_sessions()
    rng = np.random.default_rng(3)
    noisy = replace(r, displacement=r.displacement * (1.0 + rng.normal(0.0, 0.5, (len(r), 1))))
    assert at_arm(noisy)[0] is noisy


@pytest.mark.parametrize(("factor", "unit"), [(1e-3, "kN·m"), (1.0 / 9.80665, "kgf·m")])
def test_moments_in_another_unit_than_forces_are_corrected(factor: float, unit: str) -> None:
    r = simulate_correct_sessions(moment=400.0)
    wrench = r.wrench.copy()
    wrench[:, 3:] *= factor
    changed = replace(r, wrench=wrench, uncertainty=StandardUncertainty(force=5.0, moment=2.0))
    out, (finding,) = at_arm(changed, swapped_columns.correct_moment_units)
    assert (finding.effect, finding.location) == ("units", "column:mx_Nm")
    assert unit in finding.note
    assert np.allclose(out.wrench, r.wrench)


def test_stated_moments_and_moments_of_noise_remain() -> None:
    r = simulate_correct_sessions(moment=400.0)
    assert at_arm(r, swapped_columns.correct_moment_units)[0] is r
    plain = simulate_correct_sessions()
    wrench = plain.wrench.copy()
    wrench[:, 3:] = np.random.default_rng(1).normal(0.0, 1.0, (len(plain), 3))
    noise = replace(plain, wrench=wrench)
    assert at_arm(noise, swapped_columns.correct_moment_units)[0] is noise
