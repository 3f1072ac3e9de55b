"""Shift of a part that makes all unreachable points reachable."""

from __future__ import annotations

import numpy as np

from machopt.planning.plan_output.reach_advice import NEAR, _shift


def test_shift_brings_every_point_into_reach() -> None:
    rng = np.random.default_rng(2)
    inside = rng.normal(size=(40, 3))
    inside *= rng.uniform(0.0, 0.98, (40, 1)) / np.linalg.norm(inside, axis=1, keepdims=True)
    away = np.array([0.7, -0.4, 0.2])
    by = _shift(inside + away, np.ones(40))
    assert np.linalg.norm(inside + away + by, axis=1).max() <= 1.0 + NEAR
    assert np.linalg.norm(by) <= np.linalg.norm(away) + NEAR


def test_single_point_moves_by_the_missing_length() -> None:
    by = _shift(np.array([[1.3, 0.0, 0.0]]), np.array([1.0]))
    assert np.allclose(by, [-0.3, 0.0, 0.0], atol=NEAR)


def test_points_on_opposite_sides_have_no_common_shift() -> None:
    at = np.array([[1.3, 0.0, 0.0], [-1.3, 0.0, 0.0]])
    assert np.linalg.norm(at + _shift(at, np.ones(2)), axis=1).max() > 1.0 + NEAR
