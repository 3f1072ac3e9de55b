"""Whether what one session shows, the others show too: physics of a robot does not stay away for a day."""

from __future__ import annotations

import numpy as np

from machopt.diagnose import calibrated
from machopt.diagnose.evidence.grams import Model, ridged_inverse
from machopt.diagnose.search.screen import Scored

BY_DAY = ("environment",)  # families that may well be another each day


def transferred(model: Model, s: Scored) -> float:
    """Gain of a law on each session with model and coefficients from the others, per gain on all; NaN: not to be told.

    It cannot be told of a single session, nor where one has too few groups to fit anything by. What of the base only
    the session itself can tell, as the stand of a tracker that was moved for it, is fitted to it with and without the
    law alike: the others say nothing of it.
    """
    w = model.w
    days, day = np.unique(w.session, return_inverse=True)
    groups = [len(np.unique(w.group_of_visit[day == d])) for d in range(len(days))]
    if len(days) < 2 or min(groups) < calibrated.PROOF.fewest_groups or s.gain <= 0.0:
        return float("nan")
    full, P = model.with_columns(s.tried.at(s.shape)), model.X.shape[1]
    H, h = full.normal, full.Xy.sum(axis=0)
    total = 0.0
    for d in range(len(days)):
        here = np.repeat(day == d, np.diff(w.visit_starts))
        X, y = full.X[here], full.y[here]
        XX, Xy = X.T @ X, X.T @ y
        own = X[:, :P].any(axis=0) & ~full.X[~here, :P].any(axis=0)
        Q = np.linalg.qr(X[:, :P][:, own])[0]  # what is left of a session beside what it alone can tell
        rest, left = X - Q @ (Q.T @ X), y - Q @ (Q.T @ y)
        SS, Sy = rest.T @ rest, rest.T @ left
        losses = []
        for k in (P, len(h)):
            x = ridged_inverse((H - XX)[:k, :k]) @ (h - Xy)[:k]
            losses.append(float(x @ SS[:k, :k] @ x - 2.0 * x @ Sy[:k]))
        total += losses[0] - losses[1]
    return total / s.gain


def comes_again(model: Model, s: Scored) -> bool:
    """False where a law holds on one day and not on another."""
    if s.tried.hypothesis.family in BY_DAY or s.tried.hypothesis.daily:
        return True
    share = transferred(model, s)
    return bool(np.isnan(share) or share > calibrated.DETECTION.another_day)
