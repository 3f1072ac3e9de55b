"""T-optimal design for discrimination between two laws: the wrong law should fit the readings as badly as possible.

With truth y = B b and rival A, the best fit of the rival leaves λ = min_a |y − A a|²_W, the noncentrality of the test
between both. Since λ = det M_[A y] / det M_A, a T-optimal design is found like a D-optimal one with the deviation as
an additional unknown (Atkinson & Fedorov 1975; the equality is the determinant of a bordered matrix).
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from machopt.measurement.design.d_optimal_search import (
    DesignProblem,
    ModelBelief,
    ReadingDesign,
    compute_information_matrix,
    find_d_optimal_design,
)
from machopt.numerics.array_types import Array, Ints


@dataclass(frozen=True)
class DiscriminationDesign:
    """Design that discriminates between two laws."""

    design: ReadingDesign
    b_against_a: float  # noncentrality if b is true and a is fitted
    a_against_b: float  # noncentrality if a is true and b is fitted; NaN without values of a


def design_discrimination(
    responses_a: Array,
    responses_b: Array,
    values_b: Array,
    covariance: Array,
    pose: Ints,
    shared: Array,
    poses: int,
    loads: int,
    *,
    rng: np.random.Generator,
    values_a: Array | None = None,
    starts: int = 2,
) -> DiscriminationDesign:
    """Select the readings at which law b differs most from law a.

    Args:
        responses_a: (N, D, Pa) response of the rival's unknowns, all refitted.
        responses_b: (N, D, Pb) response of the law taken as true.
        values_b: (Pb,) values of the true law.
        covariance: (N, D, D) noise of the readings.
        pose: (N,) pose labels, ascending.
        shared: (D, D) covariance of the error shared by the readings of a pose.
        poses: Number of poses.
        loads: Number of different loads at each pose.
        rng: Random generator.
        values_a: (Pa,) values of a; they make the design symmetric, with each law as the truth in turn.
        starts: Number of starts of the exchange.

    Returns:
        The design with its noncentralities; near zero if no reading separates the laws.

    Source:
        Atkinson & Fedorov, Biometrika 62 (1975) 57, eq. 2.2, for laws linear in their unknowns.
    """
    ways = [(responses_a, responses_b @ values_b)]
    if values_a is not None:
        ways.append((responses_b, responses_a @ values_a))
    models = []
    for A, y in ways:
        A = _normalise_columns(A, covariance)  # noqa: PLW2901  the columns' units do not matter to a refit
        models.append(ModelBelief(np.concatenate([A, y[..., None]], axis=-1), covariance, 1.0 / len(ways)))
        models.append(ModelBelief(A, covariance, -1.0 / len(ways)))
    problem = DesignProblem(tuple(models), pose, shared)
    design = find_d_optimal_design(problem, poses, loads, rng=rng, starts=starts)
    back = (
        float("nan") if values_a is None else compute_noncentrality(*ways[1], covariance, pose, shared, design.blocks)
    )
    return DiscriminationDesign(design, compute_noncentrality(*ways[0], covariance, pose, shared, design.blocks), back)


def compute_noncentrality(
    responses: Array, truth: Array, covariance: Array, pose: Ints, shared: Array, blocks: Sequence[Sequence[int]]
) -> float:
    """Compute min_a |truth − responses a|² in units of the noise over selected readings.

    Args:
        responses: (N, D, P) response of the rival's unknowns.
        truth: (N, D) signal of the true law.
        covariance: (N, D, D) noise of the readings, as in :func:`design_discrimination`.
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
