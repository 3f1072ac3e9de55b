"""Nonlinear least squares of force waveforms: coefficients, run-out, offsets, with their covariance.

Gauss–Newton steps with Levenberg–Marquardt damping (MINPACK) on exact derivatives. First with uncorrelated noise, then
twice with the autoregression of the residuals (iterated generalised least squares). A coefficient that comes out
negative within its interval is set to 0, as in the regression of mean forces.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np

from machopt.errors import RecordingError
from machopt.measurement.cutting.coefficient_fit import NAMES, RANK
from machopt.measurement.cutting.waveform.residual_noise import (
    ResidualNoise,
    build_white_noise,
    compute_repeatable_ratio,
    fit_noise,
)
from machopt.measurement.cutting.waveform.waveform_model import COEFFICIENTS, RUNOUT, WaveformModel
from machopt.numerics.array_types import Array, Bools, make_arrays_read_only
from machopt.numerics.free_unknowns import FreeUnknownSystem

NOISE_PASSES = 2  # fits with the autoregression; a third changes no interval by more than 1 %
ROUNDING = 1e-6  # of the largest force: no innovation is smaller
MOST_STEPS = 100


@dataclass(frozen=True, kw_only=True)
class WaveformFit:
    """Result of a fit; unknowns in the order and units of :class:`WaveformModel`."""

    x: Array  # (P,)
    covariance: Array  # (P, P), the misfit included; zero of what was set to 0
    free: Bools  # (P,)
    noise: ResidualNoise
    predicted: tuple[Array, ...]  # (S_c, 3) N of each cut
    residual: Array  # (3,) N, 1 sigma of each component
    explained: Array  # (3,) R² of each component about its mean
    misfit_ratio: float  # repeatable part of the residuals over what noise makes of it; 1: no misfit
    has_misfit: bool  # beyond the 99 % quantile

    def __post_init__(self) -> None:
        make_arrays_read_only(self)


def fit_waveform(model: WaveformModel, start: Array, z: float) -> WaveformFit:
    """Return the fit.

    Args:
        model: Model of all samples.
        start: (P,) start values.
        z: half width of the intervals in standard deviations.

    Raises:
        RecordingError: the samples do not determine the unknowns, or a coefficient is negative beyond its interval.
    """
    free = np.ones(model.size, bool)
    if model.teeth == 1:
        free[RUNOUT] = False  # one tooth always leaves its own surface
    x = np.where(free, start, 0.0)
    while True:
        x, noise = _iterate(model, x, free)
        found = _assess(model, x, free, noise)
        negative = _find_negative(found, z)
        if negative is None:
            return found
        free[negative], x[negative] = False, 0.0


def _iterate(model: WaveformModel, x: Array, free: Bools) -> tuple[Array, ResidualNoise]:
    floor = ROUNDING * max(float(np.abs(cut.force).max()) for cut in model.cuts)
    noise = build_white_noise([cut.force - model.evaluate(x, n)[0] for n, cut in enumerate(model.cuts)], floor)
    x = _solve(model, x, free, noise)
    for _ in range(NOISE_PASSES):
        noise = fit_noise([cut.force - model.evaluate(x, n)[0] for n, cut in enumerate(model.cuts)], floor)
        x = _solve(model, x, free, noise)
    return x, noise


def _solve(model: WaveformModel, x: Array, free: Bools, noise: ResidualNoise) -> Array:
    from scipy.optimize import least_squares

    system = _WhitenedSystem(model, x, free, noise)
    done = least_squares(
        system.compute_residuals,
        x[free],
        jac=system.compute_jacobian,
        method="lm",
        x_scale="jac",
        ftol=1e-8,
        xtol=1e-7,
        max_nfev=MOST_STEPS,
    )
    return system.expand(done.x)


class _WhitenedSystem(FreeUnknownSystem):
    """Whitened residuals of all cuts."""

    def __init__(self, model: WaveformModel, x: Array, free: Bools, noise: ResidualNoise) -> None:
        super().__init__(x, free)
        self.model, self.noise, self.count = model, noise, int(free.sum())

    def evaluate(self, x: Array) -> tuple[Array, Array]:
        rows, slopes = [], []
        for n, cut in enumerate(self.model.cuts):
            predicted, J = self.model.evaluate(x, n)
            rows.append(self.noise.whiten(predicted - cut.force).ravel())
            slopes.append(self.noise.whiten(J[..., self.free]).reshape(-1, self.count))
        return np.concatenate(rows), np.concatenate(slopes)


def _assess(model: WaveformModel, x: Array, free: Bools, noise: ResidualNoise) -> WaveformFit:
    system = _WhitenedSystem(model, x, free, noise)
    A, e = system.compute_jacobian(x[free]), system.compute_residuals(x[free])
    scale = np.linalg.norm(A, axis=0)
    _, s, Vt = np.linalg.svd(A / np.where(scale > 0.0, scale, 1.0), full_matrices=False)
    if (scale == 0.0).any() or s[-1] < RANK * s[0]:
        raise RecordingError(
            "the waveforms do not determine all coefficients: cuts at two feeds or more, with all three forces, would"
        )
    predicted = tuple(model.evaluate(x, n)[0] for n in range(len(model.cuts)))
    whitened, first = [], 0
    for cut in model.cuts:
        count = 3 * (len(cut.force) - noise.order)
        whitened.append(e[first : first + count].reshape(-1, 3))
        first += count
    phases = [model.compute_phase(x, n)[noise.order :] for n in range(len(model.cuts))]
    ratio, limit = compute_repeatable_ratio(phases, whitened, int(free.sum()))
    variance = max(1.0, ratio) * float(e @ e) / max(len(e) - int(free.sum()), 1)
    covariance = np.zeros((model.size, model.size))
    covariance[np.ix_(free, free)] = variance * (Vt.T / s**2) @ Vt / np.outer(scale, scale)
    force = np.concatenate([cut.force for cut in model.cuts])
    rest = force - np.concatenate(predicted)
    about = np.sum((force - force.mean(axis=0)) ** 2, axis=0)
    square = np.sum(rest**2, axis=0)
    return WaveformFit(
        x=np.array(x),
        covariance=covariance,
        free=np.array(free),
        noise=noise,
        predicted=predicted,
        residual=np.sqrt(square / len(rest)),
        explained=1.0 - square / np.where(about > 0.0, about, np.inf),
        misfit_ratio=ratio,
        has_misfit=ratio > limit,
    )


def _find_negative(waveform_fit: WaveformFit, z: float) -> int | None:
    """Return a coefficient that is negative within its interval; refuse what is negative beyond it."""
    sigma = np.sqrt(np.diag(waveform_fit.covariance))[:COEFFICIENTS]
    values, free = waveform_fit.x[:COEFFICIENTS], waveform_fit.free[:COEFFICIENTS]
    high = values + z * sigma
    wrong = [NAMES[n] for n in range(COEFFICIENTS) if free[n] and high[n] < 0.0]
    if wrong or values[0] <= 0.0:
        raise RecordingError(
            f"{', '.join(wrong or NAMES[:1])} would be negative, beyond the interval: the forces have another sign or "
            "frame. Check force_on (tool or workpiece), wrench_frame, cut, spindle and helix_deg (right-hand +)"
        )
    for n in range(1, COEFFICIENTS):
        if free[n] and values[n] < 0.0:
            return n
    return None


def compute_normal_quantile(level: float) -> float:
    """Return the half width of a two-sided interval in standard deviations.

    Args:
        level: of the interval, 0 … 1.
    """
    from scipy.special import ndtri

    return float(ndtri(0.5 + 0.5 * level)) if level < 1.0 else math.inf
