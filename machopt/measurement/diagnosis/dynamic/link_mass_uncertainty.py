"""How far the masses that a URDF states may be off: what predicts stretches of a motion that no fit saw."""

from __future__ import annotations

import numpy as np
from scipy.special import chdtrc

from machopt.measurement.diagnosis import thresholds
from machopt.measurement.diagnosis.data_types.diagnosis_problem import Ints
from machopt.measurement.diagnosis.dynamic.friction import fit_least_squares
from machopt.numerics.array_types import Array


def estimate_link_mass_sigma(
    y: Array, base: Array, load: Array, rivals: Array, links: Array, group: Ints
) -> tuple[float, list[str]]:
    """1 sigma of each link's mass beside the URDF's, by what predicts unseen stretches; and what is said of it.

    Masses that are off and a payload look much alike, and a balancer or a drive's gain is taken for masses too. Where a
    payload alone, or all of these together, predict clearly better than any masses of the links, or as well and these
    would have to be off by more than makers are (:func:`_are_masses_implausible`), they are taken as stated; where
    masses predict
    clearly better than all of these together, they are off; else they may be off by as much as a payload that is named
    has to show beside.
    """
    weight = 1.0 / np.maximum(compute_coordinate_rms(y, base), 1e-12)

    def left(*more: Array) -> Array:
        return compute_holdout_squares(y, np.concatenate([base, *more], axis=2), group, weight)

    alone, loaded, linked = left(), left(load), left(links)
    every = left(rivals)
    known = np.minimum(alone, every)
    gain = known - left(rivals, links)
    if (
        gain.sum() / known.sum() > thresholds.MOTION.links_gain
        and np.mean(gain > 0) > thresholds.MOTION.links_groups
        and linked.sum() < loaded.sum()
    ):
        words = (
            "masses of several links differ from the URDF's: a scale of each is refitted, so that a "
            "payload shows only where no link could have it"
        )
        return thresholds.MOTION.link_off, [words]
    named = min(loaded, every, key=lambda x: float(x.sum()))
    worse = linked.sum() / named.sum() - 1.0
    if worse > thresholds.MOTION.links_gain or (
        worse > -thresholds.MOTION.links_gain
        and _are_masses_implausible(
            y * weight, base * weight[:, None], links * weight[:, None], _is_gain_significant(named - linked)
        )
    ):
        return 0.0, []  # any doubt is outweighed by readings enough, and takes the payload up
    return thresholds.MOTION.link_scale, []


def _is_gain_significant(gain: Array) -> bool:
    """Whether a gain (G,) on unseen stretches is surely one: twice its own standard error."""
    return bool(gain.mean() > 2.0 * np.std(gain, ddof=1) / np.sqrt(len(gain))) if len(gain) > 1 else False


def _are_masses_implausible(y: Array, base: Array, links: Array, better: bool) -> bool:
    """Whether masses of links that explain a record would be off by more than makers are: χ² of what they need.

    A small payload asks a light last link for three sigma alone, which is no rarity; so the chance asked for
    (``links_chance``) is squared where these masses predict a little better than the payload does.

    Args:
        y: (N, D) weighted; base: (N, D, P); links: (N, D, L) alike.
        better: whether masses predict unseen stretches better than a payload, if hardly.
    """
    A = np.concatenate([base, links], axis=2).reshape(-1, base.shape[2] + links.shape[2])
    b = y.reshape(-1)
    left, _ = fit_least_squares(b, A)
    held = np.zeros(A.shape[1])
    held[base.shape[2] :] = np.std(left) / thresholds.MOTION.link_scale
    _, x = fit_least_squares(np.concatenate([b, np.zeros(len(held))]), np.concatenate([A, np.diag(held)]))
    needed = x[base.shape[2] :] / thresholds.MOTION.link_scale
    chance = thresholds.MOTION.links_chance ** (2 if better else 1)
    return bool(chdtrc(len(needed), float(needed @ needed)) < chance)


def compute_coordinate_rms(y: Array, base: Array) -> Array:
    """(D,) rms of what the base leaves of each coordinate."""
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
    """(G,) weighted squares of each group's residual, fitted without it."""
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
