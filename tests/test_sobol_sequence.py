"""Scrambled Sobol sequence compared with SciPy's."""

from __future__ import annotations

import numpy as np
import pytest
from scipy.stats import qmc

from machopt.numerics.sobol_sequence import LARGEST_DIMENSION, draw_scrambled_sobol


@pytest.mark.parametrize("dimension", [1, 2, 3, 24, 30, 37, LARGEST_DIMENSION, LARGEST_DIMENSION + 1])
@pytest.mark.parametrize("count", [1, 2, 64, 2048])
def test_points_equal_scipy_bit_by_bit(dimension: int, count: int) -> None:
    for seed in (0, 20):
        own = draw_scrambled_sobol(dimension, count, np.random.default_rng(seed))
        other = qmc.Sobol(dimension, scramble=True, rng=np.random.default_rng(seed)).random(count)
        assert own.shape == (count, dimension)
        assert (own == other).all()


def test_every_dyadic_interval_of_a_coordinate_contains_one_point() -> None:
    points = draw_scrambled_sobol(40, 1024, np.random.default_rng(7))
    cells = np.sort(np.floor(points * 1024).astype(int), axis=0)
    assert (cells == np.arange(1024)[:, None]).all()
