"""Whether what one session shows, the others show too: physics of a robot does not stay away for a day."""

from __future__ import annotations

import numpy as np

from machopt.measurement.diagnosis import thresholds
from machopt.measurement.diagnosis.model_selection.screening.hypothesis_screening import ScoredHypothesis
from machopt.measurement.diagnosis.statistics.normal_equations_by_fold import WhitenedModel, invert_with_ridge
from machopt.numerics.array_types import Array

SESSION_DEPENDENT_FAMILIES = ("environment",)  # families that may well be another each day


def compute_session_transfer(model: WhitenedModel, s: ScoredHypothesis) -> float:
    """Gain of a law on each session with model and coefficients from the others, per gain on all; NaN: not to be told.

    It cannot be told of a single session, nor where one has too few groups to fit anything by. What of the base only
    the session itself can tell, as the stand of a tracker that was moved for it, is fitted to it with and without the
    law alike: the others say nothing of it.
    """
    days = model.by_session
    if len(days.rows) < 2 or days.groups < thresholds.PROOF.fewest_groups or s.gain <= 0.0:
        return float("nan")
    XX, Xy = _add_law_columns(model, s.whitened.columns_at(s.shape))
    H, h = XX.sum(axis=0), Xy.sum(axis=0)
    P = model.count
    H[:P, :P] += np.diag(model.prior)
    there = np.diagonal(days.XX, axis1=1, axis2=2) > 0.0
    total = 0.0
    for d in range(len(XX)):
        own = np.flatnonzero(there[d] & (there.sum(axis=0) == 1))
        # what is left of a session beside what it alone can tell
        B = XX[d][:, own] @ invert_with_ridge(XX[d][np.ix_(own, own)])
        SS, Sy = XX[d] - B @ XX[d][own], Xy[d] - B @ Xy[d][own]
        losses = []
        for k in (P, len(h)):
            x = invert_with_ridge((H - XX[d])[:k, :k]) @ (h - Xy[d])[:k]
            losses.append(float(x @ SS[:k, :k] @ x - 2.0 * x @ Sy[:k]))
        total += losses[0] - losses[1]
    return total / s.gain


def _add_law_columns(model: WhitenedModel, law: Array) -> tuple[Array, Array]:
    """Sums by session (D, P + p, P + p) and (D, P + p) of a model's columns and a law's (M, p)."""
    days = model.by_session
    own = [law[r] for r in days.rows]
    C = np.stack([x.T @ model.X[r] for x, r in zip(own, days.rows, strict=True)])
    upper = np.concatenate([days.XX, np.swapaxes(C, 1, 2)], axis=2)
    lower = np.concatenate([C, np.stack([x.T @ x for x in own])], axis=2)
    Xy = np.stack([x.T @ model.y[r] for x, r in zip(own, days.rows, strict=True)])
    return np.concatenate([upper, lower], axis=1), np.concatenate([days.Xy, Xy], axis=1)


def is_consistent_between_sessions(model: WhitenedModel, s: ScoredHypothesis) -> bool:
    """False where a law holds on one day and not on another."""
    if s.whitened.hypothesis.family in SESSION_DEPENDENT_FAMILIES or s.whitened.hypothesis.varies_between_sessions:
        return True
    share = compute_session_transfer(model, s)
    return bool(np.isnan(share) or share > thresholds.DETECTION.another_day)
