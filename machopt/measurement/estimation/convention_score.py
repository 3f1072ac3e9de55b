"""Evidence for another convention of a recording, with its parameters counted.

Readings of one pose share their errors, so a pose counts as one observation. Its typical error is taken as an
exponential variable of unknown scale: −2 log L = 2 n log(mean). Each fitted number costs log n (Schwarz 1978), and a
choice among m conventions costs 2 log m.
"""

from __future__ import annotations

import numpy as np

from machopt.numerics.array_types import Array, Ints

LEAST = 1e-12  # smallest error that counts, m


def compute_pose_errors(pose: Ints, error: Array) -> Array:
    """Return the mean error of each pose.

    Args:
        pose: (N,) pose labels.
        error: (N,) error of each reading, m.

    Returns:
        (G,) m, in the order of the sorted labels.
    """
    _, index = np.unique(pose, return_inverse=True)
    index = index.reshape(-1)
    return np.asarray(np.bincount(index, error) / np.bincount(index))


def compute_description_cost(by_pose: Array, parameters: int = 0, choices: float = 1.0) -> float:
    """Return −2 log evidence of a convention, up to a constant.

    Args:
        by_pose: (G,) mean error of each pose, m.
        parameters: Number of fitted numbers that the convention needs beyond the others.
        choices: Number of conventions that it was chosen from.

    Returns:
        Smaller is better; a difference of 10 is very strong evidence (Kass & Raftery 1995).
    """
    n = len(by_pose)
    fit = 2.0 * n * float(np.log(max(float(np.mean(by_pose)), LEAST)))
    return fit + parameters * float(np.log(max(n, 2))) + 2.0 * float(np.log(choices))
