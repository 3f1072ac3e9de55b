"""Transfer between sessions: a robot effect found in one session must be present in the others."""

from __future__ import annotations

import numpy as np

from machopt.measurement import thresholds
from machopt.measurement.diagnosis.model_selection.screening.hypothesis_screening import ScoredHypothesis
from machopt.measurement.diagnosis.statistics.normal_equations_by_fold import WhitenedModel, invert_with_ridge
from machopt.numerics.array_types import Array

SESSION_DEPENDENT_FAMILIES = ("environment",)  # families that may differ between sessions


def compute_session_transfer(model: WhitenedModel, s: ScoredHypothesis) -> float:
    """Compute the gain of a law on each session with model and coefficients of the other sessions, relative to its
    gain.

    Base unknowns that only one session determines, such as a moved tracker, are fitted to that session with and
    without the law.

    Args:
        model: Whitened model.
        s: Scored hypothesis.

    Returns:
        Ratio of gains; NaN for a single session, or if a session has too few groups.
    """
    session_sums = model.by_session
    if len(session_sums.rows) < 2 or session_sums.groups < thresholds.COUNTS.min_groups or s.gain <= 0.0:
        return float("nan")
    XX, Xy = _add_law_columns(model, s.whitened.columns_at(s.shape))
    H, h = XX.sum(axis=0), Xy.sum(axis=0)
    P = model.count
    H[:P, :P] += np.diag(model.prior)
    is_present = np.diagonal(session_sums.XX, axis1=1, axis2=2) > 0.0
    total = 0.0
    for d in range(len(XX)):
        session_unknowns = np.flatnonzero(is_present[d] & (is_present.sum(axis=0) == 1))
        # eliminate the unknowns that only this session determines
        B = XX[d][:, session_unknowns] @ invert_with_ridge(XX[d][np.ix_(session_unknowns, session_unknowns)])
        SS, Sy = XX[d] - B @ XX[d][session_unknowns], Xy[d] - B @ Xy[d][session_unknowns]
        losses = []
        for k in (P, len(h)):
            x = invert_with_ridge((H - XX[d])[:k, :k]) @ (h - Xy[d])[:k]
            losses.append(float(x @ SS[:k, :k] @ x - 2.0 * x @ Sy[:k]))
        total += losses[0] - losses[1]
    return total / s.gain


def _add_law_columns(model: WhitenedModel, law: Array) -> tuple[Array, Array]:
    """Return sums by session (D, P + p, P + p) and (D, P + p) of a model's columns and a law's (M, p)."""
    days = model.by_session
    own = [law[r] for r in days.rows]
    C = np.stack([x.T @ model.X[r] for x, r in zip(own, days.rows, strict=True)])
    upper = np.concatenate([days.XX, np.swapaxes(C, 1, 2)], axis=2)
    lower = np.concatenate([C, np.stack([x.T @ x for x in own])], axis=2)
    Xy = np.stack([x.T @ model.y[r] for x, r in zip(own, days.rows, strict=True)])
    return np.concatenate([upper, lower], axis=1), np.concatenate([days.Xy, Xy], axis=1)


def is_consistent_between_sessions(model: WhitenedModel, s: ScoredHypothesis) -> bool:
    """Return whether a law is present in all sessions.

    Args:
        model: Whitened model.
        s: Scored hypothesis.

    Returns:
        False if another session contradicts it.
    """
    if s.whitened.hypothesis.family in SESSION_DEPENDENT_FAMILIES or s.whitened.hypothesis.varies_between_sessions:
        return True
    share = compute_session_transfer(model, s)
    return bool(np.isnan(share) or share > thresholds.SHARES.min_transfer)
