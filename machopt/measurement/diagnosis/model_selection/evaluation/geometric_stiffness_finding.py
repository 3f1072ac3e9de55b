"""Geometric stiffness K_C as a finding: always included in the model, reported if the recording shows it."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from scipy.special import ndtr

from machopt.data_types.stiffness import StiffnessTerm
from machopt.measurement import thresholds
from machopt.measurement.diagnosis.data_types.diagnosis_result import EstimatedValue, Finding, MismatchShare
from machopt.measurement.diagnosis.model_selection.search.search_state import SearchState
from machopt.measurement.diagnosis.model_selection.search.selected_effect import add_selected_effects
from machopt.measurement.diagnosis.statistics import holdout_residuals
from machopt.measurement.diagnosis.statistics.holdout_residuals import FittedModel
from machopt.measurement.diagnosis.statistics.normal_equations_by_fold import build_base_model, copy_folds
from machopt.numerics.array_types import Array


@dataclass(frozen=True)
class GeometricStiffnessFinding:
    """Finding on K_C, with the residuals of the base without it."""

    finding: Finding
    residual_without: Array  # (N, D) SI

    def add_to_shares(self, shares: Sequence[MismatchShare], floor: float) -> list[MismatchShare]:
        """Add the share of K_C to the shares of the mismatch and rescale the others.

        Args:
            shares: Shares of the mismatch that remains with K_C.
            floor: Noise floor in the finding's unit.

        Returns:
            Shares of the whole mismatch.
        """
        power, left = (max(e**2 - floor**2, 0.0) for e in (self.finding.before, self.finding.after))
        rest = min(left / power, 1.0) if power > 0.0 else 1.0
        own = self.finding.location
        scaled = [replace(s, share=1.0 - rest if s.axis == own else rest * s.share) for s in shares]
        return [s for s in scaled if s.share > 0.0 or s.axis == own]


def find_geometric_stiffness(state: SearchState) -> GeometricStiffnessFinding | None:
    """Build the finding on K_C if leaving it out would cost as much as the least gain of a finding.

    Args:
        state: State of the search.

    Returns:
        The finding, or None.
    """
    problem = state.problem
    if problem.subtracted_displacement is None or not problem.subtracted_displacement.any():
        return None
    columns = [k for k, u in enumerate(problem.unknowns) if u.location != "arm"]
    bare = replace(
        problem,
        y=problem.y + problem.subtracted_displacement,
        base=problem.base[:, :, columns],
        unknowns=tuple(problem.unknowns[k] for k in columns),
    )
    model, unit = build_base_model(bare, state.whitening, np.random.default_rng(0))
    model = copy_folds(model, state.base)
    alone = FittedModel(model, bare.base, unit, bare.y)
    without, best = model, add_selected_effects(state.base, state.chosen)
    for c in state.chosen:  # by columns: cached products of laws belong to another whitening
        without = without.with_columns(c.columns, c.whitened.precision(c.scored.shape))
    gain = (without.rss - best.rss) / best.residual_variance
    if gain < max(thresholds.LEVELS.min_gain, thresholds.SHARES.geometric_stiffness_gain_per_row * len(state.base.y)):
        return None
    noncentrality = np.sqrt(gain)
    share = 100.0 * float(
        np.linalg.norm(problem.subtracted_displacement[state.used_rows]) / np.linalg.norm(bare.y[state.used_rows])
    )
    before = alone.heldout()
    after = state.fit_effects(()).heldout()
    sigma = share / noncentrality
    return GeometricStiffnessFinding(
        Finding(
            effect="geometric_stiffness",
            location="arm",
            law="loaded equilibrium",
            equation="K_C of load and weight, dumas2011 eqs. 8–10, solved instead of linearised",
            note="grows with the load squared",
            one_of=(("geometric_stiffness", "arm"),),
            parameters={
                "share": EstimatedValue(
                    share,
                    "%",
                    (share - 1.645 * sigma, share + 1.645 * sigma),
                    (share - 1.96 * sigma, share + 1.96 * sigma),
                )
            },
            before=holdout_residuals.compute_rmse(problem, before, state.used_rows),
            after=holdout_residuals.compute_rmse(problem, after, state.used_rows),
            p_value=float(2 * ndtr(-noncentrality)),
            correction=StiffnessTerm("geometric_stiffness", "arm", {}),
        ),
        before,
    )
