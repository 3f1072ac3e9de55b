"""The table of costs that IPOPT sees: the spline that CasADi itself would fit, and derivatives that are its own."""

from __future__ import annotations

import casadi as ca
import numpy as np
import pytest
from scipy.interpolate import make_interp_spline

from machopt.plan.costtable import CostTable

STEP = 0.0875


def _costs(n: int) -> np.ndarray:
    return np.random.default_rng(3).uniform(1.0, 2.0, (n, 33))


@pytest.mark.parametrize("n", [1, 3, 40])
def test_holds_the_spline_of_every_station(n: int) -> None:
    """Against scipy's, station by station, at the given values, between them, and at both ends."""
    cost, offset = _costs(n), np.arange(-16, 17) * STEP
    table, rows = CostTable.of(cost, STEP), np.arange(n)
    for off in (*np.linspace(-1.39, 1.39, 7), *offset[[0, 1, 16, 31, 32]]):
        expected = [float(make_interp_spline(offset, c, k=3)(off)) for c in cost]
        assert np.asarray(table(rows, np.full(n, off))).ravel() == pytest.approx(expected, abs=1e-10)


def test_is_the_interpolant_of_casadi() -> None:
    """The function it took the place of: linear between stations, of which only the stations are asked."""
    cost, offset = _costs(6), np.arange(-16, 17) * STEP
    theirs = ca.interpolant("cost", "bspline", [np.arange(6.0), offset], cost.ravel(order="F"), {"degree": [1, 3]})
    off = np.random.default_rng(1).uniform(-1.3, 1.3, 6)
    assert np.asarray(CostTable.of(cost, STEP)(np.arange(6), off)).ravel() == pytest.approx(
        np.asarray(theirs(np.stack([np.arange(6.0), off]))).ravel(), abs=1e-10
    )


def test_gradient_and_hessian_by_differences() -> None:
    """At stations exactly, where CasADi's table of two axes wrote outside its memory; at the chosen rotation too."""
    n, h = 12, 1e-5
    table, delta = CostTable.of(_costs(n), STEP), ca.MX.sym("delta", n)
    value = ca.sumsqr(table(np.arange(n), delta))
    all_of = ca.Function("f", [delta], [value, ca.gradient(value, delta), ca.hessian(value, delta)[0]])
    for at in (np.zeros(n), np.random.default_rng(2).uniform(-1.3, 1.3, n)):
        _, gradient, hessian = all_of(at)
        up, down = ([all_of(at + s * h * e) for e in np.eye(n)] for s in (1, -1))
        slopes = [float(a[0] - b[0]) / (2 * h) for a, b in zip(up, down, strict=True)]
        assert np.asarray(gradient).ravel() == pytest.approx(slopes, abs=1e-4, rel=1e-6)  # 1e-16 / h, and h²
        bends = [np.asarray(a[1] - b[1]).ravel() / (2 * h) for a, b in zip(up, down, strict=True)]
        # the third derivative jumps at the chosen rotation, a knot: what differences see there is half a jump × h
        assert np.asarray(ca.DM(hessian)) == pytest.approx(np.array(bends), abs=0.5)


def test_beside_the_table_the_cost_is_that_of_its_end() -> None:
    """IPOPT may look past the corridor; a cost of zero there would draw it outside."""
    cost = _costs(4)
    beside = np.asarray(CostTable.of(cost, STEP)(np.arange(4), np.full(4, 16.02 * STEP))).ravel()
    assert beside == pytest.approx(cost[:, -1], rel=0.05)
