"""Which joints the responses determine, and the lower bound of a joint that they do not.

A joint is identified where the standard deviation of log k, the prior of all joints included, is below the limit of
identified compliances. Such joints lose their prior in a second fit. For any other joint the likelihood is profiled: k
falls in steps while everything else is fitted again, until the sum of squares has risen by the one-sided quantile.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np

from machopt.data_types.stiffness import LEAST_STIFFNESS
from machopt.measurement import thresholds
from machopt.measurement.identification.frequency_response.response_fit import (
    ResponseFit,
    ResponsePrior,
    fit_responses,
    minimise,
)
from machopt.measurement.identification.frequency_response.response_model import JOINTS, ResponseModel
from machopt.numerics.array_types import Array, Bools

STEP = math.log(1.25)  # of the profile in log k
MOST_STEPS = 24  # down to a two-hundredth
PROFILE_EVALUATIONS = 15


@dataclass(frozen=True)
class DeterminedFit:
    """Fit in which only what is not determined keeps a prior."""

    fit: ResponseFit
    identified: Bools  # (12,) log k and log η of each joint


def fit_determined(model: ResponseModel, start: Array, prior: ResponsePrior) -> DeterminedFit:
    """Return the fit without the prior of what the responses determine.

    Args:
        model: Model of all rows.
        start: (12,) unknowns near the minimum.
        prior: Prior of all unknowns.
    """
    most = thresholds.SHARES.max_relative_error
    first = fit_responses(model, start, prior)
    known = np.sqrt(np.diag(first.compute_covariance())) < most
    while True:
        part = ResponsePrior(prior.mean, np.where(known, np.inf, prior.sigma))
        fit = fit_responses(model, first.x, part)
        still = known & (np.sqrt(np.diag(fit.compute_covariance())) < most)
        if (still == known).all():
            return DeterminedFit(fit, known)
        known = still


def find_lower_bound(model: ResponseModel, response_fit: ResponseFit, joint: int, level: float) -> float:
    """Return the one-sided lower bound of a joint's stiffness, N·m/rad, without its prior.

    Args:
        model: Model of all rows.
        response_fit: Fit.
        joint: joint, from 0.
        level: one-sided probability.
    """
    from scipy.special import ndtri

    e = model.equations
    weights = 1.0 / (response_fit.scale[e.group] * e.shape) / math.sqrt(response_fit.inflation)
    sigma = np.array(response_fit.prior.sigma)
    sigma[joint] = np.inf
    prior = ResponsePrior(response_fit.prior.mean, sigma)
    fixed = np.array([joint])
    limit = float(ndtri(level)) ** 2
    x, least = minimise(model, response_fit.x, prior, weights, steps=PROFILE_EVALUATIONS)
    before, last = 0.0, x[joint]
    for _ in range(MOST_STEPS):
        x[joint] = last - STEP
        if x[joint] <= math.log(LEAST_STIFFNESS):
            return LEAST_STIFFNESS
        x, cost = minimise(model, x, prior, weights, steps=PROFILE_EVALUATIONS, fixed=fixed)
        rise = cost - least
        if rise >= limit:
            share = math.sqrt(limit / rise) if before <= 0.0 else (limit - before) / (rise - before)
            return math.exp(last - share * STEP)
        before, last = max(rise, 0.0), x[joint]
    return LEAST_STIFFNESS


def list_identified_joints(determined_fit: DeterminedFit) -> tuple[Bools, Bools]:
    """Return which stiffnesses and which dampings are identified, (6,) each.

    Args:
        determined_fit: Fit.
    """
    return determined_fit.identified[:JOINTS], determined_fit.identified[JOINTS:] & determined_fit.identified[:JOINTS]
