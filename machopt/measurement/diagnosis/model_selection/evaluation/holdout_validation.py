"""Validation on held-out groups: the whole search is repeated without them, and then predicts them."""

from __future__ import annotations

import numpy as np

from machopt.measurement import thresholds
from machopt.measurement.diagnosis.data_types.diagnosis_result import HoldoutProof
from machopt.measurement.diagnosis.model_selection.search.search_stages import search_effects
from machopt.measurement.diagnosis.model_selection.search.search_state import SearchState
from machopt.measurement.diagnosis.model_selection.search.selected_effect import add_selected_effects
from machopt.measurement.diagnosis.statistics import holdout_residuals
from machopt.measurement.diagnosis.statistics.normal_equations_by_fold import build_base_model
from machopt.measurement.diagnosis.statistics.permutation_probability import compute_permutation_probability
from machopt.measurement.diagnosis.statistics.whitened_hypothesis import whiten_hypotheses
from machopt.measurement.diagnosis.statistics.whitening import build_whitening

HOLDOUT_FLIPS = 4096


def validate_on_holdout(state: SearchState, most: int, rng: np.random.Generator) -> HoldoutProof | None:
    """Hold out some groups, search on the rest, and predict the held-out groups.

    Args:
        state: State of the search.
        most: Largest number of effects.
        rng: Random generator of the sign flips.

    Returns:
        The validation; None if there are too few groups.
    """
    problem = state.problem
    groups = np.unique(problem.group)
    if len(groups) < thresholds.COUNTS.min_groups:
        return None
    locked = np.sort(rng.choice(groups, max(2, round(thresholds.SHARES.holdout * len(groups))), replace=False))
    is_locked = np.isin(problem.group, locked)
    used = state.used_rows & ~is_locked
    w = build_whitening(problem, state.noise, used)
    base, unit = build_base_model(problem, w, rng)
    fits = 1.0 if state.noise.replicated else np.nan
    _, chosen = search_effects(base, whiten_hypotheses(base, state.catalogue.hypotheses), most, rng, fits)
    parts = [problem.base, *(c.whitened.hypothesis.columns(c.whitened.shapes[c.scored.shape]) for c in chosen)]
    scale = np.concatenate([unit, *(c.whitened.unit[c.scored.shape] for c in chosen)])
    x = add_selected_effects(base, chosen).coefficients * scale
    before = problem.y - problem.base @ (base.coefficients * unit)
    after = problem.y - np.concatenate(parts, axis=2) @ x
    holdout_rows = state.used_rows & is_locked
    group_errors = holdout_residuals.compute_rmse_by_group(problem, (before, after), holdout_rows)[0][
        np.isin(groups, locked)
    ]
    improvement = group_errors[:, 0] ** 2 - group_errors[:, 1] ** 2
    improvement = improvement[np.isfinite(improvement)]
    signs = rng.choice([-1.0, 1.0], (HOLDOUT_FLIPS, len(improvement)))
    p = float("nan")
    if len(improvement):
        size = float(np.abs(improvement).sum())
        p = compute_permutation_probability(signs @ improvement, float(improvement.sum()), size)
    return HoldoutProof(
        groups=locked,
        before=holdout_residuals.compute_rmse(problem, before, holdout_rows),
        after=holdout_residuals.compute_rmse(problem, after, holdout_rows),
        noise_floor=holdout_residuals.compute_noise_floor(problem, state.noise, holdout_rows),
        wins=int((improvement > 0).sum()),
        of=len(improvement),
        p_value=p,
    )
