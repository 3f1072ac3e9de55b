"""Estimate of a force gain: ratios of recorded force to the force that the deflection implies, one per pose, and
their median.
"""

from __future__ import annotations

import numpy as np
from scipy.special import bdtrc

from machopt.measurement.diagnosis.data_types.diagnosis_result import EstimatedValue
from machopt.measurement.estimation.load_test_equations import LoadTestExperiment
from machopt.measurement.estimation.robust_weights import fit_least_absolute_deviations
from machopt.numerics.array_types import Array


def predict_displacements(tests: LoadTestExperiment) -> Array:
    """Predict displacements with joint springs fitted to all readings (least absolute deviations).

    Args:
        tests: Load-test experiment with N readings.

    Returns:
        (N, 3) m.
    """
    load = np.linalg.norm(tests.wrench[:, :3], axis=1) + np.linalg.norm(tests.wrench[:, 3:], axis=1)
    return np.asarray(tests.response()[:, :3] @ fit_least_absolute_deviations(tests.response(), tests.measured, load))


def estimate_force_gain(each: Array, middle: float, spread: float) -> tuple[EstimatedValue, float]:
    """Estimate the gain error of forces and its significance.

    Args:
        each: (K,) force ratios of the poses.
        middle: Median of the ratios.
        spread: Standard deviation of one ratio.

    Returns:
        Gain error in % with 90 % and 95 % confidence intervals, and the p-value of a sign test.
    """
    over, wide = 100.0 * (middle - 1.0), 100.0 * float(np.sqrt(0.5 * np.pi / len(each))) * spread
    agree = int(np.sum((each > 1.0) == (middle > 1.0)))
    low, high = ((over - k * wide, over + k * wide) for k in (1.645, 1.96))
    return EstimatedValue(over, "%", low, high), float(bdtrc(agree - 1, len(each), 0.5)) if agree else 1.0
