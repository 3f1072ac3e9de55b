"""Uncertainty of the link masses stated in the URDF, from cross-validation over time blocks."""

from __future__ import annotations

import numpy as np
from scipy.special import chdtrc

from machopt.effects import prior_scales
from machopt.measurement import thresholds
from machopt.measurement.diagnosis.data_types.diagnosis_problem import Ints
from machopt.measurement.diagnosis.dynamic.friction import fit_least_squares
from machopt.numerics.array_types import Array


def estimate_link_mass_sigma(
    y: Array, base: Array, load: Array, rivals: Array, links: Array, group: Ints
) -> tuple[float, list[str]]:
    """Estimate the prior standard deviation of each link mass relative to the URDF, by cross-validation.

    Link mass errors and a payload are similar, and so are a gravity compensator or a drive gain. The masses are taken
    as stated in two cases: a payload alone, or all alternatives together, predict clearly better than any link
    masses; or they predict equally well and the mass errors would be implausibly large
    (:func:`_are_masses_implausible`). If masses predict clearly better than all alternatives together, they are
    treated as wrong. Otherwise they may be off by the default tolerance.

    Args:
        y: (N, D) measured minus predicted torque.
        base: (N, D, P) base columns.
        load: (N, D, 4) columns of a payload.
        rivals: (N, D, R) columns of payload, compensator and gains together.
        links: (N, D, L) columns of the link masses, relative.
        group: (N,) cross-validation group.

    Returns:
        Relative standard deviation of a link mass (0: as stated), and notes.
    """
    weight = 1.0 / np.maximum(compute_coordinate_rms(y, base), 1e-12)

    def left(*more: Array) -> Array:
        return compute_holdout_squares(y, np.concatenate([base, *more], axis=2), group, weight)

    base_loss, payload_loss, link_loss = left(), left(load), left(links)
    rival_loss = left(rivals)
    best_loss = np.minimum(base_loss, rival_loss)
    gain = best_loss - left(rivals, links)
    if (
        gain.sum() / best_loss.sum() > thresholds.SHARES.negligible
        and np.mean(gain > 0) > thresholds.SHARES.half_power_amplitude
        and link_loss.sum() < payload_loss.sum()
    ):
        words = (
            "masses of several links differ from the URDF's: a scale of each is refitted, so that a "
            "payload shows only where no link could have it"
        )
        return prior_scales.WRONG_LINK_MASS.scale, [words]
    best_alternative = min(payload_loss, rival_loss, key=lambda x: float(x.sum()))
    worse = link_loss.sum() / best_alternative.sum() - 1.0
    if worse > thresholds.SHARES.negligible or (
        worse > -thresholds.SHARES.negligible
        and _are_masses_implausible(
            y * weight,
            base * weight[:, None],
            links * weight[:, None],
            _is_gain_significant(best_alternative - link_loss),
        )
    ):
        return 0.0, []  # with many readings any free mass would absorb the payload
    return prior_scales.LINK_MASS.scale, []


def _is_gain_significant(gain: Array) -> bool:
    """Return whether a cross-validated gain (G,) exceeds twice its standard error."""
    return bool(gain.mean() > 2.0 * np.std(gain, ddof=1) / np.sqrt(len(gain))) if len(gain) > 1 else False


def _are_masses_implausible(y: Array, base: Array, links: Array, better: bool) -> bool:
    """Return whether the fitted link masses deviate implausibly from the URDF: χ² of the deviations.

    A small payload alone may require a deviation of three sigma of a light last link, which is not rare. The
    significance level (``links_chance``) is squared if the masses predict slightly better than the payload.

    Args:
        y: (N, D) weighted.
        base: (N, D, P) weighted.
        links: (N, D, L) weighted.
        better: Whether masses predict held-out blocks slightly better than a payload.
    """
    A = np.concatenate([base, links], axis=2).reshape(-1, base.shape[2] + links.shape[2])
    b = y.reshape(-1)
    left, _ = fit_least_squares(b, A)
    prior_weights = np.zeros(A.shape[1])
    prior_weights[base.shape[2] :] = np.std(left) / prior_scales.LINK_MASS.scale
    _, x = fit_least_squares(
        np.concatenate([b, np.zeros(len(prior_weights))]), np.concatenate([A, np.diag(prior_weights)])
    )
    needed = x[base.shape[2] :] / prior_scales.LINK_MASS.scale
    chance = thresholds.LEVELS.significance_level ** (2 if better else 1)
    return bool(chdtrc(len(needed), float(needed @ needed)) < chance)


def compute_coordinate_rms(y: Array, base: Array) -> Array:
    """Compute the rms residual of each coordinate after a fit of the base.

    Args:
        y: (N, D) measured minus predicted torque.
        base: (N, D, P) base columns.

    Returns:
        (D,) in the unit of y.
    """
    X = base.reshape(-1, base.shape[2])
    scale = np.sqrt(np.mean(y**2, axis=0)) + 1e-12
    for _ in range(2):
        W = np.tile(1.0 / scale, len(y))
        A = X * W[:, None]
        size = np.maximum(np.linalg.norm(A, axis=0), 1e-300)
        x = np.linalg.lstsq(A / size, y.reshape(-1) * W, rcond=1e-10)[0] / size
        scale = np.sqrt(np.mean((y - base @ x) ** 2, axis=0)) + 1e-12
    return np.asarray(scale)


def compute_holdout_squares(y: Array, X: Array, group: Ints, weight: Array) -> Array:
    """Compute the cross-validated weighted residual sum of squares of each group.

    Args:
        y: (N, D) measured minus predicted torque.
        X: (N, D, P) columns.
        group: (N,) cross-validation group.
        weight: (D,) weight of each coordinate.

    Returns:
        (G,) sum of squares, fitted without the group.
    """
    P = X.shape[2]
    A = X * weight[:, None]
    b = y * weight
    labels = np.unique(group)
    size = np.maximum(np.sqrt(np.einsum("ndp,ndp->p", A, A)), 1e-300)
    A = A / size
    grams, sides = [], []
    for g in labels:
        rows = group == g
        a = A[rows].reshape(-1, P)
        grams.append(a.T @ a)
        sides.append(a.T @ b[rows].reshape(-1))
    G, s = np.sum(grams, axis=0), np.sum(sides, axis=0)
    out = np.empty(len(labels))
    for k, g in enumerate(labels):
        x = np.linalg.lstsq(G - grams[k], s - sides[k], rcond=1e-10)[0]
        rows = group == g
        out[k] = float(np.sum((b[rows] - A[rows] @ x) ** 2))
    return out
