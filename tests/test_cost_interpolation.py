"""Interpolated cost table of the smoothing: equals the SciPy spline, with exact derivatives."""

from __future__ import annotations

import numpy as np
import pytest
from scipy.interpolate import make_interp_spline

from machopt.planning.smoothing.cost_interpolation import CostInterpolation

STEP = 0.0875


def _costs(n: int) -> np.ndarray:
    return np.random.default_rng(3).uniform(1.0, 2.0, (n, 33))


@pytest.mark.parametrize("n", [1, 3, 40])
def test_table_contains_the_spline_of_every_station(n: int) -> None:
    """Reference: the SciPy spline of each station, at the given values, between them, and at both ends."""
    cost, offset = _costs(n), np.arange(-16, 17) * STEP
    table = CostInterpolation(cost, STEP)
    for off in (*np.linspace(-1.39, 1.39, 7), *offset[[0, 1, 16, 31, 32]]):
        expected = [float(make_interp_spline(offset, c, k=3)(off)) for c in cost]
        assert table.at(np.full(n, off))[0] == pytest.approx(expected, abs=1e-10)


def test_derivatives_agree_with_finite_differences() -> None:
    """At the chosen rotation, which is a knot, and slightly outside the table."""
    n, h = 12, 1e-5
    table = CostInterpolation(_costs(n), STEP)
    for at in (np.zeros(n), np.random.default_rng(2).uniform(-1.5, 1.5, n)):
        _, slope, bend = table.at(at)
        up, down = table.at(at + h), table.at(at - h)
        assert slope == pytest.approx((up[0] - down[0]) / (2 * h), abs=1e-4, rel=1e-6)  # errors: 1e-16 / h and h²
        # the third derivative jumps at a knot: the difference has an error of half a jump × h
        assert bend == pytest.approx((up[1] - down[1]) / (2 * h), abs=0.5)


def test_cost_outside_the_table_is_constant() -> None:
    """The optimization may evaluate points outside the corridor; a cost of zero there would attract it."""
    cost = _costs(4)
    assert CostInterpolation(cost, STEP).at(np.full(4, 16.02 * STEP))[0] == pytest.approx(cost[:, -1], rel=0.05)
