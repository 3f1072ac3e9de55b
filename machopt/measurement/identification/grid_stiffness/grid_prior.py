"""Prior, linearised response and posterior of the cells of a stiffness grid."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from scipy.sparse import csr_matrix

from machopt.measurement.estimation.error_clusters import VarianceComponents
from machopt.numerics.array_types import Array

RANGE_LEAST = 0.15  # ℓ in cell lengths: the correlation of neighbours, exp(−6.7), is negligible


@dataclass(frozen=True)
class GridPrior:
    """Parameters estimated by the likelihood. ``noise`` as in

    :class:`~machopt.measurement.estimation.error_clusters.VarianceComponents`.
    """

    spread: Array  # (F,) s of each varying joint, in log compliance
    range: float  # ℓ in cell lengths
    site_spread_share: float  # η: 1 sigma of a site about its cell, as a share of the spread
    noise: tuple[VarianceComponents, ...] = ()  # one per channel

    @classmethod
    def start(cls, joints: int, smooth: bool) -> GridPrior:
        """Return start values: 10 % variation, correlated neighbours, sites with 30 % of the variation.

        Args:
            joints: Number of varying joints.
            smooth: Whether neighbouring cells may be correlated.

        Returns:
            The prior.
        """
        return cls(np.full(joints, 0.1), 1.0 if smooth else RANGE_LEAST, 0.3)


@dataclass(frozen=True)
class LinearisedResponse:
    """Responses r = u + E β of the places about the current values of the cells; β: cells × joints, then terms."""

    E: csr_matrix  # (L·R, n)
    u: Array  # (L, R)


@dataclass(frozen=True, kw_only=True)
class GridPosterior:
    """Posterior of the unknowns."""

    beta: Array  # (n,)
    covariance: Array  # (n, n)
    response: Array  # (L, R) response of each place
    response_covariance: Array  # (L, R, R)
    site_response: Array  # (S, R) response of each site, with its own deviation
    value: float  # −2 log restricted likelihood, up to a constant


@dataclass(frozen=True, kw_only=True)
class MarginalEquations:
    """Equations of places and sites with the sites' deviations integrated out."""

    H: Array  # (L, R, R)
    h: Array  # (L, R)
    H_site: Array  # (S, R, R)
    h_site: Array  # (S, R)
    T: Array  # (R, R) covariance of a site's deviation
    yy: float
    logdet: float
