"""Permutation probability: equal sums count as equal for any order of their terms."""

from __future__ import annotations

import itertools

import numpy as np

from machopt.measurement.diagnosis.statistics.permutation_probability import compute_permutation_probability


def test_few_groups_have_no_smaller_probability_than_their_number_of_sign_patterns() -> None:
    """Four groups have 16 patterns; one of them is the observed one, for every order of addition."""
    rng = np.random.default_rng(1)
    for _ in range(200):
        terms = rng.uniform(0.1, 1.0, 4)
        signs = np.array(list(itertools.product((-1.0, 1.0), repeat=4)))
        drawn = np.array([sum(row[order] * terms[order]) for row in signs for order in [rng.permutation(4)]])
        p = compute_permutation_probability(drawn, float(terms.sum()), float(np.abs(terms).sum()))
        assert p == 2.0 / 17.0


def test_smaller_and_larger_values_are_counted() -> None:
    drawn = np.array([-1.0, 0.0, 1.0, 2.0])
    assert compute_permutation_probability(drawn, 0.5, 4.0) == 3.0 / 5.0
    assert compute_permutation_probability(drawn, 3.0, 4.0) == 1.0 / 5.0
