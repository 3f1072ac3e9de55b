"""What forces read per what the arm did under them: shares, one a pose, and what their middle one says."""

from __future__ import annotations

import numpy as np
from scipy.special import bdtrc

from machopt.arrays import Array
from machopt.diagnose.nouns.result import Estimate
from machopt.estimate.experiment import Experiment
from machopt.estimate.robust import start


def predicted(tests: Experiment) -> Array:
    """(N, 3) m that the arm moves by springs which fit all readings."""
    load = np.linalg.norm(tests.wrench[:, :3], axis=1) + np.linalg.norm(tests.wrench[:, 3:], axis=1)
    return np.asarray(tests.response()[:, :3] @ start(tests.response(), tests.measured, load))


def gain(each: Array, middle: float, spread: float) -> tuple[Estimate, float]:
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
    return Estimate(over, "%", low, high), float(bdtrc(agree - 1, len(each), 0.5)) if agree else 1.0
