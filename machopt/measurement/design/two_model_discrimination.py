"""T-optimal design for discrimination between two laws: the wrong law should fit the readings as badly as possible.

With truth y = B b and rival A, the best fit of the rival leaves λ = min_a |y − A a|²_W, the noncentrality of the test
between both. Since λ = det M_[A y] / det M_A, a T-optimal design is found like a D-optimal one with the deviation as
an additional unknown (Atkinson & Fedorov 1975; the equality is the determinant of a bordered matrix).
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from machopt.measurement.design.d_optimal_search import compute_information_matrix, find_d_optimal_design
from machopt.measurement.design.design_problem import DesignProblem, ModelBelief, ReadingDesign
from machopt.numerics.array_types import Array, Ints


@dataclass(frozen=True)
class DiscriminationDesign:
    """Design that discriminates between two laws."""

    design: ReadingDesign
    truth_against_rival: float  # noncentrality if the truth holds and the rival is fitted
    rival_against_truth: float  # noncentrality if the rival holds and the truth is fitted; NaN without its values


@dataclass(frozen=True)
class LawResponse:
    """Response of N readings with D components to the P unknowns of one law."""

    columns: Array  # (N, D, P)
    values: Array | None = None  # (P,) values of the unknowns; None: not known

    @property
    def signal(self) -> Array:
        """(N, D) signal of the law with its values."""
        if self.values is None:
            raise ValueError("the signal of a law needs the values of its unknowns")
        return np.asarray(self.columns @ self.values)


@dataclass(frozen=True)
class ReadingErrors:
    """Errors of N readings with D components."""

    covariance: Array  # (N, D, D) noise of the readings
    pose: Ints  # (N,) pose labels, ascending
    shared: Array  # (D, D) covariance of the error shared by the readings of a pose


def design_discrimination(
    rival: LawResponse,
    truth: LawResponse,
    errors: ReadingErrors,
    poses: int,
    loads: int,
    *,
    rng: np.random.Generator,
    starts: int = 2,
) -> DiscriminationDesign:
    """Select the readings at which the true law differs most from its rival.

    Args:
        rival: Law whose unknowns are all refitted. Its values make the design symmetric, with each law as the truth in
            turn.
        truth: Law taken as true, with its values.
        errors: Errors of the readings.
        poses: Number of poses.
        loads: Number of different loads at each pose.
        rng: Random generator.
        starts: Number of starts of the exchange.

    Returns:
        The design with its noncentralities; near zero if no reading separates the laws.

    Source:
        Atkinson & Fedorov, Biometrika 62 (1975) 57, eq. 2.2, for laws linear in their unknowns.
    """
    ways = [(rival.columns, truth.signal)]
    if rival.values is not None:
        ways.append((truth.columns, rival.signal))
    models = []
    for columns, signal in ways:
        A = _normalise_columns(columns, errors.covariance)  # the columns' units do not matter to a refit
        both = np.concatenate([A, signal[..., None]], axis=-1)
        models.append(ModelBelief(both, errors.covariance, 1.0 / len(ways)))
        models.append(ModelBelief(A, errors.covariance, -1.0 / len(ways)))
    problem = DesignProblem(tuple(models), errors.pose, errors.shared)
    design = find_d_optimal_design(problem, poses, loads, rng=rng, starts=starts)
    noncentralities = [
        compute_noncentrality(columns, signal, errors.covariance, errors.pose, errors.shared, design.blocks)
        for columns, signal in ways
    ]
    return DiscriminationDesign(design, noncentralities[0], noncentralities[1] if len(ways) > 1 else float("nan"))


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
