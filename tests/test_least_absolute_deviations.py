"""Fits by least absolute deviations: compiled sums compared with NumPy, bounds, and columns without data."""

from __future__ import annotations

import numpy as np
import pytest

from machopt.measurement.estimation.bounded_least_squares import minimise_bounded_quadratic
from machopt.measurement.estimation.robust_weights import (
    NORMAL,
    fit_least_absolute_deviations,
    sum_absolute_deviations,
)
from machopt.measurement.identification.data_quality.alternative_conventions import (
    _minimise_from,
    fit_bounded_absolute_deviations,
)


def test_weighted_sums_equal_those_of_numpy() -> None:
    rng = np.random.default_rng(2)
    X, z, x = rng.normal(size=(40, 3)), rng.normal(size=40), rng.normal(size=3)
    r = np.abs(z - X @ x)
    w = 1.0 / np.maximum(r, 1e-3 * max(np.median(r) / NORMAL, 1e-9))
    H, h = sum_absolute_deviations(X, z, x, 1e-9)
    np.testing.assert_allclose(H, X.T @ (w[:, None] * X), rtol=1e-12)
    np.testing.assert_allclose(h, X.T @ (w * z), rtol=1e-12)


def test_a_gross_error_does_not_move_the_coefficients() -> None:
    rng = np.random.default_rng(3)
    A, x = rng.normal(size=(60, 3, 2)), np.array([2.0, 0.5])
    y = A @ x
    y[7] += 100.0
    np.testing.assert_allclose(fit_least_absolute_deviations(A, y, np.ones(60)), x, rtol=1e-4)


@pytest.mark.parametrize("columns", [(0,), (0, 1), (0, 1, 2)])
def test_columns_without_data_have_small_coefficients(columns: tuple[int, ...]) -> None:
    rng = np.random.default_rng(4)
    A, x = rng.normal(size=(30, 3, 3)), np.array([1.0, 2.0, 3.0])
    A[:, :, list(columns)] = 0.0
    for fit in (fit_least_absolute_deviations, fit_bounded_absolute_deviations):
        found = fit(A, A @ x, np.ones(30))
        assert np.abs(found[list(columns)]).max() < 1e-6


@pytest.mark.parametrize("angle", [0.0, 1e-7, 1e-3, 1.0])
def test_known_positive_coefficients_give_the_minimum_of_the_search(angle: float) -> None:
    """The positive set of the previous step contains two antiparallel columns; only one of them is needed."""
    rng = np.random.default_rng(5)
    a, b, c = rng.normal(size=(3, 50))
    X = np.stack([a, -a + angle * b, c], axis=1)
    z = X @ np.array([0.1, 0.0, 0.0]) + 0.01 * rng.normal(size=50)
    H, h = X.T @ X, X.T @ z
    found, wanted = _minimise_from(H, h, np.array([True, True, False])), minimise_bounded_quadratic(H, h, np.zeros(3))
    assert (found >= 0.0).all()
    value, least = (0.5 * x @ H @ x - h @ x for x in (found, wanted))
    assert value == pytest.approx(least, rel=1e-9)
    assert np.abs(found).max() < 1.0
