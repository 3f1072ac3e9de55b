"""Screening: the gain of each hypothesis on all readings, cross-validated, and by chance.

The gain is the reduction of the whitened residual sum of squares when the model is refitted with the hypothesis. It
is the squared noncentrality of the effect. The p-value is corrected for the whole search: signs of whole groups are
flipped (wild cluster bootstrap), and the largest gain of any hypothesis and shape counts (max-T).
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from itertools import pairwise

import numpy as np
from numpy.typing import NDArray

from machopt.measurement import thresholds
from machopt.measurement.diagnosis.statistics.normal_equations_by_fold import (
    MIN_COLUMN_SQUARE,
    WhitenedModel,
    invert_with_ridge,
)
from machopt.measurement.diagnosis.statistics.whitened_hypothesis import WhitenedHypothesis
from machopt.numerics.array_types import Array

Ints = NDArray[np.int64]
SCREENING_FLIPS = 499
BATCH_NUMBERS = 2**22  # that one batch of hypotheses may need at once


@dataclass(frozen=True)
class FittedHypothesis:
    """One hypothesis fitted together with one model on all readings."""

    whitened: WhitenedHypothesis
    shape: int  # best on all readings
    x: Array  # (p,) scaled coefficients within their bounds
    gain: float  # reduction of the whitened sum of squares
    visible: float  # share of the columns' squared norm outside of the model's span, best shape


@dataclass(frozen=True)
class ScoredHypothesis(FittedHypothesis):
    """Fitted hypothesis with its cross-validated gain."""

    heldout: Array  # (F,) gain per fold; model and shape are selected without the fold

    @property
    def total(self) -> float:
        return float(self.heldout.sum())


@dataclass(frozen=True)
class _ModelFit:
    """Fit of one hypothesis together with one model, kept with the hypothesis."""

    fitted: FittedHypothesis
    projection: Array  # (S, p, P) the columns as the model's columns explain them
    information: Array  # (S, p, p) normal matrices of what the model does not explain


def score_hypotheses(model: WhitenedModel, tried: Sequence[WhitenedHypothesis]) -> list[ScoredHypothesis]:
    """Score hypotheses together with a model, with cross-validation; each is scored once with each model.

    Args:
        model: Whitened model.
        tried: All whitened hypotheses.

    Returns:
        Scored hypotheses.
    """
    missing = [t for t in tried if model not in t.scores]
    if missing:
        H, h = model.normal, model.Xy.sum(axis=0)
        XX, Xy, yy = model.XX, model.Xy, model.yy
        M_fold = invert_with_ridge(H - XX)
        x_fold = np.einsum("fij,fj->fi", M_fold, h - Xy)
        loss = yy - 2 * np.einsum("fi,fi->f", x_fold, Xy) + np.einsum("fi,fij,fj->f", x_fold, XX, x_fold)
        fit_hypotheses(model, missing)
        for some in _list_batches(missing, model.folds * model.count):
            heldout = loss[:, None] - _compute_unseen_errors(model, some, M_fold, x_fold)
            for t, gain in zip(some, heldout.T, strict=True):
                one = _fit_once(model, t).fitted
                t.scores[model] = ScoredHypothesis(t, one.shape, one.x, one.gain, one.visible, gain)
    return [score for t in tried if isinstance(score := t.scores[model], ScoredHypothesis)]


def fit_hypotheses(model: WhitenedModel, tried: Sequence[WhitenedHypothesis]) -> list[FittedHypothesis]:
    """Fit hypotheses together with a model on all readings, without cross-validation; used for p-values.

    Args:
        model: Whitened model.
        tried: All whitened hypotheses.

    Returns:
        Fitted hypotheses.
    """
    h, M = model.Xy.sum(axis=0), model.inverse
    for some in _list_batches([t for t in tried if model not in t.fits], model.count):
        C = np.concatenate([t.products_with(model) for t in some])
        last = np.cumsum([len(t.shapes) for t in some])[:-1]
        each = zip(*(np.split(values, last) for values in _fit_every_shape(some, C, h, M)), strict=True)
        for t, (x, gain, visible, projection, S) in zip(some, each, strict=True):
            best = int(np.argmax(gain))
            fitted = FittedHypothesis(t, best, x[best], float(gain[best]), float(visible[best]))
            t.fits[model] = _ModelFit(fitted, projection, S)
    return [_fit_once(model, t).fitted for t in tried]


def _fit_once(model: WhitenedModel, t: WhitenedHypothesis) -> _ModelFit:
    """Return the fit on all readings, which is kept with the hypothesis."""
    found = t.fits.get(model)
    if isinstance(found, _ModelFit):
        return found
    fit_hypotheses(model, [t])
    return _fit_once(model, t)


def _list_batches(tried: Sequence[WhitenedHypothesis], numbers: int) -> list[list[WhitenedHypothesis]]:
    """Return batches of hypotheses of equal width and bounds, of limited memory: ``numbers`` for each column."""
    alike: dict[tuple[int, tuple[float, ...]], list[WhitenedHypothesis]] = {}
    for t in tried:
        alike.setdefault((t.X.shape[2], t.hypothesis.lower), []).append(t)
    out = []
    for some in alike.values():
        batch = np.cumsum([numbers * t.X.shape[1] * t.X.shape[2] for t in some]) // BATCH_NUMBERS
        out += [[some[k] for k in np.flatnonzero(batch == n)] for n in np.unique(batch)]
    return out


def compute_gain_by_shape(model: WhitenedModel, t: WhitenedHypothesis) -> Array:
    """Compute the gain of each shape of a hypothesis on all readings.

    Args:
        model: Whitened model.
        t: Whitened hypothesis.

    Returns:
        (S,) gains.
    """
    return _fit_every_shape([t], t.products_with(model), model.Xy.sum(axis=0), model.inverse)[1]


def _fit_every_shape(
    some: Sequence[WhitenedHypothesis], C: Array, h: Array, M: Array
) -> tuple[Array, Array, Array, Array, Array]:
    """Return for every shape its coefficients (S, p), gain (S,), visible share (S,), projection and information."""
    XX, Xy = (np.concatenate([t.sums[k] for t in some]) for k in (0, 1))
    projection = (C.reshape(C.shape[0] * C.shape[1], C.shape[2]) @ M).reshape(C.shape)
    S, u = XX - _multiply_transposed(projection, C), Xy - C @ (M @ h)
    S, visible = _regularise_absorbed_directions(S, XX)
    known = np.concatenate([t.precision_matrices for t in some])
    x, gain = minimise_bounded_quadratics(S + known, u, some[0].hypothesis.lower)
    return x, gain, visible, projection, S


def _compute_unseen_errors(
    model: WhitenedModel, some: Sequence[WhitenedHypothesis], M_fold: Array, x_fold: Array
) -> Array:
    """Return the error (F, K) of each fold by the model with each hypothesis, fitted without the fold."""
    XX, Xy, yy = model.XX, model.Xy, model.yy
    C_f, XX_f, Xy_f = (
        np.concatenate(each, axis=1)
        for each in zip(*((t.products_by_fold(model), t.XX, t.Xy) for t in some), strict=True)
    )
    C_r, XX_r, Xy_r = (each.sum(axis=0) - each for each in (C_f, XX_f, Xy_f))
    F, count, p, P = C_r.shape
    rows = C_r.reshape(F, count * p, P)  # one product a fold instead of one a shape
    S_r = XX_r - _multiply_transposed((rows @ M_fold).reshape(C_r.shape), C_r)
    u_r = Xy_r - (rows @ x_fold[:, :, None]).reshape(F, count, p)
    flat, _ = _regularise_absorbed_directions(S_r.reshape(-1, p, p), XX_r.reshape(-1, p, p))
    known = np.concatenate([t.precision_matrices for t in some])
    flat = flat + np.broadcast_to(known, (F, *known.shape)).reshape(flat.shape)
    xc, gain_r = minimise_bounded_quadratics(flat, u_r.reshape(-1, p), some[0].hypothesis.lower)
    first = np.cumsum([0, *(len(t.shapes) for t in some)])
    gain_r = gain_r.reshape(F, count)
    pick = np.stack([a + np.argmax(gain_r[:, a:b], axis=1) for a, b in pairwise(first)], axis=1)  # (F, K)
    at = np.arange(F)[:, None]
    xc = xc.reshape(F, count, p)[at, pick]
    C_r, C_p, XX_p, Xy_p = C_r[at, pick], C_f[at, pick], XX_f[at, pick], Xy_f[at, pick]
    xb = x_fold[:, None] - (C_r * xc[..., None]).sum(axis=2) @ M_fold
    return np.asarray(
        yy[:, None]
        - 2 * (xb * Xy[:, None]).sum(axis=2)
        - 2 * (xc * Xy_p).sum(axis=2)
        + (xb * (xb @ XX)).sum(axis=2)
        + (xc * _multiply(XX_p, xc)).sum(axis=2)
        + 2 * (xc * _multiply(C_p, xb)).sum(axis=2)
    )


def _multiply(A: Array, x: Array) -> Array:
    """Return A x for a batch of matrices (B, m, n) and vectors (B, n)."""
    return np.asarray((A @ x[..., None])[..., 0])


def _multiply_transposed(A: Array, B: Array) -> Array:
    """Return A Bᵀ (..., p, p) for matrices (..., p, n); a sum where p is 1, as of most hypotheses."""
    if A.shape[-2] == 1:
        return np.asarray((A * B).sum(axis=-1)[..., None])
    return np.asarray(A @ np.swapaxes(B, -1, -2))


def minimise_bounded_quadratics(S: Array, u: Array, lower: tuple[float, ...]) -> tuple[Array, Array]:
    """Minimise ½ xᵀSx − uᵀx subject to x ≥ lower (0 or −∞) for a batch of problems.

    Args:
        S: (B, p, p) positive definite matrices.
        u: (B, p) linear terms.
        lower: (p,) lower bounds; empty for none.

    Returns:
        x (B, p), and the gain 2 uᵀx − xᵀSx (B,).
    """
    if u.shape[-1] == 1:
        free = u / S[..., 0]
        bounded = np.maximum(free, 0.0) if lower and np.isfinite(lower[0]) else free
        return bounded, np.asarray((bounded * (2 * u - S[..., 0] * bounded))[..., 0])
    x = np.asarray(np.linalg.solve(S, u[..., None])[..., 0])
    if lower and any(np.isfinite(v) for v in lower):
        below = np.array([np.isfinite(v) for v in lower])
        active = np.zeros_like(x, bool)
        for _ in range(x.shape[1]):
            wrong = below & (x < 0) & ~active
            if not wrong.any():
                break
            active |= wrong
            bounded = S * ~active[:, :, None] * ~active[:, None, :]
            bounded = bounded + np.einsum("bi,ij->bij", active.astype(float), np.eye(x.shape[1]))
            x = np.where(active, 0.0, np.linalg.solve(bounded, np.where(active, 0.0, u)[..., None])[..., 0])
    return np.asarray(x), np.asarray((x * (2 * u - _multiply(S, x))).sum(axis=1))


def compute_chance_probability(
    model: WhitenedModel,
    scored: Sequence[FittedHypothesis],
    residual: Array,
    rng: np.random.Generator,
    flips: int = SCREENING_FLIPS,
) -> Array:
    """Compute the probability that the largest gain of the whole search reaches each hypothesis' gain by chance.

    Args:
        model: Model that the hypotheses were fitted with.
        scored: All hypotheses.
        residual: (M,) whitened residuals of a model with all possible effects. A remaining large effect would
            inflate the chance level.
        rng: Random generator of the sign flips.
        flips: Number of sign flips.

    Returns:
        (K,) p-values.
    """
    if not scored:
        return np.zeros(0)
    fit_hypotheses(model, [s.whitened for s in scored])
    Xr = model.w.sum_by_cluster(model.X * residual[:, None])  # (G, P)
    signs = rng.choice([-1.0, 1.0], (flips, len(Xr)))
    largest: list[Array] = []  # normal deviates (flips,) of the largest gain of any law and shape of a width
    for some in _list_batches([s.whitened for s in scored], flips + len(Xr)):
        each = [_fit_once(model, t) for t in some]
        scores = np.concatenate([t.products_by_cluster(model.w, residual) for t in some], axis=1)
        projection = np.concatenate([one.projection for one in each])
        p = scores.shape[2]
        absorbed = projection.reshape(scores.shape[1] * p, Xr.shape[1])  # a base may have no columns
        scores = scores - (Xr @ absorbed.T).reshape(scores.shape)
        along = _whiten_scores(np.concatenate([one.information for one in each]), scores)
        drawn = (signs @ along.reshape(len(along), -1)).reshape(flips, *along.shape[1:])
        lower = some[0].hypothesis.lower
        if p == 1 and lower and np.isfinite(lower[0]):
            drawn = np.maximum(drawn, 0.0)
        largest.append(_convert_to_normal_deviate((drawn**2).sum(axis=2).max(axis=1), p))
    # unscaled: gains and flips contain the same excess variance
    own = np.array([_convert_to_normal_deviate(np.array(s.gain), s.whitened.X.shape[2]) for s in scored])
    return np.asarray((1.0 + (np.max(largest, axis=0)[None, :] >= own[:, None]).sum(axis=1)) / (flips + 1.0))


def _whiten_scores(S: Array, scores: Array) -> Array:
    """Return scores (G, S, p) of unit variance for the information S (S, p, p) of each shape."""
    if S.shape[-1] == 1:
        return np.asarray(scores / np.sqrt(S[..., 0]))
    return np.asarray((np.linalg.inv(np.linalg.cholesky(S)) @ scores.transpose(1, 2, 0)).transpose(2, 0, 1))


def _convert_to_normal_deviate(gain: Array, p: int) -> Array:
    """Convert a χ² of p degrees of freedom to a normal deviate (Wilson & Hilferty 1931)."""
    v = 2.0 / (9.0 * p)
    return np.asarray(((np.maximum(gain, 0.0) / p) ** (1.0 / 3.0) - (1.0 - v)) / np.sqrt(v))


def _regularise_absorbed_directions(S: Array, whole: Array) -> tuple[Array, Array]:
    """Return S with regularised absorbed directions, and the visible share (B,) of the best column."""
    d = np.maximum(np.diagonal(whole, axis1=-2, axis2=-1), MIN_COLUMN_SQUARE)
    left = np.maximum(np.diagonal(S, axis1=-2, axis2=-1), 0.0) / d
    heavy = np.maximum(thresholds.SHARES.absorbed_power - left, 0.0) * d
    p = S.shape[-1]
    out = S.copy()
    out[:, np.arange(p), np.arange(p)] += heavy + 1e-6 * d
    return out, left.max(axis=1)
