"""Significance of coefficients: a law without any significant coefficient or size is rejected whatever its gain."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from scipy.special import stdtrit

from machopt.measurement.diagnosis.statistics.normal_equations_by_fold import WhitenedModel, compute_cluster_robust_fit
from machopt.measurement.diagnosis.statistics.whitened_hypothesis import WhitenedHypothesis
from machopt.numerics.array_types import Array


def find_insignificant_laws(model: WhitenedModel, laws: Sequence[tuple[WhitenedHypothesis, int]]) -> list[int]:
    """Find laws without a coefficient or size whose 95 % interval excludes zero.

    For a body only diagonal compliances count, not the coupling of two rigid directions.

    Args:
        model: Model with the columns of all laws, in order, after those of the base.
        laws: Laws with the index of their shape.

    Returns:
        Indices of the insignificant laws.
    """
    if not laws:
        return []
    x, covariance, freedom = compute_cluster_robust_fit(model)
    t = float(stdtrit(freedom, 0.975))
    out, at = [], model.count - sum(law.X.shape[2] for law, _ in laws)
    for k, (law, shape) in enumerate(laws):
        p = law.X.shape[2]
        own, V = x[at : at + p], covariance[at : at + p, at : at + p]
        if not _has_significant_size(law, shape, own, V, t):
            out.append(k)
        at += p
    return out


def project_to_plausible_coefficients(
    model: WhitenedModel, law: WhitenedHypothesis, shape: int, x: Array
) -> tuple[Array, float]:
    """Compute the plausible coefficients with the least loss, and the loss.

    Args:
        model: Model that the law was fitted with; its coefficients adapt.
        law: Whitened hypothesis.
        shape: Index of the shape.
        x: (p,) best coefficients in the law's own scale.

    Returns:
        (p,) coefficients in the same scale, and the increase of the whitened sum of squares.
    """
    if law.hypothesis.project_to_plausible is None:
        return x, 0.0
    unit, C = law.unit[shape], law.products_with(model)[shape]
    S = law.XX[:, shape].sum(axis=0) - C @ model.inverse @ C.T
    there = law.hypothesis.project_to_plausible(x * unit, S / np.outer(unit, unit)) / unit
    moved = there - x
    return np.asarray(there), float(moved @ S @ moved)


def _has_significant_size(law: WhitenedHypothesis, shape: int, x: Array, V: Array, t: float) -> bool:
    """Return whether one of the effect's sizes is significant, by its derivative with respect to the coefficients."""
    h, unit = law.hypothesis, law.unit[shape]
    counts = np.isfinite(h.lower) if h.lower else np.full(len(x), h.project_to_plausible is None)
    if h.lower:
        x = np.maximum(x, np.array(h.lower))
    if (counts & (np.abs(x) > t * np.sqrt(np.maximum(np.diag(V), 0.0)))).any():
        return True

    def sizes(v: Array) -> Array:
        return np.array([q.value for q in h.quantities(v * unit, law.shapes[shape]).values()])

    slope = []
    for i in range(len(x)):
        step = np.zeros(len(x))
        step[i] = 1e-3 * max(float(np.sqrt(max(V[i, i], 0.0))), abs(float(x[i])), 1e-12)
        slope.append((sizes(x + step) - sizes(x - step)) / (2.0 * step[i]))
    g = np.nan_to_num(np.array(slope), posinf=0.0, neginf=0.0)  # (p, sizes)
    sigma = np.sqrt(np.maximum(np.einsum("pk,pq,qk->k", g, V, g), 0.0))
    here = np.nan_to_num(sizes(x), posinf=np.finfo(float).max)
    return bool(((np.abs(here) > t * sigma) & (sigma > 0.0)).any())
