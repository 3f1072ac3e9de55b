"""The one evaluation on groups that no step saw: the whole search again without them, then its predictions of them."""

from __future__ import annotations

import numpy as np

from machopt.measurement.diagnosis import thresholds
from machopt.measurement.diagnosis.data_types.diagnosis_result import HoldoutProof
from machopt.measurement.diagnosis.model_selection.search.forward_selection import add_selected_effects
from machopt.measurement.diagnosis.model_selection.search.joint_selection import search_effects
from machopt.measurement.diagnosis.model_selection.search.search_state import SearchState
from machopt.measurement.diagnosis.statistics import holdout_residuals
from machopt.measurement.diagnosis.statistics.normal_equations_by_fold import build_base_model, whiten_hypotheses
from machopt.measurement.diagnosis.statistics.whitening import build_whitening

FLIPS = 4096


def validate_on_holdout(state: SearchState, most: int, rng: np.random.Generator) -> HoldoutProof | None:
    """Lock some groups away, search among the rest, predict what was locked away.

    Returns:
        None where there are too few groups to spare any.
    """
    problem = state.problem
    groups = np.unique(problem.group)
    if len(groups) < thresholds.PROOF.fewest_groups:
        return None
    locked = np.sort(rng.choice(groups, max(2, round(thresholds.PROOF.locked * len(groups))), replace=False))
    away = np.isin(problem.group, locked)
    used = state.used_rows & ~away
    w = build_whitening(problem, state.noise, used)
    base, unit = build_base_model(problem, w, rng)
    fits = 1.0 if state.noise.replicated else np.nan
    _, chosen = search_effects(base, whiten_hypotheses(base, state.catalogue.hypotheses), most, rng, fits)
    parts = [problem.base, *(c.whitened.hypothesis.columns(c.whitened.shapes[c.scored.shape]) for c in chosen)]
    scale = np.concatenate([unit, *(c.whitened.unit[c.scored.shape] for c in chosen)])
    x = add_selected_effects(base, chosen).coefficients * scale
    before = problem.y - problem.base @ (base.coefficients * unit)
    after = problem.y - np.concatenate(parts, axis=2) @ x
    seen = state.used_rows & away
    each = holdout_residuals.compute_rmse_by_group(problem, (before, after), seen)[0][np.isin(groups, locked)]
    won = each[:, 0] ** 2 - each[:, 1] ** 2
    won = won[np.isfinite(won)]
    signs = rng.choice([-1.0, 1.0], (FLIPS, len(won)))
    p = float((1 + np.sum(signs @ won >= won.sum())) / (FLIPS + 1)) if len(won) else float("nan")
    return HoldoutProof(
        groups=locked,
        before=holdout_residuals.compute_rmse(problem, before, seen),
        after=holdout_residuals.compute_rmse(problem, after, seen),
        noise_floor=holdout_residuals.compute_noise_floor(problem, state.noise, seen),
        wins=int((won > 0).sum()),
        of=len(won),
        p_value=p,
    )
