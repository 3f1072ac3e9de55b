"""Variance that belongs to single poses, from regions of poses that a fit left out."""

from __future__ import annotations

import numpy as np
from scipy.special import log_ndtr

from machopt.numerics.array_types import Array

DIRECTIONS = 2  # directions along which poses are divided into regions


def estimate_pose_variance(left: Array, expected: Array, force: Array, directions: int = DIRECTIONS) -> float:
    """Estimate the independent variance of a pose from left-out regions, whose squares are ``expected`` + variance ·
    ``force``.

    Regions are weighted by the inverse of their expectation (first step of Paule & Mandel 1982). Few regions
    determine a variance poorly, and the most likely value, often zero, is not conservative. The result is the
    posterior mean over non-negative values, with the standard error from the regions' scatter.

    Args:
        left: (R,) sum of squares of a region's readings, m².
        expected: (R,) expected sum of squares, m².
        force: (R,) sum of squared forces, N².
        directions: Number of divisions into regions; the regions of each hold all poses.

    Returns:
        Variance, (m/N)².
    """
    has_load = (expected > 0) & (force > 0)
    if not has_load.any():
        return 0.0
    beyond, per_newton = left[has_load] / expected[has_load] - 1.0, force[has_load] / expected[has_load]
    found = float(beyond.sum() / per_newton.sum())
    count = len(beyond)
    if count < 2:
        return max(found, 0.0)
    off = float(np.sum((beyond - found * per_newton) ** 2)) * count / (count - 1)
    error = float(np.sqrt(directions * off) / per_newton.sum())
    if not error > 0:
        return max(found, 0.0)
    away = found / error
    mean = found + error * float(np.exp(-0.5 * away**2 - log_ndtr(away)) / np.sqrt(2.0 * np.pi))
    return max(mean, 0.0)  # guards against rounding for strongly negative estimates
