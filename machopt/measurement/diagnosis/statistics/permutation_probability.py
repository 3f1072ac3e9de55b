"""Probability of a statistic under random permutations or sign flips."""

from __future__ import annotations

import numpy as np

from machopt.numerics.array_types import Array


def compute_permutation_probability(drawn: Array, observed: float, scale: float) -> float:
    """Return the probability of a statistic at least as large as the observed one.

    With few groups, permutations give the observed value itself. Their sums are added in another order and differ by
    rounding, so values within 1e-12 of the scale count as equal.

    Args:
        drawn: (N,) statistics of the permutations.
        observed: observed statistic, in the same unit.
        scale: sum of the absolute values of the added terms, in the same unit.

    Returns:
        (1 + number of statistics at least as large) / (N + 1) (Phipson and Smyth 2010).
    """
    return float((1 + np.sum(drawn >= observed - 1e-12 * scale)) / (len(drawn) + 1))
