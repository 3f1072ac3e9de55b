"""The cubic curves of the planner, compared with scipy.interpolate."""

from __future__ import annotations

import numpy as np
from scipy.interpolate import BSpline, CubicSpline, PchipInterpolator

from machopt.planning.smoothing.cubic_curves import (
    CubicSpline as planning_CubicSpline,
)
from machopt.planning.smoothing.cubic_curves import (
    build_design_matrix,
    fit_cubic_splines,
    interpolate_monotone,
)

SAME = 1e-13  # the same sums, possibly in a different order after compilation


def test_b_splines_equal_scipy() -> None:
    rng = np.random.default_rng(3)
    for intervals in (1, 2, 7, 160):
        knots = np.r_[[0.0] * 3, np.linspace(0.0, 0.8, intervals + 1), [0.8] * 3]
        x = np.r_[0.0, np.sort(rng.uniform(0.0, 0.8, 50)), knots[3:-3], 0.8]
        theirs, ours = BSpline.design_matrix(x, knots, 3).tocsr(), build_design_matrix(knots, x)
        assert ours.shape == theirs.shape
        assert np.array_equal(ours.indices, theirs.indices)
        assert np.allclose(ours.data, theirs.data, rtol=0, atol=SAME)
        c = rng.normal(size=intervals + 3)
        assert np.allclose(planning_CubicSpline(knots, c)(x), BSpline(knots, c, 3)(x), rtol=0, atol=SAME)


def test_splines_through_equidistant_values_equal_scipy() -> None:
    x, values = np.arange(-16, 17) * 0.087, np.random.default_rng(4).normal(size=(33, 5))
    theirs = CubicSpline(x, values).c
    assert np.allclose(fit_cubic_splines(x, values), theirs, rtol=0, atol=SAME * np.abs(theirs).max())


def test_monotone_curves_equal_scipy() -> None:
    rng = np.random.default_rng(5)
    for m in (2, 3, 4, 30):
        for _ in range(20):
            x, y = np.cumsum(rng.uniform(0.01, 1.0, m)), np.round(rng.normal(size=m), 1)  # also with constant sections
            at = np.r_[x, rng.uniform(x[0], x[-1], 40)]
            assert np.allclose(interpolate_monotone(x, y, at), PchipInterpolator(x, y)(at), rtol=0, atol=SAME)
