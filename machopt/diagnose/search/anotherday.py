"""Whether what one session shows, the others show too: physics of a robot does not stay away for a day."""

from __future__ import annotations

import numpy as np

from machopt.arrays import Array
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
    days = model.days
    if len(days.rows) < 2 or days.groups < calibrated.PROOF.fewest_groups or s.gain <= 0.0:
        return float("nan")
    XX, Xy = _with(model, s.tried.at(s.shape))
    H, h = XX.sum(axis=0), Xy.sum(axis=0)
    P = model.count
    H[:P, :P] += np.diag(model.prior)
    there = np.diagonal(days.XX, axis1=1, axis2=2) > 0.0
    total = 0.0
    for d in range(len(XX)):
        own = np.flatnonzero(there[d] & (there.sum(axis=0) == 1))
        # what is left of a session beside what it alone can tell
        B = XX[d][:, own] @ ridged_inverse(XX[d][np.ix_(own, own)])
        SS, Sy = XX[d] - B @ XX[d][own], Xy[d] - B @ Xy[d][own]
        losses = []
        for k in (P, len(h)):
            x = ridged_inverse((H - XX[d])[:k, :k]) @ (h - Xy[d])[:k]
            losses.append(float(x @ SS[:k, :k] @ x - 2.0 * x @ Sy[:k]))
        total += losses[0] - losses[1]
    return total / s.gain


def _with(model: Model, law: Array) -> tuple[Array, Array]:
    """Sums by session (D, P + p, P + p) and (D, P + p) of a model's columns and a law's (M, p)."""
    days = model.days
    own = [law[r] for r in days.rows]
    C = np.stack([x.T @ model.X[r] for x, r in zip(own, days.rows, strict=True)])
    upper = np.concatenate([days.XX, np.swapaxes(C, 1, 2)], axis=2)
    lower = np.concatenate([C, np.stack([x.T @ x for x in own])], axis=2)
    Xy = np.stack([x.T @ model.y[r] for x, r in zip(own, days.rows, strict=True)])
    return np.concatenate([upper, lower], axis=1), np.concatenate([days.Xy, Xy], axis=1)


def comes_again(model: Model, s: Scored) -> bool:
    """False where a law holds on one day and not on another."""
    if s.tried.hypothesis.family in BY_DAY or s.tried.hypothesis.daily:
        return True
    share = transferred(model, s)
    return bool(np.isnan(share) or share > calibrated.DETECTION.another_day)
