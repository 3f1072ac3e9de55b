"""Weighted nonlinear least squares of frequency responses, with a scale of the noise of each response.

Minimised is Σ |H_i − H(ω_i)|²/(s_g σ_i)² + Σ ((x_j − p_j)/w_j)² by Levenberg–Marquardt steps on exact derivatives. The
scale s_g of each response follows from its residuals (iterated, feasible generalised least squares). Residuals of
neighbouring frequencies are correlated where the model lacks something: the covariance is multiplied by
(1 + r)/(1 − r) with the first autocorrelation r along the frequency, the variance of a mean of a first-order
autoregression (Box, Jenkins & Reinsel, Time Series Analysis, 4th ed. (2008), section 2.1).

The start is the first good one of several: factors of the prior, then random ones, fitted with residuals relative to
the measured receptance plus its median, whose basin is wide.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np

from machopt.data_types.stiffness import LEAST_STIFFNESS, STIFFEST
from machopt.measurement.identification.frequency_response.response_equations import TYPICAL_DAMPING
from machopt.measurement.identification.frequency_response.response_model import JOINTS, ResponseModel
from machopt.numerics.array_types import Array, ComplexArray, Ints, make_arrays_read_only
from machopt.numerics.free_unknowns import FreeUnknownSystem

PRIOR_SIGMA = 1.0  # of log k and log η: a factor e, the scatter of published joints of one size
REWEIGHTINGS = 6
START_ROWS = 400  # of the search for a start
START_FACTORS = (1.0, 0.7, 1.4, 0.5, 2.0)  # of all springs together
RANDOM_STARTS = 8
START_SCATTER = 0.4  # of log k of a random start
START_STEPS = 40
PASS_STEPS = 20  # of a pass with one set of scales; the next pass continues
GOOD_START = 0.15  # relative residual; in a wrong basin peaks are missed, and it is above 0.3
SCALE_CHANGE = 0.01  # relative, of a noise scale: intervals change by as much
MOST_CORRELATION = 0.95


@dataclass(frozen=True)
class ResponsePrior:
    """Normal prior of the unknowns log k and log η; an infinite deviation means none."""

    mean: Array  # (12,)
    sigma: Array  # (12,)

    def __post_init__(self) -> None:
        make_arrays_read_only(self)


@dataclass(frozen=True, kw_only=True)
class ResponseFit:
    """Minimum with its noise."""

    x: Array  # (12,)
    prior: ResponsePrior
    predicted: ComplexArray  # (N,) m/N
    scale: Array  # (G,) of the noise of each response
    inflation: float  # of the covariance, by correlated residuals
    information: Array  # (12, 12) of the responses alone, inflation included
    cost: float  # sum of squares, prior included, at the final scales
    log_likelihood: float

    def __post_init__(self) -> None:
        make_arrays_read_only(self)

    def compute_covariance(self) -> Array:
        """Return the covariance of the unknowns, the prior included, (12, 12)."""
        return np.asarray(np.linalg.inv(self.information + np.diag(self.prior.sigma**-2.0)))


def build_prior(stiffness: Array, has_prior: bool) -> ResponsePrior:
    """Return the prior of a fit in which nothing is known to be determined.

    Args:
        stiffness: (6,) N·m/rad, of the cell, or typical ones.
        has_prior: the cell has a stiffness; else its deviation is twice as large.
    """
    sigma = np.full(2 * JOINTS, PRIOR_SIGMA)
    sigma[:JOINTS] *= 1.0 if has_prior else 2.0
    return ResponsePrior(np.concatenate([np.log(stiffness), np.full(JOINTS, math.log(TYPICAL_DAMPING))]), sigma)


def find_start(model: ResponseModel, prior: ResponsePrior, rng: np.random.Generator) -> Array:
    """Return unknowns from which the fit converges, (12,).

    Args:
        model: Model of all rows.
        prior: Centre of the search.
        rng: Random generator of the starts.
    """
    count = len(model.equations.omega)
    rows = np.unique(np.linspace(0, count - 1, min(count, START_ROWS)).astype(np.int64))
    size = np.abs(model.equations.receptance[rows])
    weights = 1.0 / (size + np.median(size))
    starts = [prior.mean + math.log(factor) * (np.arange(2 * JOINTS) < JOINTS) for factor in START_FACTORS]
    for _ in range(RANDOM_STARTS):
        start = np.array(prior.mean)
        start[:JOINTS] += START_SCATTER * rng.normal(size=JOINTS)
        starts.append(start)
    best, least = prior.mean, math.inf
    for start in starts:
        x, cost = minimise(model, start, prior, weights, rows, steps=START_STEPS)
        if cost < least:
            best, least = x, cost
        if least < GOOD_START**2 * len(rows):
            break
    return best


def minimise(
    model: ResponseModel,
    start: Array,
    prior: ResponsePrior,
    weights: Array,
    rows: Ints | None = None,
    *,
    steps: int = 60,
    fixed: Ints | None = None,
) -> tuple[Array, float]:
    """Return the minimum and its sum of squares.

    Args:
        model: Model of all rows.
        start: (12,) unknowns.
        prior: Normal prior.
        weights: (n,) N/m, one over the standard deviation of each row.
        rows: (n,) rows; None: all.
        steps: most evaluations.
        fixed: unknowns that keep their start value.
    """
    from scipy.optimize import least_squares

    free = np.setdiff1d(np.arange(2 * JOINTS), np.zeros(0, int) if fixed is None else fixed)
    system = _WeightedSystem(model, np.array(start), free, prior, weights, rows)
    low = np.concatenate([np.full(JOINTS, math.log(LEAST_STIFFNESS)), np.full(JOINTS, math.log(1e-4))])
    high = np.concatenate([np.full(JOINTS, math.log(STIFFEST)), np.full(JOINTS, math.log(2.0))])
    done = least_squares(
        system.compute_residuals,
        np.clip(start, low + 1e-6, high - 1e-6)[free],
        jac=system.compute_jacobian,
        bounds=(low[free], high[free]),
        x_scale="jac",
        ftol=1e-8,
        xtol=1e-7,
        gtol=1e-10,
        max_nfev=steps,
    )
    return system.expand(done.x), 2.0 * float(done.cost)


class _WeightedSystem(FreeUnknownSystem):
    """Weighted residuals of the rows, and the distance from the prior."""

    def __init__(
        self, model: ResponseModel, x: Array, free: Ints, prior: ResponsePrior, weights: Array, rows: Ints | None
    ) -> None:
        super().__init__(x, free)
        self.model, self.prior, self.weights, self.rows = model, prior, weights, rows

    def evaluate(self, x: Array) -> tuple[Array, Array]:
        H, J = self.model.evaluate(x, self.rows)
        measured = self.model.equations.receptance
        e = (H - (measured if self.rows is None else measured[self.rows])) * self.weights
        slopes = (J * self.weights[:, None])[:, self.free]
        pull = 1.0 / self.prior.sigma
        residuals = np.concatenate([e.real, e.imag, (x - self.prior.mean) * pull])
        return residuals, np.concatenate([slopes.real, slopes.imag, np.diag(pull)[:, self.free]])


def fit_responses(model: ResponseModel, start: Array, prior: ResponsePrior, passes: int = REWEIGHTINGS) -> ResponseFit:
    """Return the fit with the noise of each response estimated from its residuals.

    Args:
        model: Model of all rows.
        start: (12,) unknowns near the minimum.
        prior: Normal prior.
        passes: most fits with new scales.
    """
    e, x = model.equations, np.array(start)
    scale = np.zeros(0)
    for step in range(passes):
        residual = model.evaluate(x)[0] - e.receptance
        new = _estimate_scales(residual, model, int(np.isinf(prior.sigma).sum()) or 2 * JOINTS)
        if step and np.allclose(new, scale, rtol=SCALE_CHANGE):
            break
        scale = new
        x, _ = minimise(model, x, prior, 1.0 / (scale[e.group] * e.shape), steps=PASS_STEPS)
    weights = 1.0 / (scale[e.group] * e.shape)
    H, J = model.evaluate(x)
    whitened = (H - e.receptance) * weights
    slopes = J * weights[:, None]
    stacked = np.concatenate([slopes.real, slopes.imag])
    inflation = _compute_inflation(whitened, model)
    pull = (x - prior.mean) / prior.sigma
    return ResponseFit(
        x=x,
        prior=prior,
        predicted=H,
        scale=scale,
        inflation=inflation,
        information=stacked.T @ stacked / inflation,
        cost=float(np.sum(np.abs(whitened) ** 2) + pull @ pull),
        log_likelihood=float(2.0 * np.sum(np.log(weights)) - 0.5 * np.sum(np.abs(whitened) ** 2)),
    )


def _estimate_scales(residual: ComplexArray, model: ResponseModel, unknowns: int) -> Array:
    """Return the standard deviation of each response in units of its shape; unknowns are shared by the rows."""
    e = model.equations
    square = np.bincount(e.group, np.abs(residual) ** 2 / e.shape**2)
    count = 2.0 * np.bincount(e.group)
    freedom = count * (1.0 - min(unknowns / count.sum(), 0.5))
    return np.asarray(np.maximum(np.sqrt(square / freedom), 1e-6))


def _compute_inflation(whitened: ComplexArray, model: ResponseModel) -> float:
    """Return (1 + r)/(1 − r) of the first autocorrelation along the frequency; 1 for a negative one."""
    e = model.equations
    order = np.lexsort((e.omega, e.group))
    same = np.diff(e.group[order]) == 0
    r = whitened[order]
    products = np.real(r[1:] * np.conj(r[:-1]))[same]
    correlation = float(products.sum() / same.sum() / np.mean(np.abs(r) ** 2))
    correlation = min(max(correlation, 0.0), MOST_CORRELATION)
    return (1.0 + correlation) / (1.0 - correlation)
