"""A reading that was pasted into the row of another pose is told from one that was there."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from test_diagnose_absolute import arm, measure

from machopt.diagnose.record.pasted import pasted


@pytest.mark.parametrize("turned", [0.0, 2.0])
def test_of_two_rows_that_read_alike_the_one_farther_from_the_arm_is_the_copy(turned: float) -> None:
    """Wherever the tracker stands; poses that are visited again may read alike."""
    cell, robot, _ = arm()
    T = cell.tool.T_flange_tcp
    frame = np.array([0.3, -1.0, 0.2]), np.array([0.0, 0.0, turned]), np.zeros(3)
    exact = measure(frame=frame)
    assert exact.position is not None
    assert not pasted(exact, robot, T).any()
    r = measure(frame=frame, noise=2e-5)
    assert r.position is not None
    assert not pasted(r, robot, T).any()
    x = r.position.copy()
    x[[4, 21]] = x[[17, 3]]
    spoilt = replace(r, position=x)
    assert np.flatnonzero(pasted(spoilt, robot, T)).tolist() == [4, 21]
    coarse = replace(spoilt, position=np.round(x, 5))  # read to 0.01 mm: alike by chance
    assert not pasted(coarse, robot, T).any()
