"""Noise of the residuals: an autoregression of each force, and the part that repeats with the rotation.

An autoregression r_t = Σ a_i r_(t−i) + e_t is fitted by the Yule–Walker equations to the residuals of all cuts. Its
order has the least Bayesian information criterion. Filtered residuals and derivatives have independent errors of unit
variance, so that the covariance of the unknowns is that of ordinary least squares.

Sources: Box, Jenkins & Reinsel, Time Series Analysis, 4th ed. (2008), section 7.3.2; Schwarz, Ann. Stat. 6 (1978) 461.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from machopt.numerics.array_types import Array

MOST_ORDER = 12  # of the autoregression: covers a resonance and coloured noise of a force sensor
PHASE_BINS = 48  # of a revolution, in which residuals are averaged to find what repeats


@dataclass(frozen=True)
class ResidualNoise:
    """Autoregression of travel, normal and axial force."""

    coefficients: tuple[Array, ...]  # three of (p,)
    sigma: Array  # (3,) N, of the innovations e

    @property
    def order(self) -> int:
        """Largest order of the three."""
        return max(len(a) for a in self.coefficients)

    def whiten(self, values: Array) -> Array:
        """Return filtered samples of a cut without the first ``order`` ones.

        Args:
            values: (S, 3, …) residuals in N, or their derivatives.
        """
        out = np.empty((len(values) - self.order, *values.shape[1:]))
        for f, a in enumerate(self.coefficients):
            part = np.array(values[self.order :, f])
            for lag, weight in enumerate(a, start=1):
                part -= weight * values[self.order - lag : len(values) - lag, f]
            out[:, f] = part / self.sigma[f]
        return out


def build_white_noise(residuals: Sequence[Array], floor: float) -> ResidualNoise:
    """Return uncorrelated noise with the mean square of the residuals.

    Args:
        residuals: (S_c, 3) N of each cut.
        floor: N, least standard deviation.
    """
    square = np.mean(np.concatenate(residuals) ** 2, axis=0)
    return ResidualNoise((np.zeros(0),) * 3, np.maximum(np.sqrt(square), floor))


def fit_noise(residuals: Sequence[Array], floor: float) -> ResidualNoise:
    """Return the autoregression of the residuals.

    Args:
        residuals: (S_c, 3) N of each cut, evenly spaced samples.
        floor: N, least standard deviation of an innovation: rounding of the forces.
    """
    found = [_fit_component([r[:, f] for r in residuals]) for f in range(3)]
    return ResidualNoise(tuple(a for a, _ in found), np.maximum(np.array([s for _, s in found]), floor))


def _fit_component(residuals: Sequence[Array]) -> tuple[Array, float]:
    """Return coefficients and innovation of the order with the least criterion, by Levinson's recursion."""
    count = sum(map(len, residuals))
    most = min(MOST_ORDER, min(map(len, residuals)) // 4)
    acov = np.array([sum(float(r[k:] @ r[: len(r) - k]) for r in residuals) for k in range(most + 1)]) / count
    a, variance = np.zeros(0), acov[0]
    best, least = (a, variance), count * math.log(max(variance, 1e-300))
    for p in range(1, most + 1):
        if not variance > 0.0:
            break
        reflection = (acov[p] - a @ acov[p - 1 : 0 : -1]) / variance
        a = np.append(a - reflection * a[::-1], reflection)
        variance *= 1.0 - reflection**2
        criterion = count * math.log(max(variance, 1e-300)) + p * math.log(count)
        if criterion < least:
            best, least = (a, variance), criterion
    return np.array(best[0]), math.sqrt(max(best[1], 0.0))


def compute_repeatable_ratio(phases: Sequence[Array], whitened: Sequence[Array], unknowns: int) -> tuple[float, float]:
    """Return the mean square of the part that repeats with the rotation over what noise makes of it, and its limit.

    Args:
        phases: (S_c,) rad of each cut.
        whitened: (S_c, 3) residuals of unit variance.
        unknowns: number of fitted unknowns.

    Returns:
        The ratio, about 1 without a misfit, and its 99 % quantile under noise alone.
    """
    from scipy.special import chdtri

    total, freedom = 0.0, -unknowns
    for phi, e in zip(phases, whitened, strict=True):
        number = np.floor(phi / (2.0 * math.pi) * PHASE_BINS).astype(np.intp) % PHASE_BINS
        count = np.bincount(number, minlength=PHASE_BINS)
        for f in range(3):
            sums = np.bincount(number, e[:, f], PHASE_BINS)
            total += float(np.sum(sums[count > 0] ** 2 / count[count > 0]))
            freedom += int(np.sum(count > 0))
    freedom = max(freedom, 1)
    return total / freedom, float(chdtri(freedom, 0.01)) / freedom
