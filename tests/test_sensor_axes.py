"""Rotated axes of force sensor or displacement: fitted, named once, no false positive."""

from __future__ import annotations

from dataclasses import replace
from functools import cache

import numpy as np
import pytest
from scipy.spatial.transform import Rotation
from simulated_hidden_effects import CELLS, HiddenEffects, arm, load_tests, plan_load_tests

from machopt.cell.cell_reader import load_cell
from machopt.data_types.measurements.recording import Recording
from machopt.errors import RecordingError
from machopt.kinematics.urdf_loading import load_robot
from machopt.measurement.diagnosis.data_quality.static_record_correction import correct_static_record
from machopt.measurement.estimation.load_test_equations import build_load_test_experiment
from machopt.measurement.identification.data_quality.load_test_checks import refuse_record_faults
from machopt.measurement.identification.data_quality.sensor_axes import check_sensor_axes, find_rotated_axes

CELL = "irb6700_drilling"
HINGES = {0: np.diag([3e-7, 2e-7, 1e-7]), 2: np.diag([5e-7, 3e-7, 5e-7]), 7: np.diag([1e-6, 1e-6, 5e-7])}


@cache
def simulate_load_tests(frame: str, hinge: int | None = None) -> Recording:
    rng = np.random.default_rng(17)
    a = arm(CELL)
    hinges = {} if hinge is None else {hinge: HINGES[hinge]}
    truth = HiddenEffects(a.nominal * rng.uniform(0.7, 1.4, 6), hinges=hinges)
    return load_tests(a, truth, plan_load_tests(a, rng, poses=10, loads=2, sessions=1, moment=150.0), rng, frame=frame)


def rotate_vectors(v: np.ndarray, Q: np.ndarray) -> np.ndarray:
    return np.concatenate([v[:, k : k + 3] @ Q.T for k in range(0, v.shape[1], 3)], axis=1)


@pytest.mark.parametrize(("frame", "degrees"), [("tool", 31.0), ("base", 118.0)])
@pytest.mark.parametrize("quantity", ["wrench", "displacement"])
def test_any_rotation_is_fitted_and_corrected(frame: str, degrees: float, quantity: str) -> None:
    cell, right = load_cell(CELLS / CELL), simulate_load_tests(frame)
    robot, T = load_robot(cell), cell.tool.T_flange_tcp
    axis = np.array([0.6, 0.2, -0.77])
    Q = Rotation.from_rotvec(np.radians(degrees) * axis / np.linalg.norm(axis)).as_matrix()
    wrong = replace(right, **{quantity: rotate_vectors(getattr(right, quantity), Q)})
    assert cell.stiffness is not None
    corrected, findings, _ = correct_static_record(wrong, robot, T, cell.stiffness.joints)
    place = "sensor:force" if quantity == "wrench" else "sensor:displacement"
    (finding,) = [f for f in findings if f.location == place]
    assert finding.parameters["angle"].value == pytest.approx(degrees, abs=0.5)
    was = getattr(right, quantity)
    assert np.linalg.norm(getattr(corrected, quantity) - was) < 0.01 * np.linalg.norm(was)
    retained, none, _ = correct_static_record(wrong, robot, T, cell.stiffness.joints, ("sensor_axes",))
    assert not [f for f in none if f.location == place]
    np.testing.assert_array_equal(getattr(retained, quantity), getattr(wrong, quantity))


def test_identify_asks_for_the_axes() -> None:
    cell, right = load_cell(CELLS / CELL), simulate_load_tests("tool")
    robot = load_robot(cell)
    assert right.wrench is not None
    Q = Rotation.from_euler("xyz", [10, -35, 70], degrees=True).as_matrix()
    wrong = replace(right, wrench=rotate_vectors(right.wrench, Q))
    tests = build_load_test_experiment(wrong, robot, cell.tool.T_flange_tcp)
    (fault,) = check_sensor_axes(tests, robot)
    assert (fault.code, fault.column) == ("sensor_axes", "fx_N")
    with pytest.raises(RecordingError, match="sensor_axes"):
        refuse_record_faults(tests, [fault])


@pytest.mark.parametrize("hinge", [None, *HINGES])
def test_soft_bodies_are_no_rotation(hinge: int | None) -> None:
    cell = load_cell(CELLS / CELL)
    robot = load_robot(cell)
    tests = build_load_test_experiment(simulate_load_tests("tool", hinge), robot, cell.tool.T_flange_tcp)
    assert find_rotated_axes(tests, robot) is None
