"""A finding none of whose numbers is beyond zero is none, however much it seems to gain."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from scipy.special import stdtrit

from machopt.measurement.diagnosis.statistics.normal_equations_by_fold import (
    WhitenedHypothesis,
    WhitenedModel,
    compute_cluster_robust_fit,
)
from machopt.numerics.array_types import Array


def find_insignificant_laws(model: WhitenedModel, laws: Sequence[tuple[WhitenedHypothesis, int]]) -> list[int]:
    """Which laws have no coefficient, and no size that is said, whose 95 % interval excludes zero.

    Of a body only what gives way counts: what couples two directions that do not is nothing built.

    Args:
        model: with the columns of all laws, in their order, after those of the base.
        laws: each with the index of its shape.
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
    """The coefficients that something built can have and that lose the least, and what they lose.

    Args:
        model: beside which the law was fitted; its coefficients adapt.
        law, shape: with its whitened columns.
        x: (p,) its best coefficients, in the law's own scale.

    Returns:
        (p,) in the same scale; the whitened sum of squares beyond that of ``x``.
    """
    if law.hypothesis.project_to_plausible is None:
        return x, 0.0
    unit, C = law.unit[shape], law.products_with(model)[shape]
    S = law.XX[:, shape].sum(axis=0) - C @ model.inverse @ C.T
    there = law.hypothesis.project_to_plausible(x * unit, S / np.outer(unit, unit)) / unit
    moved = there - x
    return np.asarray(there), float(moved @ S @ moved)


def _has_significant_size(law: WhitenedHypothesis, shape: int, x: Array, V: Array, t: float) -> bool:
    """Whether one of the effect's sizes is beyond zero, by its slope in the coefficients."""
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
