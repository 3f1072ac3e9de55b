"""The one evaluation on groups that no step saw: the whole search again without them, then its predictions of them."""

from __future__ import annotations

import numpy as np

from machopt.diagnose import calibrated
from machopt.diagnose.evidence import heldout
from machopt.diagnose.evidence.grams import base_model, tried
from machopt.diagnose.evidence.whitening import whitening
from machopt.diagnose.nouns.result import Proof
from machopt.diagnose.search.select import with_chosen
from machopt.diagnose.search.state import State
from machopt.diagnose.search.together import searched

FLIPS = 4096


def prove(state: State, most: int, rng: np.random.Generator) -> Proof | None:
    """Lock some groups away, search among the rest, predict what was locked away.

    Returns:
        None where there are too few groups to spare any.
    """
    problem = state.problem
    groups = np.unique(problem.group)
    if len(groups) < calibrated.PROOF.fewest_groups:
        return None
    locked = np.sort(rng.choice(groups, max(2, round(calibrated.PROOF.locked * len(groups))), replace=False))
    away = np.isin(problem.group, locked)
    used = state.used & ~away
    w = whitening(problem, state.noise, used)
    base, unit = base_model(problem, w, rng)
    fits = 1.0 if state.noise.replicated else np.nan
    _, chosen = searched(base, tried(base, state.catalogue.hypotheses), most, rng, fits)
    parts = [problem.base, *(c.tried.hypothesis.columns(c.tried.shapes[c.scored.shape]) for c in chosen)]
    scale = np.concatenate([unit, *(c.tried.unit[c.scored.shape] for c in chosen)])
    x = with_chosen(base, chosen).coefficients * scale
    before = problem.y - problem.base @ (base.coefficients * unit)
    after = problem.y - np.concatenate(parts, axis=2) @ x
    seen = state.used & away
    each = heldout.by_group(problem, (before, after), seen)[0][np.isin(groups, locked)]
    won = each[:, 0] ** 2 - each[:, 1] ** 2
    won = won[np.isfinite(won)]
    signs = rng.choice([-1.0, 1.0], (FLIPS, len(won)))
    p = float((1 + np.sum(signs @ won >= won.sum())) / (FLIPS + 1)) if len(won) else float("nan")
    return Proof(
        groups=locked,
        before=heldout.rmse(problem, before, seen),
        after=heldout.rmse(problem, after, seen),
        noise_floor=heldout.floor(problem, state.noise, seen),
        wins=int((won > 0).sum()),
        of=len(won),
        p_value=p,
    )
