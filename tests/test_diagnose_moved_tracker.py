"""Session differences at shared poses are corrected and reported, and are neither noise nor physics."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from numpy.typing import NDArray
from test_diagnose_tcp_poses import arm, measure, unit

from machopt.data_types.measurements.recording import Recording
from machopt.measurement.diagnosis.data_quality import moved_tracker_or_target
from machopt.measurement.diagnosis.data_types.record_findings import build_exact_estimate
from machopt.numerics.rigid_transforms import convert_vector_to_rotation

Array = NDArray[np.float64]
NOISE = 3e-5
SHIFT, TURN = np.array([2e-4, -3e-4, 1e-4]), np.array([2e-4, 1e-4, -3e-4])


def visits(*, fit: bool, day: int = 1) -> tuple[Recording, NDArray[np.bool_]]:
    """Return three sessions of an arm with a zero offset at joint 3, which is no session error, and the mask of the
    rows of one session."""
    r = measure(noise=NOISE, delta=lambda q: 3e-4 * unit(3) + 0 * q, registration="fit" if fit else "fixed")
    return replace(r, temperature=None), r.session == day


def spread(r: Recording) -> float:
    """Return the mean standard deviation of a pose between sessions, in m."""
    each = np.stack([np.array(r.position)[r.session == s] for s in range(3)])
    return float(each.std(axis=0).mean())


@pytest.mark.parametrize("fit", [True, False])
def test_moved_tracker_gets_its_own_frame(fit: bool) -> None:
    cell, robot, _ = arm()
    r, rows = visits(fit=fit)
    x = np.array(r.position)
    x[rows] = x[rows] @ convert_vector_to_rotation(TURN).T + SHIFT
    read, (finding,) = moved_tracker_or_target.correct_session_changes(
        replace(r, position=x), robot, cell.tool.T_flange_tcp
    )
    assert (finding.effect, finding.location, finding.record) == ("displacement_frame", "sensor:displacement", True)
    assert finding.parameters["session"].value == 1
    assert finding.parameters["angle"].value == pytest.approx(np.degrees(np.linalg.norm(TURN)), rel=0.1)
    if fit:
        np.testing.assert_array_equal(read.frame == 1, rows)
    else:
        assert spread(read) < 1.3 * spread(r) < 0.5 * spread(replace(r, position=x))
    assert (
        moved_tracker_or_target.correct_session_changes(
            replace(r, position=x), robot, cell.tool.T_flange_tcp, ("displacement_frame",)
        )[1]
        == []
    )


@pytest.mark.parametrize("sign", [1.0, -1.0])
def test_encoder_with_another_zero_is_a_column(sign: float) -> None:
    cell, robot, _ = arm()
    r, rows = visits(fit=True)
    q = r.q.copy()
    q[rows, 4] += sign * 2e-3
    read, (finding,) = moved_tracker_or_target.correct_session_changes(replace(r, q=q), robot, cell.tool.T_flange_tcp)
    assert (finding.effect, finding.location) == ("columns", "column:q5_deg")
    assert finding.parameters["offset"].value == pytest.approx(sign * np.degrees(2e-3), rel=0.02)
    np.testing.assert_allclose(read.q, r.q, atol=2e-5)


def test_replaced_reflector_is_corrected() -> None:
    cell, robot, _ = arm()
    r, rows = visits(fit=True)
    T = cell.tool.T_flange_tcp
    R = robot.compute_fk(r.q, T)[:, :3, :3] @ T[:3, :3].T
    x = np.array(r.position)
    x[rows] += R[rows] @ np.array([4e-4, 1e-4, -3e-4])
    read, (finding,) = moved_tracker_or_target.correct_session_changes(replace(r, position=x), robot, T)
    assert finding.location == "sensor:displacement"
    assert finding.parameters["shift x"].value == pytest.approx(0.4, abs=0.03)
    assert spread(read) < 1.2 * spread(r)


def test_noise_and_thermal_growth_are_left_to_the_catalogue() -> None:
    cell, robot, _ = arm()
    T = cell.tool.T_flange_tcp
    r, rows = visits(fit=True)
    assert moved_tracker_or_target.correct_session_changes(r, robot, T) == (r, [])
    grown = measure(noise=NOISE, grow=np.repeat(2e-4 * rows[:, None], 3, axis=1))
    assert moved_tracker_or_target.correct_session_changes(grown, robot, T) == (grown, [])


def test_shift_alone_may_be_thermal_unless_temperatures_exclude_it() -> None:
    cell, robot, _ = arm()
    T = cell.tool.T_flange_tcp
    r, rows = visits(fit=True)
    up = replace(r, position=np.array(r.position) + 3e-4 * rows[:, None] * [0.0, 0.0, 1.0])
    _, (finding,) = moved_tracker_or_target.correct_session_changes(up, robot, T)
    assert finding.one_of == (("displacement_frame", "sensor:displacement"), ("thermal_drift", "environment"))
    warm = replace(up, temperature=20.0 + 5.0 * rows)
    assert moved_tracker_or_target.correct_session_changes(warm, robot, T) == (warm, [])
    alike = replace(up, temperature=20.0 + 0.1 * rows)
    assert len(moved_tracker_or_target.correct_session_changes(alike, robot, T)[1]) == 1


@pytest.mark.parametrize(("drifts", "blamed"), [(0.5, False), (0.1, True)])
def test_drift_within_a_session_is_no_moved_tracker(drifts: float, blamed: bool) -> None:
    cell, robot, _ = arm()
    r, rows = visits(fit=True)
    up = replace(r, position=np.array(r.position) + 3e-4 * rows[:, None] * [0.0, 0.0, 1.0])
    _, corrected = moved_tracker_or_target.correct_session_changes(up, robot, cell.tool.T_flange_tcp)
    drift = replace(corrected[0], effect="thermal_drift", parameters={"drift": build_exact_estimate(drifts, "mm")})
    retained, output = moved_tracker_or_target.merge_with_thermal_drift(corrected, (drift,))
    assert (retained == corrected, bool(output)) == (blamed, not blamed)
    assert moved_tracker_or_target.merge_with_thermal_drift(corrected, ()) == (corrected, ())
