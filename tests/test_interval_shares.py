"""Shares of normal distributions within limits, compared with SciPy's normal distribution."""

from __future__ import annotations

import numpy as np
from scipy.special import ndtr

from machopt.numerics.normal_interval_probability import compute_interval_shares


def test_shares_equal_those_of_the_normal_distribution() -> None:
    rng = np.random.default_rng(3)
    means = rng.normal(0.0, 3.0, (40, 500))
    limit, std = rng.uniform(0.01, 6.0, 40), 10.0 ** rng.uniform(-3.0, 1.0, 40)
    t, s = limit[:, None], std[:, None]
    wanted = np.mean(ndtr((t - means) / s) - ndtr((-t - means) / s), axis=1)
    assert np.abs(compute_interval_shares(means, limit, std) - wanted).max() < 2e-11


def test_single_values_over_the_whole_range() -> None:
    x = np.linspace(-12.0, 12.0, 24001)
    found = compute_interval_shares(-x[:, None], np.full(len(x), 1e9), np.ones(len(x)))
    assert np.abs(found - 1.0).max() == 0.0
    found = compute_interval_shares(50.0 - x[:, None], np.full(len(x), 50.0), np.ones(len(x)))  # Φ(x) − 0
    assert np.abs(found - ndtr(x)).max() < 1e-11


def test_share_without_noise_counts_means_within_the_limit() -> None:
    means = np.array([[0.5, 1.5, -0.2, -3.0], [0.1, 0.2, 0.3, 0.4]])
    assert compute_interval_shares(means, np.ones(2), np.zeros(2)).tolist() == [0.5, 1.0]
