"""Readings duplicated into the row of another pose are distinguished from replicates."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from test_diagnose_session_errors import CELL, CELLS, simulate_correct_sessions
from test_diagnose_tcp_poses import arm, measure

from machopt.cell.cell_reader import load_cell
from machopt.kinematics.urdf_loading import load_robot
from machopt.measurement.diagnosis.data_quality.duplicated_rows import find_duplicated_rows


@pytest.mark.parametrize("turned", [0.0, 2.0])
def test_farther_of_two_equal_rows_is_the_duplicate(turned: float) -> None:
    """For any tracker station; repeated measurements of the same pose may be equal."""
    cell, robot, _ = arm()
    T = cell.tool.T_flange_tcp
    frame = np.array([0.3, -1.0, 0.2]), np.array([0.0, 0.0, turned]), np.zeros(3)
    exact = measure(frame=frame)
    assert exact.position is not None
    assert not find_duplicated_rows(exact, robot, T).any()
    r = measure(frame=frame, noise=2e-5)
    assert r.position is not None
    assert not find_duplicated_rows(r, robot, T).any()
    x = r.position.copy()
    x[[4, 21]] = x[[17, 3]]
    spoilt = replace(r, position=x)
    assert np.flatnonzero(find_duplicated_rows(spoilt, robot, T)).tolist() == [4, 21]
    coarse = replace(spoilt, position=np.round(x, 5))  # resolution 0.01 mm: equal by chance
    assert not find_duplicated_rows(coarse, robot, T).any()


@pytest.mark.parametrize("digits", [9, 5])
def test_duplicated_reading_of_a_load_test_is_found_in_coarse_readings(digits: int) -> None:
    r, cell = simulate_correct_sessions(), load_cell(CELLS / CELL)
    robot, T = load_robot(cell), cell.tool.T_flange_tcp
    assert r.displacement is not None
    d = np.round(r.displacement, digits)
    r = replace(r, displacement=d)
    assert not find_duplicated_rows(r, robot, T).any()
    source, goal = (np.flatnonzero((r.pose == p) & (r.session == 1)) for p in np.unique(r.pose)[[2, 7]])
    d = d.copy()
    d[goal] = d[source]
    assert np.flatnonzero(find_duplicated_rows(replace(r, displacement=d), robot, T)).tolist() == goal.tolist()
    twice = np.where(r.pose == np.unique(r.pose)[7], np.unique(r.pose)[2], r.pose)  # the same pose with another number
    assert not find_duplicated_rows(replace(r, displacement=d, pose=twice), robot, T).any()
