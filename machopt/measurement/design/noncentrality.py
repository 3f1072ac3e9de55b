"""Noncentrality of the test between two laws of the same readings.

With truth y = B b and rival A, the best fit of the rival leaves λ = min_a |y − A a|²_W, the noncentrality of the test
between both (Atkinson & Fedorov, Biometrika 62 (1975) 57).
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from machopt.measurement.design.d_optimal_search import compute_information_matrix
from machopt.measurement.design.design_problem import DesignProblem, ModelBelief
from machopt.numerics.array_types import Array, Ints


def compute_noncentrality(
    responses: Array, truth: Array, covariance: Array, pose: Ints, shared: Array, blocks: Sequence[Sequence[int]]
) -> float:
    """Compute min_a |truth − responses a|² in units of the noise over selected readings.

    Args:
        responses: (N, D, P) response of the rival's unknowns.
        truth: (N, D) signal of the true law.
        covariance: (N, D, D) noise of the readings.
        pose: (N,) pose labels.
        shared: (D, D) covariance of the error shared by the readings of a pose.
        blocks: Selected readings, grouped by pose.

    Returns:
        Noncentrality.
    """
    both = ModelBelief(
        np.concatenate([_normalise_columns(responses, covariance), truth[..., None]], axis=-1), covariance
    )
    M = compute_information_matrix(DesignProblem((both,), pose, shared), blocks)
    A, b, yy = M[:-1, :-1], M[:-1, -1], float(M[-1, -1])
    return max(0.0, yy - float(b @ np.linalg.lstsq(A, b, rcond=None)[0]))


def _normalise_columns(responses: Array, covariance: Array) -> Array:
    """Scale columns so that the most informative reading has unit information."""
    size = np.einsum("ndp,ndp->np", responses, np.linalg.solve(covariance, responses))
    most = np.sqrt(size.max(axis=0))
    return np.asarray(responses / np.where(most > 0.0, most, 1.0))
