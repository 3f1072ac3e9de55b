"""What forces read per what the arm did under them: shares, one a pose, and what their middle one says."""

from __future__ import annotations

import numpy as np
from scipy.special import bdtrc

from machopt.measurement.diagnosis.data_types.diagnosis_result import EstimatedValue
from machopt.measurement.estimation.load_test_equations import LoadTestExperiment
from machopt.measurement.estimation.robust_weights import fit_least_absolute_deviations
from machopt.numerics.array_types import Array


def predict_displacements(tests: LoadTestExperiment) -> Array:
    """(N, 3) m that the arm moves by springs which fit all readings."""
    load = np.linalg.norm(tests.wrench[:, :3], axis=1) + np.linalg.norm(tests.wrench[:, 3:], axis=1)
    return np.asarray(tests.response()[:, :3] @ fit_least_absolute_deviations(tests.response(), tests.measured, load))


def estimate_force_gain(each: Array, middle: float, spread: float) -> tuple[EstimatedValue, float]:
    """By how much forces read too much, and how likely it is that as many shares lie to that side by chance.

    Args:
        each: (K,) shares of the poses.
        middle: their median.
        spread: 1 sigma of one.

    Returns:
        %, with its 90 and 95 % intervals; the p-value.
    """
    over, wide = 100.0 * (middle - 1.0), 100.0 * float(np.sqrt(0.5 * np.pi / len(each))) * spread
    agree = int(np.sum((each > 1.0) == (middle > 1.0)))
    low, high = ((over - k * wide, over + k * wide) for k in (1.645, 1.96))
    return EstimatedValue(over, "%", low, high), float(bdtrc(agree - 1, len(each), 0.5)) if agree else 1.0
